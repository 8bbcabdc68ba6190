"""What the recorded module sent against what the replayed one sends, byte for byte."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

LONGEST_DELAY_S = 1.0
"""Longest time between a frame and its counterpart, s."""

Waiting = deque[tuple[float, bytes]]


@dataclass(frozen=True)
class Difference:
    """A frame that is another one in the log: when (stamp of the log, seconds), and both data."""

    time_s: float
    recorded: bytes
    replayed: bytes


@dataclass
class Compared:
    """The frames of one CAN-ID.

    equal, different   pairs
    only_recorded      frames of the log that the replay did not send
    only_replayed      the other way round
    """

    equal: int = 0
    different: int = 0
    only_recorded: int = 0
    only_replayed: int = 0
    first: Difference | None = None

    @property
    def all_equal(self) -> bool:
        """Nothing but equal pairs."""
        return not (self.different or self.only_recorded or self.only_replayed)


class OwnFrames:
    """Pairs the frames of one CAN-ID, in their order.

    A frame that is missing on one side does not shift the pairs behind it: an equal one among those that
    wait is preferred. ``differs(recorded, replayed)`` is called with each pair that is not equal.
    """

    def __init__(self, differs: Callable[[bytes, bytes], None]) -> None:
        self.compared = Compared()
        self._differs = differs
        self._replayed: Waiting = deque()
        self._recorded: Waiting = deque()

    def replayed(self, data: bytes, now: float) -> None:
        """The replay has sent a frame at ``now``, seconds."""
        if self._recorded:
            self.compared.only_recorded += _drop_late(self._recorded, now)
            before = _taken(self._recorded, data)
            if before is not None:
                self.compared.only_recorded += before
                self.compared.equal += 1
                return
        waiting = self._replayed
        if waiting and now - waiting[0][0] > LONGEST_DELAY_S:
            self.compared.only_replayed += _drop_late(waiting, now)
        waiting.append((now, data))

    def recorded(self, data: bytes, now: float, stamp_s: float) -> None:
        """The log has a frame, with this stamp."""
        waiting, compared = self._replayed, self.compared
        if waiting and waiting[0][1] == data:
            waiting.popleft()
            compared.equal += 1
            return
        compared.only_replayed += _drop_late(waiting, now)
        before = _taken(waiting, data)
        if before is not None:
            compared.only_replayed += before
            compared.equal += 1
        elif waiting:
            _, replayed = waiting.popleft()
            compared.different += 1
            if compared.first is None:
                compared.first = Difference(stamp_s, data, replayed)
            self._differs(data, replayed)
        else:
            compared.only_recorded += _drop_late(self._recorded, now)
            self._recorded.append((now, data))

    def close(self, now: float) -> None:
        """The log ends. What was sent just before may have its counterpart behind the end."""
        self.compared.only_replayed += _drop_late(self._replayed, now)
        self.compared.only_recorded += len(self._recorded)
        self._replayed.clear()
        self._recorded.clear()


def _drop_late(waiting: Waiting, now: float) -> int:
    """Take out what has waited too long; how many."""
    dropped = 0
    while waiting and now - waiting[0][0] > LONGEST_DELAY_S:
        waiting.popleft()
        dropped += 1
    return dropped


def _taken(waiting: Waiting, data: bytes) -> int | None:
    """Take out the first equal one and those before it; how many there were, None without an equal one."""
    for place, (_, other) in enumerate(waiting):
        if other == data:
            for _ in range(place + 1):
                waiting.popleft()
            return place
    return None
