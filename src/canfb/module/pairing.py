"""Which frames make a sample: one for each SYNC, and what came doubled, late or not at all."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from canfb import objects as od
from canfb.device.moment import NEVER
from canfb.device.node import Node
from canfb.device.od.dictionary import Dictionary, Entry
from canfb.module.interval import IntervalEstimate
from canfb.module.local_source import LocalSource
from canfb.module.objects.sample_input import SampleInput
from canfb.module.timeline import ON_TIME, Timeline, Verdict
from canfb.signal.sample import Sample
from canfb.signal.sample_times import TICK_S, TICKS

COUNTERS = (od.COUNTER_BAD_FRAMES, od.COUNTER_DUPLICATE_SYNCS, od.COUNTER_SYNCS_NOT_HEARD)


class Findings(NamedTuple):
    """What is done with what was found.

    take_usual(now)               two counts and no more have come, in answer to the last SYNC
    take(sample, received_s, synced_s, now)
                                  a sample, and when it and its SYNC were received, seconds, None if that is
                                  not known; False if it was an earlier one again
    miss(samples, now)            this many samples are missing
    lose_count(intervals, now)    this many intervals may or may not have passed
    withhold()                    what stands in the dictionary is not valid any more
    repeats(sine, cosine)         whether these are the counts of the last sample
    """

    take_usual: Callable[[float], None]
    take: Callable[[Sample, float | None, float | None, float], bool]
    miss: Callable[[int, float], None]
    lose_count: Callable[[float, float], None]
    withhold: Callable[[], None]
    repeats: Callable[[float, float], bool]


class Pairing:
    """SYNCs and RPDOs in, samples out. All times are receive times where the bus gives them.

    With a ``source`` each SYNC is answered by it, and RPDOs are not looked at.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        node: Node,
        timeline: Timeline,
        interval: IntervalEstimate,
        sample_input: SampleInput,
        source: LocalSource | None,
        findings: Findings,
    ) -> None:
        self.timeline = timeline
        self._moment = node.moment
        self._interval = interval
        self._input = sample_input
        sample_input.on_mixed = self.count_bad_frame
        self._source = source
        self._findings = findings
        self.on_interval: Callable[[bool], None] | None = None
        """Called at each SYNC, before its sample, with whether the one before it was heard in its time."""
        self._bad_frames, self._duplicate_syncs, self._unheard_syncs = (
            dictionary.entry(*counter) for counter in COUNTERS
        )
        self.begin()

    def begin(self) -> None:
        """Wait for the first sample, and for the first SYNC."""
        self.sampled = False
        """A sample came since OPERATIONAL."""
        self._sample_came = False  # since the last SYNC
        self._tracks_came = False  # since the last SYNC, with the rest of the sample or without
        self._synced = False  # a SYNC came since OPERATIONAL
        self._extra_syncs = False  # a duplicate came since the last SYNC: the interface may answer it
        self.extra = False
        """The last SYNC counts as none, but PDOs follow it."""
        self._sync_s: float | None = None  # when the SYNC before was received, if that is known
        self._stale = False  # what synchronous RPDOs hold is of an unknown interval
        self._unheard = 0  # SYNCs before this one
        self._last_time: int | None = None  # of the last valid sample, 2000:05
        self.timeline.pause()

    @property
    def timed(self) -> bool:
        """Each sample brings its time, which says better than any reception how long an interval was."""
        source = self._source
        return self._input.timed if source is None else source.timed_s is not None

    def count_bad_frame(self) -> None:
        """A frame that was not used (2012:08)."""
        _count(self._bad_frames)

    def on_rpdo(self, number: int, now: float) -> None:
        """RPDO ``number`` has come, or is taken over at a SYNC."""
        parts = self._input
        if self._stale:
            return
        if (
            number == parts.whole
            and self._synced
            and not self._tracks_came
            and self.timeline.is_usual_answer(self._moment.received)
        ):
            self._tracks_came = self._sample_came = self.sampled = True
            self._findings.take_usual(now)
            return
        if number == parts.judged:
            if (
                self._synced
                and not self._tracks_came
                and self.timeline.is_usual_answer(self._moment.received)
            ):
                self._tracks_came = True
            elif not self._belongs_here(now):
                return
        if number == parts.alone or parts.take(number):
            self.sampled = True
            sample = parts.sample()
            received_s = None if sample.time_100ns is None else self._received_s()
            if self._findings.take(sample, received_s, received_s and self._sync_s, now):
                self._sample_came = True
            else:
                self.count_bad_frame()

    def accepts_sync(self, counter: int | None, now: float) -> bool:
        """Before anything is done with a SYNC: is it on the bus for the first time, and were others missed?

        PDOs follow every SYNC of a master. One that comes too early for the sampling is not counted, and
        changes nothing else.
        """
        moment, parts = self._moment, self._input
        received, proved = moment.received, moment.proved
        verdict = self.timeline.sync(received, proved, counter)
        if verdict is ON_TIME and not parts.is_synchronous:  # as usual
            self._sync_s = received if proved else None
            return True
        if verdict.duplicate:
            _count(self._duplicate_syncs)
            self._extra_syncs = True
            self.extra = not (parts.is_synchronous or self.timeline.is_repeated(proved, counter))
            return self.extra
        self._sync_s = received if proved else None
        if parts.is_synchronous and parts.is_ambiguous and not parts.timed:
            self.count_bad_frame()
            self._stale = True
        if verdict is ON_TIME:
            return True
        self._unheard = verdict.unheard
        self._findings.withhold()
        self._stale |= parts.is_synchronous
        if verdict.doubt and not self.timed:
            self._findings.lose_count(max(1.0, verdict.unheard), now)
        elif verdict.doubt:
            self._unheard = 0  # sample times know how long it was
        return True

    def on_sync(self, counter: int | None, now: float) -> None:
        """A SYNC that was accepted: the interval before it is over, unless it is an extra one."""
        if self.extra:
            self.extra = False
            return
        if self.on_interval is not None:
            self.on_interval(not (self._unheard or self.timeline.withheld or self._extra_syncs))
        if self._source is not None:
            self._sample_source(self._source, counter, now)
        else:
            parts = self._input
            if not (parts.timed and self._interval.settled_s):
                self._measure()
            if parts.arrived and parts.give_up():
                self.count_bad_frame()
        if self._sample_came:
            self._sample_came = False
        elif self._synced and self.sampled:
            self._miss(1, now)
        if self._unheard:
            self._miss_unheard(counter, now)
        if self._extra_syncs or self._stale:
            self._extra_syncs = self._stale = False
        self._tracks_came, self._synced = False, True

    def on_idle_sync(self) -> None:
        """A SYNC in PRE-OPERATIONAL: the first samples are judged by a period that is known."""
        if self._moment.proved:
            self._interval.event(self._moment.received)

    def _measure(self) -> None:
        """A SYNC measures the interval, unless it may be late, or others were not heard."""
        if self.timeline.withheld or (not self._moment.proved and self.timeline.is_behind):
            self._interval.pause()
        else:
            self._interval.event(self._moment.received, self._moment.proved)

    def overdue(self, now: float) -> bool:
        """No SYNC and no sample for 2010:06 periods; False where the length of a period is not known."""
        passed = self.timeline.overdue(now)
        if not self.sampled:
            self.timeline.until = NEVER
        if not passed or not self.sampled:
            return False
        came = self._sample_came or self._source is not None
        self._miss(passed + (0 if came else 1), now)
        self._sample_came = True
        self._stale = self._input.is_synchronous
        return True

    def _belongs_here(self, now: float) -> bool:
        """One pair of tracks for each SYNC: does this one answer the last SYNC, or one not heard?"""
        moment, timeline = self._moment, self.timeline
        came, self._tracks_came = self._tracks_came, True
        if not self._synced:
            self._interval.event(moment.received, moment.proved)
            verdict = timeline.free_running(moment.received, moment.proved)
        elif came:
            verdict = timeline.another_sample(moment.received, moment.proved)
        else:
            verdict = timeline.first_sample(moment.received, moment.proved)
        return verdict is ON_TIME or self._take_verdict(verdict, came, now)

    def _take_verdict(self, verdict: Verdict, came: bool, now: float) -> bool:
        """For tracks that are not on time. False: they are not to be used."""
        if verdict.unheard:
            self._pass_unheard(verdict.unheard, now)
            return True
        if not came:
            if verdict.duplicate:  # of an earlier SYNC: the answer to this one may still come
                self.count_bad_frame()
                self._tracks_came = False
            return not verdict.duplicate
        if self._extra_syncs and self.timed:
            return True  # the answer to an extra SYNC: its time says what it is
        self.count_bad_frame()
        explained = self._extra_syncs or (verdict.duplicate and self._findings.repeats(*self._input.tracks))
        if not explained:
            self._findings.lose_count(1.0, now)
        return False

    def _pass_unheard(self, syncs: int, now: float) -> None:
        """So many SYNCs were not heard, and these tracks answer the last of them."""
        self._sync_s = None
        if self._input.give_up():
            self.count_bad_frame()
        _count(self._unheard_syncs, syncs)
        if self._synced:
            syncs -= 1 if self._sample_came else 0
        self._miss(syncs, now)
        self._sample_came = False

    def _miss_unheard(self, counter: int | None, now: float) -> None:
        """SYNCs that were not heard. Sample times know better than receive times how long it was."""
        unheard, self._unheard = self._unheard, 0
        if self.sampled:
            _count(self._unheard_syncs, unheard)
        if counter is not None or not self.timed:
            self._miss(unheard, now)

    def _miss(self, samples: int, now: float) -> None:
        """Before the first sample there is nothing to miss."""
        if self.sampled and samples:
            self.timeline.after_gap = True
            self._findings.miss(samples, now)

    def _sample_source(self, source: LocalSource, counter: int | None, now: float) -> None:
        """The sample of this very SYNC; without one it is missed, from the first SYNC on."""
        if self._unheard:
            self._miss_unheard(counter, now)
        self.sampled = self._synced = True
        sample = source.next(now)
        if source.timed_s is None:
            self._measure()
        if sample is not None:
            self._sample_came = True
            if source.timed_s is not None:  # far more regular than the time at which a SYNC is heard
                self._interval.event(source.timed_s)
            if not self._findings.take(sample, None, None, now):
                self.count_bad_frame()

    def _received_s(self) -> float | None:
        """When the tracks of this sample were received, seconds, if that is known."""
        moment = self._moment
        if not moment.proved or self._input.is_synchronous:
            return None
        return moment.received

    def valid(self, sample: Sample) -> None:
        """This sample with a time was good: the clock of the interface measures the interval."""
        last, self._last_time = self._last_time, sample.time_100ns
        if last is not None and self._last_time is not None and self._source is None:
            ticks = (self._last_time - last) % TICKS
            if ticks:
                self._interval.measured(ticks * TICK_S)


def _count(counter: Entry, events: int = 1) -> None:
    counter.value = (counter.value + events) & 0xFFFFFFFF
