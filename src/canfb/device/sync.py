"""SYNC consumer and producer: 1005h, 1006h, 1007h, 1019h (CiA 301, 7.2.5)."""

from __future__ import annotations

from typing import Any

from canfb.cia301 import cob
from canfb.cia301.codes import AbortCode, EmergencyCode, ErrorRegister, SdoAbort
from canfb.cia301.frame import Frame
from canfb.device.agenda import Timed
from canfb.device.core import Core
from canfb.device.moment import NEVER
from canfb.device.pdo.pdos import Pdos

_SOURCE = 0x1005
_DEFAULT_COB_ID = 0x080
_LONGEST_COUNTER = 240


class Sync(Timed):
    """SYNC as the node sees it; it goes to the `pdos`.

    The counter is None while 1019h is 0. A SYNC of the wrong length gives EMCY 8240h once and does
    not count as a SYNC. A node that produces SYNC acts on its own and drops what others send on
    the same CAN-ID. The first own SYNC comes one period after the start, with counter 1.
    """

    def __init__(self, core: Core, pdos: Pdos) -> None:
        dictionary = core.dictionary
        self.deadline = NEVER
        self.can_id = _DEFAULT_COB_ID
        self._core = core
        self._emit = core.emit
        self._counters = core.counters
        self._emergency = core.emergency
        self._pdos = pdos
        self._cob_id = dictionary.find(0x1005)
        self._period = dictionary.find(0x1006)
        self._window = dictionary.find(0x1007)
        self._overflow = dictionary.find(0x1019)
        self._enabled = False
        self._generates = False
        self._length = 0
        self._length_error = False
        core.window_s, core.window_end = 0.0, NEVER
        self._counter = 0
        self._install()
        self._read()

    def configure(self) -> None:
        """Read the parameters again, after a reset."""
        self._core.window_end = NEVER
        self._length_error = False
        self._read()

    def enable(self, enabled: bool, now: float) -> None:
        """Whether the NMT state allows SYNC; a producer starts or stops."""
        if enabled != self._enabled:
            self._enabled = enabled
            self._core.window_end = NEVER
            self._start(now)

    def handle(self, data: bytes, now: float) -> None:
        """A SYNC from the bus."""
        if self._generates:
            self._counters.malformed_frames += 1
        elif len(data) != self._length:
            self._refuse(len(data), now)
        else:
            if self._length_error:
                self._clear_length_error(now)
            self._pdos.synchronise(data[0] if data else None, now)

    def _refuse(self, length: int, now: float) -> None:
        self._length_error = True
        self._counters.malformed_frames += 1
        self._emergency.report(
            EmergencyCode.SYNC_LENGTH, ErrorRegister.COMMUNICATION, bytes([length]), now, _SOURCE
        )

    def tick(self, now: float) -> None:
        """Produce the SYNC that is due; periods missed by a late tick are left out."""
        if now < self.deadline:
            return
        period = self._period_s
        following = self.deadline + period
        self.deadline = following if following > now else now + period
        if self._length:
            self._counter = self._counter % self._value(self._overflow) + 1
            self._emit(Frame(self.can_id, bytes([self._counter])))
            self._pdos.synchronise(self._counter, now)
        else:
            self._emit(Frame(self.can_id, b""))
            self._pdos.synchronise(None, now)

    def _clear_length_error(self, now: float) -> None:
        self._length_error = False
        self._emergency.clear(EmergencyCode.SYNC_LENGTH, now, _SOURCE)

    @property
    def _period_s(self) -> float:
        return self._value(self._period) / 1e6

    def _value(self, entry: Any) -> int:
        return 0 if entry is None else int(entry.value)

    def _read(self) -> None:
        cob_id = _DEFAULT_COB_ID if self._cob_id is None else self._cob_id.value
        self.can_id = cob_id & cob.CAN_ID
        self._generates = bool(cob_id & cob.GENERATE) and self._period_s > 0
        self._length = 1 if self._value(self._overflow) > 1 else 0
        self._core.window_s = self._value(self._window) / 1e6
        if not self._core.window_s:
            self._core.window_end = NEVER

    def _start(self, now: float) -> None:
        self._counter = 0
        running = self._enabled and self._generates
        self.deadline = now + self._period_s if running else NEVER

    def _install(self) -> None:
        if self._cob_id is not None:
            self._cob_id.on_check = self._check_cob_id
        if self._overflow is not None:
            self._overflow.on_check = self._check_overflow
        for entry in (self._cob_id, self._period):
            if entry is not None:
                entry.on_written = self._restart
        for entry in (self._window, self._overflow):
            if entry is not None:
                entry.on_written = self._read

    def _restart(self) -> None:
        self._read()
        self._start(self._core.moment.now)
        self._core.reactions.routes_changed()

    def _check_cob_id(self, value: int) -> None:
        old = _DEFAULT_COB_ID if self._cob_id is None else self._cob_id.value
        if cob.is_restricted(value & cob.CAN_ID):
            raise SdoAbort(AbortCode.INVALID_VALUE)
        cob.check(
            value,
            old,
            uses_new=bool(value & cob.GENERATE),
            uses_old=bool(old & cob.GENERATE),
        )

    def _check_overflow(self, value: int) -> None:
        if value == 1 or value > _LONGEST_COUNTER:
            raise SdoAbort(AbortCode.INVALID_VALUE)
        if self._value(self._period) and value != self._value(self._overflow):
            raise SdoAbort(AbortCode.DEVICE_STATE)
