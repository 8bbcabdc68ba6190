"""What the services of a node share: :class:`Core`, and the :class:`Agenda` of those with a timer.

:class:`Pending` is an SDO write whose answer waits for its effect, as that of `save`.

:class:`Application` and :class:`ProcessData` are what a node tells its program: one method for each event,
called from within the calls of the node.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from canfb.cia301.codes import AbortCode, NmtState
from canfb.cia301.frame import Frame
from canfb.device.od.dictionary import Dictionary, Entry
from canfb.device.storage.kept import ParameterGroup

Groups = list[ParameterGroup]


class Expiry(Protocol):
    """How long the process data of the program holds."""

    @property
    def until(self) -> float:
        """Until then, seconds."""


class HeldRpdo(Protocol):
    """A synchronous RPDO."""

    def synchronise(self, now: float) -> None:
        """Take over what came since the last SYNC, with `rpdo_received`."""


# After a SYNC: no TPDOs are sent, they are, or they are and `tpdos_sampled` is called then.
IGNORED, FOLLOWED, REVOKED = range(3)


class ProcessData:
    """What SYNCs and PDOs are for the program, in one object, so that a frame takes no detour.

    The rules of `Application` hold.
    """

    def synchronise(self, counter: int | None, now: float, waiting: Sequence[HeldRpdo]) -> int:
        """A SYNC in OPERATIONAL (CiA 301, 7.2.5), `counter` None without 1019h; `waiting` RPDOs are taken
        over, then come the synchronous TPDOs, as the result says.
        """
        for rpdo in waiting:
            rpdo.synchronise(now)
        self.sync_received(counter, now)
        return FOLLOWED

    def rpdo_received(self, number: int, now: float) -> None:
        """RPDO `number` is in the dictionary."""

    def sync_received(self, counter: int | None, now: float) -> None:
        """A SYNC, after its RPDOs."""

    def tpdos_sampled(self) -> None:
        """The synchronous TPDOs are sampled."""

    def idle_sync_received(self, counter: int | None) -> None:
        """A SYNC in PRE-OPERATIONAL."""

    def rpdo_too_short(self, number: int, received: int, mapped: int, now: float) -> None:
        """RPDO `number` was dropped."""


class Application(ProcessData):
    """The program behind a :class:`canfb.device.node.Node`: a subclass overrides what it needs.

    The methods may write entries and use the node, but not its `receive` or `tick`. What they raise comes out
    of the call. Times are seconds, monotonic.
    """

    def expired(self, now: float) -> None:
        """A frame after `Expiry.until` is about to be taken."""

    def overdue(self, now: float) -> None:
        """A `tick` at or after `Expiry.until`."""

    def time_received(self, days: int, milliseconds: int, now: float) -> None:
        """TIME: days since 1984-01-01, milliseconds of the day."""

    def state_changed(self, old: NmtState, new: NmtState, now: float, why: str) -> None:
        """Another NMT state; `why` in words, "" for a command or a start."""

    def reset_done(self, communication_only: bool, now: float) -> None:
        """A reset, or the start, before the boot-up: report again what persists."""

    def configuration_changed(self) -> None:
        """PDO parameters or the NMT state have changed."""

    def check_write(self, entry: Entry | None) -> None:
        """SDO is about to write `entry`, or LSS to configure (None). SdoAbort refuses it."""

    def parameters_refused(self, faults: Mapping[ParameterGroup, str], now: float) -> None:
        """Stored parameters that were refused, and why: after a reset, and when it changes."""

    def parameters_saved(self, saved: Groups, forgotten: Groups, now: float) -> None:
        """These groups were saved, or dropped from the store."""

    def saving_failed(self, groups: Groups, reason: str, now: float) -> None:
        """These groups were not saved."""

    def emergency_sent(self, code: int, register: int, detail: bytes, now: float) -> None:
        """An EMCY goes out, with 1001h and 5 bytes."""

    def duplicate_received(self, can_id: int, now: float) -> None:
        """Another node uses a CAN-ID of this one, first time after a reset."""

    def communication_failed(self, now: float) -> None:
        """Heartbeat, guarding master or bus is lost; the state changes next."""

    def bit_rate_activated(self, kbit_s: int, delay_s: float, now: float) -> None:
        """LSS activates this bit rate: change it at `now` + `delay_s`; the node is silent up to twice
        that.
        """


NEVER = float("inf")  # The deadline of a service that waits for nothing, seconds.

# A receive time may be earlier than the one before by this; by more, the clock was set. No frame is shorter
# than 47 us (1 Mbit/s), so that it takes errors of twice as much.
STAMP_NOISE_S = 50e-6


class CallContext:
    """The `now` of the running call, and the time at which its frame was received, seconds.

    `received` is the time stamp of the frame if `is_stamped`, else that of the call; `stamp` the last one
    that was taken.
    """

    def __init__(self) -> None:
        self.now = self.received = 0.0
        self.stamp = -NEVER
        self.is_stamped = False

    def stamped(self, stamp: float) -> None:
        """The frame of the running call has this time stamp, seconds.

        One a little before the last is as late as that; one far before it, or later than now, is not used.
        """
        last = self.stamp
        self.is_stamped = last - STAMP_NOISE_S <= stamp <= self.now
        self.received = self.stamp = max(last, stamp) if self.is_stamped else self.now


class Agenda:
    """The services with a timer, in their order."""

    def __init__(self) -> None:
        self._services: tuple[Timed, ...] = ()
        self.earliest = NEVER  # The earliest deadline, seconds, unless one has :attr:`moved` since.
        self.moved = True

    def fill(self, services: Iterable[Timed]) -> None:
        self._services = tuple(services)
        for service in self._services:
            service.agenda = self
        self.moved = True

    def due(self) -> float:
        if self.moved:  # after each SYNC, so without the calls of properties
            self.earliest = min([service._deadline for service in self._services], default=NEVER)
            self.moved = False
        return self.earliest

    def tick(self, now: float, until: float) -> None:
        for service in self._services:
            if service.deadline <= until:
                service.tick(now)


class Timed(ABC):
    """A service with a timer, due at `deadline`, seconds."""

    agenda = Agenda()  # Where the service is listed; while it is in none, one that is never asked.
    _deadline = NEVER

    @property
    def deadline(self) -> float:
        return self._deadline

    @deadline.setter
    def deadline(self, due: float) -> None:
        if due != self._deadline:
            self._deadline = due
            self.agenda.moved = True

    @abstractmethod
    def tick(self, now: float) -> None:
        """Do what is due, and move the deadline on."""


@dataclass(slots=True)
class Counters:
    """Frames and values without effect, by reason."""

    # Frames that no service listens to in the present NMT state; frames for others included.
    unknown_cob_ids: int = 0
    # More than 8 bytes, a CAN-ID above 7FFh, or a length or content that the service cannot mean.
    malformed_frames: int = 0
    remote_frames: int = 0  # Remote frames where none is meant, or on a TPDO that allows none.
    # Data frames with a CAN-ID that only this node may send: another has its node-ID or COB-ID.
    duplicate_frames: int = 0
    short_rpdos: int = 0  # RPDOs shorter than their mapping; the data was kept.
    long_rpdos: int = 0  # RPDOs longer than their mapping; the mapped part was used.
    late_rpdos: int = 0  # Synchronous RPDOs after the synchronous window (1007h).
    refused_rpdo_values: int = 0  # Mapped values beyond the limits of their entry, or refused by it.
    sdo_aborts: int = 0  # SDO aborts that were sent.
    lost_emergencies: int = 0  # EMCY frames dropped for newer ones while sending was not allowed.


class Pending:
    """Made by the object (`Core.pending`), taken by the SDO server: `on_end(code)` is called when the write
    is done (None) or has failed.
    """

    def __init__(self) -> None:
        self.ended = False
        self.code: AbortCode | None = None
        self.on_end: Callable[[AbortCode | None], None] | None = None

    def end(self, code: AbortCode | None) -> None:
        self.ended, self.code = True, code
        if self.on_end is not None:
            self.on_end(code)


Handler = Callable[[bytes, float], None]  # Takes the data of a frame, and the time.


class CanIds(NamedTuple):
    """CAN-IDs that a node listens to in any NMT state, of data and remote frames.

    In any: a master need not wait before it sends PDOs.
    """

    data: frozenset[int]
    remote: frozenset[int]


class Routes:
    """The listeners of the present NMT state, by CAN-ID.

    `sent` are notified when a frame of the node itself has left. The tables stay the same objects. `changes`
    moves, and `on_change` is called, whenever they are filled again.
    """

    def __init__(self) -> None:
        self.changes = 0
        self.on_change: Callable[[], None] = lambda: None
        self.data: dict[int, Handler] = {}
        self.remote: dict[int | None, Callable[[float], None]] = {}  # Each takes the time.
        self.sent: dict[int | None, Callable[[float], None]] = {}

    def clear(self) -> None:
        self.changes += 1
        self.on_change()
        self.data.clear()
        self.remote.clear()
        self.sent.clear()

    def add(self, can_id: int | None, handler: Handler) -> None:
        """One more listener, if any; two on one CAN-ID both get it."""
        if can_id is not None:
            other = self.data.get(can_id)
            self.data[can_id] = handler if other is None else _both(other, handler)


def _both(first: Handler, second: Handler) -> Handler:
    def handle(data: bytes, now: float) -> None:
        first(data, now)
        second(data, now)

    return handle


class Reactions(ABC):
    """What follows from what a service notices; `now` in seconds."""

    @abstractmethod
    def communication_error(self, why: str, now: float) -> None:
        """Heartbeat or guarding master is lost."""

    @abstractmethod
    def heartbeat_changed(self) -> None:
        """1017h was written."""

    @abstractmethod
    def pdo_changed(self) -> None:
        """Parameters of a PDO were written."""

    @abstractmethod
    def routes_changed(self) -> None:
        """A COB-ID has changed."""

    @abstractmethod
    def bit_rate_activated(self, kbit_s: int, delay_s: float) -> None:
        """Silence for `delay_s`, the change, silence again."""

    @abstractmethod
    def lss_left(self, now: float) -> None:
        """LSS leaves the configuration state."""


class ErrorReports(Protocol):
    """EMCY, 1001h and 1003h: see `Emergency`."""

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
        """An error of `source` appeared; False if it was there already."""

    def clear(self, code: int, now: float, source: Hashable = None) -> None:
        """The error is gone."""


class Core:
    """What the services of a node share."""

    emergency: ErrorReports  # The EMCY producer of the present services; the first of them that is made.

    def __init__(
        self,
        dictionary: Dictionary,
        node_id: int,
        application: Application,
        reactions: Reactions,
        *,
        sdo_timeout_s: float,
    ) -> None:
        self.dictionary = dictionary
        # The present node-ID, 255 for none. Services hold for one: they are made again with another.
        self.node_id = node_id
        self.application = application
        self.process: ProcessData = application
        self.reactions = reactions
        self.sdo_timeout_s = sdo_timeout_s
        self.state = NmtState.INITIALISING
        self.call = CallContext()
        self.counters = Counters()
        self.agenda = Agenda()
        self.routes = Routes()
        # Of the SDO write that is just being done: its answer waits for this.
        self.pending: Pending | None = None
        self.outbox: list[Frame] = []
        # Sends a frame: with the return of the running call.
        self.emit: Callable[[Frame], None] = self.outbox.append
        # So long after a SYNC its synchronous RPDOs may come (1007h), seconds; 0.0: always.
        self.window_s = 0.0
        self.window_end = NEVER  # The end of it for the last SYNC.
