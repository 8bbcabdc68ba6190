"""NMT slave: the state machine (CiA 301, 7.3.2), the reaction to communication errors, and error control
(7.2.8.3.2): heartbeat 1017h and 1016h, node guarding 100Ch and 100Dh.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from canfb.cia301.cob import ERROR_CONTROL
from canfb.cia301.codes import AbortCode, EmergencyCode, ErrorRegister, NmtState, SdoAbort
from canfb.cia301.frame import Frame
from canfb.device.core import NEVER, Core, Timed
from canfb.device.od.dictionary import Dictionary, Entry, refuse_if

# The states with SDO, SYNC and EMCY.
COMMUNICATING = frozenset({NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL})

# The state after a communication error, by the value of 1029h:01 and the present state.
REACTION = {
    0: {NmtState.OPERATIONAL: NmtState.PRE_OPERATIONAL},
    1: {},
    2: {NmtState.OPERATIONAL: NmtState.STOPPED, NmtState.PRE_OPERATIONAL: NmtState.STOPPED},
}

WAIT_FOR_MASTER = 1 << 2  # Bit 2 of 1F80h: the node does not go to OPERATIONAL by itself.


def startup(dictionary: Dictionary, *, autostart: bool) -> Callable[[], bool]:
    """Object 1F80h (CiA 302-2): whether the node enters OPERATIONAL by itself: bit 2 is 0.

    `autostart` clears bit 2 of the default, so a stored value takes precedence.
    """
    entry = dictionary.assumed(0x1F80, value=WAIT_FOR_MASTER)
    entry.on_check = refuse_if(lambda value: value & ~WAIT_FOR_MASTER)  # all other bits are for masters
    if autostart:
        entry.default = (entry.default or 0) & ~WAIT_FOR_MASTER
        entry.value &= ~WAIT_FOR_MASTER
    return lambda: not entry.value & WAIT_FOR_MASTER


def error_behaviour(dictionary: Dictionary) -> Callable[[NmtState], NmtState]:
    """Object 1029h: the NMT state to which a communication error leads."""
    communication = dictionary.assumed(0x1029, 1)
    for entry in dictionary.without_count(0x1029):
        entry.on_check = refuse_if(lambda value: value not in REACTION)
    return lambda state: REACTION.get(communication.value, REACTION[0]).get(state, state)


class HeartbeatProducer(Timed):
    """Sends the NMT state every 1017h milliseconds, 0 for off; the boot-up is the first heartbeat."""

    def __init__(self, core: Core) -> None:
        self._core = core
        self._can_id = ERROR_CONTROL + core.node_id
        self._entry = core.dictionary.assumed(0x1017)
        self._entry.on_written = self._written

    @property
    def period_s(self) -> float:
        return float(self._entry.value / 1000)

    def boot_up(self, now: float) -> None:
        self._core.emit(Frame(self._can_id, b"\x00"))
        period = self.period_s
        self.deadline = now + period if period else NEVER

    def tick(self, now: float) -> None:
        self._core.emit(Frame(self._can_id, bytes([self._core.state])))
        self.repeat(now, self.period_s)

    def _written(self) -> None:
        self.deadline = self._core.call.now if self.period_s else NEVER
        self._core.reactions.heartbeat_changed()


class HeartbeatMonitor(Timed):
    """A sub-index of 1016h: monitors a node from its first heartbeat on."""

    def __init__(self, core: Core, entry: Entry, watched: Callable[[], Iterable[HeartbeatMonitor]]) -> None:
        self.entry = entry
        self._core = core
        self._source = entry.index, entry.subindex
        self._watched = watched
        entry.on_check = self._check
        entry.on_written = self._written

    @property
    def node_id(self) -> int:
        return watched_node(self.entry.value)

    def forget(self, now: float) -> None:
        self.deadline = NEVER
        self._core.emergency.clear(EmergencyCode.HEARTBEAT, now, self._source)

    def handle(self, data: bytes, now: float) -> None:
        if len(data) != 1:
            self._core.counters.malformed_frames += 1
            return
        self.deadline = now + (self.entry.value & 0xFFFF) / 1000
        self._core.emergency.clear(EmergencyCode.HEARTBEAT, now, self._source)

    def tick(self, now: float) -> None:
        self.deadline = NEVER
        lost = bytes([self.node_id])
        self._core.emergency.report(
            EmergencyCode.HEARTBEAT, ErrorRegister.COMMUNICATION, lost, now, self._source
        )
        self._core.reactions.communication_error(f"no heartbeat of node {self.node_id}", now)

    def _check(self, value: int) -> None:
        if value >> 24:
            raise SdoAbort(AbortCode.INVALID_VALUE)
        others = [other.node_id for other in self._watched() if other is not self]
        if watched_node(value) and watched_node(value) in others:
            raise SdoAbort(AbortCode.PARAMETER_INCOMPATIBLE)

    def _written(self) -> None:
        self.forget(self._core.call.now)
        self._core.reactions.routes_changed()


class HeartbeatConsumer:
    """Object 1016h."""

    def __init__(self, core: Core) -> None:
        self.monitors = [
            HeartbeatMonitor(core, entry, lambda: self.monitors)
            for entry in core.dictionary.without_count(0x1016)
        ]

    def configure(self, now: float) -> None:
        for monitor in self.monitors:
            monitor.forget(now)

    def routes(self) -> dict[int, Callable[[bytes, float], None]]:
        return {ERROR_CONTROL + one.node_id: one.handle for one in self.monitors if one.node_id}


def watched_node(value: int) -> int:
    node_id = value >> 16 & 0xFF
    return node_id if value & 0xFFFF and 1 <= node_id <= 127 else 0


_TOGGLE = 0x80
_GUARDING = 0x100C


class NodeGuarding(Timed):
    """Answers the remote frames of a master with the NMT state, and monitors their intervals.

    The toggle bit is 0 in the first answer after a reset. The life time, 100Ch (ms) x 100Dh, starts with the
    first remote frame. When it expires: EMCY 8130h and a communication error, once. No guarding while this
    node produces a `heartbeat`, or if 100Ch is missing.
    """

    def __init__(self, core: Core, heartbeat: HeartbeatProducer) -> None:
        self._core = core
        self._can_id = ERROR_CONTROL + core.node_id
        self._heartbeat = heartbeat
        self._can_guard = (0x100C, 0) in core.dictionary
        self._guard_time = core.dictionary.assumed(0x100C)
        self._factor = core.dictionary.assumed(0x100D)
        for entry in (self._guard_time, self._factor):
            entry.on_written = self._written

    @property
    def can_id(self) -> int | None:
        return self._can_id if self._can_guard and not self._heartbeat.period_s else None

    @property
    def life_time_s(self) -> float:
        """The life time; 0: no limit."""
        return int(self._guard_time.value) * int(self._factor.value) / 1000

    def configure(self, now: float) -> None:
        self._toggle = 0
        self._guarded = False
        self.deadline = NEVER
        self._core.emergency.clear(EmergencyCode.HEARTBEAT, now, _GUARDING)

    def request(self, now: float) -> None:
        self._core.emit(Frame(self._can_id, bytes([self._toggle | self._core.state])))
        self._toggle ^= _TOGGLE
        self._guarded = True
        self._start(now)

    def tick(self, now: float) -> None:
        self.deadline = NEVER
        self._guarded = False  # the next remote frame starts the life time again
        self._core.emergency.report(EmergencyCode.HEARTBEAT, ErrorRegister.COMMUNICATION, b"", now, _GUARDING)
        self._core.reactions.communication_error("the guarding master is silent", now)

    def _start(self, now: float) -> None:
        life_time = self.life_time_s
        self.deadline = now + life_time if life_time else NEVER
        self._core.emergency.clear(EmergencyCode.HEARTBEAT, now, _GUARDING)

    def _written(self) -> None:
        if self._guarded or not self.life_time_s:
            self._start(self._core.call.now)
