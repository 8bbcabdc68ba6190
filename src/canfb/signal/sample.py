"""One sample: what the encoder interface measured at one instant."""

from __future__ import annotations

from typing import NamedTuple

TICK_S, TICKS = 1e-7, 1 << 32
"""Sample times are U32 in 100 ns (2000:05)."""


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
                            elapsed time counts, and ``elapsed`` is not used
    earlier                 pairs (sine, cosine) that were taken before this one in the same interval, the
                            newest first: pair j of m - 1 was taken j/m of an interval before
    options                 elapsed times that are possible if it is not known which one it was, ``elapsed``
                            the first of them: the phases decide, or :meth:`SignalChain.confirm`
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
    options: tuple[float, ...] = ()
