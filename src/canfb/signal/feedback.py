"""What the signal chain gives for each sample."""

from __future__ import annotations

from typing import Final, NamedTuple

from canfb.objects import FAULT_WORDS, StatusBit

FAULT_BITS: Final = sum(FAULT_WORDS)
"""Of the status word: what is wrong with a sample."""
FLAGGED_BITS: Final = FAULT_BITS | StatusBit.COASTING.value | StatusBit.LOST.value
"""Those, and that the position coasts or is lost."""


class Feedback(NamedTuple):
    """Every stage of the chain for one sample.

    sine, cosine     conditioned tracks, counts
    amplitude        of the conditioned tracks, counts
    raw_phase        Table 1, cycles, 0..1; NaN without a phase
    cycles, phase    the position: cycle count and phase (cycles, 0..1). The measured one when
                     the sample was taken, the predicted one while coasting
    residual         eq. 12, cycles, 0..0.5; 0.5 when there was nothing to compare
    status           status word 2011:01 (:class:`canfb.signal.supervision.StatusBit`)
    speed_cycles     speed between the last two good samples, cycles per sampling interval:
                     the speed of half an interval ago
    acceleration_cycles  its change since the sample before, cycles per interval squared: the
                     acceleration of one interval ago
    jump_cycles      cycles that the position will be set right by, with the next sample; else 0
    samples          samples processed since the start: moves with every call
    """

    sine: float
    cosine: float
    amplitude: float
    raw_phase: float
    cycles: int
    phase: float
    residual: float
    status: int
    speed_cycles: float
    acceleration_cycles: float
    jump_cycles: int
    samples: int

    @property
    def valid(self) -> bool:
        """Status bit 0: the position may be used."""
        return bool(self.status & 1)
