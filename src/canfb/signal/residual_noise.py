"""The noise of the residual, measured while the machine moves (2011:0B), and the part a limit may use.

The difference of two successive residuals contains little of the motion, and weighs four phases by 1, 3, 3,
1. The rms is derived from the median of a block, which single jerks do not change.
"""

from __future__ import annotations

import itertools
import math
import statistics
from collections import deque

from canfb.signal.sample import Feedback
from canfb.signal.supervision import AMPLITUDE, CLIPPED, COASTING, FROZEN, LOST, MISSED, RESIDUAL, VALID

BLOCK_SAMPLES = 64
MEDIAN_OF_RMS = 0.6745  # median of |x| over rms, for a normal distribution
# Sums of the squared weights: of a residual (1, 2, 1), and of the difference of two residuals.
RESIDUAL_WEIGHTS, DIFFERENCE_WEIGHTS = 6.0, 20.0
# A block shows the errors of all phases if its phases are in EIGHTHS of the eight parts of the cycle, and its
# speed is LEAST_STEP cycles per interval or more from whole cycles.
EIGHTHS = 5
LEAST_STEP = 0.1
FEWEST_BLOCKS = 4  # blocks before a limit uses the noise
REFERENCE_BLOCKS = 32  # the first blocks, which are the reference; and the recent ones
MOST_GROWTH = 2.0  # times the reference
BAD = AMPLITUDE | CLIPPED | COASTING | FROZEN | LOST | MISSED | RESIDUAL


class ResidualNoise:
    """Measures in blocks of 64 successive valid samples of a moving machine, one block in four.

    ``rms_cycles`` is the rms of the residual in the last block, cycles, NaN before the first one.
    ``usable_cycles``: the largest of the last 32 blocks, at most twice that of the first 32, so that a
    slowly growing fault moves a limit by at most a factor of two; NaN before four blocks.
    """

    __slots__ = ("_block", "_recent", "_reference", "due", "rms_cycles")

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        self.rms_cycles = math.nan
        self._reference: list[float] = []
        self._recent: deque[float] = deque(maxlen=REFERENCE_BLOCKS)
        self.due = 0
        """Number of the sample at which the next block begins: :meth:`take` needs none before it."""
        self._block: list[Feedback] = []

    @property
    def usable_cycles(self) -> float:
        if len(self._recent) < FEWEST_BLOCKS:
            return math.nan
        return min(max(self._recent), MOST_GROWTH * max(self._reference))

    def take(self, feedback: Feedback) -> bool:
        if feedback.samples < self.due:
            return False
        if feedback.status & (BAD | VALID) != VALID:
            self._block = []
            return False
        self._block.append(feedback)
        return len(self._block) >= BLOCK_SAMPLES + 2 and self._complete()

    def _complete(self) -> bool:
        block, self._block = self._block, []
        last = block[-1]
        step = abs(last.speed_cycles - round(last.speed_cycles))
        eighths = {int(one.phase * 8.0) for one in block}
        if len(eighths) < EIGHTHS or step < LEAST_STEP:
            return False
        residuals = [one.acceleration_cycles for one in block[1:]]
        differences = [abs(new - old) for old, new in itertools.pairwise(residuals)]
        difference = statistics.median(differences) / MEDIAN_OF_RMS
        self.rms_cycles = rms = difference * math.sqrt(RESIDUAL_WEIGHTS / DIFFERENCE_WEIGHTS)
        self._recent.append(rms)
        if len(self._reference) < REFERENCE_BLOCKS:
            self._reference.append(rms)
        self.due = last.samples + 3 * BLOCK_SAMPLES + 1
        return True
