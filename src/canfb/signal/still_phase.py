"""Does a machine stand still whose cycle count is lost? Its phases must, for long enough.

A machine that turns at whole cycles per interval shows phases that stand still, too. Of a drive with a clock
of its own, 100 ppm from that of SYNC, they move by more than 0.02 cycle in 256 samples; at any other speed
they stay so near with a chance of 1.6e-4.
"""

from __future__ import annotations

import math

STANDSTILL_CYCLES = 0.001  # per interval, on average: what noise and a servo at rest may show
STILL_SAMPLES, STILL_CYCLES = 256, 0.02


class StillPhase:
    """Counts the samples in a row near one phase; ``phase`` is that of a machine that is known to stand."""

    __slots__ = ("_phase", "samples")

    def __init__(self, phase: float | None = None) -> None:
        self.samples = 0 if phase is None else STILL_SAMPLES
        self._phase = math.nan if phase is None else phase

    def take(self, phase: float) -> None:
        """The next sample; ``phase`` 0..1, cycles."""
        apart = (phase - self._phase + 0.5) % 1.0 - 0.5
        if self.samples and abs(apart) <= STILL_CYCLES:
            self.samples += 1
        else:
            self.samples, self._phase = 1, phase
