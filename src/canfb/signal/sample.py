"""One sample: what the encoder interface measured at one instant, and what the signal chain makes of it.

The interface may take m samples in an interval of SYNC, by its own clock, and send the pairs together
(2000:08..0D, 0F..16). The chain then works in sampling intervals, 1/m of that of SYNC.
"""

from __future__ import annotations

from math import inf
from typing import Final, NamedTuple

from canfb.objects import FAULT_WORDS, StatusBit

TICK_S, TICKS = 1e-7, 1 << 32
"""Sample times are U32 in 100 ns (2000:05)."""

MOST_PER_SYNC = 8
LEAST_APART = 0.25  # sampling intervals: a pair that is nearer to the sample before it, or older, is left out


class Sample(NamedTuple):
    """One pair of ADC counts with what came with it (objects 2000:01..0D).

    sine, cosine            ADC counts, signed, zero at mid-scale
    elapsed                 intervals of SYNC since the previous sample: n + 1 after n missed samples
    invalid                 the encoder interface flagged this sample as bad (2000:06 bit 1)
    coarse_sine, coarse_cosine  the track with one cycle per revolution, ADC counts, or None
    zero_pulse              fraction of the interval at which the zero pulse came (0..1, 2000:07); None: it
                            did not
    time_100ns              sample time in 100 ns, modulo 2^32 (2000:05), or None. It determines the
                            elapsed time; ``elapsed``, by the count of SYNCs, is then a check
    earlier                 earlier pairs (sine, cosine) of the same interval, newest first: pair j of m - 1
                            was taken j/m of an interval before
    """

    sine: float
    cosine: float
    elapsed: float = 1.0
    invalid: bool = False
    coarse_sine: float | None = None
    coarse_cosine: float | None = None
    zero_pulse: float | None = None
    time_100ns: int | None = None
    earlier: tuple[tuple[float, float], ...] = ()


def in_order(sample: Sample, passed: float, per_sync: int) -> list[Sample]:
    """The samples of this SYNC interval, oldest first, each with ``elapsed`` > 0 in sampling intervals.

    ``passed``: sampling intervals since the newest sample of the SYNC interval before; ``per_sync``: samples
    in an interval of SYNC. The zero pulse goes to the first sample after it, the rest to the newest.
    """
    earlier = sample.earlier[: per_sync - 1]
    while earlier and passed - len(earlier) < LEAST_APART:
        earlier = earlier[:-1]
    pulse = inf if sample.zero_pulse is None else sample.zero_pulse * passed
    begin = 0.0
    samples: list[Sample] = []
    for sine, cosine in reversed(earlier):
        elapsed = passed - len(earlier) if not samples else 1.0
        place = None
        if pulse <= begin + elapsed:
            place, pulse = (pulse - begin) / elapsed, inf
        samples.append(Sample(sine, cosine, elapsed, zero_pulse=place))
        begin += elapsed
    elapsed = passed - begin
    place = None if pulse == inf else min((pulse - begin) / elapsed, 1.0)
    return [*samples, sample._replace(elapsed=elapsed, zero_pulse=place)]


FAULT_BITS: Final = sum(FAULT_WORDS)
"""Status bits: faults of a sample."""
FLAGGED_BITS: Final = FAULT_BITS | StatusBit.COASTING.value | StatusBit.LOST.value
"""Status bits: faults of a sample, and a position that coasts or is lost."""


class Feedback(NamedTuple):
    """Every stage of the chain for one sample.

    sine, cosine     conditioned tracks, counts
    amplitude        of the conditioned tracks, counts
    raw_phase        Table 1, cycles, 0..1; NaN without a phase
    cycles, phase    the position: cycle count and phase (cycles, 0..1); measured if the sample was
                     used, predicted while coasting
    residual         eq. 12, cycles, 0..0.5; 0.5 if there was nothing to compare
    status           status word 2011:01 (:class:`canfb.signal.supervision.StatusBit`)
    speed_cycles     speed between the last two good samples, cycles per sampling interval:
                     the speed half an interval ago
    acceleration_cycles  its change since the previous sample, cycles per interval squared: the
                     acceleration one interval ago
    jump_cycles      cycles by which the position will be corrected at the next sample; else 0
    samples          samples processed since the start, missed ones included
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
