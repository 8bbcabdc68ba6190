"""Which errors of the count cannot pass unseen, by the residual limit L and what the motion uses of it.

Eq. 9: the bounds of docs/legal-motion.md ("Effect of a glitch"), with the acceleration a in cycles per
interval squared: n samples in a row are without harm while (n + 2) (L + a) <= 1 and
floor((n + 2)^2 / 4) (L + a) <= 1. Third-order prediction: those of the same page, with the jerk. What is
kept after missed or flagged samples follows from what is declared ("Missed samples").
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from canfb.signal.declared import Declared
from canfb.signal.limits import ROUNDING, safe_deviation, samples_without_harm

SAMPLE_BOUNDS = {n: safe_deviation(n) for n in (1, 2, 3)}
"""Largest L + a for so many samples in a row."""
WELL = 1.0 / 6.0  # docs/faults.md: keep the limit below 1/6
WELL_THIRD_ORDER = 0.25  # docs/legal-motion.md: a single bad sample is without harm


@dataclass(frozen=True)
class CountDetection:
    """What a supervision by eq. 12 detects.

    limit_cycles       the residual limit, L
    motion_cycles      what the motion uses of it: the largest acceleration, cycles per interval squared
    declared           what is declared of machine and encoder: the motions that are followed in doubt
    """

    limit_cycles: float
    motion_cycles: float
    declared: Declared

    well = WELL

    @property
    def bad_samples(self) -> int:
        """Bad samples in a row, of any phase, that cannot make an unseen error of the count."""
        return samples_without_harm(self.limit_cycles + self.motion_cycles)

    @property
    def missed_samples(self) -> int:
        """Missed or flagged samples in a row after which exactly one motion is left."""
        return self.declared.kept_samples(self.motion_cycles)

    def kept_with(self, **declared: Any) -> int:
        """:attr:`missed_samples` if this were declared instead, by the names of :class:`Declared`."""
        return replace(self.declared, **declared).kept_samples(self.motion_cycles)

    @property
    def is_declared(self) -> bool:
        """The motion is within what is declared, or assumed in doubt."""
        return self.motion_cycles <= self.declared.followed + ROUNDING

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
        """The limit is as narrow as docs/faults.md recommends."""
        return self.limit_cycles + self.motion_cycles <= self.well + ROUNDING


@dataclass(frozen=True)
class JerkDetection(CountDetection):
    """The same with third-order prediction: the motion is the jerk, cycles per interval cubed."""

    well = WELL_THIRD_ORDER

    @property
    def bad_samples(self) -> int:
        """1 or 0: two in succession nearly always lose the position."""
        return int(self.is_sharp)

    @property
    def unseen_jump_cycles(self) -> float:
        """The sample after a jump counts twice: a third difference is 1, -2, 1 times the jump."""
        return self.limit_cycles / 2.0 if self.limit_cycles <= 1.0 / 3.0 else self.limit_cycles
