"""The whole chain for one encoder: when its samples were taken (:mod:`.sample_times`), what they give
(:mod:`.stages`).

Intervals are those of SYNC here, and those from sample to sample in the stages.
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

    TypeError for a ``config`` that is not a :class:`ChainConfig` and a ``table`` that is not a
    :class:`canfb.CorrectionTable` or a whole :class:`canfb.Calibration` (None: the identity).
    """

    def __init__(self, config: ChainConfig, table: AnyTable = None) -> None:
        config, table = with_correction(config, table)
        self.stages = Stages(config, table)
        self.tracks = self.stages.tracks  # What makes a phase of counts.
        # Called when :attr:`unit_s` has changed, before a sample is held against limits of the old one.
        self.on_unit: Callable[[], None] = lambda: None
        # Of the last interval: what the samples before the newest gave, oldest first.
        self.between: tuple[Feedback, ...] = ()
        # The last sample came, but so soon after the one before that nothing was made of it.
        self.crowded = False
        # Sample times say how long an interval was; False: they only tell new samples from doubled ones.
        self.measures_intervals = True
        self._pauses = Pauses(self.stages)
        self.times = SampleTimes(self.stages.rests)
        self.sample_grid = self.times.grid  # The clock of the encoder interface, by the sample times so far.
        self._per_sync = 1
        self._left_out = 0.0  # since then, of samples that were crowded
        self._unused = 0.0  # and of those with a wrong time that were not used, as the machine had moved
        self._untimed_unit_s = config.interval_s

    # What it is told between two samples.

    def set_limits(self, limits: ChainLimits) -> None:
        """Take new limits. Another encoder resets coarse track and zero pulse."""
        if limits.samples_per_sync != self._per_sync:
            self.stages.sample_faster(limits.samples_per_sync / self._per_sync)
            self._per_sync = limits.samples_per_sync
            self.between = ()
        self.stages.set_limits(limits)
        self._follow_unit()

    def activate(self, correction: Correction) -> None:
        """Take another ``correction``. TypeError for a bad table."""
        self.stages.activate(correction)

    def adapt(self, limits: AdaptConfig | None, start_from: FollowedDrift | None = None) -> None:
        """Follow the drift of the tracks within these limits from the next sample on; None: as calibrated.

        It goes on from the drift that was found, or from another one, ``start_from``.
        """
        self.stages.adapt(limits, start_from)

    def use_second(self, sensor: SecondSensor | None) -> None:
        """Take another sensor, or none; nothing is known of it. TypeError if it is not one."""
        if sensor is not None and not isinstance(sensor, SecondSensor):
            raise TypeError(f"sensor must be a SecondSensor or None, not {type(sensor).__name__}")
        self.stages.use_second(sensor)

    def hear_second(self, values: int, increments: int) -> None:
        """An interval of SYNC is over in which the other sensor sent this number of ``values``.

        With just one, its ``increments`` (INTEGER32) are those at the sample before this call. -1: it is not
        certain which ones came.
        """
        second = self.stages.second
        if second is not None:
            second.hear(int(values), int(increments))

    # What it has found.

    @property
    def correction(self) -> Correction:
        """The active correction."""
        return self.tracks.correction

    @property
    def adaptation(self) -> Adaptation:
        """What follows the drift of the tracks; :meth:`adapt` turns it on."""
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
        """There was a sample since the start, or the machine turned at the reset before it."""
        return self.stages.estimator.tracker.started or self._pauses.turned > 0.0

    @property
    def loss_cause(self) -> LossCause:
        """Why the position was lost the last time."""
        return self.stages.estimator.loss_cause

    @property
    def lost(self) -> bool:
        """True from the moment the position is lost until :meth:`restart`."""
        return self.stages.estimator.lost

    @property
    def searches(self) -> bool:
        """Uneven sample times may still tell at what speed the machine turns."""
        return self.stages.estimator.searches

    # Units.

    @property
    def sync_interval_s(self) -> float:
        """Nominal interval of SYNC, seconds, used to check sample times. 0.0: not known."""
        return self.times.sync_interval_s

    @sync_interval_s.setter
    def sync_interval_s(self, interval_s: float) -> None:
        """Positions and speeds stay as they are; intervals in progress are counted in the new unit."""
        old, self.times.sync_interval_s = self.times.unit_s, interval_s
        self._unit_may_have_changed(old)

    def use_interval(self, sampling_s: float) -> None:
        """The sampling interval where samples bring no time, seconds; 0.0: not known."""
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
        """Another interface may send the sample times from now on, by another clock and at another rate."""
        self.times.reset()
        self.sync_interval_s = 0.0

    # Starts and pauses.

    def restart(self, cycles: int = 0, speed_cycles: float = 0.0) -> None:
        """Forget the position: the next good sample starts with this cycle count and speed.

        ``cycles`` is the cycle count there, ``speed_cycles`` in cycles per sampling interval, default:
        standstill. It must be right to less than half a cycle; the position is lost where the next
        sample shows that it is not.
        ValueError for a speed that is not finite or above 2**31 in size.
        """
        self.stages.restart(cycles, speed_cycles)
        self._pauses.turned = 0.0
        self._forget_times_of_samples()

    def reset(self) -> None:
        """:meth:`restart` at cycle count 0, as the module is reset: the machine may be turning.

        The next :meth:`resume` holds that against it: it does not start on a machine that may still turn.
        """
        self._pauses.reset()
        self._forget_times_of_samples()

    def resume(self, intervals: float = 0.0) -> None:
        """Go on after a pause of ``intervals`` of SYNC in which the machine moved less than half a cycle.

        The position is lost if at its speed the machine could have left the cycle meanwhile, if it stood and
        its next phase is another one, or if it was in doubt and not valid. A lost one starts again, at cycle
        count 0, if the machine stood when it was lost and its phases did since; after :meth:`reset` unless
        the machine turned at it, or the position was lost and its phases had not stood for STILL_SAMPLES.
        """
        goes_on = self._pauses.resume(intervals * self._per_sync)
        self._forget_times_of_samples(keep_interval=goes_on)

    def _forget_times_of_samples(self, keep_interval: bool = False) -> None:
        (self.times.forget if keep_interval else self.times.reset)()
        self._left_out = self._unused = 0.0

    def slips(self, intervals: float) -> bool:
        """Within these intervals of SYNC the machine moves so far that its phase could mislead."""
        return self._pauses.moves(intervals * self._per_sync, SLIP_CYCLES)

    def displaces(self, intervals: float) -> bool:
        """A sample that was taken so many intervals of SYNC earlier or later is not a good one."""
        declared = self.stages.estimator.declared
        most = SLIP_CYCLES if declared.acceleration is None else declared.phase_error
        return self._pauses.moves(intervals * self._per_sync, most)

    def uncertain(self, intervals: float) -> Feedback | None:
        """Up to this many intervals of SYNC may have passed uncounted: lost, except at standstill.

        None where that makes no difference: each phase is then less than half a cycle from the last.
        """
        return self.lose() if self.slips(intervals) or self.stages.estimator.contradicted else None

    def lose(self) -> Feedback:
        """The position is lost from now on: no cycles were counted."""
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

        A sample with the time of one before comes too late: the same
        Feedback object is returned, and nothing changes. Times must agree
        with the receptions, of this sample at ``received_s`` and of the SYNC that it answers at
        ``synced_s``, seconds, None where that is not known. One whose time fits nothing is a bad sample in
        motion; see :class:`canfb.signal.sample_times.SampleTimes`. It ``counts`` but where another one
        answered this SYNC. If ``elapsed`` is not finite and above 0, it is bad; a moving machine is lost.

        With several samples in an interval (``samples_per_sync`` of :class:`ChainLimits`) all of them are
        taken, in their order; the result is that of the newest, :attr:`between` has the others.
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
            # One of a machine that creeps would be right, and its speed by the count wrong by far.
            may_rest = passed == SUSPECT or (passed == REPEATED and times.passed > 0.0)
            rests = (
                may_rest
                and self.begun
                and stages.is_near(sample.sine, sample.cosine)
                and not (self.lost or self.slips(times.off) or self._pauses.creeps)
            )
            self._left_out += elapsed * (self.crowded and counts)
            if passed != SUSPECT and not rests:  # at rest a late one is used
                return self._restarted(sample) if passed == RESTARTED or stages.last is None else stages.last
            times.waited += elapsed
            self._unused += elapsed * (not rests)
            return self.after(sample, elapsed, placed=rests)
        if passed <= times.waited:  # what was waited for did not pass
            return self._restarted(sample, least=inf)
        next_one = elapsed + times.waited < HOLE_INTERVALS
        # Of several samples the earlier ones lie in one interval of SYNC, that of the times or another.
        off = abs(passed - counted)
        placed = self._per_sync == 1 or off < HOLE_INTERVALS - 1.0 or not self.slips(off)
        if self.measures_intervals or not placed:
            elapsed = passed - times.waited  # what was waited for is counted already
        times.waited = self._left_out = self._unused = 0.0
        return self.after(sample, elapsed, placed=placed, next_one=next_one)

    def withheld(self, feedback: Feedback) -> Feedback:
        """The last sample, which was valid, as one that is not confirmed: nothing is learned from it."""
        self.adaptation.drop()
        return feedback._replace(status=feedback.status & ~VALID | COASTING)

    def _restarted(self, sample: Sample, least: float = 1.0) -> Feedback:
        """The clock of the interface was restarted, or none of the SYNCs since the last sample was heard.

        Its length is unknown: in doubt behind refused samples a machine moves; one that creeps may have, as
        the times say.
        """
        intervals = max(least, self.times.passed) if self._pauses.creeps else 1.0
        lost = (
            self.lose()
            if self.stages.estimator.undecided or (self.stages.estimator.in_doubt and self._unused)
            else self.uncertain(intervals)
        )
        self.times.waited = self._left_out = self._unused = 0.0
        if self.lost:  # what its times say of the speed begins here
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
        """:meth:`step` for a sample of known time; its own time is not looked at.

        ``elapsed`` intervals of SYNC after the one before; ``placed``: False if that is not known, which
        makes it a bad sample; ``next_one``: by the count of SYNCs none was missed.
        """
        sine, cosine, _, invalid, coarse, _, pulse, time_100ns, _ = sample
        bad, timed = invalid or not placed, time_100ns is not None
        if self._per_sync > 1:
            return self._take_all(sample, elapsed, bad, not placed, next_one)
        in_turn = elapsed == 1.0 or (timed and elapsed <= HOLE_INTERVALS)
        usual = in_turn and not bad and coarse is pulse is None
        extras = None if usual else Extras(sample, not placed, next_one)
        # Numbers of numpy would make all that follows as coarse as they are, or overflow.
        return self.stages.take(float(sine), float(cosine), elapsed, timed, extras)

    def _take_all(
        self, sample: Sample, elapsed: float, bad: bool, unplaced: bool, next_one: bool
    ) -> Feedback:
        stages, timed = self.stages, sample.time_100ns is not None
        if stages.place is None:  # the interval that the pulse is a part of may be longer
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
        """One interval of SYNC without a sample: the position coasts, flagged."""
        self.times.waited += 1.0
        self.between = ()
        return self.stages.miss(float(self._per_sync))
