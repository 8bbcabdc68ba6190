"""Which frames make a sample: one for each SYNC, and what came doubled, late or not at all.

What time says of a frame, the judge says (:mod:`canfb.timing.judge`). Here it meets the parts of a sample,
which may come in several RPDOs, and becomes what the chain is told: a sample after so many intervals, one
that is missing, or a count that is in doubt.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from canfb import objects as od
from canfb.device.application import ProcessData
from canfb.device.core import NEVER
from canfb.device.node import Node
from canfb.device.od.dictionary import Dictionary, Entry
from canfb.module.interval import SamplingInterval
from canfb.module.objects.prediction import Prediction
from canfb.module.objects.sample_input import LocalSource, SampleInput
from canfb.module.objects.second_input import SecondInput
from canfb.signal.sample import Sample
from canfb.timing.judge import USUAL, Judge, Passed, Refusal
from canfb.timing.sync_judge import NOTHING_TO_REPORT, SyncVerdict

COUNTER_OVERFLOW = 0x1019
COUNTERS = (od.COUNTER_BAD_FRAMES, od.COUNTER_DUPLICATE_SYNCS, od.COUNTER_SYNCS_NOT_HEARD)


class Actions(NamedTuple):
    """What is done with what was found.

    take_usual(now)               two counts and no more have come, in answer to the last SYNC
    take(sample, passed, now)     a sample after what the judge says has passed; False if nothing came of it
    take_usual_timed(received_s, synced_s, now)
                                  two counts and their time have come, no more, in answer to the last SYNC;
                                  False if that is left to take_timed
    take_timed(sample, received_s, synced_s, extra, now)
                                  a sample with its time, and when it and its SYNC were received, seconds,
                                  None if that is not known; extra: it may answer an extra SYNC; False if it
                                  was an earlier one again
    miss(samples, now)            this many samples are missing
    confirm(elapsed)              the one of the last set of intervals that was true
    lose_count(intervals, now)    this many intervals may or may not have passed
    slips(intervals)              whether the machine leaves its position in so many intervals
    withhold()                    what stands in the dictionary is not valid any more
    repeats(sine, cosine)         whether these are the counts of the last sample
    extrapolate()                 a SYNC, before its TPDOs are sampled, if 2013:01 is not 0
    """

    take_usual: Callable[[float], None]
    take: Callable[[Sample, Passed, float], bool]
    take_usual_timed: Callable[[float | None, float | None, float], bool]
    take_timed: Callable[[Sample, float | None, float | None, bool, float], bool]
    miss: Callable[[int, float], None]
    confirm: Callable[[float], None]
    lose_count: Callable[[float, float], None]
    slips: Callable[[float], bool]
    withhold: Callable[[], None]
    repeats: Callable[[float, float], bool]
    extrapolate: Callable[[], None]


class Pairing(ProcessData):
    """SYNCs and RPDOs in, samples out. All times are receive times where the bus gives them.

    With a ``source`` each SYNC is answered by it, and RPDOs are not looked at.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        node: Node,
        judge: Judge,
        interval: SamplingInterval,
        sample_input: SampleInput,
        source: LocalSource | None,
        second: SecondInput,
        prediction: Prediction,
        actions: Actions,
    ) -> None:
        self.judge = judge
        self._call = node.call
        self._interval = interval
        self._overflow, self._periods = (
            dictionary.entry(COUNTER_OVERFLOW),
            dictionary.entry(*od.SUPERVISION_PERIODS),
        )
        self._input = sample_input
        sample_input.on_mixed = self.count_bad_frame
        self._source, self._second = source, second
        self._prediction = prediction
        self._actions = actions
        self._bad_frames, self._duplicate_syncs, self._lost_syncs = (
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
        self._extra_came = False  # before the last SYNC, after the one before
        self.extra = False
        """The last SYNC counts as none, but PDOs follow it."""
        self._stale = False  # what synchronous RPDOs hold is of an unknown interval
        self._verdict = NOTHING_TO_REPORT  # on the last SYNC
        self._passed: Passed = USUAL  # up to the tracks that have come
        self.judge.pause()

    @property
    def timed(self) -> bool:
        """Each sample brings its time, which says better than any reception how long an interval was."""
        source = self._source
        return self._input.timed if source is None else source.source_time_s is not None

    def count_bad_frame(self) -> None:
        """A frame that was not used (2012:08)."""
        _count(self._bad_frames)

    # SYNC.

    def idle_sync_received(self, counter: int | None) -> None:
        """A SYNC in PRE-OPERATIONAL: the first samples are judged by a period that is known."""
        self._hear(counter)
        self.judge.until = NEVER

    def _hear(self, counter: int | None) -> None:
        judge, call = self.judge, self._call
        judge.overflow, judge.periods = self._overflow.value, self._periods.value
        if not judge.clock.period_s:
            judge.clock.nominal_s = self._interval.nominal_s
        self._extra_came = judge.extra_came
        self._verdict = judge.sync(call.received, call.is_stamped, counter)

    def accepts_sync(self, counter: int | None, now: float) -> bool:
        """Before anything is done with a SYNC: is it on the bus for the first time, and were others missed?

        True: synchronous PDOs follow, as every SYNC of a master. One that comes too early for the sampling
        (2012:0D) brings no sample; the position is withheld if the machine moves.
        """
        self._hear(counter)
        verdict, parts = self._verdict, self._input
        if verdict is NOTHING_TO_REPORT and not (parts.is_synchronous or self.judge.is_open):  # as usual
            return True
        if verdict.extra:
            _count(self._duplicate_syncs)
            self.extra = not verdict.repeated
            self._stale |= self.extra and parts.is_synchronous and not parts.timed  # whose it is, is open
            if self.extra and self._actions.slips(self.judge.extra_after):
                self._actions.withhold()  # the position is that of the SYNC before
            return self.extra
        if parts.is_synchronous and parts.is_ambiguous and not parts.timed:
            self.count_bad_frame()
            self._stale = True
        if verdict.lost or verdict.doubt or self.judge.is_open:
            self._actions.withhold()
            self._stale |= parts.is_synchronous
        if verdict.confirmed is not None and not self.timed:
            self._actions.confirm(verdict.confirmed)
        if verdict.doubt and not self.timed:  # sample times know how long it was
            self._actions.lose_count(verdict.doubt, now)
        self._miss_before(verdict, counter, now)
        return True

    def _miss_before(self, verdict: SyncVerdict, counter: int | None, now: float) -> None:
        """Samples that answer none of the SYNCs before this one."""
        missed, lost = verdict.missed, verdict.lost
        if lost and self.sampled:
            _count(self._lost_syncs, lost)
        if lost and counter is None and self.timed:  # sample times know better than receive times
            missed -= lost
        if missed > 0:
            self._miss(missed, now)

    def sync_received(self, counter: int | None, now: float) -> bool:
        """A SYNC that was accepted: the interval before it is over, unless it is an extra one.

        With 2013:01 the TPDOs get the position of this SYNC; the sample of a source belongs to it anyway.
        """
        extrapolates = self._prediction.extrapolates and self._source is None
        if self.extra:
            self.extra = self._stale = False
            if extrapolates:  # no sample belongs to it, and so none is extrapolated to it
                self._actions.withhold()
            return False
        parts, judge = self._input, self.judge
        if self._second.number is not None:
            self._second.interval_over(not (self._verdict.lost or judge.is_open or self._extra_came))
        if parts.arrived and parts.give_up():
            self.count_bad_frame()
        if not self._sample_came and self.sampled:
            if self._tracks_came:  # without the rest of the sample
                judge.drop()
                self._miss(1, now)
            elif parts.is_synchronous and self._synced and self._source is None:
                judge.unanswered()
                self._miss(1, now)
        self._sample_came = self._tracks_came = self._stale = False
        self._synced = True
        if self._source is not None:
            self._sample_source(self._source, now)
        if extrapolates:
            self._actions.extrapolate()
        return extrapolates

    def tpdos_sampled(self) -> None:
        """The measured position again."""
        self._prediction.withdraw()

    def _miss(self, samples: int, now: float) -> None:
        """Before the first sample there is nothing to miss."""
        if self.sampled:
            self._actions.miss(samples, now)

    def overdue(self, now: float) -> bool:
        """No SYNC and no sample for 2010:06 periods; False where the length of a period is not known."""
        judge = self.judge
        missed = judge.overdue(now)
        if not self.sampled:
            judge.until = NEVER
        if not missed or not self.sampled:
            return False
        self._miss(missed, now)
        self._tracks_came = False
        self._stale = self._input.is_synchronous
        return True

    # Samples.

    def rpdo_too_short(self, number: int, received: int, mapped: int, now: float) -> None:
        """Counted in 2012:08, whatever ``number``, ``received`` and ``mapped`` are."""
        self.count_bad_frame()

    def rpdo_received(self, number: int, now: float) -> None:
        """RPDO ``number``, or its data at a SYNC: a sample, a part of it, or the other sensor."""
        if number == self._second.number:
            self._second.value_received()
        parts = self._input
        if self._stale or self._source is not None:
            return
        if number == parts.whole_timed and self._synced:
            received_s, synced_s = self._receptions()
            if self._actions.take_usual_timed(received_s, synced_s, now):
                self._sample_came = self.sampled = True
                self.judge.answered_last_sync()
                return
        if number == parts.judged:
            passed = self._judged(now)
            if passed is None:
                return
            self._tracks_came = True
            if passed is USUAL and number == parts.whole:
                self._sample_came = self.sampled = True
                self._actions.take_usual(now)
                return
            self._passed = passed
        if number == parts.alone or parts.take(number):
            self._complete(parts.sample(), now)

    def _judged(self, now: float) -> Passed | None:
        """One pair of tracks for each SYNC: which one does this answer? None: it is not to be used."""
        call, judge = self._call, self.judge
        if self._synced:
            passed = judge.answer(call.received, call.is_stamped)
        else:
            passed = judge.free(call.received, call.is_stamped)
        if isinstance(passed, Passed):
            if judge.advanced:
                self._pass_lost(judge.advanced, passed, now)
            elapsed, actions = passed.elapsed, self._actions
            if isinstance(elapsed, tuple) and actions.slips(1.0) and actions.repeats(*self._input.tracks):
                return passed._replace(certain=False)  # the last one again, and so late that another may fit
            return passed
        self.count_bad_frame()
        if passed is Refusal.ANOTHER:
            explained = judge.extra_came or self._actions.repeats(*self._input.tracks)
            if not explained:
                self._actions.lose_count(1.0, now)
            elif judge.next_is_due(call.received) and self._actions.slips(1.0):
                self._actions.withhold()  # equal counts may be whole cycles further on
        return None

    def _pass_lost(self, syncs: int, passed: Passed, now: float) -> None:
        """So many SYNCs were not received, and these tracks answer the last of them.

        The sample before them may have answered the first, so what is missing is what has passed for certain.
        """
        self.judge.advanced = 0
        if self._input.give_up():
            self.count_bad_frame()
        _count(self._lost_syncs, syncs)
        least = passed.options[0]
        if syncs > 1 and least > 1.0:
            self._miss(min(syncs, int(least)) - 1, now)
        self._sample_came = False

    def _complete(self, sample: Sample, now: float) -> None:
        """All parts of a sample are there."""
        self.sampled = True
        if sample.time_100ns is not None:
            came = self._timed(sample, now)
        else:
            passed = self._passed if self._input.judged is not None else self.judge.answered_last_sync()
            came = self._actions.take(sample, passed, now)
        if came:
            self._sample_came = True
        else:
            self.count_bad_frame()

    def _timed(self, sample: Sample, now: float) -> bool:
        """By its time a sample is the next one, whatever was received when."""
        call, judge = self._call, self.judge
        received_s, synced_s = self._receptions()
        if not self._synced and self._source is None:
            judge.sync(call.received, call.is_stamped, None)  # each sample is its own
        came = self._actions.take_timed(sample, received_s, synced_s, judge.extra_came, now)
        if came:
            judge.answered_last_sync()
        return came

    def _receptions(self) -> tuple[float | None, float | None]:
        """When the bus received this PDO and the SYNC that it answers, seconds; None: not known.

        Without receive times the first is None, the second the time of the call of the SYNC. The second is
        None where it is open which SYNC it answers, and both are for a synchronous RPDO and for a source.
        """
        call, judge = self._call, self.judge
        if self._input.is_synchronous or self._source is not None:
            return None, None
        received_s = call.received if call.is_stamped else None
        if self._synced and judge.stamped == call.is_stamped and not judge.extra_came:
            return received_s, judge.synced_s
        return received_s, None  # which SYNC it answers is open

    def _sample_source(self, source: LocalSource, now: float) -> None:
        """The sample of this very SYNC; without one it is missed, from the first SYNC on."""
        self.sampled = True
        self.judge.sampled = True
        sample = source.next(now)
        if sample is None:
            self.judge.unanswered()
            self._miss(1, now)
        else:
            self._complete(sample, now)


def _count(counter: Entry, events: int = 1) -> None:
    counter.value = (counter.value + events) & 0xFFFFFFFF
