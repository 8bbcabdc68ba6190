"""Transmit PDOs (CiA 301, 7.2.2): from the dictionary into a frame.

| type, 18xxh:02 | is sent |
| --- | --- |
| 0 | at the SYNC after an event |
| 1 to F0h | at every n-th SYNC; with a counter (1019h) from the SYNC whose counter is sub-index 6 |
| FCh | on a remote frame, as sampled at the last SYNC |
| FDh | on a remote frame |
| FEh, FFh | at an event, not before the inhibit time is over, and when the event timer expires |

An event calls `Tpdo.at_event`, a SYNC `at_sync`: each is `send` itself if no condition remains to be checked.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence

from canfb.cia301.frame import Frame
from canfb.device.core import NEVER, Core, Timed
from canfb.device.od.dictionary import Entry, refuse_if
from canfb.device.pdo.mapping import (
    EVENT_DRIVEN,
    SYNC_REMOTE,
    SYNCHRONOUS,
    Direction,
    PdoParameters,
    Slot,
    struct_of,
)

Pack = Callable[[], bytes]
UNFIT = (struct.error, OverflowError)  # What `struct` raises for a value that does not fit.

_LARGEST_START = 240
_new = tuple.__new__  # makes a named tuple in half the time that its own constructor takes


class Tpdo(Timed):
    """Samples the dictionary and sends it.

    A remote frame requests any TPDO whose COB-ID has bit 30 = 0. Sub-index 3 is the inhibit time (100 us), 5
    the event timer (ms). Synchronous TPDOs are sent with the SYNC itself, always within the window
    of 1007h.
    """

    def __init__(self, core: Core, number: int) -> None:
        self._core = core
        self._emit = core.emit
        self.parameters = PdoParameters(core.dictionary, number, Direction.TRANSMIT, self._written)
        self._inhibit = self.parameters.further(3)
        self._event_timer = self.parameters.further(5)
        self._start_value = self.parameters.further(6)
        self._inhibit.on_check = refuse_if(lambda value: self.parameters.is_valid)
        self._start_value.on_check = refuse_if(
            lambda value: self.parameters.is_valid or value > _LARGEST_START
        )
        self._event_timer.on_written = self._written
        self._event, self._sent_s = False, -NEVER
        self.enable(False, 0.0)

    @property
    def remote_can_id(self) -> int | None:
        return self._can_id if self._is_active and self.parameters.allows_remote else None

    @property
    def is_synchronous(self) -> bool:
        return self._is_active and (self._type in SYNCHRONOUS or self._type == SYNC_REMOTE)

    @property
    def takes_events(self) -> bool:
        return self._event_driven or (self._is_active and self._type == 0)

    def enable(self, operational: bool, now: float) -> None:
        """Activate the TPDO if `operational`; compile the mapping."""
        self._operational = operational
        slots = self.parameters.active_slots() if operational else []
        self._pack, self._is_active = packer(slots), bool(slots)
        self._can_id = self.parameters.can_id
        self._type: int = self.parameters.type.value
        self._event_driven = self._is_active and self._type in EVENT_DRIVEN
        self._inhibit_s: float = self._inhibit.value / 10_000
        self._timer_s: float = self._event_timer.value / 1000 if self._event_driven else 0.0
        self.is_inhibited = self._event_driven and self._inhibit_s > 0
        self._event &= self._is_active  # a waiting event outlasts a write to the type or a timer
        self._limited = self._inhibit_s > 0 or self._timer_s > 0 or self._event
        self.at_event = self.send if self._event_driven and not self._limited else self.trigger
        self._timer_end = now + self._timer_s if self._timer_s else NEVER
        self._waits_for_start = self._start_value.value > 0
        self.at_sync = self.send if self._type == 1 and not self._waits_for_start else self.synchronise
        self._syncs = 0
        self.sampled: bytes | None = None  # at the last SYNC, for a remote request
        self._schedule()

    @property
    def _free_s(self) -> float:
        return self._sent_s + self._inhibit_s

    def trigger(self, now: float) -> None:
        if self._event_driven and now >= self._free_s:
            self.send(now)
        elif self._is_active:
            self._event = True
            self._schedule()

    def synchronise(self, now: float, counter: int | None) -> None:
        if self._type == SYNC_REMOTE:
            self.sampled = self._pack()
        elif self._is_turn(counter):
            self.send(now)

    def send(self, now: float, counter: int | None = None) -> None:
        """Sample and send it; only while it is active."""
        self._emit(_new(Frame, (self._can_id, self._pack(), False, None)))
        if self._limited:
            self._restart(now)

    def request(self, now: float) -> None:
        if self._type == SYNC_REMOTE:
            if self.sampled is not None:
                self._emit(Frame(self._can_id, self.sampled))
        elif self._event_driven:
            self.trigger(now)
        else:
            self.send(now)

    def sent(self, now: float) -> None:
        """It left at `now`: the inhibit time starts. Called only if `is_inhibited`."""
        self._sent_s = now
        self._schedule()

    def tick(self, now: float) -> None:
        """The inhibit time of a waiting event, or the event timer, is over."""
        self._timer_end = NEVER
        self.trigger(now)

    def _is_turn(self, counter: int | None) -> bool:
        if self._type == 0:
            event, self._event = self._event, False
            return event
        if self._waits_for_start and counter is not None:
            is_turn: bool = counter == self._start_value.value
            self._waits_for_start = not is_turn
        else:
            self._syncs += 1
            is_turn = self._syncs >= self._type
        if is_turn:
            self._syncs = 0
        return is_turn

    def _restart(self, now: float) -> None:
        self._event = False
        if self.is_inhibited:
            self._sent_s = now
        if self._timer_s:
            self._timer_end = now + self._timer_s
        self._schedule()

    def _schedule(self) -> None:
        waits = self._event and self._event_driven
        self.deadline = min(self._free_s if waits else NEVER, self._timer_end)

    def _written(self) -> None:
        self.enable(self._operational, self._core.call.now)
        self._core.reactions.pdo_changed()


def packer(slots: Sequence[Slot]) -> Pack:
    """A function that packs the current values; ValueError when one does not fit its type.

    Hooks of the entries are evaluated now only.
    """
    entries = tuple(slot.entry for slot in slots if slot.entry is not None)
    whole = struct_of(slots)
    if whole is None:
        return bit_packer(slots)
    pack = whole.pack
    if any(entry.on_read for entry in entries) or len(entries) not in (1, 3):

        def pack_any() -> bytes:
            try:
                return pack(*[entry.current() for entry in entries])
            except UNFIT:
                return _encoded(entries)

        return pack_any
    first, second, third = (entries * 3)[:3]

    def pack_one() -> bytes:
        try:
            return pack(first.value)
        except UNFIT:
            return _encoded(entries)

    def pack_three() -> bytes:
        try:
            return pack(first.value, second.value, third.value)
        except UNFIT:
            return _encoded(entries)

    return pack_one if len(entries) == 1 else pack_three


def _encoded(entries: tuple[Entry, ...]) -> bytes:
    return b"".join([entry.encode() for entry in entries])  # its error names the entry


def bit_packer(slots: Sequence[Slot]) -> Pack:
    """A `packer` for any bit lengths; unused bits are 0."""
    length = (sum(slot.bits for slot in slots) + 7) // 8

    def pack() -> bytes:
        word = offset = 0
        for slot in slots:
            if slot.entry is not None:
                word |= int.from_bytes(slot.entry.encode(), "little") << offset
            offset += slot.bits
        return word.to_bytes(length, "little")

    return pack
