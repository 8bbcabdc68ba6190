"""A module with its own ADC: a source instead of the ADC PDO, object 2000h filled from it."""

from __future__ import annotations

import math
from collections.abc import Callable

from canfb.device.od.dictionary import Dictionary
from canfb.module.objects.sample_input import PARTS, PLACES, SAMPLE_INVALID, ZERO_PULSE, SampleInput
from canfb.signal.sample import Sample
from canfb.signal.sample_times import TICK_S, TICKS
from canfb.sources.protocol import Source, SourceEnded

SETTLED_S = 1.0  # without a failure, before a source is said to work again
LEAST, MOST = -32768, 32767  # INTEGER16


class LocalSource:
    """Asks a :class:`canfb.sources.protocol.Source` at each SYNC; nothing that it does raises.

    ``tell`` gets one line when the source fails, when it works again, and when it has ended.
    """

    def __init__(
        self, source: Source, dictionary: Dictionary, sample_input: SampleInput, tell: Callable[[str], None]
    ) -> None:
        self._source = source
        self._tell = tell
        self._input = sample_input
        entries = [dictionary.entry(*part) for part in PARTS]
        self._sine, self._cosine, self._coarse_sine, self._coarse_cosine = entries[:4]
        self._time, self._flags, self._place = entries[4:]
        self._failed_s: float | None = None
        self.ended = False
        """The source has no sample left."""
        self.timed_s: float | None = None
        """Time of the last sample by its time stamps, seconds since the first one; None without them."""

    def next(self, now: float) -> Sample | None:
        """The sample of the SYNC at ``now`` (seconds), None for a missed one; its counts go into 2000h."""
        if self.ended:
            return None
        try:
            sample = self._source.next()
            if sample is not None:
                sample = self._taken(sample)
        except SourceEnded:
            self.ended = True
            self._tell("the source has ended: no more samples")
            return None
        except Exception as error:  # a node on a bus outlives its converter, whatever the driver raises
            if self._failed_s is None:
                self._tell(f"the source fails: {_one_line(error)}")
            self._failed_s = now
            return None
        if sample is not None and self._failed_s is not None and now - self._failed_s >= SETTLED_S:
            self._failed_s = None
            self._tell("the source works again")
        return sample

    def _taken(self, sample: Sample) -> Sample:
        """Whole counts, as object 2000h holds them."""
        sine, cosine = _counts("sine", sample.sine), _counts("cosine", sample.cosine)
        self._sine.value, self._cosine.value = sine, cosine
        if not 0.0 < sample.elapsed <= TICKS:
            raise ValueError(f"elapsed {sample.elapsed} is not a number of intervals")
        flags = SAMPLE_INVALID if sample.invalid else 0
        if sample.zero_pulse is not None:
            if not 0.0 <= sample.zero_pulse <= 1.0:
                raise ValueError(f"zero_pulse {sample.zero_pulse} is not a fraction of the interval")
            self._input.pulses += 1
            flags |= ZERO_PULSE
            self._place.value = min(int(sample.zero_pulse * PLACES), 0xFFFF)
        self._flags.value = flags
        if sample.time_100ns is not None:
            self._keep_time(sample.time_100ns)
        coarse_sine = coarse_cosine = None
        if sample.coarse_sine is not None and sample.coarse_cosine is not None:
            self._coarse_sine.value = coarse_sine = _counts("coarse_sine", sample.coarse_sine)
            self._coarse_cosine.value = coarse_cosine = _counts("coarse_cosine", sample.coarse_cosine)
        return sample._replace(sine=sine, cosine=cosine, coarse_sine=coarse_sine, coarse_cosine=coarse_cosine)

    def _keep_time(self, time_100ns: int) -> None:
        ticks = (time_100ns - self._time.value) % TICKS
        self.timed_s = 0.0 if self.timed_s is None else self.timed_s + ticks * TICK_S
        self._time.value = time_100ns % TICKS


def _counts(name: str, value: float) -> int:
    if not math.isfinite(value) or not LEAST <= (counts := round(value)) <= MOST:
        raise ValueError(f"{name} {value} does not fit INTEGER16")
    return counts


def _one_line(error: Exception) -> str:
    text = str(error).strip().splitlines()
    return text[0] if text else type(error).__name__
