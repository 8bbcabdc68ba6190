"""The whole chain for one encoder: sample times to intervals (:mod:`.sample_times`), samples at known
intervals to positions (:mod:`.stages`).

Intervals here are those of SYNC; in the stages, from sample to sample.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf

from canfb.objects import LossCause
from canfb.signal.adaptation import Adaptation, AdaptConfig, FollowedDrift
from canfb.signal.bounded_motion import HOLE_INTERVALS
from canfb.signal.chain_config import ChainConfig, ChainLimits, with_correction
from canfb.signal.correction import AnyTable, Correction
from canfb.signal.front_end import SAME_INTERVAL
from canfb.signal.pauses import Pauses
from canfb.signal.sample import Feedback, Sample, in_order
from canfb.signal.sample_times import CROWDED, REPEATED, RESTARTED, SUSPECT, SampleTimes
from canfb.signal.second_position import SecondSensor
from canfb.signal.speeds import SLIP_CYCLES
from canfb.signal.stages import Extras, Stages
from canfb.signal.supervision import COASTING, LOST, MISSED, VALID
from canfb.signal.witness.reference import Reference
from canfb.signal.witness.second import SecondPosition


class SignalChain:
    """One encoder, sample by sample.

    A sample that fails a check is flagged in its own :class:`Feedback` and never moves the
    cycle count; see :mod:`canfb.signal.estimator` for what happens then. ``stages`` take samples whose
    interval is known.

    TypeError unless ``config`` is a :class:`ChainConfig`, and ``table`` a
    :class:`canfb.CorrectionTable`, a whole :class:`canfb.Calibration` or None (the identity).
    """

    def __init__(self, config: ChainConfig, table: AnyTable = None) -> None:
        config, table = with_correction(config, table)
        self.stages = Stages(config, table)
        self.tracks = self.stages.tracks  # from counts to a phase
        # Called when :attr:`unit_s` has changed: limits per interval must be set before the next sample.
        self.on_unit: Callable[[], None] = lambda: None
        # Feedback of the samples before the newest of the last SYNC interval, oldest first.
        self.between: tuple[Feedback, ...] = ()
        # The last sample was new, but too near to the one before to be used.
        self.crowded = False
        # Sample times give the elapsed intervals; False: they only distinguish new samples from doubled ones.
        self.measures_intervals = True
        self._pauses = Pauses(self.stages)
        self.times = SampleTimes(self.stages.rests)
        self.sample_grid = self.times.grid  # the clock of the encoder interface, by its sample times
        self._per_sync = 1
        # Intervals since the last sample whose time was right: of crowded samples, and of samples that were
        # not used because their time was wrong and the machine moved.
        self._left_out = 0.0
        self._unused = 0.0
        self._untimed_unit_s = config.interval_s

    # Set between samples.

    def set_limits(self, limits: ChainLimits) -> None:
        """Use these limits. Another number of cycles per revolution resets coarse track and zero pulse."""
        if limits.samples_per_sync != self._per_sync:
            self.stages.sample_faster(limits.samples_per_sync / self._per_sync)
            self._per_sync = limits.samples_per_sync
            self.between = ()
        self.stages.set_limits(limits)
        self._follow_unit()

    def activate(self, correction: Correction) -> None:
        """Use this ``correction``. TypeError for a bad table."""
        self.stages.activate(correction)

    def adapt(self, limits: AdaptConfig | None, start_from: FollowedDrift | None = None) -> None:
        """Follow the drift of the tracks within these ``limits`` from the next sample on; None: off.

        Begins at the drift found so far, or at ``start_from``.
        """
        self.stages.adapt(limits, start_from)

    def use_second(self, sensor: SecondSensor | None) -> None:
        """Use another ``sensor`` from its next value on, or None. TypeError for anything else."""
        if sensor is not None and not isinstance(sensor, SecondSensor):
            raise TypeError(f"sensor must be a SecondSensor or None, not {type(sensor).__name__}")
        self.stages.use_second(sensor)

    def hear_second(self, values: int, increments: int) -> None:
        """End an interval of SYNC in which the other sensor sent this number of ``values``; -1: not certain.

        If it sent one, ``increments`` (INTEGER32) is its position at the sample before this call.
        """
        second = self.stages.second
        if second is not None:
            second.hear(int(values), int(increments))

    # Results.

    @property
    def correction(self) -> Correction:
        """The active correction."""
        return self.tracks.correction

    @property
    def adaptation(self) -> Adaptation:
        """The drift of the tracks, followed after :meth:`adapt`."""
        return self.tracks.adaptation

    @property
    def reference(self) -> Reference:
        """The state of coarse track and zero pulse."""
        return self.stages.reference

    @property
    def second(self) -> SecondPosition | None:
        """Comparison with another sensor, None without one."""
        return self.stages.second

    @property
    def samples(self) -> int:
        """Number of the last sample, 0 before the first."""
        return self.stages.samples

    @property
    def begun(self) -> bool:
        """True if there was a sample since the start, or the machine turned at the last reset."""
        return self.stages.estimator.tracker.started or self._pauses.turned > 0.0

    @property
    def loss_cause(self) -> LossCause:
        """Why the position was lost the last time."""
        return self.stages.estimator.loss_cause

    @property
    def lost(self) -> bool:
        """True while the position is lost."""
        return self.stages.estimator.lost

    @property
    def searches(self) -> bool:
        """True while uneven sample times may still determine the speed."""
        return self.stages.estimator.searches

    # Units.

    @property
    def sync_interval_s(self) -> float:
        """Nominal interval of SYNC, seconds, to check sample times. 0.0: not known."""
        return self.times.sync_interval_s

    @sync_interval_s.setter
    def sync_interval_s(self, interval_s: float) -> None:
        """Keep positions and speeds; count intervals in progress in the new unit."""
        old, self.times.sync_interval_s = self.times.unit_s, interval_s
        self._unit_may_have_changed(old)

    def use_interval(self, sampling_s: float) -> None:
        """Set the sampling interval of samples without time, seconds; 0.0: not known."""
        if abs(sampling_s - self._untimed_unit_s) > SAME_INTERVAL * self._untimed_unit_s:
            self._untimed_unit_s = sampling_s
            self._follow_unit()

    @property
    def unit_s(self) -> float:
        """The interval in which speeds of timed samples are given, seconds; 0.0 before it is known."""
        return self.times.unit_s / self._per_sync

    def _unit_may_have_changed(self, old_s: float) -> None:
        unit_s = self.times.unit_s
        if unit_s != old_s:
            if old_s > 0.0 and unit_s > 0.0:
                factor = old_s / unit_s
                self.times.waited *= factor
                self._left_out *= factor
                self.stages.rescale(factor)
            self.on_unit()
        self._follow_unit()

    def _follow_unit(self) -> None:
        unit_s = self.unit_s or self._untimed_unit_s
        if unit_s != self.tracks.unit_s:
            self.stages.use_unit(unit_s)

    def forget_times(self) -> None:
        """Forget the sample times: another interface may send them, with another clock and rate."""
        self.times.reset()
        self.sync_interval_s = 0.0

    # Starts and pauses.

    def restart(self, cycles: int = 0, speed_cycles: float = 0.0) -> None:
        """Forget the position: the next good sample has the cycle count ``cycles``.

        ``speed_cycles`` is the speed there, cycles per sampling interval, right to less than half a cycle
        (default: standstill); the position is lost if the next sample shows that it is not.
        ValueError for a speed that is not finite or above 2**31 in size.
        """
        self.stages.restart(cycles, speed_cycles)
        self._pauses.turned = 0.0
        self._forget_times_of_samples()

    def reset(self) -> None:
        """:meth:`restart` at cycle count 0, as the module is reset, on a machine that may be turning.

        If it may still turn at the next :meth:`resume`, the position is lost then.
        """
        self._pauses.reset()
        self._forget_times_of_samples()

    def resume(self, intervals: float = 0.0) -> None:
        """Continue after a pause of ``intervals`` of SYNC in which the machine moved less than half a cycle.

        The position is lost if the machine could have left the cycle meanwhile at its speed, if it stood and
        its next phase differs, or if it was in doubt and not valid. A lost position starts again at cycle
        count 0 if the machine stood when it was lost, and its phase has not changed since. After
        :meth:`reset` it starts, too, unless the machine turned then, or the position was lost and
        the phase had not stood for STILL_SAMPLES.
        """
        goes_on = self._pauses.resume(intervals * self._per_sync)
        self._forget_times_of_samples(keep_interval=goes_on)

    def _forget_times_of_samples(self, keep_interval: bool = False) -> None:
        (self.times.forget if keep_interval else self.times.reset)()
        self._left_out = self._unused = 0.0

    def slips(self, intervals: float) -> bool:
        """True if the machine moves SLIP_CYCLES or more within these ``intervals`` of SYNC."""
        return self._pauses.moves(intervals * self._per_sync, SLIP_CYCLES)

    def displaces(self, intervals: float) -> bool:
        """True if a sample is not good when it is taken ``intervals`` of SYNC early or late."""
        declared = self.stages.estimator.declared
        most = SLIP_CYCLES if declared.acceleration is None else declared.phase_error
        return self._pauses.moves(intervals * self._per_sync, most)

    def uncertain(self, intervals: float) -> Feedback | None:
        """Lose the position, except at standstill: ``intervals`` of SYNC or less may have passed uncounted.

        None if it is kept: the next phase is then less than half a cycle from the last.
        """
        return self.lose() if self.slips(intervals) or self.stages.estimator.contradicted else None

    def lose(self) -> Feedback:
        """Lose the position: cycles may have passed uncounted."""
        return self.stages.lose()

    # Samples.

    def step(
        self,
        sample: Sample,
        received_s: float | None = None,
        synced_s: float | None = None,
        counts: bool = True,
    ) -> Feedback:
        """Take one sample through the whole chain. A bad sample is flagged, it never raises.

        For a sample with the time of an earlier one, the last Feedback object is returned and nothing
        changes. ``received_s`` and ``synced_s`` are the receive times of the sample and of the SYNC that it
        answers, seconds, None if not known, and check its own time
        (:class:`canfb.signal.sample_times.SampleTimes`). If that fits nothing, the sample is bad in motion.
        ``counts`` False: another sample has answered this SYNC. If ``elapsed`` is not finite and above 0,
        the sample is bad, and the position of a moving machine is lost.

        With several samples in an interval (``samples_per_sync`` of :class:`ChainLimits`) all of them are
        taken in order; the result is that of the newest, :attr:`between` has the others.
        """
        time_100ns, elapsed = sample.time_100ns, float(sample.elapsed)
        if not 0.0 < elapsed < inf:
            return self.uncertain(inf) or self.after(sample, 1.0, placed=False)
        if time_100ns is None:
            return self.after(sample, elapsed)
        times, stages = self.times, self.stages
        speed, unit_s = abs(stages.estimator.tracker.step_cycles) * self._per_sync, times.unit_s
        counted = elapsed + times.waited + self._left_out
        passed = times.elapsed(int(time_100ns), counted, received_s, synced_s, speed)
        self._unit_may_have_changed(unit_s)
        self.crowded = passed == CROWDED
        if passed <= 0.0:
            # While the machine creeps, the position would be right, but its speed by the count far off.
            may_rest = passed == SUSPECT or (passed == REPEATED and times.passed > 0.0)
            rests = (
                may_rest
                and self.begun
                and stages.is_near(sample.sine, sample.cosine)
                and not (self.lost or self.slips(times.off) or self._pauses.creeps)
            )
            self._left_out += elapsed * (self.crowded and counts)
            if passed != SUSPECT and not rests:  # at rest even a late sample is used
                return self._restarted(sample) if passed == RESTARTED or stages.last is None else stages.last
            times.waited += elapsed
            self._unused += elapsed * (not rests)
            return self.after(sample, elapsed, placed=rests)
        if passed <= times.waited:  # less than the intervals already counted as missed
            return self._restarted(sample, least=inf)
        next_one = elapsed + times.waited < HOLE_INTERVALS
        # The earlier samples of a SYNC are spread over its interval: times and count must agree on that.
        off = abs(passed - counted)
        placed = self._per_sync == 1 or off < HOLE_INTERVALS - 1.0 or not self.slips(off)
        if self.measures_intervals or not placed:
            elapsed = passed - times.waited  # less the intervals already counted as missed
        times.waited = self._left_out = self._unused = 0.0
        return self.after(sample, elapsed, placed=placed, next_one=next_one)

    def withheld(self, feedback: Feedback) -> Feedback:
        """``feedback``, which is valid, as not confirmed yet: not valid, and nothing is learned from it."""
        self.adaptation.drop()
        return feedback._replace(status=feedback.status & ~VALID | COASTING)

    def _restarted(self, sample: Sample, least: float = 1.0) -> Feedback:
        """Continue after a restart of the interface's clock, or after an unknown number of missed SYNCs.

        The position is lost if several motions are left, or samples of a doubt were not used. A machine that
        creeps may have moved for as long as the times show.
        """
        intervals = max(least, self.times.passed) if self._pauses.creeps else 1.0
        lost = (
            self.lose()
            if self.stages.estimator.undecided or (self.stages.estimator.in_doubt and self._unused)
            else self.uncertain(intervals)
        )
        self.times.waited = self._left_out = self._unused = 0.0
        if self.lost:  # the search for the speed by uneven times begins here
            self.stages.estimator.lose(LossCause.TIME, starts=False)
        return self.after(sample._replace(time_100ns=None), sample.elapsed) if lost is None else lost

    def after(
        self,
        sample: Sample,
        elapsed: float,
        *,
        placed: bool = True,
        next_one: bool = False,
    ) -> Feedback:
        """:meth:`step` for a sample ``elapsed`` intervals of SYNC after the last; its own time is not used.

        ``placed`` False: ``elapsed`` is not known, so the sample is bad. ``next_one``: no sample was missed,
        by the count of SYNCs.
        """
        sine, cosine, _, invalid, coarse, _, pulse, time_100ns, _ = sample
        bad, timed = invalid or not placed, time_100ns is not None
        if self._per_sync > 1:
            return self._take_all(sample, elapsed, bad, not placed, next_one)
        in_turn = elapsed == 1.0 or (timed and elapsed <= HOLE_INTERVALS)
        usual = in_turn and not bad and coarse is pulse is None
        extras = None if usual else Extras(sample, not placed, next_one)
        # Scalars of numpy would lower the precision of all that follows, or overflow.
        return self.stages.take(float(sine), float(cosine), elapsed, timed, extras)

    def _take_all(
        self, sample: Sample, elapsed: float, bad: bool, unplaced: bool, next_one: bool
    ) -> Feedback:
        stages, timed = self.stages, sample.time_100ns is not None
        if stages.place is None:  # the pulse is at a fraction of an interval whose begin was not used
            sample = sample._replace(zero_pulse=None)
        samples = [sample] if bad else in_order(sample, elapsed * self._per_sync, self._per_sync)
        next_one = next_one and len(samples) == self._per_sync
        between: list[Feedback] = []
        pulse = None
        for one in samples[:-1]:
            follows = stages.place is not None
            extras = Extras(one._replace(zero_pulse=None), next_one=next_one, newest=False)
            feedback = stages.take(float(one.sine), float(one.cosine), one.elapsed, timed, extras)
            after = stages.place
            self.reference.passed(after is not None)
            if after is None or (between and (between[-1].status ^ feedback.status) & (VALID | LOST)):
                pulse = None
            elif one.zero_pulse is not None and follows:
                pulse = self.reference.pulse(after, one.zero_pulse, stages.clock, one.elapsed)
            between.append(feedback)
        newest = samples[-1]
        whole = elapsed * self._per_sync if bad else newest.elapsed
        extras = Extras(newest, unplaced, next_one, pulse)
        feedback = stages.take(float(newest.sine), float(newest.cosine), whole, timed, extras)
        if any(one.status & MISSED for one in between):
            feedback = stages.last = feedback._replace(status=feedback.status | MISSED)
        self.between = tuple(one._replace(status=one.status & ~MISSED) for one in between)
        return feedback

    def miss(self) -> Feedback:
        """Pass one interval of SYNC without a sample: the position coasts, flagged."""
        self.times.waited += 1.0
        self.between = ()
        return self.stages.miss(float(self._per_sync))
