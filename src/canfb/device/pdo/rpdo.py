"""Receive PDOs (CiA 301, 7.2.2): from the frame into the dictionary.

| type, 14xxh:02 | takes effect |
| --- | --- |
| 0 to F0h | at the next SYNC, if received within the window of 1007h; the last of several counts |
| FEh, FFh | at once |

The mapping is compiled once (:func:`unpacker`): a sample costs one `struct` call and an assignment for each
value.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from canfb.cia301 import datatypes
from canfb.cia301.codes import EmergencyCode, ErrorRegister
from canfb.device.core import NEVER, Core, Timed
from canfb.device.od.dictionary import is_accepted
from canfb.device.pdo.mapping import SYNCHRONOUS, Direction, PdoParameters, Slot, struct_of

Unpack = Callable[[bytes], int]

# The errors that an RPDO of the mapped length clears.
ERRORS = (EmergencyCode.RPDO_LENGTH, EmergencyCode.RPDO_LENGTH_EXCEEDED, EmergencyCode.RPDO_TIMEOUT)


class Rpdo(Timed):
    """Takes data into the dictionary.

    A PDO that is too short is dropped (EMCY 8210h), one that is too long is used as far as mapped
    (8220h). Sub-index 5 is the time-out in milliseconds, from the first PDO on (8250h). Each error is
    reported once; a PDO of the mapped length ends it.
    """

    def __init__(self, core: Core, number: int) -> None:
        self.number = number
        self._source = "RPDO", number
        self._core = core
        self._counters = core.counters
        self.parameters = PdoParameters(core.dictionary, number, Direction.RECEIVE, self._written)
        self._timeout = self.parameters.further(5)
        self._timeout.on_written = self._written
        self._failed = False
        self.enable(False, 0.0)

    def holds(self, objects: Iterable[tuple[int, int]]) -> bool:
        """Whether it is valid and maps these objects."""
        mapped = {mapping >> 8 for mapping in self.parameters.mappings}
        return self.parameters.is_valid and {index << 8 | sub for index, sub in objects} <= mapped

    @property
    def can_id(self) -> int | None:
        return self.parameters.can_id if self._length else None

    def enable(self, operational: bool, now: float) -> None:
        self._operational = operational
        slots = self.parameters.active_slots() if operational else []
        self._length = length_of(slots)
        self._unpack = unpacker(slots)
        self.is_synchronous: bool = self.parameters.type.value in SYNCHRONOUS
        self._timeout_s: float = self._timeout.value / 1000
        # Number of synchronous PDOs since the last SYNC; the next SYNC takes over the last one, `_pending`.
        self.waiting = 0
        self.deadline = NEVER
        self._choose_usual()

    def handle(self, data: bytes, now: float) -> None:
        if len(data) != self._usual_length and not self._look_closely(data, now):
            return
        refused = self._unpack(data)
        if refused:
            self._counters.refused_rpdo_values += refused
        self._core.process.rpdo_received(self.number, now)

    def _look_closely(self, data: bytes, now: float) -> bool:
        """The unusual cases of `handle`. False: do not take the PDO over now."""
        received, mapped = len(data), self._length
        if received < mapped:
            self._counters.short_rpdos += 1
            self._report(EmergencyCode.RPDO_LENGTH, bytes([self.number & 0xFF, received, mapped]), now)
            self._clear(EmergencyCode.RPDO_LENGTH_EXCEEDED, now)
            self._core.process.rpdo_too_short(self.number, received, mapped, now)
            return False
        if received > mapped:
            self._counters.long_rpdos += 1
            detail = bytes([self.number & 0xFF, received, mapped])
            self._report(EmergencyCode.RPDO_LENGTH_EXCEEDED, detail, now)
            self._clear(EmergencyCode.RPDO_LENGTH, now)
            self._clear(EmergencyCode.RPDO_TIMEOUT, now)
        elif self._failed:
            self._clear_errors(now)
        self.deadline = now + self._timeout_s if self._timeout_s else NEVER
        if not self.is_synchronous:
            return True
        if self._core.call.received <= self._core.window_end:
            self._pending = data
            self.waiting += 1
        else:
            self._counters.late_rpdos += 1
        return False

    def synchronise(self, now: float) -> None:
        waiting, self.waiting = self.waiting, 0
        if waiting:
            self._counters.refused_rpdo_values += self._unpack(self._pending)
            self._core.process.rpdo_received(self.number, now)

    def tick(self, now: float) -> None:
        self.deadline = NEVER
        self._report(EmergencyCode.RPDO_TIMEOUT, bytes([self.number & 0xFF]), now)

    def _report(self, code: EmergencyCode, manufacturer: bytes, now: float) -> None:
        self._failed = True
        self._choose_usual()
        self._core.emergency.report(code, ErrorRegister.COMMUNICATION, manufacturer, now, self._source)

    def _choose_usual(self) -> None:
        """Set the length, bytes, of PDOs that `handle` takes over at once; -1: none."""
        supervised = self._failed or self._timeout_s > 0
        self._usual_length = -1 if supervised or self.is_synchronous else self._length

    def _clear_errors(self, now: float) -> None:
        self._failed = False
        self._choose_usual()
        for code in ERRORS:
            self._clear(code, now)

    def _clear(self, code: EmergencyCode, now: float) -> None:
        self._core.emergency.clear(code, now, self._source)

    def _written(self) -> None:
        now = self._core.call.now
        self._clear_errors(now)
        self.enable(self._operational, now)
        self._core.reactions.pdo_changed()


def length_of(slots: Sequence[Slot]) -> int:
    return (sum(slot.bits for slot in slots) + 7) // 8


def unpacker(slots: Sequence[Slot]) -> Unpack:
    """A function that stores the data of a PDO and returns the number of refused values.

    The data must have the mapped length or more. Limits and hooks of the entries are evaluated now only.
    """
    entries = tuple(slot.entry for slot in slots if slot.entry is not None)
    whole = struct_of(slots)
    if whole is None:
        return bit_unpacker(slots)
    unpack = whole.unpack_from

    def unpack_any(data: bytes) -> int:
        return sum(
            not is_accepted(entry.store, value) for entry, value in zip(entries, unpack(data), strict=True)
        )

    def unpack_plain(data: bytes) -> int:
        for entry, value in zip(entries, unpack(data), strict=True):
            entry.value = value
        return 0

    if any((one.low, one.high, one.on_check, one.on_written) != (None,) * 4 for one in entries):
        return unpack_any
    if len(entries) not in (2, 3):
        return unpack_plain
    first, second, third = (entries * 2)[:3]

    def unpack_two(data: bytes) -> int:
        first.value, second.value = unpack(data)
        return 0

    def unpack_three(data: bytes) -> int:
        first.value, second.value, third.value = unpack(data)
        return 0

    return unpack_two if len(entries) == 2 else unpack_three


def bit_unpacker(slots: Sequence[Slot]) -> Unpack:
    """An `unpacker` for objects of any bit length."""

    def unpack(data: bytes) -> int:
        word = int.from_bytes(data, "little")
        refused = 0
        for slot in slots:
            if slot.entry is not None:
                raw = (word & (1 << slot.bits) - 1).to_bytes((slot.bits + 7) // 8, "little")
                refused += not is_accepted(slot.entry.store, datatypes.decode(slot.data_type, raw))
            word >>= slot.bits
        return refused

    return unpack
