"""Which errors of the count cannot pass unseen, by the residual limit L and the acceleration a.

The bounds of docs/faults.md, "Effect of a glitch" and "Effect of a missed sample": n samples in a row are
without harm while (n + 2) (L + a) <= 1 and floor((n + 2)^2 / 4) (L + a) <= 1.
"""

from __future__ import annotations

from dataclasses import dataclass

MOST_IN_A_ROW = 255
SAMPLE_BOUNDS = {1: 1.0 / 3.0, 2: 1.0 / 4.0, 3: 1.0 / 6.0}
"""Largest L + a for so many samples in a row."""
WELL = 1.0 / 6.0  # docs/faults.md: keep the limit below 1/6
ROUNDING = 1e-9


@dataclass(frozen=True)
class CountDetection:
    """What a supervision by eq. 12 detects.

    limit_cycles           the residual limit, L
    acceleration_cycles    the largest true acceleration, cycles per interval squared
    accepted_cycles        largest acceleration of a trajectory that is accepted over missed samples:
                           2010:02, or L while that is not known
    """

    limit_cycles: float
    acceleration_cycles: float
    accepted_cycles: float

    @property
    def bad_samples(self) -> int:
        """Bad samples in a row, of any phase, that cannot make an unseen error of the count."""
        return samples_without_harm(self.limit_cycles + self.acceleration_cycles)

    @property
    def missed_samples(self) -> int:
        """Missed samples in a row after which exactly one trajectory is left, for every motion."""
        return samples_without_harm(self.accepted_cycles + self.acceleration_cycles)

    @property
    def half_cycle(self) -> bool:
        """A jump of half a cycle (both tracks inverted) is over the limit in its own sample."""
        return self.limit_cycles + self.acceleration_cycles < 0.5

    @property
    def is_sharp(self) -> bool:
        """The limit is where docs/faults.md wants it."""
        return self.limit_cycles + self.acceleration_cycles <= WELL + ROUNDING


def samples_without_harm(cycles: float) -> int:
    """The largest n with (n + 2) x <= 1 and floor((n + 2)^2 / 4) x <= 1; ``cycles`` is x, not negative."""
    n = 0
    while n < MOST_IN_A_ROW and max(n + 3, (n + 3) ** 2 // 4) * cycles <= 1.0 + ROUNDING:
        n += 1
    return n
