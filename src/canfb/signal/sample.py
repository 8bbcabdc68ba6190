"""One sample: what the encoder interface measured at one instant."""

from __future__ import annotations

from typing import NamedTuple


class Sample(NamedTuple):
    """One pair of ADC counts with what came with it (objects 2000:01..07).

    sine, cosine            ADC counts, signed, zero at mid-scale
    elapsed                 sampling intervals since the sample before; 1.0 on a bus without
                            losses, n + 1 after n missed samples
    invalid                 the encoder interface itself calls this sample bad (2000:06 bit 1)
    coarse_sine/_cosine     the track with one cycle per revolution, ADC counts, or None
    """

    sine: float
    cosine: float
    elapsed: float = 1.0
    invalid: bool = False
    coarse_sine: float | None = None
    coarse_cosine: float | None = None
