"""The usual sample of a chain in one piece: nearly each sample takes this way, and it costs half as much.

A usual sample comes one interval after the one before, or within 5 % of it as its own time says
(:meth:`UsualStep.usual_timed`), brings two counts and no more, keeps all limits, and nothing is in doubt
before it or after it. For any other one the chain has its parts, which are called one by one; after each of
them :meth:`UsualStep._look_again` says whether the next one may be usual. tests/signal/test_usual_step.py
compares both, bit for bit.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from math import sqrt

from canfb.signal.adaptation import NEVER, Adaptation, AdaptConfig, FollowedDrift
from canfb.signal.conditioning import IDENTITY, Coefficients, Conditioning
from canfb.signal.correction import CorrectionTable, Lines
from canfb.signal.estimator import Estimator
from canfb.signal.feedback import Feedback
from canfb.signal.front_end import AHEAD_INTERVALS, SAME_INTERVAL, FrontEnd
from canfb.signal.frozen import FrozenInput
from canfb.signal.harmonics import NO_LOW_PASS, Corners, Row, corrected
from canfb.signal.recovery.auxiliary_encoder import ComparedChain
from canfb.signal.sample import Sample
from canfb.signal.sample_times import SampleTimes
from canfb.signal.supervision import VALID, Supervision
from canfb.signal.tracker import Track, Tracker

_new = tuple.__new__  # makes a named tuple in half the time that its own constructor takes


class UsualStep(ComparedChain):
    """What a usual sample reads and writes; the chain says when one may come (``_nothing_in_doubt``)."""

    _estimator: Estimator
    _supervision: Supervision
    _frozen: FrozenInput
    _base_status: int  # TABLE_ACTIVE or 0
    _referenced: int  # REFERENCED or 0
    _tracker: Tracker
    _places: deque[tuple[int, float, float]]  # of the estimator
    _coefficients: Coefficients  # of the next sample
    _bounds: tuple[float, float, float, float]
    _entries: int  # of the table; 0 for the identity
    _lines: Lines
    _times: SampleTimes
    _waited: float  # intervals without a sample since the last one with a sample time
    _per_sync: int
    measures_intervals: bool

    def __init__(self) -> None:
        self.on_unit: Callable[[], None] = lambda: None
        """Called when :attr:`unit_s` has changed, before a sample is held against limits of the old one."""
        self._nothing_in_doubt = False
        self._status = VALID  # of a usual sample
        self._stands = False  # the counts repeat, and the machine stands still
        self._samples = 0
        self._clock = 0.0  # sampling intervals since the start
        self._speed = 0.0
        self._sine = self._cosine = math.nan  # counts of the last sample
        self._last: Feedback | None = None
        self._before: Track | Feedback | None = None  # the last sample, if it was taken
        self._front: FrontEnd | None = None  # that depends on the speed
        self._conditioning = IDENTITY
        self._corners = NO_LOW_PASS
        self._row: Row = ()  # of the harmonics at the speed of the next sample
        self._sampling_s = 0.0
        self.lag_intervals = 0.0
        """2002:07 in sampling intervals: the position is that of so much earlier."""
        self.adaptation = Adaptation()
        """What follows the drift of the tracks; :meth:`adapt` turns it on."""
        self._learning_from = NEVER  # the number of the sample

    @property
    def samples(self) -> int:
        """The number of the last sample, 0 before the first one."""
        return self._samples

    @property
    def begun(self) -> bool:
        """There was a sample since the start."""
        return self._tracker.started

    def repeats(self, sine: float, cosine: float) -> bool:
        """``sine`` and ``cosine`` are the counts of the last sample, before conditioning."""
        return sine == self._sine and cosine == self._cosine

    def _use_table(self, table: CorrectionTable | None) -> None:
        """Correct by this table from the next sample on."""
        self._nothing_in_doubt = False
        self._table = table
        self._entries, self._lines = (0, ()) if table is None else (len(table), table.lines())

    @property
    def interval_s(self) -> float:
        """Nominal interval of SYNC, seconds, used to check sample times. 0.0: not known."""
        return self._times.interval_s

    @interval_s.setter
    def interval_s(self, interval_s: float) -> None:
        """Positions and speeds stay as they are; intervals in progress are counted in the new unit."""
        old, self._times.interval_s = self._times.unit_s, interval_s
        if self._times.unit_s != old:
            self._unit_changed(old)
        self._follow_unit()

    def _unit_changed(self, old_s: float) -> None:
        """Intervals are counted in another unit, or for the first time in one that is known."""
        unit_s = self._times.unit_s
        if old_s > 0.0 and unit_s > 0.0:
            factor = old_s / unit_s
            self._waited *= factor
            self._estimator.rescale(factor)
        self.on_unit()

    @property
    def unit_s(self) -> float:
        """The interval in which speeds of timed samples are given, seconds; 0.0 before it is known."""
        return self._times.unit_s / self._per_sync

    def forget_times(self) -> None:
        """Another interface may send the sample times from now on, by another clock and at another rate."""
        self._times.reset()
        self.interval_s = 0.0

    @property
    def conditions_by_past(self) -> bool:
        """Counts alone do not give the phase."""
        return self._front is not None or self.adaptation.is_on

    def turned_rad(self, speed_cycles: float) -> float:
        """By how much the tracks turn at this speed from the sine of a sample to its cosine."""
        return 0.0 if self._front is None else self._front.turned_rad(speed_cycles)

    def hertz(self, speed_cycles: float) -> float:
        """This speed in cycles per second, 0.0 while nothing depends on it."""
        return 0.0 if self._front is None else self._front.hertz(speed_cycles)

    @property
    def needs_interval(self) -> bool:
        """The analog path depends on the speed in cycles per second, or the drift is followed by the hour:
        :meth:`use_interval` is required.
        """
        return self._front is not None or self._conditioning.delay_s != 0.0 or self.adaptation.is_on

    def use_interval(self, sampling_s: float) -> None:
        """The sampling interval where samples bring no time, seconds; 0.0: not known."""
        if abs(sampling_s - self._sampling_s) > SAME_INTERVAL * self._sampling_s:
            self._sampling_s = sampling_s
            self._follow_unit()

    def _use_front_end(self, conditioning: Conditioning, corners: Corners) -> None:
        """Condition so from the next sample on."""
        self._conditioning, self._corners = conditioning, corners
        delayed = conditioning.cosine_delay_s != 0.0
        self._front = FrontEnd(conditioning, corners) if delayed or corners.are_there else None
        self._coefficients, self._row = conditioning.coefficients(), ()
        self._estimator.phases_keep = not delayed
        self._remove_drift()
        self._follow_unit()

    def adapt(self, limits: AdaptConfig | None, start_from: FollowedDrift | None = None) -> None:
        """Follow the drift of the tracks within these limits from the next sample on; None: as calibrated.

        It goes on from the drift that was found, or from another one.
        """
        self.adaptation.limits = limits
        if start_from is not None:
            self.adaptation.start_from(start_from)
        self._learning_from = self.adaptation.due
        self._use_front_end(self._conditioning, self._corners)

    def _learn(self, feedback: Feedback) -> None:
        """A sample for the adaptation, whose result counts from the next one on."""
        adaptation = self.adaptation
        moved = adaptation.take(feedback, self.unit_s or self._sampling_s)
        self._learning_from = adaptation.due
        if moved:
            self._remove_drift()
            self._turn(feedback.speed_cycles + AHEAD_INTERVALS * feedback.acceleration_cycles)

    def _remove_drift(self) -> None:
        """Behind the conditioning; the analog path is that of the conditioning."""
        if self.adaptation.is_on:
            used = self.adaptation.drift.removed_by(self._conditioning)
            self._coefficients = used.coefficients()
            if self._front is not None:
                self._front.use_conditioning(used)

    def _follow_unit(self) -> None:
        """The interval of the speeds may be another one."""
        unit_s = self.unit_s or self._sampling_s
        self.lag_intervals = self._conditioning.delay_s / unit_s if unit_s > 0.0 else 0.0
        if self._front is not None:
            self._front.use_interval(unit_s)
            self._turn(self._tracker.step_cycles if self._tracker.started else self._speed)

    def _turn(self, speed_cycles: float) -> None:
        """The next sample is expected at this speed. While the position is lost it may be any other."""
        if self._front is None:
            return
        known = not self._estimator.lost and (self._tracker.started or speed_cycles != 0.0)
        self._supervision.amplitude_known(known or not self._corners.are_there)
        self._coefficients = self._front.coefficients(speed_cycles, known)
        if self._front.varies:
            self._vary(self._front, speed_cycles)

    def _vary(self, front: FrontEnd, speed_cycles: float) -> None:
        """What depends on the speed beside the coefficients."""
        self._row = front.row(speed_cycles)
        self.lag_intervals = front.lag_intervals(speed_cycles)

    def _forget_sample(self) -> None:
        """The next sample is the first of its kind."""
        self._nothing_in_doubt = False
        self._last = self._before = None
        self._sine = self._cosine = math.nan
        self._speed = 0.0
        self._turn(0.0)

    def _look_again(self, feedback: Feedback) -> None:
        """After ``feedback``: may the next sample be a usual one?"""
        estimator = self._estimator
        in_doubt = estimator.in_doubt or self._reference.in_doubt or self._second is not None
        self._stands = self._frozen.stands
        faulty = self._supervision.after_fault or (self._frozen.repeats and not self._stands)
        if feedback.status & VALID and not (in_doubt or faulty or estimator.searches):
            self._nothing_in_doubt = True
            self._places, self._bounds = self._estimator.places, self._supervision.bounds
            self._status = VALID | self._base_status | self._referenced

    def after(
        self, sample: Sample, elapsed: float, options: tuple[float, ...] = (), *, next_one: bool = False
    ) -> Feedback:
        """:meth:`SignalChain.after`."""
        raise NotImplementedError

    def usual_timed(
        self, sine: float, cosine: float, time_100ns: int, received_s: float | None, synced_s: float | None
    ) -> Feedback | None:
        """:meth:`SignalChain.step` for these counts and no more, if their time is a usual one; else None."""
        if self._waited or self._per_sync != 1 or not self.measures_intervals:
            return None
        elapsed = self._times.in_turn(time_100ns, received_s, synced_s)
        if not elapsed:
            return None
        feedback = self.usual(sine, cosine, elapsed)
        if feedback is not None:
            return feedback
        sample = Sample(sine, cosine, time_100ns=time_100ns)
        return self.after(sample, elapsed, next_one=True)  # which asks :meth:`usual` again, and is refused

    def _count_repeats(self, repeated: bool) -> None:
        """The counts of a machine that stood still are the same again, or others."""
        if repeated:
            self._frozen.repeated(0.0)  # the speed counts at the first repeat only
        else:
            self._frozen.moved()
            self._stands = False

    def usual(self, sine: float, cosine: float, elapsed: float = 1.0) -> Feedback | None:
        """:meth:`SignalChain.step` for these counts if the sample is a usual one; else None, nothing changed.

        ``elapsed`` in intervals. The arithmetic is that of :func:`raw_phase` (Table 1) and
        :meth:`CorrectionTable.correct`.
        """
        repeated = sine == self._sine and cosine == self._cosine
        if not self._nothing_in_doubt or (repeated and not self._stands):
            return None
        offset_s, gain_s, offset_c, factor_c, skew = self._coefficients
        lowest, highest, smallest, largest = self._bounds
        s = (sine - offset_s) * gain_s
        c = (cosine - offset_c) * factor_c - s * skew
        amplitude = sqrt(s * s + c * c)
        if not (  # a chained comparison takes longer
            lowest < sine
            and sine < highest
            and lowest < cosine
            and cosine < highest
            and smallest <= amplitude
            and amplitude <= largest
        ):
            return None
        if c > 0.0 and -c <= s <= c:
            raw = 0.125 * (s / c)
            if raw < 0.0:
                raw += 1.0
            raw = raw + 0.0 if raw != 1.0 else 0.0
        elif c < 0.0 and c <= s <= -c:
            raw = 0.5 + 0.125 * (s / c)
        elif s > 0.0:
            raw = 0.25 - 0.125 * (c / s)
        elif s < 0.0:
            raw = 0.75 - 0.125 * (c / s)
        else:
            return None
        phase = raw
        if self._entries:
            place = raw * self._entries
            index = int(place)
            first, slope = self._lines[index]
            phase = first + (place - index) * slope
            if phase < 0.0:
                phase += 1.0
            if phase >= 1.0:
                phase -= 1.0
        if self._row:
            phase = corrected(self._row, phase)
        tracker = self._tracker
        residual = tracker.advance(phase) if elapsed == 1.0 else self._estimator.advance_over(phase, elapsed)
        if residual < 0.0:
            return None
        if self._stands:
            self._count_repeats(repeated)
        cycles, speed = tracker.cycles, tracker.step_cycles
        self._places.append((cycles, phase, elapsed))
        self._sine, self._cosine = sine, cosine
        self._clock += elapsed
        self._samples = samples = self._samples + 1
        acceleration, self._speed = speed - self._speed, speed
        self._last = self._before = last = _new(
            Feedback,
            (
                s,
                c,
                amplitude,
                raw,
                cycles,
                phase,
                residual,
                self._status,
                speed,
                acceleration,
                0,
                samples,
            ),
        )
        front = self._front
        if front is not None:
            ahead = speed + AHEAD_INTERVALS * acceleration
            self._coefficients = front.coefficients(ahead)
            if front.varies:
                self._vary(front, ahead)
        if samples >= self._learning_from:
            self._learn(last)
        return last
