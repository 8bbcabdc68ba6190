"""Receive times of the bus, brought onto the clock of the runner."""

from __future__ import annotations

from collections.abc import Callable
from math import nan

LARGEST_STEP_S = 0.0005  # between two looks at both clocks; more is a step of the wall clock
CLOSE_S = 1e-5  # so much later than the look before: the processor may have been away between the clocks
LOOKS = 3
LONGEST_DELAY_S = 60.0  # a time further back is not of the wall clock


class ReceiveTimes:
    """What python-can stamps is the time of day, as the kernel has it; a runner counts monotonic seconds.

    ``clock`` and ``wall`` are the two clocks. A stamp says how long ago a frame came, by the wall clock:
    that is taken off ``now``. When the wall clock is set, the frames that wait may have stamps of before
    or after: they have none until the queue was empty once. Stamps of another clock are not used.
    """

    def __init__(self, clock: Callable[[], float], wall: Callable[[], float]) -> None:
        self._clock = clock
        self._wall = wall
        self._stepped = False
        self._difference_s = self._look()

    def emptied(self) -> None:
        """No frame waits: what comes now has stamps of the wall clock as it is."""
        if self._stepped:
            self._stepped = False
            self._difference_s = self._look()

    def received(self, stamp_s: float, now: float) -> float | None:
        """When a frame with this stamp came, seconds on the clock of ``now``; None if that is not known."""
        self.compare(now)
        return self.of(stamp_s, now)

    def compare(self, now: float) -> float:
        """Look at the wall clock at ``now``, for :meth:`of` several frames.

        What it is ahead of the other one, seconds; not a number where stamps are not to be used.
        """
        difference = self._wall() - now
        if not -LARGEST_STEP_S <= difference - self._difference_s <= CLOSE_S:
            difference = self._look()  # else the frames would seem to have come earlier than they did
            if abs(difference - self._difference_s) > LARGEST_STEP_S:
                self._stepped = True
        self._difference_s = difference
        return nan if self._stepped else difference

    def of(self, stamp_s: float, now: float) -> float | None:
        """:meth:`received`, where :meth:`compare` was called with this ``now``, or an earlier one."""
        delay = self._difference_s + now - stamp_s
        if self._stepped or not -LARGEST_STEP_S <= delay <= LONGEST_DELAY_S:
            return None
        return min(now, now - delay)

    def _look(self) -> float:
        """The wall clock minus the other, read as close together as a few attempts bring it."""
        looks = []
        for _ in range(LOOKS):
            before = self._clock()
            wall = self._wall()
            after = self._clock()
            looks.append((after - before, wall - (before + after) / 2.0))
        return min(looks)[1]
