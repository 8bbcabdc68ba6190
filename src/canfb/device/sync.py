"""SYNC and TIME: 1005h, 1006h, 1007h, 1019h (CiA 301, 7.2.5), and 1012h (7.2.6).

`Sync.handle` keeps one order: the program takes over the synchronous RPDOs and acts on the new interval
(`ProcessData.synchronise`, whose result says whether TPDOs follow); synchronous TPDOs are sent; then
`tpdos_sampled`. The CAN-ID cannot change while the device produces SYNC, the counter not while 1006h is set
(7.5.2.5 to 7.5.2.22).
"""

from __future__ import annotations

from collections.abc import Callable

from canfb.cia301 import cob
from canfb.cia301.codes import AbortCode, EmergencyCode, ErrorRegister, SdoAbort
from canfb.cia301.frame import Frame
from canfb.device.core import NEVER, REVOKED, Core, Routes, Timed
from canfb.device.pdo.mapping import Direction, numbers
from canfb.device.pdo.rpdo import Rpdo
from canfb.device.pdo.tpdo import Tpdo

_SYNC_OBJECT = 0x1005
_LONGEST_COUNTER = 240


class Pdos:
    """The RPDOs and TPDOs, by their numbers."""

    def __init__(self, core: Core) -> None:
        self.rpdos = {number: Rpdo(core, number) for number in numbers(core.dictionary, Direction.RECEIVE)}
        self.tpdos = {number: Tpdo(core, number) for number in numbers(core.dictionary, Direction.TRANSMIT)}
        self.operational = False
        self.sync_rpdos: list[Rpdo] = []
        self.send: list[Callable[[float, int | None], None]] = []  # `at_sync` of the synchronous TPDOs.

    def enable(self, operational: bool, now: float) -> None:
        self.operational = operational
        for rpdo in self.rpdos.values():
            rpdo.enable(operational, now)
        for tpdo in self.tpdos.values():
            tpdo.enable(operational, now)

    def forget_sampled(self) -> None:
        for tpdo in self.tpdos.values():
            tpdo.sampled = None

    def add_routes(self, routes: Routes) -> None:
        for rpdo in self.rpdos.values():
            routes.add(rpdo.can_id, rpdo.handle)
        for tpdo in self.tpdos.values():
            routes.remote[tpdo.remote_can_id] = tpdo.request
            if tpdo.is_inhibited:
                routes.sent[tpdo.parameters.configured_can_id] = tpdo.sent

    def choose(self) -> None:
        self.sync_rpdos = [rpdo for rpdo in self.rpdos.values() if rpdo.is_synchronous]
        self.send = [tpdo.at_sync for tpdo in self.tpdos.values() if tpdo.is_synchronous]


class Sync(Timed):
    """SYNC consumer and producer.

    A SYNC of the wrong length gives EMCY 8240h once and is ignored. A producer ignores the SYNCs of others;
    it sends its first SYNC one period after the start, with counter 1.
    """

    def __init__(self, core: Core, pdos: Pdos) -> None:
        dictionary = core.dictionary
        self._core = core
        self._pdos = pdos
        self._cob_id = dictionary.assumed(0x1005, value=cob.SYNC)
        self._period = dictionary.assumed(0x1006)
        self._window = dictionary.assumed(0x1007)
        self._overflow = dictionary.assumed(0x1019)
        self._enabled = False
        self._counter = 0
        self._cob_id.on_check = lambda value: cob.check(
            value, self._cob_id.value, lambda cob_id: cob_id & cob.GENERATE, always_named=True
        )
        self._overflow.on_check = self._check_overflow
        self._cob_id.on_written = self._period.on_written = self._restart
        self._window.on_written = self._overflow.on_written = self._read
        self.configure()

    def configure(self) -> None:
        self._length_error = False
        self._read()

    def enable(self, enabled: bool, now: float) -> None:
        if enabled != self._enabled:
            self._enabled = enabled
            self._core.window_end = NEVER
            self._start(now)

    def handle(self, data: bytes, now: float) -> None:
        if (self._length_error or len(data) != self._length) and not self._has_length(data, now):
            return
        counter = data[0] if data else None
        core, pdos = self._core, self._pdos
        if core.window_s:
            core.window_end = core.call.received + core.window_s
        process = core.process
        if not pdos.operational:
            process.idle_sync_received(counter)
            return
        follow = process.synchronise(counter, now, pdos.sync_rpdos)
        if follow:
            for send in pdos.send:
                send(now, counter)
            if follow == REVOKED:
                process.tpdos_sampled()

    def drop(self, data: bytes, now: float) -> None:
        self._core.counters.malformed_frames += 1

    def _has_length(self, data: bytes, now: float) -> bool:
        self._length_error = wrong = len(data) != self._length
        if wrong:
            self._core.counters.malformed_frames += 1
            code, length = EmergencyCode.SYNC_LENGTH, bytes([len(data)])
            self._core.emergency.report(code, ErrorRegister.COMMUNICATION, length, now, _SYNC_OBJECT)
        else:
            self._core.emergency.clear(EmergencyCode.SYNC_LENGTH, now, _SYNC_OBJECT)
        return not wrong

    def tick(self, now: float) -> None:
        """Produce the SYNC that is due."""
        self.repeat(now, self._period_s)
        data = b""
        if self._length:
            self._counter = self._counter % self._overflow.value + 1
            data = bytes([self._counter])
        self._core.emit(Frame(self.can_id, data))
        self.handle(data, now)

    @property
    def _period_s(self) -> float:
        return float(self._period.value / 1e6)

    def _read(self) -> None:
        self.can_id = int(self._cob_id.value & cob.CAN_ID)
        self.generates = bool(self._cob_id.value & cob.GENERATE) and self._period_s > 0
        self._length = 1 if self._overflow.value > 1 else 0
        self._core.window_s = self._window.value / 1e6
        if not self._core.window_s:
            self._core.window_end = NEVER

    def _start(self, now: float) -> None:
        self._counter = 0
        self.deadline = now + self._period_s if self._enabled and self.generates else NEVER

    def _restart(self) -> None:
        self._read()
        self._start(self._core.call.now)
        self._core.reactions.routes_changed()

    def _check_overflow(self, value: int) -> None:
        if value == 1 or value > _LONGEST_COUNTER:
            raise SdoAbort(AbortCode.INVALID_VALUE)
        if self._period.value and value != self._overflow.value:
            raise SdoAbort(AbortCode.DEVICE_STATE)


MILLISECONDS_PER_DAY = 86_400_000
CONSUME = 1 << 31  # Bit 31 of 1012h: the device listens to TIME.
PRODUCE = 1 << 30  # Bit 30 of 1012h: the device produces TIME; not supported here.

_TIME_LENGTH = 6
_MILLISECOND_BITS = 0x0FFFFFFF


class TimeStamp:
    """TIME consumer: passes the time of day to the program."""

    def __init__(self, core: Core) -> None:
        self._entry = entry = core.dictionary.assumed(0x1012)
        self._core = core
        entry.on_check = lambda value: cob.check(
            value, entry.value, lambda cob_id: cob_id & CONSUME, always_named=True, reserved=PRODUCE
        )
        entry.on_written = core.reactions.routes_changed

    @property
    def can_id(self) -> int | None:
        value: int = self._entry.value
        return value & cob.CAN_ID if value & CONSUME else None

    def handle(self, data: bytes, now: float) -> None:
        milliseconds = int.from_bytes(data[:4], "little") & _MILLISECOND_BITS
        if len(data) != _TIME_LENGTH or milliseconds >= MILLISECONDS_PER_DAY:
            self._core.counters.malformed_frames += 1
            return
        self._core.application.time_received(int.from_bytes(data[4:], "little"), milliseconds, now)
