"""One transmit PDO (CiA 301, 7.2.2)."""

from __future__ import annotations

from collections.abc import Callable

from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.cia301.frame import Frame
from canfb.device.agenda import Timed
from canfb.device.core import Core
from canfb.device.moment import NEVER
from canfb.device.od.entry import Entry
from canfb.device.pdo.mapping import Direction, Layout
from canfb.device.pdo.pdo import EVENT_DRIVEN, SYNC_REMOTE, SYNCHRONOUS, PdoParameters

_LARGEST_START = 240
_new = tuple.__new__  # makes a named tuple in half the time that its own constructor takes


class Tpdo(Timed):
    """Samples the dictionary and sends it.

    Type 0: at the SYNC after an event. 1 to F0h: at every type-th SYNC, from the one with the
    counter of sub-index 6 on. FCh: sampled at the SYNC, sent on a remote frame. FDh: on a remote
    frame. FEh, FFh: at an event, not more often than the inhibit time (sub-index 3, 100 us), and
    at the latest when the event timer (sub-index 5, ms) is over. A remote frame asks for a TPDO of
    any type whose COB-ID has bit 30 = 0; types FEh and FFh keep their inhibit time then, too.

    Synchronous TPDOs go out with the SYNC itself, so that the window of 1007h always holds.
    """

    def __init__(self, core: Core, number: int) -> None:
        self.deadline = NEVER
        self._core = core
        self._emit = core.emit
        self._parameters = PdoParameters(core.dictionary, number, Direction.TRANSMIT, self._written)
        self._inhibit = self._parameters.find(3)
        self._event_timer = self._parameters.find(5)
        self._start_value = self._parameters.find(6)
        self._install()
        self._operational = False
        self._layout: Layout | None = None
        self._pack: Callable[[], bytes] | None = None
        self._can_id = 0
        self._type = 0
        self._event_driven = False
        self._inhibit_s = 0.0
        self._timer_s = 0.0
        self._limited = False
        self._pack_at_once: Callable[[], bytes] | None = None  # at an event that nothing delays
        self._not_before = -NEVER
        self._timer_end = NEVER
        self._event = False
        self._waits_for_start = False
        self._pack_each_sync: Callable[[], bytes] | None = None
        self._syncs = 0
        self._sampled: bytes | None = None

    @property
    def remote_can_id(self) -> int | None:
        """The CAN-ID on which it answers remote frames now, None when it does not."""
        if self._layout is None or not self._parameters.allows_remote:
            return None
        return self._can_id

    @property
    def configured_can_id(self) -> int | None:
        """The CAN-ID it has, in any NMT state; None while it is not valid."""
        return self._parameters.can_id if self._parameters.is_valid else None

    @property
    def is_synchronous(self) -> bool:
        """Whether the TPDO acts at a SYNC now."""
        return self._layout is not None and (self._type in SYNCHRONOUS or self._type == SYNC_REMOTE)

    def enable(self, operational: bool, now: float) -> None:
        """Whether the NMT state allows PDOs. The mapping is compiled here."""
        self._operational = operational
        self._layout = self._parameters.layout() if operational else None
        self._pack = None if self._layout is None else self._layout.pack
        self._can_id = self._parameters.can_id
        self._type = self._parameters.type.value
        self._event_driven = self._layout is not None and self._type in EVENT_DRIVEN
        self._inhibit_s = _value(self._inhibit) / 10_000
        self._timer_s = _value(self._event_timer) / 1000 if self._event_driven else 0.0
        self._limited = self._inhibit_s > 0 or self._timer_s > 0
        self._pack_at_once = self._pack if self._event_driven and not self._limited else None
        if not self._inhibit_s:
            self._not_before = -NEVER
        self._timer_end = now + self._timer_s if self._timer_s else NEVER
        self._event = False
        self._waits_for_start = _value(self._start_value) > 0
        self._pack_each_sync = (
            self._pack if self._type == 1 and not (self._waits_for_start or self._limited) else None
        )
        self._syncs = 0
        self._sampled = None
        self._schedule()

    def trigger(self, now: float) -> None:
        """An event of the application; without effect while the TPDO is not active."""
        pack = self._pack_at_once
        if pack is not None:
            emit = self._emit
            emit(_new(Frame, (self._can_id, pack(), False, None)))
        elif self._event_driven:
            if self._limited and now < self._not_before:
                self._event = True
                self._schedule()
            else:
                self._send(now)
        elif self._layout is not None:
            self._event = True

    def synchronise(self, counter: int | None, now: float) -> None:
        """A SYNC, with its counter if it has one."""
        pack = self._pack_each_sync
        if pack is not None:
            emit = self._emit
            emit(_new(Frame, (self._can_id, pack(), False, None)))
        elif self._type == 0:
            if self._event:
                self._event = False
                self._send(now)
        elif self._type == SYNC_REMOTE:
            self._sampled = self._sample()
        elif self._is_turn(counter):
            self._send(now)

    def request(self, now: float) -> None:
        """A remote frame asks for the TPDO."""
        if self._type == SYNC_REMOTE:
            if self._sampled is not None:
                self._emit(Frame(self._can_id, self._sampled))
        elif self._event_driven:
            self.trigger(now)
        else:
            self._send(now)

    @property
    def is_inhibited(self) -> bool:
        """Whether an inhibit time holds it now."""
        return self._event_driven and self._inhibit_s > 0

    def sent(self, now: float) -> None:
        """The TPDO went onto the bus at `now`, later than given out: the inhibit time counts from here."""
        if self.is_inhibited:
            self._not_before = now + self._inhibit_s
            self._schedule()

    def tick(self, now: float) -> None:
        """Send what waited for the inhibit time, or what the event timer asks for."""
        timer_over = now >= self._timer_end
        if (self._event and self._event_driven) or timer_over:
            if now >= self._not_before:
                self._send(now)
            else:
                self._event = True
                self._timer_end = NEVER
                self._schedule()

    def _is_turn(self, counter: int | None) -> bool:
        if self._waits_for_start and counter is not None:
            if counter != _value(self._start_value):
                return False
            self._waits_for_start = False
            self._syncs = 0
            return True
        self._syncs += 1
        if self._syncs < self._type:
            return False
        self._syncs = 0
        return True

    def _sample(self) -> bytes:
        return b"" if self._layout is None else self._layout.pack()

    def _send(self, now: float) -> None:
        pack = self._pack
        if pack is None:
            return
        self._emit(_new(Frame, (self._can_id, pack(), False, None)))
        if self._limited:
            self._event = False
            if self._inhibit_s and self._event_driven:
                self._not_before = now + self._inhibit_s
            if self._timer_s:
                self._timer_end = now + self._timer_s
            self._schedule()

    def _schedule(self) -> None:
        waits = self._event and self._event_driven
        self.deadline = min(self._not_before if waits else NEVER, self._timer_end)

    def _install(self) -> None:
        if self._inhibit is not None:
            self._inhibit.on_check = self._parameters.refuse_while_valid
        if self._start_value is not None:
            self._start_value.on_check = self._check_start_value
        if self._event_timer is not None:
            self._event_timer.on_written = self._written

    def _check_start_value(self, value: int) -> None:
        self._parameters.refuse_while_valid(value)
        if value > _LARGEST_START:
            raise SdoAbort(AbortCode.INVALID_VALUE)

    def _written(self) -> None:
        self.enable(self._operational, self._core.moment.now)
        self._core.reactions.pdo_changed()


def _value(entry: Entry | None) -> int:
    return 0 if entry is None else int(entry.value)
