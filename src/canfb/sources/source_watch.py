"""A source asked for the sample of each SYNC by a node that stays on its bus, whatever the source does."""

from __future__ import annotations

import math
from collections.abc import Callable

from canfb.signal.sample import TICKS, Sample
from canfb.sources.protocol import SourceEnded

SETTLED_S = 1.0  # without a failure, before a source is said to work again
LEAST, MOST = -32768, 32767  # INTEGER16


class SourceWatch:
    """Calls ``ask`` for one sample at each SYNC; nothing that it raises goes through.

    ``tell`` gets one line when the source fails, when it works again, and when it has ended.
    """

    def __init__(self, ask: Callable[[], Sample | None], tell: Callable[[str], None]) -> None:
        self._ask = ask
        self._tell = tell
        self._failed_s: float | None = None
        self.ended = False
        """The source has no sample left."""

    @property
    def failing(self) -> bool:
        """It has failed, and has not worked for a second since."""
        return self._failed_s is not None

    def sample(self, now: float) -> Sample | None:
        """The sample of the SYNC at ``now`` (seconds), in whole counts; None for a missed one."""
        if self.ended:
            return None
        try:
            sample = self._ask()
            if sample is not None:
                sample = _checked(sample)
        except SourceEnded:
            self.ended = True
            self._tell("the source has ended: no more samples")
            return None
        except Exception as error:  # a node on a bus outlives its converter, whatever the driver raises
            first, self._failed_s = self._failed_s is None, now
            if first:
                self._tell(f"the source fails: {_one_line(error)}")
            return None
        if sample is not None and self._failed_s is not None and now - self._failed_s >= SETTLED_S:
            self._failed_s = None
            self._tell("the source works again")
        return sample


def _checked(sample: Sample) -> Sample:
    """The sample in whole counts; half a coarse track is none. ValueError for what no object can hold."""
    sine, cosine = _counts("sine", sample.sine), _counts("cosine", sample.cosine)
    if not 0.0 < sample.elapsed <= TICKS:
        raise ValueError(f"elapsed {sample.elapsed} is not a number of intervals")
    if sample.zero_pulse is not None and not 0.0 <= sample.zero_pulse <= 1.0:
        raise ValueError(f"zero_pulse {sample.zero_pulse} is not a fraction of the interval")
    coarse_sine = coarse_cosine = None
    if sample.coarse_sine is not None and sample.coarse_cosine is not None:
        coarse_sine = _counts("coarse_sine", sample.coarse_sine)
        coarse_cosine = _counts("coarse_cosine", sample.coarse_cosine)
    earlier = tuple((_counts("sine", one), _counts("cosine", other)) for one, other in sample.earlier)
    return sample._replace(
        sine=sine, cosine=cosine, coarse_sine=coarse_sine, coarse_cosine=coarse_cosine, earlier=earlier
    )


def _counts(name: str, value: float) -> int:
    if not math.isfinite(value) or not LEAST <= (counts := round(value)) <= MOST:
        raise ValueError(f"{name} {value} does not fit INTEGER16")
    return counts


def _one_line(error: Exception) -> str:
    text = str(error).strip().splitlines()
    return text[0] if text else type(error).__name__
