"""Which service listens to which CAN-ID."""

from __future__ import annotations

from collections.abc import Callable

Handler = Callable[[bytes, float], None]
"""Takes the data of a frame, and the time."""
RemoteHandler = Callable[[float], None]
"""Takes a remote frame: the time."""


class Routes:
    """The listeners of the present NMT state, by CAN-ID: `data` and `remote` for the two kinds of frames.

    `sent` are those that want to know when a frame of the node itself has left: an inhibit time counts
    from there. The three tables stay the same objects, whatever they hold. `changes` moves whenever they
    are filled again.
    """

    __slots__ = ("changes", "data", "remote", "sent")

    def __init__(self) -> None:
        self.changes = 0
        self.data: dict[int, Handler] = {}
        self.remote: dict[int, RemoteHandler] = {}
        self.sent: dict[int | None, Callable[[float], None]] = {}

    def clear(self) -> None:
        """Nobody listens."""
        self.changes += 1
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
        """Who follows the frames that leave; None for one that sends nothing now. The last one added does."""
        if can_id is not None:
            self.sent[can_id] = follow


def _both(first: Handler, second: Handler) -> Handler:
    """Two services on one CAN-ID, which the configuration allows."""

    def handle(data: bytes, now: float) -> None:
        first(data, now)
        second(data, now)

    return handle
