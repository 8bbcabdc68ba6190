"""From frames to samples: which RPDOs make a sample, which SYNC it answers, and which SYNCs have none.

Each SYNC is accounted for once, by its sample or as missed. A usual sample (two counts, perhaps with their
time, in turn) goes from the dictionary straight to the stages; any other becomes a :class:`Sample`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from canfb import objects as od
from canfb.device.core import FOLLOWED, IGNORED, NEVER, REVOKED, HeldRpdo, ProcessData
from canfb.device.node import Node
from canfb.device.od.dictionary import Dictionary, Entry
from canfb.module.interval import InterfaceGrid, SamplingInterval
from canfb.module.objects.recorder import SampleObservers
from canfb.module.objects.sample_input import NO_RPDO, LocalSource, SampleInput, SecondInput
from canfb.module.parameters import Limits
from canfb.module.publishing import Publishing
from canfb.signal.chain import SignalChain
from canfb.signal.sample import TICK_S, Feedback, Sample
from canfb.signal.speeds import SLIP_CYCLES
from canfb.signal.supervision import VALID
from canfb.timing.answers import Answers
from canfb.timing.syncs import USUAL, Syncs, SyncVerdict

COUNTERS = (od.COUNTER_BAD_FRAMES, od.COUNTER_DUPLICATE_SYNCS, od.COUNTER_SYNCS_NOT_HEARD)
TOGETHER = 0.5  # periods within which all parts of a sample come; later ones are nearer to the next sample
CAME = -2  # in `Pairing.usual`, in place of the number of an RPDO: that RPDO has come
MOST_MISSED = 256  # missed samples that are counted one by one; more than 2010:03 can bridge


class Pairing(ProcessData):
    """SYNCs and RPDOs in, feedback out. All times are receive times where the bus gives them.

    A ``source``, if any, provides the samples instead of RPDOs. ``observers`` see samples and misses.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        node: Node,
        syncs: Syncs,
        answers: Answers,
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
        self.syncs, self.answers = syncs, answers
        self._call = node.call
        self._interval, self._grid, self._limits = interval, grid, limits
        self._chain, self._stages, self._publishing = chain, chain.stages, publishing
        self._prediction = publishing.prediction
        self._source, self._second, self._observers = source, second, observers
        self._input = sample_input
        self._overflow = entry(*od.SYNCHRONOUS_COUNTER_OVERFLOW)
        self._bad_frames, self._duplicate_syncs, self._lost_syncs = (entry(*counter) for counter in COUNTERS)
        self._longest_answer = entry(*od.SUPERVISION_ANSWER_DELAY)
        self._longest_answer.on_written = self._answers_changed
        sample_input.on_mixed = self.count_bad_frame
        chain.on_unit = limits.unit_changed
        self.unconfirmed = 0  # samples after a pause that are still to be withheld
        self.on_first: Callable[[float], None] = lambda now: None  # called before the first sample
        self.begin()

    def begin(self) -> None:
        self.sampled = False  # a sample came since OPERATIONAL
        self._sample_came = 0  # samples since the last SYNC; without sample times at most 1
        self._synced = False  # a SYNC came since OPERATIONAL
        self._stale = False  # synchronous RPDOs hold data of an unknown interval
        # Distance of the last sampling instant from the grid, intervals; and when the last tracks came.
        self._off, self._came_s = 0.0, -NEVER
        self._ambiguous = False  # the last tracks came when another SYNC was due: that SYNC decides
        self._moves = False  # the machine has moved since, so fast that the choice of the SYNC matters
        self._begun_s = 0.0  # when the first part of the present sample came
        self._elapsed = 0.0  # intervals up to tracks that wait for the other parts; 0.0: none wait
        self._tracks = 0, 0  # the counts of these tracks
        # The RPDO that may bring a usual sample of the last SYNC; CAME: it has, with nothing unusual since.
        self.usual = NO_RPDO
        self.syncs.pause()
        self._input.begin()
        self._accounted = self._answered = self.syncs.place  # last place accounted for; last with a sample

    @property
    def timed(self) -> bool:
        """True if each sample brings its time."""
        return self._input.timed if self._source is None else self._source.source_time_s is not None

    def count_bad_frame(self) -> None:
        _count(self._bad_frames)

    def _answers_changed(self) -> None:
        self.answers.forget()
        self.usual = NO_RPDO
        if not self.timed:  # which SYNC the next sample answers is open
            self._lose_count(1.0, self._call.now)

    # SYNC.

    def idle_sync_received(self, counter: int | None) -> None:
        """Feed the grid in PRE-OPERATIONAL: the period is known when the first sample comes."""
        syncs, call = self.syncs, self._call
        syncs.overflow = self._overflow.value
        syncs.sync(call.received, call.is_stamped, counter)
        syncs.until = NEVER

    def synchronise(self, counter: int | None, now: float, waiting: Sequence[HeldRpdo]) -> int:
        """A SYNC ends the interval before it, unless it is an extra one.

        With 2013:01 the TPDOs get the position extrapolated to this SYNC; a source samples at it anyway.
        """
        syncs, call = self.syncs, self._call
        if counter is not None:
            syncs.overflow = self._overflow.value
        after_extra = syncs.extra_came
        verdict = syncs.sync(call.received, call.is_stamped, counter)
        if verdict is USUAL and self.usual == CAME and not (waiting or self._prediction.is_on):
            self._sample_came, self.usual = 0, self._input.usual
            return FOLLOWED
        self.usual = NO_RPDO
        if verdict.extra:
            return self._extra_sync(verdict, now, waiting)
        self._begin_interval(verdict, counter, now, waiting, after_extra)
        if self._prediction.extrapolates and self._source is None:
            last, behind = self._publishing.last, max(1, syncs.place - self._accounted)
            if last is not None:
                self._prediction.extrapolate(last, behind, self.answers.waits + 1)
            return REVOKED
        return FOLLOWED

    def _begin_interval(
        self,
        verdict: SyncVerdict,
        counter: int | None,
        now: float,
        waiting: Sequence[HeldRpdo],
        after_extra: bool,
    ) -> None:
        """Account for the interval before this SYNC; find out if the next one may bring a usual sample."""
        syncs, parts, source = self.syncs, self._input, self._source
        place, late = syncs.place, syncs.late_s > 0.0
        if verdict is not USUAL:
            self._limits.follow()
        if longest_s := self._longest_answer.value:
            self.answers.synced(place, syncs.synced_s, syncs.grid, longest_s * syncs.stamped)
        due = place - 1 - self.answers.waits  # the last place whose sample should have come by now
        if verdict != USUAL or late or waiting or self._ambiguous or due > self._accounted:
            self._account(verdict, counter, now, waiting, due)
        self._off = verdict.off  # not earlier: a sample that took effect in _account answers the SYNC before
        if self._second.number is not None:
            self._second.interval_over(not (verdict.lost or late or after_extra))
        if parts.is_synchronous and self.sampled and self._synced and source is None:
            if not (self._sample_came or self._elapsed):
                self._miss_to(place, now)
            self._accounted = place  # by the sample that came, perhaps at an extra SYNC before
        if not (parts.arrived and self.answers.waits):
            self._end_parts(now)
        self._sample_came, self._stale = 0, False
        self._synced = True
        if source is not None:
            self._sample_source(source, now)
            return
        in_turn = not self._prediction.follows if parts.timed else due == self._accounted == self._answered
        is_open = late or verdict.off or syncs.grid.early
        if in_turn and self.sampled and not (is_open or self.unconfirmed or self.answers.waits):
            self.usual = parts.usual

    def _extra_sync(self, verdict: SyncVerdict, now: float, waiting: Sequence[HeldRpdo]) -> int:
        """A SYNC that is too early, and has no sample: count it in 2012:0D.

        PDOs are synchronised by it unless it is a copy. The position is withheld if the machine moves.
        """
        parts, syncs = self._input, self.syncs
        _count(self._duplicate_syncs)
        follows = not verdict.repeated
        self._stale |= follows and parts.is_synchronous and not parts.timed  # tracks may answer either SYNC
        if follows and self._chain.slips(syncs.extra_after):
            self._publishing.withhold()  # the position is that of the SYNC before
        if verdict.doubt and not self.timed:
            self._lose_count(verdict.doubt, now)
        if not follows:
            return IGNORED
        for rpdo in waiting:
            rpdo.synchronise(now)
        self._stale = False
        if self._prediction.extrapolates and self._source is None:
            self._publishing.withhold()  # this SYNC has no sample: the position cannot be extrapolated to it
        return FOLLOWED

    def _account(
        self, verdict: SyncVerdict, counter: int | None, now: float, waiting: Sequence[HeldRpdo], due: int
    ) -> None:
        parts, syncs = self._input, self.syncs
        unsure = bool(verdict.lost or verdict.doubt or syncs.late_s)
        if parts.is_synchronous:
            if parts.is_ambiguous and not parts.timed:
                self.count_bad_frame()
                self._stale = True
            chain = self._chain  # the interval of the data matters only if the machine moves
            self._stale |= unsure and (not chain.begun or chain.lost or chain.displaces(1.0))
        if unsure:
            self._publishing.withhold()
        if lost := verdict.lost:
            _count(self._lost_syncs, lost * self.sampled)
            by_times = counter is None and self.timed and not (parts.is_synchronous or self.answers.waits)
            self._accounted += lost if by_times else self._answered_of(lost)
        doubt = verdict.doubt or (verdict.lost if self._ambiguous else 0.0)
        self._ambiguous = False
        if doubt and not self.timed:  # sample times measure the interval themselves
            self._lose_count(doubt, now)
        if parts.is_synchronous and due > self._accounted:
            self._miss_to(due, now)
        for rpdo in waiting:  # if the tracks did not wait for SYNC, their sample precedes the missed ones
            rpdo.synchronise(now)
        self._miss_to(max(due, self._accounted), now)

    def _answered_of(self, lost: int) -> int:
        """How many of the SYNCs that were not received are answered by samples since the last SYNC."""
        # Answers that may come after later SYNCs are paired one by one, in _answered_sync.
        answered = 0 if self.answers.waits else max(0, min(lost, self._sample_came - 1))
        self._sample_came -= answered
        return answered

    def tpdos_sampled(self) -> None:
        self._prediction.withdraw()

    def _miss_to(self, place: int, now: float) -> None:
        missed, self._accounted = place - self._accounted, place
        self._miss(missed, now)

    def _miss(self, samples: int, now: float) -> None:
        if not self.sampled:
            return
        was_lost = self._chain.lost
        # More than MOST_MISSED lose the position, and a lost one does not depend on how many were missed.
        for left in range(min(samples, MOST_MISSED) - 1, -1, -1):
            self._publishing.publish(self._chain.miss(), now, send=not (left or was_lost))
            for _ in range(self._interval.samples_per_sync):
                self._observers.miss()

    def overdue(self, now: float) -> bool:
        """No SYNC and no sample for 2010:06 periods: count them as missed. False: unknown period."""
        syncs = self.syncs
        self.usual = NO_RPDO
        if not self.sampled:
            self.begin()  # there is nothing to count yet: the next SYNC is the first
        if not syncs.overdue(now, self.timed):
            return False
        if self._ambiguous and not self.timed:
            self._lose_count(1.0, now)  # no SYNC came that decides which one the last sample answers
        if self._elapsed:
            self._end_parts(now)
        self._accounted += self._answered_of(syncs.place - self._accounted)
        self._miss_to(max(syncs.place - self.answers.waits, self._accounted), now)
        self._ambiguous = False
        self._stale = self._input.is_synchronous
        return True

    # Samples.

    def rpdo_too_short(self, number: int, received: int, mapped: int, now: float) -> None:
        self.count_bad_frame()

    def rpdo_received(self, number: int, now: float) -> None:
        """RPDO ``number`` brings a sample, a part of one, or the position of the other sensor.

        A usual sample is two counts, perhaps with their time, which answer the last SYNC in time.
        """
        parts, syncs, call, feedback = self._input, self.syncs, self._call, None
        stamped = call.is_stamped
        if number == self.usual and not (self._observers.open or parts.flags.value):
            if parts.timed:
                if stamped == syncs.stamped:
                    received_s = call.received if stamped else None
                    elapsed = self._chain.times.in_turn(parts.time.value, received_s, syncs.synced_s)
                    if elapsed:
                        feedback = self._stages.take(parts.sine.value, parts.cosine.value, elapsed, True)
            elif (
                self.answers.is_usual(call.received - syncs.synced_s, syncs.grid)
                if stamped and syncs.stamped
                else not call.received >= syncs.grid.due
            ):
                feedback = self._stages.take(parts.sine.value, parts.cosine.value)
        if feedback is None:
            self._look_closely(number, now)
            return
        self.usual, self._sample_came, self._came_s = CAME, 1, call.received
        self._accounted = self._answered = syncs.place
        noise = self._limits.noise
        if feedback[-1] >= noise.due and noise.take(feedback):
            self._limits.measured()
        self._publishing.publish(feedback, now)

    def _look_closely(self, number: int, now: float) -> None:
        if number == self._second.number:
            self._second.values += 1
        parts = self._input
        if number == parts.usual:
            self.usual = NO_RPDO
        if self._stale or self._source is not None:
            return
        apart_s, most_s = self._call.received - self._begun_s, TOGETHER * self.syncs.grid.rough
        if parts.arrived and self.answers.waits and apart_s > most_s:
            self._end_parts(now)
        parts.is_mixed &= parts.arrived != 0 or apart_s <= most_s
        if not parts.arrived:
            self._begun_s = self._call.received
        if number == parts.judged:
            elapsed = self._judged(now)
            if elapsed is None:
                parts.is_mixed |= parts.arrived != 0  # refused tracks have overwritten the sample in 2000h
                return
            self._elapsed, self._tracks = elapsed, (parts.sine.value, parts.cosine.value)
        if number == parts.alone or parts.take(number):
            self._complete(parts.sample(), now)

    def _end_parts(self, now: float) -> None:
        """Give up a sample that is not complete: tracks without the other parts are a missed sample."""
        if self._input.arrived and self._input.give_up():
            self.count_bad_frame()
        if self._elapsed and self.sampled and self._synced:
            self._miss(int(self._elapsed), now)
        self._elapsed = 0.0

    def _judged(self, now: float) -> float | None:
        """Intervals since the last sample, by the SYNC that the tracks answer; None: they are not used."""
        call, syncs, answers, chain = self._call, self.syncs, self.answers, self._chain
        place, parts = syncs.place, self._input
        rests = not (chain.lost or chain.slips(1.0))  # then it does not matter which SYNC it answers
        next_may_have_come = not rests and call.received >= syncs.grid.due - syncs.grid.allowed
        if not self._synced:
            if answers.waits:  # it may answer a SYNC before the start
                return None
            verdict = syncs.sync(call.received, call.is_stamped, None)  # no SYNCs: the sample is its own
            if verdict is not USUAL:
                self._limits.follow()
            if verdict.doubt:
                self._lose_count(verdict.doubt, now)
            place = syncs.place if not verdict.extra else self._answered
        elif call.is_stamped and syncs.stamped:
            delay_s = call.received - syncs.synced_s
            is_early = answers.is_early(delay_s, syncs.grid)
            if place == self._accounted + 1 and answers.is_usual(delay_s, syncs.grid):
                return self._answer(place)
            later = answers.place(delay_s, syncs, self._accounted - place)
            if is_early and (later is None or later >= 0):
                self._off = max(self._off, syncs.grid.lead / syncs.grid.period)
            if answers.has_moved(syncs.grid):
                self._lose_count(1.0, now)
            elif later is None and next_may_have_come:
                self._publishing.withhold()  # the sample may answer a SYNC that was not received
            free = later is not None and place + later > self._accounted
            if rests and not (free or answers.waits):
                later = 0
            if later is None and place > self._accounted:
                self.count_bad_frame()
                return None
            if later and later > 0:
                self._pass_lost(later, now)  # or is that SYNC only late?
                self._ambiguous = call.received < syncs.grid.due - syncs.grid.period + syncs.grid.allowed
            place += later or 0  # None: the last SYNC has its sample already
        elif syncs.grid.period:
            self._ambiguous = call.received >= syncs.grid.due
            soonest_s = self._came_s + (place - self._answered - 0.5) * syncs.grid.period
            if place - self._answered > 1 and call.received < soonest_s:  # a late answer to the SYNC before
                self._lose_count(1.0, now)
        self._came_s = call.received
        if place > (self._answered if rests else self._accounted) or not self.sampled:
            return self._answer(place)
        self.count_bad_frame()
        if place <= self._answered:  # more samples than SYNCs
            counts = parts.sine.value, parts.cosine.value
            repeats = counts == self._tracks if self._elapsed else self._stages.repeats(*counts)
            if not (syncs.extra_came or repeats):
                self._moves |= not self._stages.is_near(*counts, SLIP_CYCLES)
                self._lose_count(1.0, now)
            elif next_may_have_come:
                self._publishing.withhold()  # a new sample whole cycles further has equal counts
        return None

    def _answer(self, place: int) -> float:
        elapsed = max(1, place - self._accounted) if self.sampled else 1
        self._accounted = self._answered = place
        return float(elapsed)

    def _pass_lost(self, syncs: int, now: float) -> None:
        """Pass ``syncs`` that were not received; the tracks that came answer the last of them."""
        self.syncs.advance(syncs)
        self._end_parts(now)
        _count(self._lost_syncs, syncs * self.sampled)
        self._sample_came = 0
        self._off = 0.0

    def _begin_samples(self, now: float) -> None:
        if not self.sampled:
            self.sampled = True
            self.on_first(now)

    def _complete(self, sample: Sample, now: float) -> None:
        self._begin_samples(now)
        if sample.time_100ns is not None:
            self._timed(sample, now)
            return
        elapsed, self._elapsed, self._sample_came = self._elapsed, 0.0, 1
        placed = not (self._off and self._chain.displaces(self._off))
        is_open = self._ambiguous or self.syncs.late_s > 0.0 or self.syncs.grid.early > 0
        self._moves = is_open and (self._moves or self._chain.slips(1.0))
        feedback = self._chain.after(sample, elapsed or self._answer(self.syncs.place), placed=placed)
        if self.unconfirmed or self._moves or (is_open and self._chain.slips(1.0)):
            feedback = self._withheld(feedback)
        self._out(sample, feedback, now)

    def _timed(self, sample: Sample, now: float) -> None:
        """Take a sample by its own time. An old one is dropped; one near the last accounts for its SYNC."""
        call, syncs, source = self._call, self.syncs, self._source
        if not self._synced and source is None:
            syncs.sync(call.received, call.is_stamped, None)  # no SYNCs: the sample is its own
        place, received_s, synced_s = syncs.place, None, None  # for a source or a synchronous RPDO
        if not self._input.is_synchronous and source is None:
            received_s = call.received if call.is_stamped else None
            is_first = self._synced and not (self._sample_came or syncs.extra_came)
            if self._synced and self.answers.waits and call.is_stamped and syncs.stamped:
                place, synced_s = self._answered_sync(call.received - syncs.synced_s)
                sample = sample._replace(elapsed=max(1.0, float(place - self._accounted)))
            elif is_first and syncs.stamped == call.is_stamped:  # it certainly answers the last SYNC
                synced_s = syncs.synced_s
        self._limits.unit_changed()
        if self._interval.samples_per_sync > 1:
            self._grid.follow(syncs.grid.seen)
        last, times = self._publishing.last, self._chain.times
        feedback = self._chain.step(sample, received_s, synced_s, place > self._accounted)
        is_new = last is None or feedback.samples != last.samples
        if is_new:
            is_open = (self._chain.between and syncs.stamped and syncs.grid.row) or syncs.grid.early
            withheld = self.unconfirmed or (is_open and self._chain.slips(1.0))
            self._out(sample, self._withheld(feedback) if withheld else feedback, now)
        elif times.passed > 0.0 and self._chain.slips(1.0):
            self._publishing.withhold()  # if the refused time is right, the published position is old
        if is_new or self._chain.crowded:
            self._sample_came += 1
            self._answer(max(place, self._accounted))
        else:
            self.count_bad_frame()

    def _answered_sync(self, delay_s: float) -> tuple[int, float | None]:
        """Place and receive time of the SYNC that a PDO answers; if that is open, the next place and None."""
        syncs, answers = self.syncs, self.answers
        later = answers.place(delay_s, syncs, self._accounted - syncs.place)
        if later is None:
            answers.has_moved(syncs.grid)
        place = min(syncs.place, self._accounted + 1 if later is None else syncs.place + later)
        return place, None if later is None or later > 0 or syncs.extra_came else answers.synced_s.get(place)

    def _sample_source(self, source: LocalSource, now: float) -> None:
        if not self.sampled:
            self._accounted = self.syncs.place - 1
        self._begin_samples(now)
        sample = source.next(now)
        if sample is None:
            self._miss_to(self.syncs.place, now)
        else:
            self._complete(sample, now)

    # Samples into the chain, and out.

    def _withheld(self, feedback: Feedback) -> Feedback:
        if not feedback.status & VALID:
            return feedback
        self.unconfirmed = max(0, self.unconfirmed - 1)
        return self._chain.withheld(feedback)

    def _out(self, sample: Sample, feedback: Feedback, now: float) -> None:
        between = self._chain.between
        self._publishing.count(between, now)
        for one in (*between, feedback):
            if self._limits.noise.take(one):
                self._limits.measured()
        self._publishing.publish(feedback, now)
        if self._observers.open:
            per_sync, apart = self._interval.samples_per_sync, round(self._chain.unit_s / TICK_S)
            self._observers.take_all(sample, feedback, between, per_sync, apart)

    def _lose_count(self, intervals: float, now: float) -> None:
        """``intervals`` may have passed uncounted: the position is lost if the machine moves."""
        moved = self._moves and not self._chain.lost  # while an earlier doubt was open
        feedback = self._chain.lose() if moved else self._chain.uncertain(intervals)
        if feedback is not None:
            self._publishing.publish(feedback, now)


def _count(counter: Entry, events: int = 1) -> None:
    counter.value = (counter.value + events) & 0xFFFFFFFF
