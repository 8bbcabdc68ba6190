"""Which errors of the count cannot pass unseen, by the residual limit L and the acceleration a.

The bounds of docs/faults.md, "Effect of a glitch" and "Effect of a missed sample": n samples in a row are
without harm while (n + 2) (L + a) <= 1 and floor((n + 2)^2 / 4) (L + a) <= 1.
"""

from __future__ import annotations

from dataclasses import dataclass

from canfb.signal.limits import ROUNDING, safe_deviation, samples_without_harm

SAMPLE_BOUNDS = {n: safe_deviation(n) for n in (1, 2, 3)}
"""Largest L + a for so many samples in a row."""
WELL = 1.0 / 6.0  # docs/faults.md: keep the limit below 1/6


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
