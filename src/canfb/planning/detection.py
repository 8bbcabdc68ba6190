"""Which errors of the count cannot pass unseen, by the residual limit L and what the motion uses of it.

Eq. 9: the bounds of docs/legal-motion.md ("Effect of a glitch", "Missed samples"), with the
acceleration a in cycles per interval squared: n samples in a row are without harm while (n + 2) (L + a) <= 1
and floor((n + 2)^2 / 4) (L + a) <= 1. Third-order prediction: those of docs/legal-motion.md, with the jerk.
"""

from __future__ import annotations

from dataclasses import dataclass

from canfb.signal.bounded_motion import scale
from canfb.signal.limits import PHASE_ERROR_CYCLES, ROUNDING, safe_deviation, samples_without_harm

SAMPLE_BOUNDS = {n: safe_deviation(n) for n in (1, 2, 3)}
"""Largest L + a for so many samples in a row."""
WELL = 1.0 / 6.0  # docs/faults.md: keep the limit below 1/6
WELL_THIRD_ORDER = 0.25  # docs/legal-motion.md: a single bad sample is without harm


@dataclass(frozen=True)
class CountDetection:
    """What a supervision by eq. 12 detects.

    limit_cycles       the residual limit, L
    motion_cycles      what the motion uses of it: the largest acceleration, cycles per interval squared
    accepted_cycles    largest acceleration of a trajectory that is accepted over missed samples:
                       2010:02, or L while that is not known
    """

    limit_cycles: float
    motion_cycles: float
    accepted_cycles: float

    well = WELL

    @property
    def bad_samples(self) -> int:
        """Bad samples in a row, of any phase, that cannot make an unseen error of the count."""
        return samples_without_harm(self.limit_cycles + self.motion_cycles)

    @property
    def missed_samples(self) -> int:
        """Missed samples in a row after which exactly one trajectory is left, for every motion."""
        return samples_without_harm(self.accepted_cycles + self.motion_cycles)

    @property
    def unseen_jump_cycles(self) -> float:
        """A jump of the phase below this one may pass."""
        return self.limit_cycles

    @property
    def half_cycle(self) -> bool:
        """A jump of half a cycle (both tracks inverted) is over the limit in its own sample."""
        return self.limit_cycles + self.motion_cycles < 0.5

    @property
    def is_sharp(self) -> bool:
        """The limit is where the pages want it."""
        return self.limit_cycles + self.motion_cycles <= self.well + ROUNDING


@dataclass(frozen=True)
class JerkDetection(CountDetection):
    """The same with third-order prediction: the motion is the jerk, cycles per interval cubed.

    known_jerk      2010:08, cycles per interval cubed; None: not known
    phase_cycles    largest error of a phase
    known_error     what the module takes for it
    """

    known_jerk: float | None
    phase_cycles: float
    known_error: float = PHASE_ERROR_CYCLES

    well = WELL_THIRD_ORDER

    @property
    def bad_samples(self) -> int:
        """1 or 0: two in succession nearly always lose the position."""
        return int(self.is_sharp)

    @property
    def unseen_jump_cycles(self) -> float:
        """The sample after a jump counts twice: a third difference is 1, -2, 1 times the jump."""
        return self.limit_cycles / 2.0 if self.limit_cycles <= 1.0 / 3.0 else self.limit_cycles

    @property
    def missed_samples(self) -> int:
        """Those after which no other cycle is as near to the parabola as the module accepts, 0..3."""
        return next((n for n in (3, 2, 1) if self._is_certain(n)), 0)

    def _is_certain(self, missed: int) -> bool:
        jerks = scale((-2.0, -1.0, 0.0), missed + 1.0)
        weights = 2.0 * (missed + 2.0) ** 2
        accepted = self.limit_cycles * max(jerks, weights / 8.0)
        if self.known_jerk is not None:
            accepted = min(accepted, self.known_jerk * jerks + self.known_error * weights)
        off = self.motion_cycles * jerks + self.phase_cycles * weights
        return accepted + off <= 1.0 + ROUNDING
