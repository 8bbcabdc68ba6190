"""What the user declares of machine, encoder and bus, and what follows from it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

from canfb.signal.bounded_motion import ORDER, BoundedMotion
from canfb.signal.limits import MOST_IN_A_ROW, PHASE_ERROR_CYCLES, kept_samples, samples_without_harm
from canfb.signal.tracker import RESIDUAL_LIMIT

DOUBT_ACCELERATION = (
    0.1  # default of 2010:0B, cycles per interval^2: one to three missed samples are unique up to it
)
COAST_SAMPLES = 3  # default of 2010:03
MOST_BAD_SAMPLES = 8  # 2010:0A; what the estimator remembers is enough for them
MOST_BY_DEFAULT = 3  # each one more multiplies what a contradiction costs


@dataclass(frozen=True, kw_only=True)
class Declared:
    """Bounds while which hold a valid position is right. Intervals are those from sample to sample.

    residual_limit      of usual samples, cycles; in force, so narrowed by what is declared below
    widest_limit        2010:01, cycles: of the first step after a start; None: ``residual_limit``
    acceleration        largest, cycles per interval^2; None: not known
    acceleration_waits  it is declared, but not yet in which interval: the second sample shows it
    phase_error         largest of a good sample, cycles
    instant_error       largest of a sampling instant, intervals
    bad                 m: samples in a row that may be bad unnoticed; 0: as many as cannot do harm
    doubt_acceleration  assumed in doubt if ``acceleration`` is not known; 0: none is
    coast_samples       intervals of SYNC without a good sample until the position is lost
    samples_per_sync    in one of SYNC: all other intervals are those from sample to sample
    """

    residual_limit: float = RESIDUAL_LIMIT
    widest_limit: float | None = None
    acceleration: float | None = None
    acceleration_waits: bool = False
    phase_error: float = PHASE_ERROR_CYCLES
    instant_error: float = 0.0
    bad: int = 0
    doubt_acceleration: float = DOUBT_ACCELERATION
    coast_samples: int = COAST_SAMPLES
    samples_per_sync: int = 1

    @property
    def coasting(self) -> int:
        return self.coast_samples * self.samples_per_sync

    @property
    def first_limit(self) -> float:
        return max(self.residual_limit, self.widest_limit or 0.0)

    @property
    def start_error(self) -> float:
        """The part of :attr:`first_limit` that no acceleration and no phase error explains, cycles."""
        return self.first_limit - self.residual_limit

    @property
    def assumes(self) -> bool:
        return self.acceleration is None and self.doubt_acceleration > 0.0

    @cached_property
    def bad_samples(self) -> int:
        """m: as declared, or as many as cannot do harm at twice the bound; at least 1."""
        if self.bad:
            return self.bad
        return max(1, min(samples_without_harm(2.0 * self.followed), MOST_BY_DEFAULT))

    @property
    def followed(self) -> float:
        """Largest acceleration of the motions followed in doubt, cycles per interval^2."""
        return self.in_doubt.largest

    def kept_samples(self, motion: float | None = None) -> int:
        """Missed or flagged samples in a row after which the position is certain, 0..255.

        ``motion`` is the largest acceleration of the machine, None: :attr:`followed`.
        """
        largest = self.followed if motion is None else min(motion, self.followed)
        most = min(self.coasting, MOST_IN_A_ROW)
        return kept_samples(self.followed, largest, self.phase_error, most)

    @cached_property
    def usual(self) -> BoundedMotion:
        return self._motion(assumed=math.inf, usual=True)

    @cached_property
    def in_doubt(self) -> BoundedMotion:
        return self._motion(assumed=self.doubt_acceleration or math.inf, usual=False)

    def _motion(self, *, assumed: float, usual: bool) -> BoundedMotion:
        known, weights = self.acceleration, 2.0**ORDER
        if known is None:
            largest = max(0.0, self.residual_limit - weights * self.phase_error)
        else:
            largest = min(known, self.residual_limit)
        error = self.phase_error
        if usual:
            error = max(0.0, self.residual_limit - largest) / weights
        elif known is None:
            largest = min(largest, assumed)
        return BoundedMotion(largest, error, self.instant_error)
