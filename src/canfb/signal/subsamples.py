"""Several samples in one interval of SYNC (2000:08..0D): put in their order, with their distances.

The encoder interface samples m times in an interval, by its own clock, and sends the pairs together. The
chain then works in intervals of a sample, 1/m of that of SYNC.
"""

from __future__ import annotations

from canfb.signal.sample import Sample

MOST_PER_SYNC = 4
LEAST_APART = 0.25  # sampling interval: a pair nearer to the sample before it, or older, is left out


def in_order(sample: Sample, passed: float, per_sync: int) -> list[Sample]:
    """The samples of this interval, oldest first; ``elapsed`` of each is in sampling intervals, above 0.

    ``passed`` are the sampling intervals since the newest sample of the interval before, ``per_sync`` how
    many there are in an interval of SYNC. What belongs to all of them, or to the instant of the newest,
    stays with that. The zero pulse is given to the sample before which it came.
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
    """Where the ``pulse`` is in the interval from ``begin``, None: not there; and the pulse if it is left."""
    if pulse is None or pulse > begin + elapsed:
        return None, pulse
    return (pulse - begin) / elapsed, None
