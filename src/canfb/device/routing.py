"""Which service listens to which CAN-ID."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

Handler = Callable[[bytes, float], None]
"""Takes the data of a frame, and the time."""
RemoteHandler = Callable[[float], None]
"""Takes a remote frame: the time."""


class CanIds(NamedTuple):
    """CAN-IDs that a node listens to; all other frames are only counted.

    `data` and `remote` are those of data and remote frames now. `any_state` and `any_state_remote` are those
    with the present parameters in any NMT state: a master that starts the node need not wait before it sends
    PDOs, so a filter of the bus has to pass them before.
    """

    data: frozenset[int]
    remote: frozenset[int]
    any_state: frozenset[int]
    any_state_remote: frozenset[int]


def _nobody_follows() -> None:
    """Nobody asked."""


class Routes:
    """The listeners of the present NMT state, by CAN-ID: `data` and `remote` for the two kinds of frames.

    `sent` are those that are notified when a frame of the node itself has left: an inhibit time counts
    from there. The three tables stay the same objects, whatever they hold. `changes` moves, and `on_change`
    is called, whenever they are filled again.
    """

    __slots__ = ("changes", "data", "on_change", "remote", "sent")

    def __init__(self) -> None:
        self.changes = 0
        self.on_change: Callable[[], None] = _nobody_follows
        self.data: dict[int, Handler] = {}
        self.remote: dict[int, RemoteHandler] = {}
        self.sent: dict[int | None, Callable[[float], None]] = {}

    def clear(self) -> None:
        """Nobody listens."""
        self.changes += 1
        self.on_change()
        self.data.clear()
        self.remote.clear()
        self.sent.clear()

    def add(self, can_id: int | None, handler: Handler) -> None:
        """One more listener; None for one that listens to nothing now. Two on one CAN-ID both hear."""
        if can_id is not None:
            other = self.data.get(can_id)
            self.data[can_id] = handler if other is None else _both(other, handler)

    def add_remote(self, can_id: int | None, handler: RemoteHandler) -> None:
        """Who answers remote frames; None for one that does not now. The last one added does."""
        if can_id is not None:
            self.remote[can_id] = handler

    def add_sent(self, can_id: int | None, follow: Callable[[float], None]) -> None:
        """Observer of the frames that leave: the last one added; None: nothing is sent now."""
        if can_id is not None:
            self.sent[can_id] = follow


def _both(first: Handler, second: Handler) -> Handler:
    """Two services on one CAN-ID, which the configuration allows."""

    def handle(data: bytes, now: float) -> None:
        first(data, now)
        second(data, now)

    return handle
