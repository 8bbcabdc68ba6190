"""How large a deviation usually is, and from where on it is none of the usual ones."""

from __future__ import annotations

import math

WINDOW_SAMPLES = 1024
LEARNED_SAMPLES = 32
BEYOND = 2.0  # times the largest of the last samples: more than 6 standard deviations of Gaussian jitter


class UsualScatter:
    """Follows the largest deviation of the last 1024 to 2048 samples.

    ``limit_s`` is twice that, seconds; infinite until 32 samples have come. One that is beyond it
    is learned like the others: what goes on is usual from the second sample on.
    """

    __slots__ = ("_before_s", "_largest_s", "_left", "_unlearned", "limit_s")

    def __init__(self) -> None:
        self.limit_s = math.inf
        self._largest_s = self._before_s = 0.0
        self._left = WINDOW_SAMPLES
        self._unlearned = LEARNED_SAMPLES

    def learn(self, deviation_s: float) -> None:
        """Another sample deviates by so much, seconds, at least 0."""
        if deviation_s > self._largest_s:
            self._largest_s = deviation_s
            self._find_limit()
        self._left -= 1
        if not self._left:
            self._before_s, self._largest_s = self._largest_s, 0.0
            self._left = WINDOW_SAMPLES
            self._find_limit()
        if self._unlearned:
            self._unlearned -= 1
            self._find_limit()

    def _find_limit(self) -> None:
        if not self._unlearned:
            self.limit_s = BEYOND * max(self._largest_s, self._before_s)
