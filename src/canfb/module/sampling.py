"""From a sample, or its absence, through the chain to what is published."""

from __future__ import annotations

from functools import partial

from canfb.device.moment import NEVER
from canfb.device.node import Node
from canfb.device.od.dictionary import Dictionary
from canfb.module.interval import IntervalEstimate
from canfb.module.local_source import LocalSource
from canfb.module.objects.sample_input import SampleInput
from canfb.module.pairing import Findings, Pairing
from canfb.module.parameters import Limits
from canfb.module.publishing import Publishing
from canfb.module.tap import Taps
from canfb.module.timeline import Timeline
from canfb.module.usual_sample import UsualSample
from canfb.signal.chain import SignalChain
from canfb.signal.feedback import Feedback
from canfb.signal.nominal_sync import NominalSync
from canfb.signal.sample import Sample
from canfb.signal.sample_times import TICK_S, TICKS
from canfb.signal.supervision import COASTING, VALID

MOST_MISSED = 256  # in a row, one by one: more than 2010:03 can bridge
SAME_INTERVAL = 0.02
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

    ``pairing`` is fed by the node. ``taps`` see each sample and each one that was missed.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        node: Node,
        interval: IntervalEstimate,
        limits: Limits,
        chain: SignalChain,
        parts: SampleInput,
        source: LocalSource | None,
        taps: Taps,
        publishing: Publishing,
    ) -> None:
        self._interval, self._limits, self._chain = interval, limits, chain
        self._taps, self._publishing, self._prediction = taps, publishing, publishing.prediction
        self._paused_s = 0.0
        self._grid_learned_s = 0.0
        self._timed: SampleInstant | None = None  # of the last valid sample with a time
        self._doubted: SampleInstant | None = None  # of the present one, if it is not valid
        publishing.events.unconfirmed = self._why_unconfirmed
        self._grid = NominalSync(
            GRID_SYNCS
        )  # by which an interface takes its samples, if several for each SYNC
        self.timeline = timeline = Timeline(dictionary, interval)
        self._usual = UsualSample(
            dictionary,
            chain,
            limits,
            timeline,
            taps,
            publishing,
            unusual=partial(self._take_counts, parts),
        )
        found = Findings(
            self._usual.take, self._take, self._miss, self._lose_count, publishing.withhold, chain.repeats
        )
        self.pairing = Pairing(dictionary, node, timeline, interval, parts, source, found)

    def _take_counts(self, parts: SampleInput, now: float) -> None:
        """A sample without a time."""
        self._take(parts.sample(), None, None, now)

    def _take(self, sample: Sample, received_s: float | None, synced_s: float | None, now: float) -> bool:
        """A sample through the chain, and out; False if it is an earlier one, and nothing happened.

        Nothing happens either with one that is too near to the last, but it did come.
        """
        if self._limits.narrowed:
            self._limits.follow()
        time_100ns = sample.time_100ns
        if time_100ns is None:
            feedback = self._chain.step(sample)
            if feedback.status & VALID and (self._usual.unconfirmed or self.timeline.withheld):
                feedback = self._withheld(feedback)
        else:
            self._follow_interval()
            last = self._publishing.last
            feedback = self._chain.step(sample, received_s, synced_s)
            if last is not None and feedback.samples == last.samples:
                return self._chain.crowded
            if feedback.status & VALID:
                self.pairing.valid(sample)
                if sample.earlier:
                    self._grid.sample(time_100ns)
                if self._prediction.follows:
                    self._prediction.sampled(time_100ns)
                self._timed, self._doubted = (time_100ns, received_s, synced_s), None
                if self._usual.unconfirmed:
                    feedback = self._withheld(feedback)
            else:
                self._doubted = (time_100ns, received_s, synced_s)
        noise = self._limits.noise
        if self._chain.between:
            self._publishing.count(self._chain.between, now)
            for earlier in self._chain.between:
                if noise.take(earlier):
                    self._limits.measured()
        if noise.take(feedback):
            self._limits.measured()
        self._usual.publish(feedback, now)
        if self._taps.open:
            self._tap(sample, feedback)
        return True

    def _tap(self, sample: Sample, feedback: Feedback) -> None:
        """All samples of this SYNC for the taps, each with its own time."""
        between, apart = self._chain.between, round(self._chain.unit_s / TICK_S)
        for place in range(self._interval.samples_per_sync - 1, 0, -1):
            if place > len(between):
                self._taps.miss()
                continue
            time = sample.time_100ns
            at = None if time is None else (time - place * apart) % TICKS
            sine, cosine = sample.earlier[place - 1]
            self._taps.take(
                Sample(sine, cosine, invalid=sample.invalid, time_100ns=at), between[len(between) - place]
            )
        self._taps.take(sample, feedback)

    def _withheld(self, feedback: Feedback) -> Feedback:
        """What may be right, but is not confirmed."""
        if self._usual.unconfirmed:
            self._usual.unconfirmed -= 1
        return feedback._replace(status=feedback.status & ~VALID | COASTING)

    def _why_unconfirmed(self) -> str:
        """What keeps a position without a fault from being valid, in words; "" where that is not known."""
        if self._usual.unconfirmed:
            return f"{CONFIRMING_SAMPLES} samples must confirm it after the pause"
        if self.timeline.withheld:
            frame, late_s = self.timeline.late
            return f"{frame} {late_s * 1e3:.3g} ms late, one may have been missed: the next SYNCs decide"
        if self._chain.searches:
            return "the sample times do not confirm yet that the machine stood at the start"
        if self._chain.reference.in_doubt:
            return "a zero pulse contradicts it"
        if self._timed is None or self._doubted is None:
            return ""
        return doubt_words(self._timed, self._doubted, self._interval.settled_s or self._interval.seconds)

    def _follow_interval(self) -> None:
        """Take the nominal interval along, by which sample times are judged.

        Only once it is known: at a start on a busy host the first SYNCs are heard at uneven times, and the
        times of even samples would become uneven by them. Until then the first sample time is the unit.
        """
        seconds, same = self._interval.known_s, SAME_INTERVAL
        if self._interval.samples_per_sync > 1:
            grid_s = self._grid_s()
            # Of the earlier samples it is not known when they were taken: at standstill it does not matter.
            self._chain.measures_intervals = grid_s > 0.0
            seconds, same = grid_s or seconds, SAME_GRID
        if seconds and abs(seconds - self._chain.interval_s) > same * seconds:
            self._chain.interval_s = seconds

    def _grid_s(self) -> float:
        """The interval of SYNC by the clock of the interface, which takes the earlier samples by it.

        0.0: not known yet. 1006h is exact but for the drift of that clock, and so better for a while. What
        was learned stays until the module is reset, or a new lock knows better.
        """
        grid, nominal_s = self._grid, self._interval.nominal_s
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
        # Of a position that is lost it makes no difference how long it has been.
        for left in range(min(samples, MOST_MISSED) - 1, -1, -1):
            self._publishing.publish(self._chain.miss(), now, send=not left and not known_as_lost)
            for _ in range(self._interval.samples_per_sync):
                self._taps.miss()

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
            self.timeline.until = NEVER

    def uncounted(self, now: float) -> None:
        """The bus is gone: SYNCs are not counted, and the position is lost."""
        if self.pairing.sampled:
            self._publishing.publish(self._chain.lose(), now, send=False)
            self.pairing.begin()

    def pause(self, now: float) -> None:
        """OPERATIONAL ends: nobody counts, and what can be read by SDO is not valid any more."""
        self._publishing.withhold()
        timeline = self.timeline
        self._paused_s = timeline.synced_s if timeline.begun else now
        timeline.pause()

    def resume(self, now: float) -> None:
        """OPERATIONAL, for the first time or again: nothing was counted meanwhile."""
        chain, interval = self._chain, self._interval
        self.pairing.begin()
        interval_s = interval.settled_s or interval.seconds
        self._timed = self._doubted = None
        self._usual.unconfirmed = CONFIRMING_SAMPLES if chain.begun and not chain.lost else 0
        # Since the last SYNC, whose sample may not have come any more.
        chain.resume((now - self._paused_s) / interval_s + 1.0 if interval_s else NEVER)
        interval.pause()
        self._prediction.pause(self._publishing.last)
        self._publishing.withhold()

    def configured(self, samples_per_sync: int, timed: bool) -> None:
        """PDO parameters or the NMT state have changed: so many samples for each SYNC, ``timed`` or not."""
        limits = self._limits
        if (samples_per_sync, timed) != (self._interval.samples_per_sync, limits.timed):
            self._interval.samples_per_sync, limits.timed = samples_per_sync, timed
            self._chain.measures_intervals = True
            limits.noise_changes()

    def forget_interval(self) -> None:
        """After a reset another master may send SYNC at another rate."""
        self._interval.reset()
        self._grid.forget()
        self._grid_learned_s = 0.0
        self._chain.forget_times()
