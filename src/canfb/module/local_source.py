"""A module with its own ADC: a source instead of the ADC PDO, object 2000h filled from it."""

from __future__ import annotations

from collections.abc import Callable

from canfb import objects as od
from canfb.device.od.dictionary import Dictionary
from canfb.module.objects.sample_input import PARTS, PLACES, SAMPLE_INVALID, ZERO_PULSE, SampleInput
from canfb.signal.sample import TICK_S, TICKS, Sample
from canfb.sources.protocol import Grouped, Source
from canfb.sources.source_watch import SourceWatch


class LocalSource:
    """Asks a :class:`canfb.sources.protocol.Source` at each SYNC; nothing that it does raises.

    ``tell`` gets one line when the source fails, when it works again, and when it has ended.
    """

    def __init__(
        self, source: Source, dictionary: Dictionary, sample_input: SampleInput, tell: Callable[[str], None]
    ) -> None:
        self._watch = SourceWatch(source.next, tell)
        self._input = sample_input
        entries = [dictionary.entry(*part) for part in PARTS]
        self._sine, self._cosine, self._coarse_sine, self._coarse_cosine = entries[:4]
        self._time, self._flags, self._place = entries[4:]
        self._earlier = [
            (dictionary.entry(*sine), dictionary.entry(*cosine)) for sine, cosine in od.SAMPLE_EARLIER
        ]
        self.samples_per_sync = source.samples_per_sync if isinstance(source, Grouped) else 1
        """Pairs in a sample; several have a time."""
        self.timed_s: float | None = None
        """Time of the last sample by its time stamps, seconds since the first one; None without them."""

    @property
    def ended(self) -> bool:
        """The source has no sample left."""
        return self._watch.ended

    def next(self, now: float) -> Sample | None:
        """The sample of the SYNC at ``now`` (seconds), None for a missed one; its counts go into 2000h."""
        sample = self._watch.sample(now)
        if sample is not None:
            self._keep(sample)
        return sample

    def _keep(self, sample: Sample) -> None:
        self._sine.value, self._cosine.value = sample.sine, sample.cosine
        flags = SAMPLE_INVALID if sample.invalid else 0
        if sample.zero_pulse is not None:
            self._input.pulses += 1
            flags |= ZERO_PULSE
            self._place.value = min(int(sample.zero_pulse * PLACES), 0xFFFF)
        self._flags.value = flags
        if sample.time_100ns is not None:
            self._keep_time(sample.time_100ns)
        for (first, second), (sine, cosine) in zip(self._earlier, sample.earlier, strict=False):
            first.value, second.value = sine, cosine
        if sample.coarse_sine is not None:
            self._coarse_sine.value, self._coarse_cosine.value = sample.coarse_sine, sample.coarse_cosine

    def _keep_time(self, time_100ns: int) -> None:
        ticks = (time_100ns - self._time.value) % TICKS
        self.timed_s = 0.0 if self.timed_s is None else self.timed_s + ticks * TICK_S
        self._time.value = time_100ns % TICKS
