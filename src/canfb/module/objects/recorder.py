"""Who gets every sample: the observers, and object 2050h, the samples as they come, for upload."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from canfb import objects as od
from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.device.od.dictionary import Dictionary
from canfb.module.interval import SamplingInterval
from canfb.signal.feedback import Feedback
from canfb.signal.sample import TICKS, Sample
from canfb.signal.sample_recording import SampleRecording


class SampleObserver(Protocol):
    """Gets each sample from `add` to `remove`, after its position was published."""

    def take(self, sample: Sample, feedback: Feedback) -> None:
        """A sample, and what the chain made of it."""

    def miss(self) -> None:
        """A SYNC without a sample."""


class SampleObservers:
    """The present observers; usually none."""

    __slots__ = ("open",)

    def __init__(self) -> None:
        self.open: tuple[SampleObserver, ...] = ()

    def add(self, observer: SampleObserver) -> None:
        """It gets the samples from the next one on; nothing happens when it does already."""
        if observer not in self.open:
            self.open = (*self.open, observer)

    def remove(self, observer: SampleObserver) -> None:
        """No more samples for it."""
        self.open = tuple(one for one in self.open if one is not observer)

    def take(self, sample: Sample, feedback: Feedback) -> None:
        """A sample for all of them."""
        for observer in self.open:
            observer.take(sample, feedback)

    def take_all(
        self, sample: Sample, feedback: Feedback, between: Sequence[Feedback], per_sync: int, apart_ticks: int
    ) -> None:
        """The samples of one SYNC, ``apart_ticks`` apart; ``between`` are the feedbacks before the newest."""
        for place in range(per_sync - 1, 0, -1):
            if place > len(between):
                self.miss()
                continue
            time = sample.time_100ns
            at = None if time is None else (time - place * apart_ticks) % TICKS
            sine, cosine = sample.earlier[place - 1]
            earlier = Sample(sine, cosine, invalid=sample.invalid, time_100ns=at)
            self.take(earlier, between[len(between) - place])
        self.take(sample, feedback)

    def miss(self) -> None:
        """No sample, for all of them."""
        for observer in self.open:
            observer.miss()


COMMANDS = frozenset(od.RecordingCommand)


class Recorder:
    """Records raw counts, one pair for each sampling interval, from the next sample on.

    Start (2050:01 = 1) drops what was recorded, stop (2) keeps it; when the memory is full
    (2050:02 = 2050:05) the recording ends by itself, and so it does when the module leaves
    OPERATIONAL, because time would be lost. 2050:03 gives the samples so far at any time.
    """

    def __init__(
        self, dictionary: Dictionary, interval: SamplingInterval, observers: SampleObservers
    ) -> None:
        self._interval = interval
        self._observers = observers
        self._recording = SampleRecording(dictionary.entry(*od.RECORDING_CAPACITY).value)
        self._command = command = dictionary.entry(*od.RECORDING_COMMAND)
        command.on_check = _check_command
        command.on_written = self._obey
        command.on_read = lambda: int(self.is_recording)
        dictionary.entry(*od.RECORDING_RECORDED).on_read = lambda: len(self._recording)
        dictionary.entry(*od.RECORDING_SAMPLES).on_read = self._recording.to_bytes
        dictionary.entry(*od.RECORDING_RATE).on_read = self._rate

    @property
    def is_recording(self) -> bool:
        """True while samples are taken."""
        return self in self._observers.open

    def reset(self) -> None:
        """Nothing is recorded, and nothing was."""
        self.stop()
        self._recording.clear()

    def stop(self) -> None:
        """No more samples; those that there are stay."""
        self._observers.remove(self)

    def take(self, sample: Sample, feedback: Feedback) -> None:
        """One sample, whatever the checks say of it; what the encoder interface calls invalid is none."""
        if sample.invalid:
            self._recording.miss()
        else:
            self._recording.take(int(sample.sine), int(sample.cosine))
        if self._recording.is_full:
            self.stop()

    def miss(self) -> None:
        """A SYNC without a sample."""
        self._recording.miss()
        if self._recording.is_full:
            self.stop()

    def _obey(self) -> None:
        if self._command.value == od.RecordingCommand.START:
            self._recording.clear()
            self._observers.add(self)
        else:
            self.stop()

    def _rate(self) -> int:
        interval_s = self._interval.sample_s
        return min(round(1.0 / interval_s), 0xFFFFFFFF) if interval_s > 0.0 else 0


def _check_command(value: int) -> None:
    if value not in COMMANDS:
        raise SdoAbort(AbortCode.INVALID_VALUE)
