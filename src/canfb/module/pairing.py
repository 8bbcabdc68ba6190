"""Which frames make a sample, one for each SYNC, and what becomes of it, or of its absence.

What time says of a frame, the judge says (:mod:`canfb.timing.judge`). Here it meets the parts of a sample,
which may come in several RPDOs. A sample goes through the chain with the intervals that have passed, and its
feedback is published; what is not certain is withheld. Nearly each one is two counts, with their own time or
without. It goes to the chain as it stands in the dictionary, and all others as a :class:`Sample`: the same
frame by frame (tests/module/test_usual_sample.py).
"""

from __future__ import annotations

from canfb import objects as od
from canfb.device.application import ProcessData
from canfb.device.core import NEVER
from canfb.device.node import Node
from canfb.device.od.dictionary import Dictionary, Entry
from canfb.module.interval import InterfaceGrid, SamplingInterval
from canfb.module.objects.recorder import SampleObservers
from canfb.module.objects.sample_input import LocalSource, SampleInput
from canfb.module.objects.second_input import SecondInput
from canfb.module.parameters import Limits
from canfb.module.publishing import Publishing
from canfb.signal.chain import SignalChain
from canfb.signal.feedback import Feedback
from canfb.signal.sample import TICK_S, Sample
from canfb.signal.supervision import VALID
from canfb.timing.judge import USUAL, Judge, Passed, Refusal
from canfb.timing.sync_verdict import NOTHING_TO_REPORT, SyncVerdict

COUNTER_OVERFLOW = 0x1019
COUNTERS = (od.COUNTER_BAD_FRAMES, od.COUNTER_DUPLICATE_SYNCS, od.COUNTER_SYNCS_NOT_HEARD)
MOST_MISSED = 256  # in a row, one by one: more than 2010:03 can bridge


class Pairing(ProcessData):
    """SYNCs and RPDOs in, feedback out. All times are receive times where the bus gives them.

    With a ``source`` each SYNC is answered by it, and RPDOs are not looked at. ``observers`` see each sample
    and each one that was missed.
    """

    # More than 30 attributes in a dict cost each frame 3 % of a cycle.
    __slots__ = (
        "_bad_frames",
        "_call",
        "_chain",
        "_duplicate_syncs",
        "_extra_came",
        "_grid",
        "_input",
        "_interval",
        "_limits",
        "_lost_syncs",
        "_observers",
        "_overflow",
        "_passed",
        "_periods",
        "_prediction",
        "_publishing",
        "_sample_came",
        "_second",
        "_set_waited",
        "_source",
        "_stages",
        "_stale",
        "_synced",
        "_tracks_came",
        "_verdict",
        "_waited",
        "extra",
        "judge",
        "sampled",
        "syncs",
        "unconfirmed",
    )

    def __init__(
        self,
        dictionary: Dictionary,
        node: Node,
        judge: Judge,
        interval: SamplingInterval,
        grid: InterfaceGrid,
        limits: Limits,
        chain: SignalChain,
        sample_input: SampleInput,
        source: LocalSource | None,
        second: SecondInput,
        observers: SampleObservers,
        publishing: Publishing,
    ) -> None:
        entry = dictionary.entry
        self.judge, self.syncs = judge, judge.syncs
        self._call = node.call
        self._interval, self._grid, self._limits = interval, grid, limits
        self._chain, self._stages, self._publishing = chain, chain.stages, publishing
        self._prediction = publishing.prediction
        self._source, self._second, self._observers = source, second, observers
        self._input = sample_input
        self._overflow, self._periods = entry(COUNTER_OVERFLOW), entry(*od.SUPERVISION_PERIODS)
        self._bad_frames, self._duplicate_syncs, self._lost_syncs = (entry(*counter) for counter in COUNTERS)
        sample_input.on_mixed = self.count_bad_frame
        chain.on_unit = limits.unit_changed
        self.unconfirmed = 0
        """Samples after a pause that are not called valid yet."""
        self._set_waited = 0.0  # `_waited` at the last sample that had several possible intervals
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
        self._passed: Passed = USUAL  # of the tracks that have come, before the other parts
        self._waited = 0.0  # intervals since the last sample that were reported as missed
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
        self.syncs.until = NEVER

    def _hear(self, counter: int | None) -> None:
        syncs, call = self.syncs, self._call
        syncs.overflow, syncs.periods = self._overflow.value, self._periods.value
        if not syncs.clock.period_s:
            syncs.clock.nominal_s = self._interval.nominal_s
        self._extra_came = syncs.extra_came
        self._verdict = syncs.sync(call.received, call.is_stamped, counter)

    def accepts_sync(self, counter: int | None, now: float) -> bool:
        """Before anything is done with a SYNC: is it on the bus for the first time, and were others missed?

        True: synchronous PDOs follow, as every SYNC of a master. One that comes too early for the sampling
        (2012:0D) brings no sample; the position is withheld if the machine moves.
        """
        self._hear(counter)
        verdict, parts = self._verdict, self._input
        if verdict is NOTHING_TO_REPORT and not (parts.is_synchronous or self.syncs.is_open):  # as usual
            return True
        if verdict.extra:
            _count(self._duplicate_syncs)
            self.extra = not verdict.repeated
            self._stale |= self.extra and parts.is_synchronous and not parts.timed  # may answer either
            if self.extra and self._chain.slips(self.syncs.extra_after):
                self._publishing.withhold()  # the position is that of the SYNC before
            return self.extra
        if parts.is_synchronous and parts.is_ambiguous and not parts.timed:
            self.count_bad_frame()
            self._stale = True
        if verdict.lost or verdict.doubt or self.syncs.is_open:
            self._publishing.withhold()
            self._stale |= parts.is_synchronous
        if verdict.confirmed is not None and not self.timed:
            self._chain.confirm(verdict.confirmed - self._set_waited)
        if verdict.doubt and not self.timed:  # sample times know how long it was
            self._lose_count(verdict.doubt, now)
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
                self._publishing.withhold()
            return False
        parts, syncs = self._input, self.syncs
        if self._second.number is not None:
            self._second.interval_over(not (self._verdict.lost or syncs.is_open or self._extra_came))
        if parts.arrived and parts.give_up():
            self.count_bad_frame()
        if not self._sample_came and self.sampled:
            if self._tracks_came:  # without the rest of the sample
                self.judge.drop()
                self._miss(1, now)
            elif parts.is_synchronous and self._synced and self._source is None:
                syncs.give_up()
                self._miss(1, now)
        self._sample_came = self._tracks_came = self._stale = False
        self._synced = True
        if self._source is not None:
            self._sample_source(self._source, now)
        if extrapolates:
            self._publishing.extrapolate()
        return extrapolates

    def tpdos_sampled(self) -> None:
        """The measured position again."""
        self._prediction.withdraw()

    def _miss(self, samples: int, now: float) -> None:
        """So many samples that did not come, reported once; before the first one there is nothing to miss."""
        if not self.sampled:
            return
        known_as_lost = self._chain.lost
        self._waited += samples
        # Of a position that is lost it makes no difference how long it has been.
        for left in range(min(samples, MOST_MISSED) - 1, -1, -1):
            self._publishing.publish(self._chain.miss(), now, send=not left and not known_as_lost)
            for _ in range(self._interval.samples_per_sync):
                self._observers.miss()

    def overdue(self, now: float) -> bool:
        """No SYNC and no sample for 2010:06 periods; False where the length of a period is not known."""
        syncs = self.syncs
        missed = syncs.overdue(now)
        if not self.sampled:
            syncs.until = NEVER
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
            if self._take_usual_timed(received_s, synced_s, now):
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
                self._take_usual(now)
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
            open_ = passed is not USUAL and isinstance(passed.elapsed, tuple)
            if open_ and self._chain.slips(1.0) and self._stages.repeats(*self._input.tracks):
                return passed._replace(certain=False)  # the last one again, and so late that another may fit
            return passed
        self.count_bad_frame()
        if passed is Refusal.ANOTHER:
            explained = self.syncs.extra_came or self._stages.repeats(*self._input.tracks)
            if not explained:
                self._lose_count(1.0, now)
            elif judge.next_is_due(call.received) and self._chain.slips(1.0):
                self._publishing.withhold()  # equal counts may be whole cycles further on
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
            came = self._take(sample, passed, now)
        if came:
            self._sample_came = True
        else:
            self.count_bad_frame()

    def _timed(self, sample: Sample, now: float) -> bool:
        """By its time a sample is the next one, whatever was received when."""
        call, syncs = self._call, self.syncs
        received_s, synced_s = self._receptions()
        if not self._synced and self._source is None:
            syncs.sync(call.received, call.is_stamped, None)  # each sample is its own
        came = self._take_timed(sample, received_s, synced_s, syncs.extra_came, now)
        if came:
            self.judge.answered_last_sync()
        return came

    def _receptions(self) -> tuple[float | None, float | None]:
        """When the bus received this PDO and the SYNC that it answers, seconds; None: not known.

        Without receive times the first is None, the second the time of the call of the SYNC. The second is
        None where it is open which SYNC it answers, and both are for a synchronous RPDO and for a source.
        """
        call, syncs = self._call, self.syncs
        if self._input.is_synchronous or self._source is not None:
            return None, None
        received_s = call.received if call.is_stamped else None
        if self._synced and syncs.stamped == call.is_stamped and not syncs.extra_came:
            return received_s, syncs.synced_s
        return received_s, None  # which SYNC it answers is open

    def _sample_source(self, source: LocalSource, now: float) -> None:
        """The sample of this very SYNC; without one it is missed, from the first SYNC on."""
        self.sampled = True
        self.syncs.count.sampled = True
        sample = source.next(now)
        if sample is None:
            self.syncs.give_up()
            self._miss(1, now)
        else:
            self._complete(sample, now)

    # Samples into the chain, and out.

    def _take_usual(self, now: float) -> None:
        """Two counts that answer the last SYNC, as they stand in the dictionary."""
        parts = self._input
        if self._waited or self.unconfirmed or self._observers.open or parts.flags.value:
            self._take(parts.sample(), USUAL, now)
            return
        limits = self._limits
        if limits.narrowed:
            limits.follow()
        feedback = self._stages.take(parts.sine.value, parts.cosine.value)
        noise = limits.noise
        if feedback[-1] >= noise.due and noise.take(feedback):
            limits.measured()
        self._publishing.publish(feedback, now)

    def _take(self, sample: Sample, passed: Passed, now: float) -> bool:
        """A sample without a time through the chain, and out; False if nothing came of it."""
        if self._limits.narrowed:
            self._limits.follow()
        options = self._since_last(passed)
        if not options:
            if len(passed.options) > 1:
                self._lose_count(passed.options[-1] - passed.options[0], now)
            return False
        several = options if len(options) > 1 else ()
        placed = not (passed.instant_error and self._chain.slips(passed.instant_error))
        feedback = self._chain.after(sample, options[0], several, placed=placed)
        if feedback.status & VALID and (self.unconfirmed or not passed.certain):
            feedback = self._withheld(feedback)
        self._out(sample, feedback, now)
        return True

    def _since_last(self, passed: Passed) -> tuple[float, ...]:
        """Intervals since the last sample or miss, all possible ones; none if it may be one of those missed.

        Then it comes too late: the time goes on from the miss, and the set would lack what may be true.
        """
        options, waited = passed.options, self._waited
        if options[0] <= waited:
            self._waited = waited - options[0]
            return ()
        self._waited = 0.0
        if len(options) > 1:
            self._set_waited = waited
        return tuple([one - waited for one in options]) if waited else options

    def _take_usual_timed(self, received_s: float | None, synced_s: float | None, now: float) -> bool:
        """A sample with its time as it stands in the dictionary; False if it is to be looked at closely."""
        parts = self._input
        if self._prediction.follows or self.unconfirmed or self._observers.open or parts.flags.value:
            return False
        limits = self._limits
        if limits.narrowed:
            limits.follow()
        feedback = self._chain.take_in_turn(
            parts.sine.value, parts.cosine.value, parts.time.value, received_s, synced_s
        )
        if feedback is None:
            return False
        self._waited = 0.0
        noise = limits.noise
        if feedback[-1] >= noise.due and noise.take(feedback):
            limits.measured()
        self._publishing.publish(feedback, now)
        return True

    def _take_timed(
        self, sample: Sample, received_s: float | None, synced_s: float | None, extra: bool, now: float
    ) -> bool:
        """A sample with its time; False if it is an earlier one again, and nothing happened.

        Nothing happens either with one that is too near to the last, but it did come.
        """
        self._limits.unit_changed()
        if self._interval.samples_per_sync > 1:
            self._grid.follow()
        last = self._publishing.last
        feedback = self._chain.step(sample, received_s, synced_s, extra)
        if last is not None and feedback.samples == last.samples:
            return self._chain.crowded
        self._waited = 0.0
        if feedback.status & VALID and self.unconfirmed:
            feedback = self._withheld(feedback)
        self._out(sample, feedback, now)
        return True

    def _withheld(self, feedback: Feedback) -> Feedback:
        """What may be right, but is not confirmed."""
        if self.unconfirmed:
            self.unconfirmed -= 1
        return self._chain.withheld(feedback)

    def _out(self, sample: Sample, feedback: Feedback, now: float) -> None:
        noise = self._limits.noise
        if self._chain.between:
            self._publishing.count(self._chain.between, now)
            for earlier in self._chain.between:
                if noise.take(earlier):
                    self._limits.measured()
        if noise.take(feedback):
            self._limits.measured()
        self._publishing.publish(feedback, now)
        if self._observers.open:
            per_sync, apart = self._interval.samples_per_sync, round(self._chain.unit_s / TICK_S)
            self._observers.take_all(sample, feedback, self._chain.between, per_sync, apart)

    def _lose_count(self, intervals: float, now: float) -> None:
        """So many intervals may or may not have passed: the position is lost if the machine moves."""
        feedback = self._chain.uncertain(intervals)
        if feedback is not None:
            self._publishing.publish(feedback, now)


def _count(counter: Entry, events: int = 1) -> None:
    counter.value = (counter.value + events) & 0xFFFFFFFF
