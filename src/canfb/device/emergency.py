"""EMCY producer with error register 1001h and error history 1003h (CiA 301, 7.2.7)."""

from __future__ import annotations

import functools
import operator
from collections import deque
from collections.abc import Hashable

from canfb.cia301 import cob
from canfb.cia301.codes import EMERGENCY, AbortCode, EmergencyCode, ErrorRegister, SdoAbort
from canfb.cia301.frame import Frame
from canfb.device.core import NEVER, Core, Timed
from canfb.device.od.dictionary import Entry, refuse_if

_WAITING = 8


class Emergency(Timed):
    """Reports an error (code and source) once until it is cleared.

    Up to eight frames wait while the inhibit time (1015h) or the NMT state forbids sending.
    """

    def __init__(self, core: Core) -> None:
        dictionary = core.dictionary
        self._core = core
        self._register = dictionary.assumed(0x1001)
        self._history_count = dictionary.assumed(0x1003)
        self._history = dictionary.without_count(0x1003)
        self._cob_id = dictionary.assumed(0x1014, value=cob.EMERGENCY + core.node_id)
        self._inhibit = dictionary.assumed(0x1015)
        self._allowed = False
        self.reset()
        self._cob_id.on_check = lambda value: cob.check(value, self._cob_id.value, reserved=cob.NO_RTR)
        self._cob_id.on_written = core.reactions.routes_changed
        self._inhibit.on_written = lambda: self.tick(core.call.now)
        self._history_count.on_check = refuse_if(bool)  # 0 clears the history
        for entry in self._history:
            entry.on_read = functools.partial(self._remembered, entry)

    @property
    def can_id(self) -> int | None:
        value = self._cob_id.value
        return int(value & cob.CAN_ID) if cob.is_valid(value) else None

    def reset(self) -> None:
        self._active: dict[tuple[int, Hashable], int] = {}
        self._waiting: deque[bytes] = deque()
        self._sent_s = -NEVER
        self._register.value = 0
        self._history_count.value = 0

    def enable(self, allowed: bool, now: float) -> None:
        self._allowed = allowed
        self.tick(now)

    def report(
        self,
        code: int,
        register_bits: int,
        manufacturer: bytes,
        now: float,
        source: Hashable = None,
        *,
        again: bool = False,
    ) -> bool:
        """Report an error in 1001h, 1003h and EMCY. False, and no report, if it is active, unless ``again``.

        `register_bits` are bits of 1001h, `manufacturer` up to 5 bytes. `source` None: the program.
        """
        key = (int(code), source)
        if key in self._active and not again:
            return False
        self._active[key] = int(register_bits | ErrorRegister.GENERIC)
        self._remember(int(code), manufacturer)
        self._send(int(code), manufacturer, now)
        return True

    def clear(self, code: int, now: float, source: Hashable = None) -> None:
        if self._active.pop((int(code), source), None) is not None:
            self._send(EmergencyCode.NO_ERROR, b"", now)

    def tick(self, now: float) -> None:
        can_id = self.can_id
        if can_id is None:
            self._waiting.clear()
        while can_id is not None and self._waiting and self._allowed and now >= self._free_s:
            data = self._waiting.popleft()
            self._core.emit(Frame(can_id, data))
            code, register, detail = EMERGENCY.unpack(data)
            self._core.application.emergency_sent(code, register, detail, now)
            self._sent_s = now
        self.deadline = self._free_s if self._waiting and self._allowed else NEVER

    def sent(self, now: float) -> None:
        """An EMCY has left: the inhibit time starts."""
        self._sent_s = now

    def _send(self, code: int, manufacturer: bytes, now: float) -> None:
        self._register.value = functools.reduce(operator.or_, self._active.values(), 0)
        if len(self._waiting) == _WAITING:
            self._waiting.popleft()
            self._core.counters.lost_emergencies += 1
        self._waiting.append(EMERGENCY.pack(code, self._register.value, manufacturer))
        self.tick(now)

    def _remember(self, code: int, manufacturer: bytes) -> None:
        newest = code | int.from_bytes(manufacturer[:2], "little") << 16
        shifted = [newest, *(entry.value for entry in self._history)]
        for entry, value in zip(self._history, shifted, strict=False):  # the oldest drops out
            entry.value = value
        self._history_count.value = min(self._history_count.value + 1, len(self._history))

    @property
    def _free_s(self) -> float:
        return self._sent_s + float(self._inhibit.value / 10_000)

    def _remembered(self, entry: Entry) -> int:
        if entry.subindex > self._history_count.value:
            raise SdoAbort(AbortCode.NO_DATA)
        return int(entry.value)
