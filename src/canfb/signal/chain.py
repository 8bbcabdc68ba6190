"""The whole chain for one sample: conditioning, Table 1, correction, eq. 9, supervision."""

from __future__ import annotations

import math

from canfb.objects import LossCause
from canfb.signal import speeds
from canfb.signal.blocks import Scratch
from canfb.signal.bounded_motion import HOLE_INTERVALS
from canfb.signal.chain_config import ChainConfig, ChainLimits, check_config
from canfb.signal.correction import Correction, CorrectionTable, check_table
from canfb.signal.declared import Declared
from canfb.signal.estimator import Estimator
from canfb.signal.estimator_runs import follow_run, successor, take_run
from canfb.signal.feedback import Feedback
from canfb.signal.front_end import AHEAD_INTERVALS
from canfb.signal.frozen import FrozenInput, repeats
from canfb.signal.harmonics import corrected
from canfb.signal.pauses import Pauses
from canfb.signal.phase import AnyArray, raw_phase
from canfb.signal.recovery.coarse import CoarseTrack
from canfb.signal.recovery.reference import Pulse, Reference
from canfb.signal.recovery.zero_pulse import ZeroPulse
from canfb.signal.sample import Sample, in_order
from canfb.signal.sample_times import CROWDED, REPEATED, SUSPECT, SampleTimes
from canfb.signal.supervision import (
    FROZEN,
    LOST,
    MISSED,
    REFERENCED,
    RESIDUAL,
    TABLE_ACTIVE,
    VALID,
    Supervision,
)
from canfb.signal.tracker import Track, TrackResult
from canfb.signal.tracking import continues, write_places_before

_new = tuple.__new__  # makes a named tuple in half the time that its own constructor takes


class SignalChain(Pauses):
    """One encoder, sample by sample.

    A sample that fails a check is flagged in its own :class:`Feedback` and never moves the
    cycle count; see :mod:`canfb.signal.estimator` for what happens then.

    TypeError for a ``config`` that is not a :class:`ChainConfig` and a ``table`` that is not a
    :class:`CorrectionTable` (None: the identity).
    """

    def __init__(self, config: ChainConfig, table: CorrectionTable | None = None) -> None:
        check_config(config)
        super().__init__()
        self._estimator = Estimator(config.chain_limits.declared)
        self._tracker = self._estimator.tracker
        self._supervision = Supervision(config.limits)
        self._frozen = FrozenInput(config.frozen_samples, self._tracker.residual_limit)
        self._per_sync = 1
        self.between: tuple[Feedback, ...] = ()
        """Of the last interval: what the samples before the newest gave, oldest first."""
        self._times = SampleTimes()
        self.nominal_sync = self._times.nominal_sync
        """The clock of the encoder interface, by the sample times so far."""
        self.measures_intervals = True
        """Sample times say how long an interval was; False: they only tell new samples from doubled ones."""
        limits = config.chain_limits
        self.crowded = False
        """The last sample came, but so soon after the one before that nothing was made of it."""
        self._make_reference(limits)
        self._sampling_s = config.interval_s
        self.set_limits(limits)
        self.activate(Correction(table, config.conditioning))
        self.adapt(config.adaptation)

    @property
    def correction(self) -> Correction:
        """The active correction."""
        return self._correction

    @property
    def reference(self) -> Reference:
        """The state of coarse track and zero pulse."""
        return self._reference

    @property
    def loss_cause(self) -> LossCause:
        """Why the position was lost the last time."""
        return self._estimator.loss_cause

    @property
    def lost(self) -> bool:
        """True from the moment the position is lost until :meth:`restart`."""
        return self._estimator.lost

    @property
    def searches(self) -> bool:
        """Uneven sample times may still tell at what speed the machine turns."""
        return self._estimator.searches

    def set_limits(self, limits: ChainLimits) -> None:
        """Take new limits, between two samples. Another encoder resets coarse track and zero pulse."""
        self._nothing_in_doubt = False
        if limits.samples_per_sync != self._per_sync:
            self._sample_faster(limits.samples_per_sync)
        self._declare(limits.declared)
        self._frozen.residual_limit_cycles = limits.residual_limit
        self._supervision.set_limits(limits.sample)
        self._frozen.frozen_samples = limits.frozen_samples
        if limits.cycles_per_revolution != self._reference.coarse.cycles_per_revolution:
            self._make_reference(limits)
        self._reference.coarse.limit_revolutions = limits.coarse_limit_revolutions
        self._reference.coarse.full_scale_counts = limits.sample.full_scale_counts
        self._use_front_end(self._conditioning, limits.corners)

    def _declare(self, declared: Declared) -> None:
        """Hold the next samples against this; the position stays.

        With another order of prediction it is lost if the samples were about to determine it; or if the
        machine accelerates by more than the prediction of constant speed can follow.
        """
        if declared.order == self._estimator.order:
            self._estimator.declare(declared)
            return
        self._estimator = successor(self._estimator, declared)
        self._estimator.phases_keep = not self._conditioning.cosine_delay_s
        self._tracker = self._estimator.tracker
        self._reference.follow(self._estimator)

    def _sample_faster(self, per_sync: int) -> None:
        """From the next interval on there are so many samples in it; the position stays."""
        factor = per_sync / self._per_sync
        self._per_sync = per_sync
        self.between = ()
        self._estimator.rescale(factor)
        self._reference.slipped()
        self._speed /= factor
        self._before = None

    def _make_reference(self, limits: ChainLimits) -> None:
        n = limits.cycles_per_revolution
        coarse = CoarseTrack(n, limits.sample.full_scale_counts, limits.coarse_limit_revolutions)
        self._reference = Reference(self._estimator, coarse, ZeroPulse(n))
        self._referenced = 0
        self._renew_second()

    def activate(self, correction: Correction) -> None:
        """Take another ``correction``, between two samples. TypeError if its table is none."""
        check_table(correction.table)
        self._correction = correction
        self._use_table(correction.table)
        self.adaptation.use(correction)
        self._use_front_end(correction.conditioning, self._corners)
        self._base_status = 0 if correction.table is None else TABLE_ACTIVE

    def restart(self, cycles: int = 0, speed_cycles: float = 0.0) -> None:
        """Forget the position: the next good sample starts with this cycle count and speed.

        ``cycles`` is the cycle count there, ``speed_cycles`` in cycles per sampling interval, default:
        standstill. It must be right to less than half a cycle; the position is lost where the next
        sample shows that it is not.
        ValueError for a speed that is not finite or above 2**31 in size.
        """
        self._estimator.restart(cycles, speed_cycles)
        self._reference.restart()
        self._restart_second()
        self._pause()
        self._times.reset()
        self._waits, self._turned = False, 0.0
        self._speed = float(speed_cycles)
        self._turn(self._speed)

    def lose(self) -> Feedback:
        """The position is lost from now on: no cycles were counted."""
        self._estimator.lose(LossCause.TIME)
        self._reference.slipped()
        track = self._tracker.predict(0.0)
        return self._feedback(math.nan, math.nan, 0.0, math.nan, track, LOST, 0)

    def _pause(self) -> None:
        self._forget_sample()
        self._times.forget()
        self._referenced = REFERENCED if self._reference.zero.referenced else 0
        self._waited = 0.0
        self._was_valid = 0

    def step(
        self,
        sample: Sample,
        received_s: float | None = None,
        synced_s: float | None = None,
        extra: bool = False,
    ) -> Feedback:
        """Take one sample through the whole chain. A bad sample is flagged, it never raises.

        A sample with the time of the one before, or of an earlier one, comes too late: the same
        Feedback, the same object, is returned, and nothing changes. Times must agree
        with the receptions, of this sample at ``received_s`` and of the SYNC that it answers at
        ``synced_s``, seconds, None where that is not known; ``extra``: it may answer a SYNC too many.
        One whose time fits nothing is a bad sample; see :class:`canfb.signal.sample_times.SampleTimes`.

        With several samples in an interval (``samples_per_sync`` of :class:`ChainLimits`) all of them are
        taken, in their order; the result is that of the newest, :attr:`between` has the others.
        """
        time_100ns, elapsed = sample.time_100ns, sample.elapsed
        if time_100ns is None:
            return self.after(sample, elapsed, sample.options)
        speed, unit_s = self._tracker.step_cycles * self._per_sync, self._times.unit_s
        counted = elapsed + self._waited
        passed = self._times.elapsed(time_100ns, counted, received_s, synced_s, speed, extra)
        if self._times.unit_s != unit_s:
            self._unit_changed(unit_s)
        if self._front is not None and self._front.unit_s != self.unit_s:
            self._follow_unit()
        self.crowded = passed == CROWDED
        if passed <= 0.0:
            if passed in (REPEATED, CROWDED) and self._last is not None:
                return self._last
            if passed != SUSPECT:
                return self._restarted(sample)
            self._waited += elapsed
            return self.after(sample, elapsed, placed=False)
        next_one = elapsed + self._waited < HOLE_INTERVALS
        if self.measures_intervals:
            elapsed = passed - self._waited  # what was waited for is counted already
        self._waited = 0.0
        return self.after(sample, elapsed, next_one=next_one)

    def after(
        self,
        sample: Sample,
        elapsed: float,
        options: tuple[float, ...] = (),
        *,
        placed: bool = True,
        next_one: bool = False,
    ) -> Feedback:
        """:meth:`step` where it is known when the sample was taken, whatever its own time says.

        ``elapsed`` intervals of SYNC after the one before, or any of the ``options``; ``placed``: False if
        that is not known, which makes it a bad sample; ``next_one``: by the count of SYNCs none was missed.
        """
        sine, cosine, _, invalid, coarse, _, pulse, _, _, _ = sample
        bad = invalid or not placed
        self._estimator.timed = timed = sample.time_100ns is not None
        in_turn = elapsed == 1.0 or (timed and elapsed <= HOLE_INTERVALS)
        if in_turn and not (bad or options) and coarse is pulse is None:
            feedback = self.usual(sine, cosine, elapsed)
            if feedback is not None:
                return feedback
        if self._per_sync == 1:
            feedback = self._take(sample, elapsed, bad, not placed, next_one, options=options)
            self._look_again(feedback)
            return feedback
        return self._take_all(sample, elapsed, bad, not placed, next_one, options)

    def _take_all(
        self,
        sample: Sample,
        elapsed: float,
        bad: bool,
        unplaced: bool,
        next_one: bool,
        options: tuple[float, ...],
    ) -> Feedback:
        """The samples of one SYNC in their order, ``elapsed`` intervals of SYNC after those before."""
        later = [(one - elapsed) * self._per_sync for one in options]  # than the first option
        samples = [sample] if bad else in_order(sample, elapsed * self._per_sync, self._per_sync)
        next_one = next_one and len(samples) == self._per_sync
        between: list[Feedback] = []
        pulse = None
        for one in samples[:-1]:
            before = self._before
            first = one._replace(zero_pulse=None)
            times = () if between else tuple(one.elapsed + more for more in later)
            feedback = self._take(first, one.elapsed, False, False, next_one, newest=False, options=times)
            after = self._before
            self._reference.passed(one.elapsed, after is not None)
            if after is None or (between and (between[-1].status ^ feedback.status) & (VALID | LOST)):
                pulse = None
            elif one.zero_pulse is not None and before is not None:
                pulse = self._reference.pulse(before, after, one.zero_pulse, self._clock, one.elapsed)
            between.append(feedback)
        newest = samples[-1]
        whole = elapsed * self._per_sync if bad else newest.elapsed
        times = () if between else tuple(whole + more for more in later)
        feedback = self._take(newest, whole, bad, unplaced, next_one, pulse, options=times)
        if any(one.status & MISSED for one in between):
            feedback = self._last = feedback._replace(status=feedback.status | MISSED)
        self.between = tuple(one._replace(status=one.status & ~MISSED) for one in between)
        return feedback

    def _take(
        self,
        sample: Sample,
        elapsed: float,
        bad: bool,
        unplaced: bool,
        next_one: bool,
        pulse: Pulse | None = None,
        newest: bool = True,
        options: tuple[float, ...] = (),
    ) -> Feedback:
        """One sample, ``elapsed`` sampling intervals after the one before; its time was looked at.

        ``options`` are all times that may have elapsed, if it is not known which.

        ``pulse`` is a zero pulse that came before one of the :attr:`between`; ``newest``: it is none of them.
        """
        sine, cosine, _, _, coarse, _, zero_pulse, _, _, _ = sample
        offset_s, gain_s, offset_c, factor_c, skew = self._coefficients
        s = (sine - offset_s) * gain_s
        c = (cosine - offset_c) * factor_c - s * skew
        amplitude = math.sqrt(s * s + c * c)
        raw = raw_phase(s, c)
        supervision = self._supervision
        lowest, highest, smallest, largest = supervision.bounds
        if lowest < sine < highest and lowest < cosine < highest and smallest <= amplitude <= largest:
            faults = 0
            if supervision.after_fault:
                supervision.passed()
        else:
            faults = supervision.faults(sine, cosine, amplitude)
        if sine == self._sine and cosine == self._cosine:
            if self._frozen.repeated(0.0 if self._frozen.repeats else self._least_speed()):
                faults |= FROZEN
        else:
            self._sine, self._cosine = sine, cosine
            if self._frozen.repeats:
                self._frozen.moved()
        if self._waits and self._may_start():
            self.restart()
        measured = not (faults or bad) and raw == raw
        if measured:
            table = self._table
            phase = raw if table is None else table.correct(raw)
            if self._row:
                phase = corrected(self._row, phase)
            track, bits = self._estimator.good(phase, options or elapsed)
        else:
            track, bits = self._estimator.bad(options or elapsed, missed=unplaced)
        reference = self._reference
        if bits & LOST and (not measured or bits & RESIDUAL):
            reference.slipped()
        jump = 0
        self._clock += elapsed
        if coarse is not None or zero_pulse is not None or pulse is not None or reference.in_doubt:
            before = self._before if measured else None
            if pulse is None and zero_pulse is not None and before is not None:
                pulse = reference.pulse(before, track, zero_pulse, self._clock, elapsed)
            bits, jump = reference.apply(sample, track, bits, pulse, elapsed if before else 0.0)
            self._referenced = REFERENCED if self._reference.zero.referenced else 0
        if self._second is not None:
            bits, jump = self._second.apply(track, bits, jump, elapsed, measured, coarse is None, newest)
        self._before = track if measured and jump == 0 else None
        if elapsed > HOLE_INTERVALS and not (next_one and bits & VALID):
            bits |= MISSED
        return self._feedback(s, c, amplitude, raw, track, bits | faults, jump)

    @property
    def _doubtful(self) -> int:
        """Last steps of which any may have been bad."""
        return self._estimator.declared.bad_samples + 1

    def _least_speed(self) -> float:
        return speeds.least_speed(self._estimator.places, self._doubtful)

    def write_places_before(self, tracked: TrackResult, at: int) -> None:
        """Write what the prediction needs into ``tracked``, three places before ``at``."""
        if self._tracker.is_steady:
            write_places_before(self._tracker, tracked, at)

    def continues(self, tracked: TrackResult, at: int) -> bool:
        """True if :meth:`follow_run` may begin at ``at``: what the prediction needs stands before.

        And nothing of the last samples is in doubt. A lost position is not: eq. 9 runs on with it.
        """
        doubts = (
            self._waits
            or self._estimator.in_doubt
            or self.searches
            or self._supervision.after_fault
            or self._reference.in_doubt
        )
        return not doubts and continues(self._tracker, tracked, at)

    def follow_run(
        self, sine: AnyArray, cosine: AnyArray, tracked: TrackResult, run: slice, scratch: Scratch
    ) -> int:
        """:meth:`step` for a run of samples, one interval apart, that keep the limits of one sample.

        Only where :meth:`continues`. ``sine``, ``cosine`` are its counts, ``tracked.phase[run]`` the
        corrected phases. ``scratch`` has the length of the run. Fills the rest of ``tracked[run]``.
        The result is the number of samples taken: those before the first with a residual
        over the limit (unless the position is lost) or a frozen input. The chain stands
        after these, and the rest is for :meth:`step`.
        """
        start: int = run.start
        cycles, phase = tracked.cycles, tracked.phase
        state = self._tracker.snapshot()
        stop = follow_run(self._estimator, tracked, run, scratch)
        if stop > start:
            before = self._sine, self._cosine
            equal = repeats(sine[: stop - start], cosine[: stop - start], before, scratch.bit)
            if equal is None:
                self._frozen.moved()
            else:
                least = speeds.least_speeds(
                    () if self.lost else self._estimator.places,
                    cycles[start:stop],
                    phase[start:stop],
                    self._doubtful,
                )
                stop = start + self._frozen.take_run(equal, least)
        if stop == start:
            self._tracker.restore(state)
            return 0
        last = Track(int(cycles[stop - 1]), float(phase[stop - 1]), float(tracked.residual[stop - 1]), True)
        take_run(self._estimator, state, tracked, start, stop)
        self._sine, self._cosine = float(sine[stop - start - 1]), float(cosine[stop - start - 1])
        self._before, self._last = last, None
        self._speed = self._tracker.step_cycles
        self._was_valid = 0 if self._estimator.lost else VALID
        if self._estimator.lost and not tracked.ok[start:stop].all():
            self._reference.slipped()
        self._clock += stop - start
        self._samples += stop - start
        self._nothing_in_doubt = False
        return stop - start

    def confirm(self, elapsed: float, back: int = 0) -> None:
        """Now it is known that the sample ``back`` before the last one came after this elapsed time.

        It is one of its :attr:`canfb.Sample.options`. Missed samples count in ``back``. The position is lost
        if the sample was taken to have come after another.
        """
        last = self._per_sync - 1  # the first sample of an interval has the times
        self._estimator.confirm((elapsed - 1.0) * self._per_sync + 1.0, back * self._per_sync + last)

    def miss(self) -> Feedback:
        """One interval of SYNC without a sample: the position coasts, flagged."""
        self._waited += 1.0
        intervals = float(self._per_sync)
        track, bits = self._estimator.bad(intervals, missed=True)
        self._clock += intervals
        self._before = None
        self.between = ()
        self._reference.missed()
        bits = self._miss_second(bits)
        return self._feedback(math.nan, math.nan, 0.0, math.nan, track, bits | MISSED, 0)

    def _feedback(
        self, s: float, c: float, amplitude: float, raw: float, track: Track, bits: int, jump: int
    ) -> Feedback:
        self._nothing_in_doubt = False
        self._samples = samples = self._samples + 1
        cycles, phase, residual, _ = track
        speed = self._tracker.step_cycles
        if self._was_valid or not bits & VALID:
            acceleration = speed - self._speed
        else:  # the speed of a sample that was not valid may be wrong by whole cycles
            acceleration = speeds.acceleration(self._estimator.places)
        self._speed, self._was_valid = speed, bits & VALID
        if bits & VALID and len(places := self._estimator.places) > 2 and places[-1][2] > HOLE_INTERVALS:
            acceleration = speeds.acceleration(places)
            self._speed += acceleration * (places[-1][2] - 1.0) / 2.0  # as over the last interval alone
        if self._front is not None:
            self._turn(speed + AHEAD_INTERVALS * acceleration if bits & VALID else speed)
        status = bits | self._base_status
        if self._referenced and not bits & LOST:
            status |= REFERENCED
        self._last = _new(
            Feedback,
            (s, c, amplitude, raw, cycles, phase, residual, status, speed, acceleration, jump, samples),
        )
        if self.adaptation.is_on:
            self._learn(self._last)
        return self._last
