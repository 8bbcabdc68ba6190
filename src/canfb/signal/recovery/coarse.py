"""The coarse track, one cycle per revolution: a rough check of the position, and its rough estimate.

Paper, section 4: a second estimate of position and speed shows an error of the first, and
sets the cycle count into the right range of speed.
"""

from __future__ import annotations

import math

from canfb.signal.recovery.speed_search import SpeedSearch

HYSTERESIS = 0.75  # a disagreement ends below this part of the limit
LOWEST_AMPLITUDE = 0.1  # of the full scale: a coarse track below it is ignored
NOISE_LSB = 4.0  # of the angle
HARMONIC = 2  # of the revolution, the highest that the error of the coarse track may have


class CoarseTrack:
    """Compares the angle of the coarse track with the position, and finds lost ranges of speed.

    ``limit_revolutions`` (2010:05) is how far the two may differ; the coarse track itself
    must be that accurate. All angles in revolutions.
    """

    def __init__(self, cycles_per_revolution: int, full_scale_counts: int, limit_revolutions: float) -> None:
        self.cycles_per_revolution = cycles_per_revolution
        self.full_scale_counts = full_scale_counts
        self.limit_revolutions = limit_revolutions
        self.forget()

    def forget(self) -> None:
        """Forget where the coarse track stands to the fine one."""
        self._offset: float | None = None
        self._disagrees = False
        self.restart_search()

    @property
    def aligned(self) -> bool:
        """True once it is known where the coarse track stands to the fine one."""
        return self._offset is not None

    def angle(self, sine: float, cosine: float) -> float | None:
        """Angle of the coarse track, 0..1 revolution; None if its amplitude is too small."""
        lowest = LOWEST_AMPLITUDE * self.full_scale_counts
        if not sine * sine + cosine * cosine > lowest * lowest:
            return None
        return math.atan2(sine, cosine) / (2.0 * math.pi) % 1.0 % 1.0

    def align(self, angle: float, cycles: int, phase: float) -> None:
        """Take this position, known to be right, for the one at ``angle``."""
        self._offset = angle - self._fine_angle(cycles, phase)
        self._disagrees = False

    def disagrees(self, angle: float | None, cycles: int, phase: float) -> bool:
        """True if the coarse track contradicts this position, or has no angle."""
        if angle is None or self._offset is None:
            return angle is None
        difference = abs(_wrapped(angle - self._offset - self._fine_angle(cycles, phase)))
        limit = self.limit_revolutions * (HYSTERESIS if self._disagrees else 1.0)
        self._disagrees = difference > limit
        return self._disagrees

    def nearest_cycles(self, angle: float, cycles: int, phase: float) -> int:
        """The cycle count nearest to ``cycles`` whose position stands at ``angle``, as far as known."""
        difference = _wrapped(angle - (self._offset or 0.0) - self._fine_angle(cycles, phase))
        return cycles + round(difference * self.cycles_per_revolution)

    def restart_search(self) -> None:
        """Restart the search for the range of speed."""
        self._turned = 0.0
        self._last_angle: float | None = None
        self._first_cycles = 0
        self._time = 0.0
        slope = (
            2.0 * math.pi * HARMONIC * self.limit_revolutions
        )  # the error changes slowly along the revolution
        noise = NOISE_LSB / (math.pi * self.full_scale_counts) * self.cycles_per_revolution
        most = 2.0 * self.limit_revolutions * self.cycles_per_revolution
        self._search = SpeedSearch(slope, most, noise)

    def search(self, angle: float | None, cycles: int, phase: float, elapsed: float) -> int | None:
        """Feed a position that eq. 9 counts with a speed wrong by whole cycles per interval.

        The number of cycles per interval that its speed lacks, or None as long as the coarse
        track cannot determine it. Eq. 9 must have counted without a gap since :meth:`restart_search`.
        """
        if angle is None:
            self.restart_search()
            return None
        if self._last_angle is None:
            self._last_angle, self._first_cycles = angle, cycles
        else:
            self._time += elapsed
        self._turned += _wrapped(angle - self._last_angle)
        self._last_angle = angle
        moved = self._turned * self.cycles_per_revolution
        return self._search.feed(self._time, moved - (cycles - self._first_cycles) - phase, moved)

    def _fine_angle(self, cycles: int, phase: float) -> float:
        return (cycles % self.cycles_per_revolution + phase) / self.cycles_per_revolution


def _wrapped(angle: float) -> float:
    return angle - math.floor(angle + 0.5)
