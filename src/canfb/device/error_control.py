"""Error control (CiA 301, 7.2.8.3.2): heartbeat 1017h and 1016h, node guarding 100Ch and 100Dh."""

from __future__ import annotations

from collections.abc import Callable

from canfb.cia301.cob import ERROR_CONTROL
from canfb.cia301.codes import AbortCode, EmergencyCode, ErrorRegister, SdoAbort
from canfb.cia301.frame import Frame
from canfb.device.core import NEVER, Core, Timed
from canfb.device.od.dictionary import Entry


class HeartbeatProducer(Timed):
    """Sends the NMT state every 1017h milliseconds; 0 is off.

    The boot-up counts as the first heartbeat. A new period starts with a heartbeat at once.
    """

    def __init__(self, core: Core) -> None:
        self.deadline = NEVER
        self._core = core
        self._can_id = ERROR_CONTROL + core.node_id
        self._entry = core.dictionary.find(0x1017)
        if self._entry is not None:
            self._entry.on_written = self._written

    @property
    def is_active(self) -> bool:
        """Whether there is a heartbeat: 1017h is not 0."""
        return self._period_s > 0

    @property
    def _period_s(self) -> float:
        return 0.0 if self._entry is None else self._entry.value / 1000

    def boot_up(self, now: float) -> None:
        """Send the boot-up message and begin the period."""
        self._core.emit(Frame(self._can_id, b"\x00"))
        period = self._period_s
        self.deadline = now + period if period else NEVER

    def stop(self) -> None:
        """Send nothing until the next boot-up."""
        self.deadline = NEVER

    def tick(self, now: float) -> None:
        """Send the heartbeat that is due. What was missed by a late tick is left out."""
        if now < self.deadline:
            return
        self._core.emit(Frame(self._can_id, bytes([self._core.state])))
        period = self._period_s
        following = self.deadline + period if period else NEVER
        self.deadline = following if following > now else now + period

    def _written(self) -> None:
        self.deadline = self._core.call.now if self._period_s else NEVER
        self._core.reactions.heartbeat_changed()


class HeartbeatMonitor:
    """One sub-index of 1016h: watches one node from its first heartbeat on."""

    def __init__(self, core: Core, entry: Entry) -> None:
        self.entry = entry
        self.deadline = NEVER
        self._counters = core.counters
        self._emergency = core.emergency
        self._lost = core.reactions.communication_error

    @property
    def node_id(self) -> int:
        """The watched node, 0 when the entry is unused (time 0, or no node-ID)."""
        return watched_node(self.entry.value)

    def forget(self, now: float) -> None:
        """Wait for the first heartbeat again, with no error."""
        self.deadline = NEVER
        self._emergency.clear(EmergencyCode.HEARTBEAT, now, self._source)

    def handle(self, data: bytes, now: float) -> None:
        """A heartbeat or boot-up of the node."""
        if len(data) != 1:
            self._counters.malformed_frames += 1
            return
        self.deadline = now + (self.entry.value & 0xFFFF) / 1000
        self._emergency.clear(EmergencyCode.HEARTBEAT, now, self._source)

    def tick(self, now: float) -> None:
        """Report a heartbeat that did not come in time, once."""
        if now < self.deadline:
            return
        self.deadline = NEVER
        self._emergency.report(
            EmergencyCode.HEARTBEAT,
            ErrorRegister.COMMUNICATION,
            bytes([self.node_id]),
            now,
            self._source,
        )
        self._lost(f"no heartbeat of node {self.node_id}", now)

    @property
    def _source(self) -> tuple[int, int]:
        return self.entry.index, self.entry.subindex


class HeartbeatConsumer(Timed):
    """Object 1016h: watches the heartbeats of other nodes."""

    def __init__(self, core: Core) -> None:
        self.deadline = NEVER
        self._core = core
        entries = [entry for entry in core.dictionary if entry.index == 0x1016 and entry.subindex]
        self._monitors = [HeartbeatMonitor(core, entry) for entry in entries]
        for monitor in self._monitors:
            self._install(monitor)

    def configure(self, now: float) -> None:
        """Read 1016h again and wait for each first heartbeat."""
        for monitor in self._monitors:
            monitor.forget(now)
        self.deadline = NEVER

    def routes(self) -> dict[int, Callable[[bytes, float], None]]:
        """Who listens to which CAN-ID."""
        return {
            ERROR_CONTROL + monitor.node_id: self._handler(monitor)
            for monitor in self._monitors
            if monitor.node_id
        }

    def tick(self, now: float) -> None:
        """Report the heartbeats that did not come."""
        for monitor in self._monitors:
            monitor.tick(now)
        self._schedule()

    def _handler(self, monitor: HeartbeatMonitor) -> Callable[[bytes, float], None]:
        def handle(data: bytes, now: float) -> None:
            monitor.handle(data, now)
            self._schedule()

        return handle

    def _schedule(self) -> None:
        self.deadline = min((monitor.deadline for monitor in self._monitors), default=NEVER)

    def _install(self, monitor: HeartbeatMonitor) -> None:
        def check(value: int) -> None:
            if value >> 24:
                raise SdoAbort(AbortCode.INVALID_VALUE)
            node_id = watched_node(value)
            others = [other for other in self._monitors if other is not monitor]
            if node_id and any(other.node_id == node_id for other in others):
                raise SdoAbort(AbortCode.PARAMETER_INCOMPATIBLE)

        def written() -> None:
            monitor.forget(self._core.call.now)
            self._schedule()
            self._core.reactions.routes_changed()

        monitor.entry.on_check = check
        monitor.entry.on_written = written


def watched_node(value: int) -> int:
    """Node-ID of a value of 1016h, 0 for one that watches nothing."""
    node_id = value >> 16 & 0xFF
    return node_id if value & 0xFFFF and 1 <= node_id <= 127 else 0


_TOGGLE = 0x80
_GUARDING = 0x100C


class NodeGuarding(Timed):
    """Answers the remote frames of a master with the NMT state, and watches that they come.

    The toggle bit is 0 in the first answer after a reset, then alternates. The life time, 100Ch
    milliseconds times 100Dh, runs from the first remote frame on; 0 is none. When it is over:
    EMCY 8130h and a communication error, once; the next remote frame ends the error. There is no
    guarding while there is a `heartbeat`, nor on a device without 100Ch.
    """

    def __init__(self, core: Core, heartbeat: HeartbeatProducer) -> None:
        self.deadline = NEVER
        self._core = core
        self._can_id = ERROR_CONTROL + core.node_id
        self._emergency = core.emergency
        self._heartbeat = heartbeat
        self._guard_time = core.dictionary.find(0x100C)
        self._factor = core.dictionary.find(0x100D)
        self._toggle = 0
        self._guarded = False
        for entry in (self._guard_time, self._factor):
            if entry is not None:
                entry.on_written = self._written

    @property
    def can_id(self) -> int | None:
        """The CAN-ID on which it answers remote frames now, None when it does not."""
        return None if self._guard_time is None or self._heartbeat.is_active else self._can_id

    @property
    def life_time_s(self) -> float:
        """How long a master may be silent, seconds; 0 for any time."""
        if self._guard_time is None or self._factor is None:
            return 0.0
        return int(self._guard_time.value) * int(self._factor.value) / 1000

    def configure(self, now: float) -> None:
        """Restart: toggle bit 0, no error, no life time before the first remote frame."""
        self._toggle = 0
        self._guarded = False
        self.deadline = NEVER
        self._emergency.clear(EmergencyCode.HEARTBEAT, now, _GUARDING)

    def request(self, now: float) -> None:
        """A remote frame of the master."""
        self._core.emit(Frame(self._can_id, bytes([self._toggle | self._core.state])))
        self._toggle ^= _TOGGLE
        self._guarded = True
        self._start(now)

    def tick(self, now: float) -> None:
        """Report that the master is silent, once."""
        if now < self.deadline:
            return
        self.deadline = NEVER
        self._guarded = False  # the next remote frame starts the life time again
        self._emergency.report(EmergencyCode.HEARTBEAT, ErrorRegister.COMMUNICATION, b"", now, _GUARDING)
        self._core.reactions.communication_error("the guarding master is silent", now)

    def _start(self, now: float) -> None:
        life_time = self.life_time_s
        self.deadline = now + life_time if life_time else NEVER
        self._emergency.clear(EmergencyCode.HEARTBEAT, now, _GUARDING)

    def _written(self) -> None:
        """Another life time holds from now on; none ends an error."""
        if self._guarded or not self.life_time_s:
            self._start(self._core.call.now)
