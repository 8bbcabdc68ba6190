"""Errors of the phases of an encoder, and what of them is in a difference of phases."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from canfb.planning.planned_module import PlannedModule
from canfb.planning.situation import EncoderErrors
from canfb.signal.third_order import SECOND, THIRD

RAW_PHASE_ERROR_CYCLES = 0.0113  # of Table 1, without a correction table
TABLE_PHASE_ERROR_CYCLES = 0.001  # of what a reference measurement leaves
PEAK = 6.0  # standard deviations of the noise: one healthy sample in 5e8 is further off
ROUNDING_VARIANCE = 1.0 / 12.0  # counts^2


class Weights(NamedTuple):
    """How a difference of phases adds up their errors.

    order            of the prediction
    errors           sum of the sizes of the weights
    variance         sum of their squares
    """

    order: int
    errors: float
    variance: float


SECOND_DIFFERENCE = Weights(SECOND, 4.0, 6.0)  # 1, 2, 1
THIRD_DIFFERENCE = Weights(THIRD, 8.0, 20.0)  # 1, 3, 3, 1


@dataclass(frozen=True)
class PhaseErrors:
    """Of the encoder of a module, without those of the sampling instants."""

    errors: EncoderErrors
    module: PlannedModule

    @cached_property
    def noise_cycles(self) -> float:
        """The rms noise of a phase; inf without an amplitude."""
        counts = math.sqrt(self.errors.noise_counts**2 + ROUNDING_VARIANCE)
        amplitude = self.errors.amplitude * self.module.full_scale_counts
        return counts / (2.0 * math.pi * amplitude) if amplitude else math.inf

    @property
    def largest_cycles(self) -> float:
        """The largest error of a phase but for noise, stated or usual."""
        if self.errors.phase_cycles is not None:
            return self.errors.phase_cycles
        return TABLE_PHASE_ERROR_CYCLES if self.module.has_table else RAW_PHASE_ERROR_CYCLES

    def largest_in(self, weights: Weights) -> float:
        """At most in a difference: all errors at the same time, and the noise."""
        noise = PEAK * math.sqrt(weights.variance) * self.noise_cycles
        return weights.errors * self.largest_cycles + noise

    def rms_in(self, weights: Weights) -> float:
        """The rms of a difference, as the module measures it (2011:0B).

        At speed the errors of the table are as good as random: up to their largest size, all alike.
        """
        return math.sqrt(weights.variance) * math.hypot(
            self.noise_cycles, self.largest_cycles / math.sqrt(3.0)
        )
