"""The core of a node: what its services share, and what they ask of the node.

Every service takes the core and finds there what it needs: entries, the time, how to send, whom to tell.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Hashable
from typing import Protocol

from canfb.cia301.frame import Frame
from canfb.cia301.nmt import NmtState
from canfb.device.agenda import Agenda
from canfb.device.application import Application
from canfb.device.counters import Counters
from canfb.device.moment import NEVER, Emit, Moment
from canfb.device.od.dictionary import Dictionary
from canfb.device.pending import Pending
from canfb.device.routing import Routes


class Reactions(ABC):
    """What follows from what a service notices, beyond the service; `now` in seconds.

    What only the program wants to know goes to it directly (`Core.application`).
    """

    @abstractmethod
    def state_changed(self, old: NmtState, new: NmtState, now: float) -> None:
        """The NMT state is another one."""

    @abstractmethod
    def reset(self, communication_only: bool, now: float) -> None:
        """The NMT master resets the node, or its communication only."""

    @abstractmethod
    def communication_error(self, why: str, now: float) -> None:
        """A heartbeat or the guarding master is lost; `why` in words."""

    @abstractmethod
    def heartbeat_changed(self) -> None:
        """1017h was written."""

    @abstractmethod
    def pdo_changed(self) -> None:
        """Parameters of a PDO were written."""

    @abstractmethod
    def routes_changed(self) -> None:
        """A COB-ID has changed, so that another service may listen to a CAN-ID."""

    @abstractmethod
    def bit_rate_activated(self, kbit_s: int, delay_s: float) -> None:
        """LSS activates a bit rate: silence for `delay_s`, the change, silence for `delay_s` again."""

    @abstractmethod
    def lss_left(self, now: float) -> None:
        """The LSS master has left the configuration state."""

    @abstractmethod
    def silence_ended(self, now: float) -> None:
        """The silence for a change of the bit rate is over."""


class ErrorReports(Protocol):
    """Where a service reports an error: EMCY, 1001h and 1003h. See `Emergency`."""

    def report(
        self,
        code: int,
        register_bits: int,
        manufacturer: bytes,
        now: float,
        source: Hashable = None,
        *,
        again: bool = False,
    ) -> None:
        """An error of `source` appeared; nothing if it is active already, unless it is told `again`."""

    def clear(self, code: int, now: float, source: Hashable = None) -> None:
        """The error is gone; nothing happens when it was not active."""


class Core:
    """What the services of a node share, from its first power-on on."""

    __slots__ = (
        "agenda",
        "application",
        "counters",
        "dictionary",
        "emergency",
        "emit",
        "moment",
        "node_id",
        "outbox",
        "pending",
        "reactions",
        "routes",
        "sdo_timeout_s",
        "state",
        "window_end",
        "window_s",
    )

    emergency: ErrorReports
    """The EMCY producer of the present services; the first of them that is made."""

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
        self.node_id = node_id
        """The present node-ID, 255 for none. Services hold for one: they are made again with another."""
        self.application = application
        self.reactions = reactions
        self.sdo_timeout_s = sdo_timeout_s
        self.state = NmtState.INITIALISING
        self.moment = Moment()
        self.counters = Counters()
        self.agenda = Agenda()
        self.routes = Routes()
        self.pending: Pending | None = None
        """Of the SDO write that is just being done: its answer waits for this."""
        self.outbox: list[Frame] = []
        self.emit: Emit = self.outbox.append
        """Sends a frame: with the return of the running call."""
        self.window_s = 0.0
        """So long after a SYNC its synchronous RPDOs may come (1007h), seconds; 0.0: always."""
        self.window_end = NEVER
        """The end of it for the last SYNC."""
