"""One sample: what the encoder interface measured at one instant, and several in one interval of SYNC.

Of several (2000:08..0D, 0F..16) it takes m in an interval, by its own clock, and sends the pairs together.
The chain then works in intervals of a sample, 1/m of that of SYNC.
"""

from __future__ import annotations

from typing import NamedTuple

TICK_S, TICKS = 1e-7, 1 << 32
"""Sample times are U32 in 100 ns (2000:05)."""

MOST_PER_SYNC = 8
LEAST_APART = 0.25  # sampling interval: a pair nearer to the sample before it, or older, is left out


class Sample(NamedTuple):
    """One pair of ADC counts with what came with it (objects 2000:01..0D).

    sine, cosine            ADC counts, signed, zero at mid-scale
    elapsed                 intervals of SYNC since the sample before; 1.0 on a bus without
                            losses, n + 1 after n missed samples
    invalid                 the encoder interface itself calls this sample bad (2000:06 bit 1)
    coarse_sine, coarse_cosine  the track with one cycle per revolution, ADC counts, or None
    zero_pulse              the zero pulse came since the sample before, at this part of the
                            interval (0..1, 2000:07); None: it did not
    time_100ns              sample time in 100 ns, modulo 2^32 (2000:05), or None. With it the real
                            elapsed time counts, and ``elapsed``, by the count of SYNCs, is a check
    earlier                 pairs (sine, cosine) that were taken before this one in the same interval, the
                            newest first: pair j of m - 1 was taken j/m of an interval before
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
    """The samples of this interval, oldest first; ``elapsed`` of each is in sampling intervals, above 0.

    ``passed`` are those since the newest sample of the interval before, ``per_sync`` how many there are in
    one of SYNC. The zero pulse is given to the sample before which it came, the rest stays with the newest.
    """
    earlier = sample.earlier[: per_sync - 1]
    while earlier and passed - len(earlier) < LEAST_APART:
        earlier = earlier[:-1]
    pulse = None if sample.zero_pulse is None else sample.zero_pulse * passed
    begin = 0.0
    samples: list[Sample] = []
    for sine, cosine in reversed(earlier):
        elapsed = passed - len(earlier) if not samples else 1.0
        place, pulse = _place(pulse, begin, elapsed)
        samples.append(Sample(sine, cosine, elapsed, zero_pulse=place))
        begin += elapsed
    elapsed = passed - begin
    place = None if pulse is None else min((pulse - begin) / elapsed, 1.0)
    return [*samples, sample._replace(elapsed=elapsed, zero_pulse=place)]


def _place(pulse: float | None, begin: float, elapsed: float) -> tuple[float | None, float | None]:
    if pulse is None or pulse > begin + elapsed:
        return None, pulse
    return (pulse - begin) / elapsed, None
