"""From a sample, or its absence, through the chain to what is published."""

from __future__ import annotations

from canfb import objects as od
from canfb.device.core import NEVER
from canfb.device.node import Node
from canfb.device.od.dictionary import Dictionary
from canfb.module.interval import SamplingInterval
from canfb.module.objects.recorder import SampleObservers
from canfb.module.objects.sample_input import LocalSource, SampleInput
from canfb.module.objects.second_input import SecondInput
from canfb.module.pairing import Actions, Pairing
from canfb.module.parameters import Limits
from canfb.module.publishing import Publishing
from canfb.signal.chain import SignalChain
from canfb.signal.feedback import Feedback
from canfb.signal.nominal_sync import MEMORY_SYNCS
from canfb.signal.sample import TICK_S, TICKS, Sample
from canfb.signal.supervision import COASTING, VALID
from canfb.timing.judge import USUAL, Judge, Passed

MOST_MISSED = 256  # in a row, one by one: more than 2010:03 can bridge
SAME_GRID = 2e-6  # of the interval
GRID_SYNCS = 1024
EXACT_SYNCS = 512  # from then on a lock is more exact than the drift of a clock
CLOSE = 2e-3  # of the interval: as far as the first lock may be from 1006h
CONFIRMING_SAMPLES = 4  # after a pause in which the machine may have begun to move


SampleInstant = tuple[int, float | None, float | None]
"""Sample time in 100 ns; when the sample and its SYNC were received, seconds, None where not known."""


def doubt_words(before: SampleInstant, now: SampleInstant, interval_s: float) -> str:
    """By how much a sample time deviates from the receptions, or from the nominal interval, in words.

    ``before`` is the last valid sample, ``interval_s`` the interval of SYNC, 0.0: not known.
    """
    by_time_s = ((now[0] - before[0] + TICKS // 2) % TICKS - TICKS // 2) * TICK_S
    text = f"sample time {by_time_s * 1e3:.3f} ms after the last valid one"
    for what, place in (("its SYNC", 2), ("its reception", 1)):
        first, last = before[place], now[place]
        if first is not None and last is not None:
            apart_s = last - first
            return f"{text}, by {what} {apart_s * 1e3:.3f} ms"
    return f"{text}, by the interval {interval_s * 1e3:.3f} ms" if interval_s else text


class Sampling:
    """Gives the chain what the pairing finds, and withholds what is not certain.

    ``pairing`` is fed by the node. ``observers`` see each sample and each one that was missed.

    Nearly each sample is two counts in time, with their own time or without. It goes to the chain as it
    stands in the dictionary, and all others as a :class:`Sample`; tests/module/test_usual_sample.py compares
    both, frame by frame.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        node: Node,
        judge: Judge,
        interval: SamplingInterval,
        limits: Limits,
        chain: SignalChain,
        parts: SampleInput,
        source: LocalSource | None,
        second: SecondInput,
        observers: SampleObservers,
        publishing: Publishing,
    ) -> None:
        self._interval, self._limits, self._chain, self._stages = interval, limits, chain, chain.stages
        self._observers, self._publishing, self._prediction = observers, publishing, publishing.prediction
        self._paused_s = 0.0
        self._grid_learned_s = 0.0
        self._timed: SampleInstant | None = None  # of the last valid sample with a time
        self._doubted: SampleInstant | None = None  # of the present one, if it is not valid
        publishing.events.unconfirmed = self._why_unconfirmed
        chain.on_unit = self._unit_changed
        self._waited = 0.0  # intervals since the last sample that were reported as missed
        self._set_waited = 0.0  # those before the last set of intervals
        self._judge = judge
        self._sine, self._cosine, self._time, self._flags = (
            dictionary.entry(*part)
            for part in (od.SAMPLE_SINE, od.SAMPLE_COSINE, od.SAMPLE_TIME, od.SAMPLE_FLAGS)
        )
        self._parts = parts
        self._unconfirmed = 0  # samples after a pause that are not called valid yet
        actions = Actions(
            take_usual=self._take_usual,
            take=self._take,
            take_usual_timed=self._take_usual_timed,
            take_timed=self._take_timed,
            miss=self._miss,
            confirm=self._confirm,
            lose_count=self._lose_count,
            slips=chain.slips,
            withhold=publishing.withhold,
            repeats=chain.stages.repeats,
            extrapolate=publishing.extrapolate,
        )
        self.pairing = Pairing(
            dictionary, node, judge, interval, parts, source, second, self._prediction, actions
        )

    def _take_usual(self, now: float) -> None:
        """Two counts that answer the last SYNC, as they stand in the dictionary."""
        if self._waited or self._unconfirmed or self._observers.open or self._flags.value:
            self._take(self._parts.sample(), USUAL, now)
            return
        limits = self._limits
        if limits.narrowed:
            limits.follow()
        feedback = self._stages.take(self._sine.value, self._cosine.value)
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
            return False
        several = options if len(options) > 1 else ()
        placed = not (passed.instant_error and self._chain.slips(passed.instant_error))
        feedback = self._chain.after(sample, options[0], several, placed=placed)
        if feedback.status & VALID and (self._unconfirmed or not passed.certain):
            feedback = self._withheld(feedback)
        self._out(sample, feedback, now)
        return True

    def _since_last(self, passed: Passed) -> tuple[float, ...]:
        """Intervals since the last sample or miss, all possible ones; none if it may be one of those missed.

        Then it comes too late: the time goes on from the miss, and the set would lack what may be true.
        """
        options, waited = passed.options, self._waited
        if options[0] <= waited:
            return ()
        self._waited = 0.0
        if len(options) > 1:
            self._set_waited = waited
        return tuple([one - waited for one in options]) if waited else options

    def _take_usual_timed(self, received_s: float | None, synced_s: float | None, now: float) -> bool:
        """A sample with its time as it stands in the dictionary; False if it is to be looked at closely."""
        if self._prediction.follows or self._unconfirmed or self._observers.open or self._flags.value:
            return False
        limits = self._limits
        if limits.narrowed:
            limits.follow()
        time_100ns = self._time.value
        feedback = self._chain.take_in_turn(
            self._sine.value, self._cosine.value, time_100ns, received_s, synced_s
        )
        if feedback is None:
            return False
        self._waited = 0.0
        self._remember(feedback, (time_100ns, received_s, synced_s))
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
        time_100ns = sample.time_100ns
        assert time_100ns is not None
        self._unit_changed()
        if self._interval.samples_per_sync > 1:
            self._follow_grid()
        last = self._publishing.last
        feedback = self._chain.step(sample, received_s, synced_s, extra)
        if last is not None and feedback.samples == last.samples:
            return self._chain.crowded
        self._waited = 0.0
        self._remember(feedback, (time_100ns, received_s, synced_s))
        if feedback.status & VALID and self._unconfirmed:
            feedback = self._withheld(feedback)
        self._out(sample, feedback, now)
        return True

    def _unit_changed(self) -> None:
        """The limits are those of the interval in which the sample is counted, also of the first one."""
        self._interval.speed_unit_s = self._chain.unit_s
        if self._limits.narrowed:
            self._limits.follow()

    def _remember(self, feedback: Feedback, instant: SampleInstant) -> None:
        """When the sample was taken: a later one that is in doubt is compared with it in words."""
        if feedback.status & VALID:
            self._timed, self._doubted = instant, None
        else:
            self._doubted = instant

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
            self._observe(sample, feedback)

    def _observe(self, sample: Sample, feedback: Feedback) -> None:
        """All samples of this SYNC for the observers, each with its own time."""
        between, apart = self._chain.between, round(self._chain.unit_s / TICK_S)
        for place in range(self._interval.samples_per_sync - 1, 0, -1):
            if place > len(between):
                self._observers.miss()
                continue
            time = sample.time_100ns
            at = None if time is None else (time - place * apart) % TICKS
            sine, cosine = sample.earlier[place - 1]
            self._observers.take(
                Sample(sine, cosine, invalid=sample.invalid, time_100ns=at), between[len(between) - place]
            )
        self._observers.take(sample, feedback)

    def _withheld(self, feedback: Feedback) -> Feedback:
        """What may be right, but is not confirmed."""
        self._chain.adaptation.drop()
        if self._unconfirmed:
            self._unconfirmed -= 1
        return feedback._replace(status=feedback.status & ~VALID | COASTING)

    def _why_unconfirmed(self) -> str:
        """What keeps a position without a fault from being valid, in words; "" where that is not known."""
        if self._unconfirmed:
            return f"{CONFIRMING_SAMPLES} samples must confirm it after the pause"
        if self._judge.is_open:
            late_ms = self._judge.late_s * 1e3
            return f"SYNC {late_ms:.3g} ms late, one may have been missed: the next SYNCs decide"
        if self._chain.searches:
            return "the sample times do not confirm yet that the machine stood at the start"
        if self._chain.reference.in_doubt:
            return "a zero pulse contradicts it"
        if self._timed is None or self._doubted is None:
            return ""
        return doubt_words(self._timed, self._doubted, self._interval.seconds)

    def _follow_grid(self) -> None:
        """Several samples for each SYNC: the earlier ones were taken by the interval of SYNC, exactly."""
        grid_s, chain = self._grid_s(), self._chain
        # Of the earlier samples it is not known when they were taken: at standstill it does not matter.
        chain.measures_intervals = grid_s > 0.0
        if abs(grid_s - chain.sync_interval_s) > SAME_GRID * grid_s:
            chain.sync_interval_s = grid_s

    def _grid_s(self) -> float:
        """The interval of SYNC by the clock of the interface, which takes the earlier samples by it.

        0.0: not known yet. 1006h is exact but for the drift of that clock, and so better for a while. What
        was learned stays until the module is reset, or a new lock knows better.
        """
        grid, nominal_s = self._chain.nominal_sync, self._interval.nominal_s
        if not grid.locked:
            return self._grid_learned_s or nominal_s
        learned_s = grid.period_ticks * TICK_S
        if grid.seen < EXACT_SYNCS and abs(learned_s - nominal_s) <= CLOSE * nominal_s:
            return nominal_s
        self._grid_learned_s = learned_s
        return learned_s

    def _miss(self, samples: int, now: float) -> None:
        """So many samples that did not come, reported once."""
        known_as_lost = self._chain.lost
        self._waited += samples
        # Of a position that is lost it makes no difference how long it has been.
        for left in range(min(samples, MOST_MISSED) - 1, -1, -1):
            self._publishing.publish(self._chain.miss(), now, send=not left and not known_as_lost)
            for _ in range(self._interval.samples_per_sync):
                self._observers.miss()

    def _confirm(self, elapsed: float) -> None:
        """So many intervals had passed at the last sample that had several."""
        self._chain.confirm(elapsed - self._set_waited)

    def _lose_count(self, intervals: float, now: float) -> None:
        """So many intervals may or may not have passed: the position is lost if the machine moves."""
        feedback = self._chain.uncertain(intervals)
        if feedback is not None:
            self._publishing.publish(feedback, now)

    def overdue(self, now: float) -> None:
        """No SYNC and no sample for 2010:06 periods: what stands there is not the position any more."""
        if not self.pairing.overdue(now):
            self._publishing.outdated(now)
        if self._chain.lost:
            self._judge.until = NEVER

    def uncounted(self, now: float) -> None:
        """The bus is gone: SYNCs are not counted, and the position is lost."""
        if self.pairing.sampled:
            self._publishing.publish(self._chain.lose(), now, send=False)
            self._begin()

    def _begin(self) -> None:
        self.pairing.begin()
        self._waited = 0.0

    def pause(self, now: float) -> None:
        """OPERATIONAL ends: nobody counts, and what can be read by SDO is not valid any more."""
        self._publishing.withhold()
        judge = self._judge
        self._paused_s = judge.synced_s if judge.begun else now
        judge.pause()

    def resume(self, now: float) -> None:
        """OPERATIONAL, for the first time or again: nothing was counted meanwhile."""
        chain, interval_s = self._chain, self._interval.seconds
        self._begin()
        self._timed = self._doubted = None
        self._unconfirmed = CONFIRMING_SAMPLES if chain.begun and not chain.lost else 0
        # Since the last SYNC, whose sample may not have come any more.
        chain.resume((now - self._paused_s) / interval_s + 1.0 if interval_s else NEVER)
        self._prediction.pause(self._publishing.last)
        self._publishing.withhold()

    def configured(self, samples_per_sync: int, timed: bool) -> None:
        """PDO parameters or the NMT state have changed: so many samples for each SYNC, ``timed`` or not."""
        limits = self._limits
        if (samples_per_sync, timed) != (self._interval.samples_per_sync, limits.timed):
            self._interval.samples_per_sync, limits.timed = samples_per_sync, timed
            self._interval.speed_unit_s = 0.0
            self._chain.measures_intervals = True
            self._chain.nominal_sync.memory_syncs = GRID_SYNCS if samples_per_sync > 1 else MEMORY_SYNCS
            limits.noise_changes()

    def forget_interval(self) -> None:
        """After a reset another master may send SYNC at another rate."""
        self._judge.forget()
        self._interval.speed_unit_s = 0.0
        self._grid_learned_s = 0.0
        self._chain.forget_times()
