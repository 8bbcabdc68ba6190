"""The stages of one sample: conditioning, Table 1, correction, eq. 9, supervision, comparisons.

A usual sample is in turn and within all limits, with nothing in doubt; :meth:`Stages._resolve` takes any
other.
"""

from __future__ import annotations

from math import hypot, inf, nan, sqrt, tau
from typing import NamedTuple

from canfb.objects import LossCause
from canfb.signal import speeds
from canfb.signal.adaptation import AdaptConfig, FollowedDrift
from canfb.signal.blocks import Scratch
from canfb.signal.bounded_motion import HOLE_INTERVALS, LONG_INTERVAL
from canfb.signal.chain_config import ChainConfig, ChainLimits
from canfb.signal.conditioner import Conditioner
from canfb.signal.correction import Correction, CorrectionTable
from canfb.signal.estimator import Estimator
from canfb.signal.front_end import AHEAD_INTERVALS
from canfb.signal.phase import AnyArray, raw_phase
from canfb.signal.sample import Feedback, Sample
from canfb.signal.second_position import SecondSensor
from canfb.signal.supervision import (
    FROZEN,
    LOST,
    MISSED,
    REFERENCED,
    RESIDUAL,
    TABLE_ACTIVE,
    VALID,
    FrozenInput,
    Supervision,
    repeats,
)
from canfb.signal.tracker import NOT_USUAL, Track, TrackResult, count_run
from canfb.signal.witness.reference import Reference
from canfb.signal.witness.second import SecondPosition
from canfb.signal.witness.witness import CoarseTrack
from canfb.signal.witness.zero_pulse import Pulse, ZeroPulse

CONFIRMING_SAMPLES = 4  # after a pause in which the machine may have begun to move
_new = tuple.__new__  # makes a named tuple in half the time that its own constructor takes


class Extras(NamedTuple):
    """Data of a sample beside two counts in turn.

    sample    the sample, with coarse track and zero pulse
    unplaced  its instant is not known, so it is not used
    next_one  no sample was missed before it, by the count of SYNCs
    pulse     a zero pulse before an earlier sample of the same SYNC interval
    newest    it is the newest sample of its SYNC interval
    """

    sample: Sample
    unplaced: bool = False
    next_one: bool = False
    pulse: Pulse | None = None
    newest: bool = True


class Stages:
    """One encoder, sample by sample, at known intervals. A bad sample is flagged and never moves the cycle
    count.

    estimator   of the cycle count
    tracks      from counts to a phase
    reference   coarse track and zero pulse; made again for another encoder
    second      comparison with another sensor, None without one
    samples     number of the last sample, 0 before the first one
    last        its feedback, None after a start
    place       its position, None if it was not used; ``was_valid``: not 0 if it was valid
    clock       sampling intervals since the start
    base_status  bits of every sample
    """

    last: Feedback | None
    place: Track | Feedback | None
    _due: tuple[float, float, int] | None

    def __init__(self, config: ChainConfig, table: CorrectionTable | None) -> None:
        limits = config.chain_limits
        self.estimator = Estimator(limits)
        self._tracker = self.estimator.tracker
        self._supervision = Supervision(limits.sample)
        self._frozen = FrozenInput(limits.frozen_samples, limits.residual_limit)
        self.tracks = Conditioner(config.interval_s)
        self.second: SecondPosition | None = None
        self.samples = 0
        self.clock = 0.0
        self._forget_sample()
        self._make_reference(limits)
        self.set_limits(limits)
        self.activate(Correction(table, config.conditioning))
        self.adapt(config.adaptation)

    # What may change between two samples.

    def set_limits(self, limits: ChainLimits) -> None:
        self.estimator.declare(limits)
        self._supervision.set_limits(limits.sample)
        self._frozen.residual_limit_cycles = limits.residual_limit
        self._frozen.frozen_samples = limits.frozen_samples
        if limits.cycles_per_revolution != self.reference.zero.cycles_per_revolution:
            self._make_reference(limits, self.reference.had_position)
        self.reference.coarse.limit(limits.sample.full_scale_counts, limits.coarse_limit_revolutions)
        self.tracks.use_corners(limits.corners)
        self._tracks_changed()

    def _make_reference(self, limits: ChainLimits, had_position: bool = False) -> None:
        n = limits.cycles_per_revolution
        coarse = CoarseTrack(n, limits.sample.full_scale_counts, limits.coarse_limit_revolutions)
        self.reference = Reference(self.estimator, coarse, ZeroPulse(n))
        self.reference.had_position = had_position
        if self.second is not None:  # what was found of the other sensor does not hold any more
            self.use_second(self.second.sensor)

    def use_second(self, sensor: SecondSensor | None) -> None:
        self._usual_status = 0
        self.second = None if sensor is None else SecondPosition(sensor, self.reference)

    def activate(self, correction: Correction) -> None:
        self.tracks.activate(correction)
        self._activated = self.samples  # the phases up to this sample had another correction
        self.base_status = 0 if correction.table is None else TABLE_ACTIVE
        self._tracks_changed()

    def adapt(self, limits: AdaptConfig | None, start_from: FollowedDrift | None = None) -> None:
        self.tracks.adapt(limits, start_from)
        self._tracks_changed()

    def _tracks_changed(self) -> None:
        self._usual_status = 0
        self.estimator.phases_keep = self.tracks.phases_keep
        self._expect(self._tracker.step_cycles if self._tracker.started else self._speed)

    def use_unit(self, unit_s: float) -> None:
        """Set the sampling interval, seconds; 0.0: not known. Speeds per interval are kept."""
        self.tracks.use_unit(unit_s)
        self._tracks_changed()

    def rescale(self, factor: float) -> None:
        """Count intervals in a unit that is shorter by ``factor``."""
        estimator = self.estimator
        if factor >= LONG_INTERVAL and self.rests():
            estimator.resume()  # standstill says more than places that are now long intervals apart
        else:
            estimator.rescale(factor)
        self._speed /= factor

    def rests(self) -> bool:
        return bool(self.was_valid) and speeds.stood_still(self.estimator.places, 2)

    def sample_faster(self, factor: float) -> None:
        self.rescale(factor)
        self.reference.slipped()
        self.place = None

    # Starts and pauses.

    def restart(self, cycles: int = 0, speed_cycles: float = 0.0) -> None:
        self.estimator.restart(cycles, speed_cycles)
        self.reference.restart()
        if self.second is not None:
            self.second.restart()
        self._forget_sample(speed_cycles)

    def resume(self, displacement_cycles: float, spread_cycles: float = 0.0, starts: bool = True) -> None:
        """Continue after a pause in which the machine stopped or moved ``displacement_cycles``; inf: lost."""
        self.reference.restart(keep=True)
        if self.second is not None:
            self.second.restart(keep=True)
        self.estimator.resume()
        self._forget_sample()
        if displacement_cycles == inf:
            self.lose_after_pause(starts)
        elif self._tracker.started:
            # After a change of the correction, the next phase cannot be compared with the last one.
            last = self._tracker.places[1].phase if self._activated < self.samples else nan
            due = last + displacement_cycles / 2.0
            most = abs(displacement_cycles) / 2.0 + spread_cycles
            # A machine that stood and moves at once may have begun in the pause, and be whole cycles away.
            self._due = due, most + speeds.MOVED_CYCLES, 1 if most else CONFIRMING_SAMPLES

    def lose_after_pause(self, starts: bool) -> None:
        self.estimator.lose(LossCause.PAUSE, starts)
        if self.second is not None:
            self.second.restart()

    def _forget_sample(self, speed_cycles: float = 0.0) -> None:
        self._usual_status = 0  # status of the next sample if it is usual; 0: it cannot be
        self.last = self.place = None
        self._sine = self._cosine = nan  # counts of the last sample
        self._speed, self.was_valid = float(speed_cycles), 0  # of the last sample
        # The phase expected after a pause (NaN: any), its tolerance, and the number of samples to be checked.
        self._due = None
        self._expect(self._speed)

    # Samples.

    def take(
        self,
        sine: float,
        cosine: float,
        elapsed: float = 1.0,
        timed: bool = False,
        extras: Extras | None = None,
    ) -> Feedback:
        """Take one sample, ``elapsed`` intervals after the one before. A bad one is flagged, it never raises.

        ``timed``: its own time gives ``elapsed``, and the next interval may be uneven. Without ``extras`` it
        comes in turn: after one interval, or if ``timed`` after HOLE_INTERVALS at most.
        """
        tracks = self.tracks
        offset_s, gain_s, offset_c, factor_c, skew = tracks.coefficients
        lowest, highest, smallest, largest = self._supervision.bounds
        s = (sine - offset_s) * gain_s
        c = (cosine - offset_c) * factor_c - s * skew
        amplitude = sqrt(s * s + c * c)
        raw = raw_phase(s, c)
        phase = nan
        if (
            lowest < sine < highest
            and lowest < cosine < highest
            and smallest <= amplitude <= largest
            and raw == raw
        ):
            phase = tracks.correct(raw)
        repeated = sine == self._sine and cosine == self._cosine
        residual = NOT_USUAL
        tracker, estimator = self._tracker, self.estimator
        if (
            self._usual_status
            and extras is None
            and phase == phase
            and not (repeated and not self._frozen.repeats)  # a first repeat: does the machine stand?
        ):
            steady = tracker.elapsed == elapsed == 1.0
            limit = tracker.residual_limit if steady else estimator.limit_over(elapsed)
            residual = tracker.advance(phase, elapsed, limit)
        if residual < 0.0:
            return self._resolve(sine, cosine, (s, c, amplitude, raw, phase), elapsed, timed, extras)
        if self._frozen.repeats:
            self._frozen.take(repeated)
        cycles, speed = tracker.cycles, tracker.step_cycles
        estimator.places.append((cycles, phase, elapsed))
        self._sine, self._cosine = sine, cosine
        self.clock += elapsed
        self.samples = samples = self.samples + 1
        acceleration, self._speed = speed - self._speed, speed
        status = self._usual_status
        self.last = self.place = last = _new(
            Feedback,
            (s, c, amplitude, raw, cycles, phase, residual, status, speed, acceleration, 0, samples),
        )
        if tracks.front is not None:
            tracks.expect(speed + AHEAD_INTERVALS * acceleration)
        if samples >= tracks.adaptation.due:
            self._learn(last)
        return last

    def _resolve(
        self,
        sine: float,
        cosine: float,
        stages: tuple[float, float, float, float, float],
        elapsed: float,
        timed: bool,
        extras: Extras | None,
    ) -> Feedback:
        s, c, amplitude, raw, phase = stages
        sample, unplaced, next_one, pulse, newest = extras or Extras(Sample(sine, cosine))
        faults = self._supervision.faults(sine, cosine, amplitude)
        estimator, reference, frozen = self.estimator, self.reference, self._frozen
        repeated = self.repeats(sine, cosine)
        if repeated and not frozen.repeats:  # any of the last samples may have been bad
            frozen.speed_cycles = speeds.least_speed(estimator.places, estimator.declared.bad_samples + 1)
        if frozen.take(repeated):
            faults |= FROZEN
        self._sine, self._cosine = sine, cosine
        estimator.timed = timed
        measured = not (faults or sample.invalid or unplaced) and phase == phase
        if measured and self._due is not None:
            due, most, samples = self._due
            away = abs(speeds.apart(phase, due)) > most  # the machine has neither stopped nor gone on
            due = phase if samples == CONFIRMING_SAMPLES else due  # at standstill the first phase stays
            self._due = None if away or samples == 1 else (due, most, samples - 1)
            if away:
                self.lose_after_pause(starts=False)
        track, bits = estimator.good(phase, elapsed) if measured else estimator.bad(elapsed, missed=unplaced)
        if bits & LOST and (not measured or bits & RESIDUAL):
            reference.slipped()
        reference.counted(elapsed)
        jump = 0
        self.clock += elapsed
        zero_pulse = sample.zero_pulse
        no_coarse = sample.coarse_sine is None
        if not no_coarse or zero_pulse is not None or pulse is not None or reference.in_doubt:
            follows = measured and self.place is not None
            if pulse is None and zero_pulse is not None and follows:
                pulse = reference.pulse(track, zero_pulse, self.clock, elapsed)
            bits, jump = reference.apply(
                sample,
                track,
                bits,
                # Before the other sensor confirms the speed of a start, the place of a pulse is not known.
                pulse if self.second is None or self.second.witness.proven or estimator.lost else None,
                self.clock,
                follows,
            )
        if self.second is not None:
            bits, jump = self.second.apply(track, bits, jump, self.clock, measured, no_coarse, newest)
        self.place = track if measured and jump == 0 else None
        if elapsed > HOLE_INTERVALS and not (next_one and bits & VALID):
            bits |= MISSED
        if bits & VALID and newest:  # no witness confirms the earlier samples of a SYNC interval
            reference.had_position = True
        feedback = self._feedback((s, c, amplitude, raw), track, bits | faults, jump)
        self._look_again(feedback)
        return feedback

    def miss(self, intervals: float) -> Feedback:
        track, bits = self.estimator.bad(intervals, missed=True)
        self.clock += intervals
        self.place = None
        self.reference.missed()
        if self.second is not None:
            bits = self.second.missed(bits)
        return self._feedback((nan, nan, 0.0, nan), track, bits | MISSED, 0)

    def lose(self) -> Feedback:
        self.estimator.lose(LossCause.TIME)
        return self._feedback((nan, nan, 0.0, nan), self._tracker.predict(0.0), LOST, 0)

    def _feedback(
        self, stages: tuple[float, float, float, float], track: Track, bits: int, jump: int
    ) -> Feedback:
        self._usual_status = 0
        self.samples = samples = self.samples + 1
        cycles, phase, residual, _ = track
        speed, places = self._tracker.step_cycles, self.estimator.places
        valid = bits & VALID
        # The speed of a sample that was not valid may be wrong by whole cycles.
        known = self.was_valid or not valid
        acceleration = speed - self._speed if known else speeds.acceleration(places)
        self._speed, self.was_valid = speed, valid
        if valid and len(places) > 2 and places[-1][2] > HOLE_INTERVALS:
            acceleration = speeds.acceleration(places)
            self._speed += acceleration * (places[-1][2] - 1.0) / 2.0  # the speed in its last interval
        self._expect(speed + AHEAD_INTERVALS * acceleration if valid else speed)
        status = bits | self.base_status
        if self.reference.zero.referenced and not bits & LOST:
            status |= REFERENCED
        self.last = _new(
            Feedback, (*stages, cycles, phase, residual, status, speed, acceleration, jump, samples)
        )
        if self.tracks.adaptation.is_on:
            self._learn(self.last)
        return self.last

    def _look_again(self, feedback: Feedback) -> None:
        # Whether the next sample can be a usual one.
        estimator, frozen = self.estimator, self._frozen
        in_doubt = (
            estimator.in_doubt or self.reference.in_doubt or self.second is not None or self._due is not None
        )
        faulty = self._supervision.after_fault or (frozen.repeats and not frozen.stands)
        if feedback.status & VALID and not (in_doubt or faulty or estimator.searches):
            self._usual_status = feedback.status & (VALID | TABLE_ACTIVE | REFERENCED)

    def is_near(self, sine: float, cosine: float, cycles: float = speeds.STILL_CYCLES) -> bool:
        """True if the phase is within ``cycles`` of the last one; by default, as at standstill."""
        return hypot(sine - self._sine, cosine - self._cosine) <= tau * cycles * hypot(sine, cosine)

    def repeats(self, sine: float, cosine: float) -> bool:
        return sine == self._sine and cosine == self._cosine

    def _learn(self, feedback: Feedback) -> None:
        if self.tracks.learn(feedback):
            self._expect(feedback.speed_cycles + AHEAD_INTERVALS * feedback.acceleration_cycles)

    def _expect(self, speed_cycles: float) -> None:
        tracks = self.tracks
        if tracks.front is not None:
            known = not self.estimator.lost and (self._tracker.started or speed_cycles != 0.0)
            self._supervision.amplitude_known(known or not tracks.corners.are_there)
            tracks.expect(speed_cycles, known)

    # Runs on arrays (:mod:`canfb.signal.stream`).

    @property
    def may_run(self) -> bool:
        """True if :meth:`follow_run` may begin: eq. 9 has two even samples, and nothing is in doubt."""
        doubts = (
            self.estimator.in_doubt
            or self.estimator.searches
            or self._supervision.after_fault
            or self.reference.in_doubt
            or (self._frozen.frozen_samples and self._frozen.repeats)
        )
        return self._tracker.is_steady and not doubts

    def follow_run(self, sine: AnyArray, cosine: AnyArray, run: TrackResult, scratch: Scratch) -> int:
        """:meth:`take` for a run of samples, one interval apart, that keep the limits of one sample.

        Only if :attr:`may_run`. ``run.phase`` holds the corrected phases; the rest of ``run`` is filled.
        Returns the number of samples taken: those before the first with a residual over the limit (unless
        the position is lost) or a frozen input. The state for witnesses, pauses and analog path is not
        updated: a stream has none of them.
        """
        count_run(self._tracker, run, scratch)
        followed = self.estimator.lost or run.ok.all()
        taken = len(sine) if followed else int(run.ok.argmin())
        if taken and self._frozen.frozen_samples:
            before = self._sine, self._cosine
            equal = repeats(sine[:taken], cosine[:taken], before, scratch.bit)
            taken = taken if equal is None else self._frozen.before_row(equal)
        if not taken:
            return 0
        self.estimator.go_on(run, taken)
        self._sine, self._cosine = float(sine[taken - 1]), float(cosine[taken - 1])
        return taken
