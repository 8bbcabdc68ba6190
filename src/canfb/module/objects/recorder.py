"""Observers of every sample, and object 2050h: a recording for upload."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from canfb import objects as od
from canfb.device.od.dictionary import Dictionary, refuse_if
from canfb.module.interval import SamplingInterval
from canfb.signal.sample import TICKS, Feedback, Sample
from canfb.signal.sample_recording import SampleRecording


class SampleObserver(Protocol):
    """Gets each sample after its position was published."""

    def take(self, sample: Sample, feedback: Feedback) -> None:
        """Called with each sample."""

    def miss(self) -> None:
        """Called for each missed sample."""


class SampleObservers:
    """The observers; usually there are none."""

    __slots__ = ("open",)

    def __init__(self) -> None:
        self.open: tuple[SampleObserver, ...] = ()

    def add(self, observer: SampleObserver) -> None:
        if observer not in self.open:
            self.open = (*self.open, observer)

    def remove(self, observer: SampleObserver) -> None:
        self.open = tuple(one for one in self.open if one is not observer)

    def take_all(
        self, sample: Sample, feedback: Feedback, between: Sequence[Feedback], per_sync: int, apart_ticks: int
    ) -> None:
        """Pass on the samples of a SYNC, ``apart_ticks`` apart; ``between``: feedbacks before the newest."""
        for place in range(per_sync - 1, 0, -1):
            if place > len(between):
                self.miss()
                continue
            time = sample.time_100ns
            at = None if time is None else (time - place * apart_ticks) % TICKS
            sine, cosine = sample.earlier[place - 1]
            earlier = Sample(sine, cosine, invalid=sample.invalid, time_100ns=at)
            for observer in self.open:
                observer.take(earlier, between[len(between) - place])
        for observer in self.open:
            observer.take(sample, feedback)

    def miss(self) -> None:
        for observer in self.open:
            observer.miss()


class Recorder:
    """Records raw counts, one pair for each sampling interval.

    It ends when the memory is full (2050:02 = 2050:05), and when the module leaves OPERATIONAL or its input
    changes, since samples would be missing. 2050:03 has the samples so far at any time.
    """

    def __init__(
        self, dictionary: Dictionary, interval: SamplingInterval, observers: SampleObservers
    ) -> None:
        self._interval, self._observers = interval, observers
        self._recording = recording = SampleRecording(dictionary.entry(*od.RECORDING_CAPACITY).value)
        self._command = command = dictionary.entry(*od.RECORDING_COMMAND)
        command.on_check = refuse_if(lambda value: value not in [*od.RecordingCommand])
        command.on_written = self._obey
        dictionary.read_live(
            {
                od.RECORDING_COMMAND: lambda: int(self in self._observers.open),
                od.RECORDING_RECORDED: lambda: len(recording),
                od.RECORDING_SAMPLES: recording.to_bytes,
                od.RECORDING_RATE: self._rate,
            }
        )

    def reset(self) -> None:
        self.stop()
        self._recording.clear()

    def stop(self) -> None:
        self._observers.remove(self)

    def take(self, sample: Sample, feedback: Feedback) -> None:
        """Record a sample, also a flagged one, but not one that the interface calls invalid."""
        if sample.invalid:
            self.miss()
            return
        self._recording.take(int(sample.sine), int(sample.cosine))
        self._stop_if_full()

    def miss(self) -> None:
        self._recording.miss()
        self._stop_if_full()

    def _stop_if_full(self) -> None:
        if self._recording.is_full:
            self.stop()

    def _obey(self) -> None:
        self.stop()
        if self._command.value == od.RecordingCommand.START:
            self._recording.clear()
            self._observers.add(self)

    def _rate(self) -> int:
        interval_s = self._interval.sample_s
        return min(round(1.0 / interval_s), 0xFFFFFFFF) if interval_s > 0.0 else 0
