"""How large a deviation usually is, and from where on it is none of the usual ones."""

from __future__ import annotations

WINDOW_SAMPLES = 1024
LEARNED_SAMPLES = 32
BEYOND = 2.0  # times the largest of the last samples: more than 6 standard deviations of Gaussian jitter
# Times the largest, where another witness is against it, too: of Gaussian jitter one in 114 is beyond after
# 32 samples (one in 33 is beyond the largest itself), later far fewer.
DOUBTED = 1.25
# From standstill a machine has at most 32 A cycles per interval when 32 samples have come. Another cycle
# count within the limit L needs an error of a time that costs 1 - L - A there: (1 - L - A) / 32 A intervals,
# L = 1/3, A = L / 2. Below it no error of a time does harm before the usual ones are known.
START_PART = 3.0 / 32.0
# A deviation that was refused is usual if it is one of BEGUN with less than APART samples from one to the
# next: jitter begins like that, wrong times are rarer.
BEGUN, APART = 3, 24


class UsualScatter:
    """Follows the largest deviation of the last 1024 to 2048 samples.

    ``ever_s`` is that, ``limit_s`` twice as much, seconds; :meth:`limit_of` is what holds for intervals of
    some length: at most some part of one, and until 32 samples have come at least 3/32. What is beyond the
    limit is not learned, unless it is the third in close succession.
    """

    __slots__ = (
        "_before_s",
        "_largest_s",
        "_left",
        "_passed",
        "_refused",
        "_refused_s",
        "ever_s",
        "learned",
        "limit_s",
    )

    def __init__(self) -> None:
        self.limit_s = self.ever_s = 0.0
        self.learned = 0
        """Samples that count towards the first limit, up to 32."""
        self._largest_s = self._before_s = 0.0
        self._left = WINDOW_SAMPLES
        self._refused, self._refused_s = 0, 0.0  # in close succession, and the largest of them
        self._passed = 0  # samples since the last of them

    def limit_of(self, interval_s: float, most_part: float) -> float:
        """The limit in force for intervals of this length, seconds; at most so much of one."""
        limit_s = self.limit_s
        if self.learned < LEARNED_SAMPLES:
            limit_s = max(limit_s, START_PART * interval_s)
        return min(limit_s, most_part * interval_s)

    def see(self, deviation_s: float, limit_s: float) -> bool:
        """Whether this one is usual, by the limit in force; it is learned, or refused."""
        usual = abs(deviation_s) <= limit_s
        if usual:
            self.learn(abs(deviation_s))
        else:
            self.refuse(abs(deviation_s))
        return usual

    def learn(self, deviation_s: float) -> None:
        """Another sample deviates by so much, seconds, at least 0, and was right."""
        if deviation_s > self._largest_s:
            self._largest_s = deviation_s
            self._find_limit()
        self._left -= 1
        self._passed += 1
        if not self._left:
            self._before_s, self._largest_s = self._largest_s, 0.0
            self._left = WINDOW_SAMPLES
            self._find_limit()
        if self.learned < LEARNED_SAMPLES:
            self.learned += 1

    def begin(self, deviations_s: list[float]) -> None:
        """These are all that are known, seconds, at least 0; what was refused stays so."""
        self._largest_s = max(deviations_s, default=0.0)
        self.learned = len(deviations_s)
        self._find_limit()

    def refuse(self, deviation_s: float) -> None:
        """Another one was beyond the limit: a wrong time, or jitter that begins."""
        if self._passed >= APART:
            self._refused, self._refused_s = 0, 0.0
        self._passed = 0
        self._refused += 1
        self._refused_s = max(self._refused_s, deviation_s)
        if self._refused >= BEGUN:
            self.learn(self._refused_s)

    def _find_limit(self) -> None:
        self.ever_s = max(self._largest_s, self._before_s)
        self.limit_s = BEYOND * self.ever_s
