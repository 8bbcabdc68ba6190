"""What the services of a node share: :class:`Core`, and :class:`Agenda`, which runs those with a timer.

:class:`Pending` is an SDO write that is answered once it has taken effect, such as `save`.

A node reports to its program through :class:`Application` and :class:`ProcessData`: one method for each
event, called from within the calls of the node.
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
    """How long the process data of the program is valid."""

    @property
    def until(self) -> float:
        """End of validity, seconds."""


class HeldRpdo(Protocol):
    """A synchronous RPDO."""

    def synchronise(self, now: float) -> None:
        """Take over the last PDO since the last SYNC, and call `rpdo_received`."""


# The synchronous TPDOs after a SYNC: not sent; sent; sent, and `tpdos_sampled` is called after them.
IGNORED, FOLLOWED, REVOKED = range(3)


class ProcessData:
    """SYNCs and PDOs as events for the program, in one object, so that a frame takes no detour.

    The rules of `Application` hold.
    """

    def synchronise(self, counter: int | None, now: float, waiting: Sequence[HeldRpdo]) -> int:
        """A SYNC in OPERATIONAL (CiA 301, 7.2.5), `counter` None without 1019h: take over the `waiting`
        RPDOs. The result, e.g. `FOLLOWED`, controls the synchronous TPDOs.
        """
        for rpdo in waiting:
            rpdo.synchronise(now)
        self.sync_received(counter, now)
        return FOLLOWED

    def rpdo_received(self, number: int, now: float) -> None:
        """The dictionary has the values of RPDO `number`."""

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

    The methods may write entries and use the node, but not its `receive` or `tick`, which pass on their
    exceptions. Times are seconds, monotonic.
    """

    def expired(self, now: float) -> None:
        """A frame received after `Expiry.until` is processed next."""

    def overdue(self, now: float) -> None:
        """A `tick` at or after `Expiry.until`."""

    def time_received(self, days: int, milliseconds: int, now: float) -> None:
        """TIME: days since 1984-01-01, milliseconds of the day."""

    def state_changed(self, old: NmtState, new: NmtState, now: float, why: str) -> None:
        """The NMT state changed; `why` in words, "" for a command or a start."""

    def reset_done(self, communication_only: bool, now: float) -> None:
        """After a reset or the start, before the boot-up: report persistent errors again."""

    def configuration_changed(self) -> None:
        """PDO parameters or the NMT state have changed."""

    def check_write(self, entry: Entry | None) -> None:
        """SDO is about to write `entry`, or LSS to configure (None). SdoAbort refuses it."""

    def parameters_refused(self, faults: Mapping[ParameterGroup, str], now: float) -> None:
        """Groups of stored parameters that were refused, and why: after a reset and at a change."""

    def parameters_saved(self, saved: Groups, forgotten: Groups, now: float) -> None:
        """These groups were saved, or dropped from the store."""

    def saving_failed(self, groups: Groups, reason: str, now: float) -> None:
        """These groups were not saved."""

    def emergency_sent(self, code: int, register: int, detail: bytes, now: float) -> None:
        """The node sends an EMCY: error code, 1001h as ``register``, 5 manufacturer bytes as ``detail``."""

    def duplicate_received(self, can_id: int, now: float) -> None:
        """Another node uses a CAN-ID of this one, first time after a reset."""

    def communication_failed(self, now: float) -> None:
        """Heartbeat, guarding master or bus is lost; the state changes next."""

    def bit_rate_activated(self, kbit_s: int, delay_s: float, now: float) -> None:
        """LSS activates this bit rate: change it at `now` + `delay_s`; the node is silent for
        2 `delay_s`.
        """


NEVER = float("inf")  # The deadline of a service that waits for nothing, seconds.

# By how much a receive time may precede the previous one; if by more, the clock was set. The shortest frame
# takes 47 us (1 Mbit/s), so the order of two frames tolerates this much.
STAMP_NOISE_S = 50e-6


class CallContext:
    """The `now` of the running call, and the time at which its frame was received, seconds.

    `received` is the time stamp of the frame if `is_stamped`, else `now`; `stamp` is the last one that was
    used.
    """

    def __init__(self) -> None:
        self.now = self.received = 0.0
        self.stamp = -NEVER
        self.is_stamped = False

    def stamped(self, stamp: float) -> None:
        """The frame of the running call has this time stamp, seconds.

        Up to `STAMP_NOISE_S` before the last stamp it counts as equal to that; earlier, or later than now,
        it is not used.
        """
        last = self.stamp
        self.is_stamped = last - STAMP_NOISE_S <= stamp <= self.now
        self.received = self.stamp = max(last, stamp) if self.is_stamped else self.now


class Agenda:
    """The services with a timer, in their order."""

    def __init__(self) -> None:
        self._services: tuple[Timed, ...] = ()
        self.earliest = NEVER  # The earliest deadline, seconds; outdated while :attr:`moved`.
        self.moved = True

    def fill(self, services: Iterable[Timed]) -> None:
        self._services = tuple(services)
        for service in self._services:
            service.agenda = self
        self.moved = True

    def due(self) -> float:
        if self.moved:  # runs after each SYNC, so it reads _deadline without the property
            self.earliest = min([service._deadline for service in self._services], default=NEVER)
            self.moved = False
        return self.earliest

    def tick(self, now: float, until: float) -> None:
        for service in self._services:
            if service.deadline <= until:
                service.tick(now)


class Timed(ABC):
    """A service with a timer, due at `deadline`, seconds."""

    agenda = Agenda()  # The agenda that lists the service; until then this dummy, which nobody reads.
    _deadline = NEVER

    @property
    def deadline(self) -> float:
        return self._deadline

    @deadline.setter
    def deadline(self, due: float) -> None:
        if due != self._deadline:
            self._deadline = due
            self.agenda.moved = True

    def repeat(self, now: float, period_s: float) -> None:
        """One period on; missed ones are left out."""
        following = self.deadline + period_s
        self.deadline = following if following > now else now + period_s

    @abstractmethod
    def tick(self, now: float) -> None:
        """Do what is due, and move the deadline on."""


@dataclass(slots=True)
class Counters:
    """Frames and values with no effect, by reason."""

    # Frames that no service listens to in the present NMT state; frames for others included.
    unknown_cob_ids: int = 0
    # More than 8 bytes, a CAN-ID above 7FFh, or a length or content that the service does not define.
    malformed_frames: int = 0
    remote_frames: int = 0  # Remote frames that no service answers, or on a TPDO that allows none.
    # Data frames with a CAN-ID that only this node may send: another has its node-ID or COB-ID.
    duplicate_frames: int = 0
    short_rpdos: int = 0  # RPDOs shorter than their mapping, dropped: the entries keep their values.
    long_rpdos: int = 0  # RPDOs longer than their mapping; the mapped part was used.
    late_rpdos: int = 0  # Synchronous RPDOs after the synchronous window (1007h).
    refused_rpdo_values: int = 0  # Mapped values beyond the limits of their entry, or refused by it.
    sdo_aborts: int = 0  # SDO aborts that were sent.
    lost_emergencies: int = 0  # EMCY frames dropped for newer ones while sending was not allowed.


class Pending:
    """An SDO write in progress. The object sets `Core.pending`, the SDO server takes it: `on_end(code)` is
    called when the write is done (None) or has failed.
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
    """CAN-IDs of data and remote frames that a node listens to in at least one NMT state.

    Independent of the present state: a master need not wait before it sends PDOs.
    """

    data: frozenset[int]
    remote: frozenset[int]


class Routes:
    """The listeners of the present NMT state, by CAN-ID.

    `sent` has the callbacks for frames of the node itself that have left. The dicts stay the same objects;
    whenever they are filled again, `changes` is incremented and `on_change` called.
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
        """Add a listener, unless `can_id` is None; several on one CAN-ID all get the frame."""
        if can_id is not None:
            other = self.data.get(can_id)
            self.data[can_id] = handler if other is None else _both(other, handler)


def _both(first: Handler, second: Handler) -> Handler:
    def handle(data: bytes, now: float) -> None:
        first(data, now)
        second(data, now)

    return handle


class Reactions(ABC):
    """What services notify the node of; `now` in seconds."""

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
        """Be silent for `delay_s`, change the bit rate, be silent for `delay_s`."""

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

    emergency: ErrorReports  # The EMCY producer of the present services; made before all others.

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
        # The present node-ID, 255 for none. The services are made again for another.
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
        # Set during an SDO write that ends later; the SDO server then delays its answer.
        self.pending: Pending | None = None
        self.outbox: list[Frame] = []
        # Queues a frame; the running call returns it.
        self.emit: Callable[[Frame], None] = self.outbox.append
        # Synchronous window length (1007h), seconds; 0.0: no limit.
        self.window_s = 0.0
        self.window_end = NEVER  # The end of the window after the last SYNC, seconds.
