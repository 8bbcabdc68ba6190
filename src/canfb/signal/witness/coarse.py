"""The coarse track, one cycle per revolution (paper, section 4): a witness with a value at every sample."""

from __future__ import annotations

import math

from canfb.signal.witness.witness import Pair, Witness

LOWEST_AMPLITUDE = 0.1  # of the full scale: a coarse track below it is ignored
NOISE_LSB = 4.0  # of the angle
HARMONIC = 2  # of the revolution, the highest that the error of the coarse track may have


class CoarseScale:
    """Revolutions in cycles; the coarse track itself must be right within ``limit_revolutions`` (2010:05)."""

    step_cycles = 0.0
    steady_cycles = math.inf  # its error changes along the revolution

    def __init__(self, cycles_per_revolution: int, full_scale_counts: int, limit_revolutions: float) -> None:
        self.given = cycles_per_revolution, full_scale_counts, limit_revolutions
        self.period_cycles = float(cycles_per_revolution)
        self.tolerance_cycles = limit_revolutions * cycles_per_revolution
        self.slope = 2.0 * math.pi * HARMONIC * limit_revolutions
        self.noise_cycles = NOISE_LSB / (math.pi * full_scale_counts) * cycles_per_revolution

    def moved_cycles(self, since: Pair, now: Pair) -> float:
        return (now.value - since.value) * self.period_cycles

    def difference_cycles(self, since: Pair, now: Pair) -> float:
        return self.moved_cycles(since, now) - (now.cycles - since.cycles) - (now.phase - since.phase)


class CoarseTrack(Witness):
    """Of ``cycles_per_revolution``, that may differ by ``limit_revolutions``."""

    scale: CoarseScale

    def __init__(self, cycles_per_revolution: int, full_scale_counts: int, limit_revolutions: float) -> None:
        self._turns = self._angle = 0.0  # whole revolutions, and the part of one at the last value
        super().__init__(CoarseScale(cycles_per_revolution, full_scale_counts, limit_revolutions))
        self.firm = True

    def limit(self, full_scale_counts: int, limit_revolutions: float) -> None:
        scale = CoarseScale(self.scale.given[0], full_scale_counts, limit_revolutions)
        if scale.given != self.scale.given:
            self.use(scale)

    def forget(self) -> None:
        super().forget()
        self.firm = True

    def angle(self, sine: float, cosine: float) -> float | None:
        """Angle, 0..1 revolution; None if its amplitude is too small."""
        lowest = LOWEST_AMPLITUDE * self.scale.given[1]
        if not sine * sine + cosine * cosine > lowest * lowest:
            return None
        return math.atan2(sine, cosine) / (2.0 * math.pi) % 1.0 % 1.0

    def pair(self, angle: float | None, cycles: int, phase: float, time: float) -> Pair | None:
        if angle is None:
            self.restart_search()
            return None
        self._turns += math.floor(self._angle - angle + 0.5)
        self._angle = angle
        return Pair(cycles, phase, self._turns + angle, time)
