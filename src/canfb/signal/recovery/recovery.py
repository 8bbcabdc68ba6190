"""Coasting over bad samples, and the moment when the position counts as lost.

The recursion of eq. 9 never forgets: after one wrong cycle count it runs on with a wrong
speed. So a sample that fails a check leaves the position in doubt (:mod:`canfb.signal.recovery.doubt`)
until several successive samples determine it. Eq. 9 runs on beside that, as in the paper: it is right
when not a sample was wrong but the acceleration was beyond the limit.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from canfb.signal.blocks import Scratch
from canfb.signal.phase import FloatArray
from canfb.signal.recovery.bridge import Place, accelerations
from canfb.signal.recovery.doubt import Doubt, Undecided
from canfb.signal.recovery.parabola import MotionLimits
from canfb.signal.supervision import COASTING, LOST, RESIDUAL, VALID
from canfb.signal.tracker import NOT_USUAL, RESIDUAL_LIMIT, Track, Tracker, TrackResult
from canfb.signal.tracking import steady_run

# A glitch below the residual limit is seen one sample later, a row of three at most three later.
DOUBTED_SAMPLES = 3
MISSED_INTERVALS = 1.5  # since the sample before: one was missed
LARGEST_CERTAIN_CYCLES = (
    0.95  # of deviation from the prediction, in one direction and in the other: 1 less noise
)
COAST_SAMPLES = 3  # default of 2010:03
REMEMBERED_SAMPLES = 16  # show how smoothly the machine runs


class Recovery:
    """Feeds a :class:`Tracker` with good samples and bridges the bad ones.

    ``coast_samples`` (2010:03): this many sampling intervals without a good sample are
    bridged; one more, and the position is lost. Lost stays until :meth:`restart` or
    :meth:`found`: eq. 9 then runs on with the samples, but its count is not guaranteed.
    """

    __slots__ = (
        "_doubt",
        "_first_after",
        "_instant_error",
        "_widest_limit",
        "acceleration_limit",
        "coast_samples",
        "lost",
        "on_lost",
        "places",
        "tracker",
    )

    order = 2
    """Of the prediction: 2 limits the acceleration, 3 the jerk."""

    def __init__(self, tracker: Tracker, coast_samples: int) -> None:
        self.tracker = tracker
        self.coast_samples = coast_samples
        self.acceleration_limit: float | None = None
        """Largest acceleration of the machine, cycles per interval squared; None: not known."""
        self._instant_error = 0.0  # of sample times, intervals
        self._widest_limit = tracker.residual_limit
        self.on_lost: Callable[[], None] = _nothing
        """Called when the position is lost."""
        self.places: deque[tuple[int, float, float]] = deque(maxlen=REMEMBERED_SAMPLES)
        """The last good samples: cycle count, phase, and the intervals since the one before."""
        self.restart()

    def set_motion(self, limits: MotionLimits) -> None:
        """Take what the machine can do, between two samples."""
        self.tracker.residual_limit = limits.residual_limit
        self.acceleration_limit = limits.acceleration
        self._instant_error, self._widest_limit = limits.instant_error, limits.widest_limit

    def restart(self, cycles: int = 0, speed_cycles: float = 0.0) -> None:
        """Start afresh with this cycle count and speed; the position is not lost any more.

        ``speed_cycles`` in cycles per interval, as in :meth:`Tracker.restart`.
        """
        self.tracker.restart(cycles, speed_cycles)
        self.lost = False
        self._doubt: Doubt | None = None
        self._first_after: Place | None = None  # the first sample after a gap, its speed not certain yet
        self.places.clear()

    def take_over(self, old: Recovery) -> None:
        """Go on where ``old`` is, which predicts by another order; what is in doubt stays behind."""
        self.on_lost, self.lost = old.on_lost, old.lost
        self.tracker.take_over(old.tracker)
        self.places.extend(old.places)

    def resume(self) -> None:
        """Go on at standstill from the last position, or from cycle count 0 if it was lost."""
        if self.lost or self._doubt or not self.places:
            self.restart()
        else:
            self.tracker.halt()
            cycles, phase, _ = self.places[-1]
            self.places.clear()
            self.places.append((cycles, phase, 1.0))

    def lose(self) -> None:
        """Call the position lost, from outside."""
        self.lost = True
        self._doubt = self._first_after = None
        self.places.clear()
        self.on_lost()

    def found(self, cycles: int, step_cycles: int) -> None:
        """Shift the cycle count by ``cycles`` and the speed by ``step_cycles`` per interval."""
        self.tracker.shift(cycles, step_cycles)
        if self._doubt is None and not step_cycles and not self.lost:
            places = [(count + cycles, phase, elapsed) for count, phase, elapsed in self.places]
            self.places.clear()
            self.places.extend(places)
        else:
            self._doubt = self._first_after = None
            self._remember_tracker()

    def vouch(self) -> None:
        """The position is not lost any more: what eq. 9 counts is right."""
        self.lost = False
        self._remember_tracker()

    def restart_count(self) -> None:
        """The count up to here was wrong, and from here on it is right: the motion goes on."""
        self.lose()
        self.vouch()

    @property
    def in_doubt(self) -> bool:
        """True while the next samples must decide where the position is; not when it is lost."""
        return self._doubt is not None

    def follow_run(self, tracked: TrackResult, run: slice, scratch: Scratch) -> int:
        """Follow a run of phases, ``tracked.phase[run]``, one interval apart, with eq. 9 on arrays.

        Only where the tracker is steady and nothing is in doubt. The two phases that eq. 9 stands
        on are in ``tracked`` before the run, and so is the cycle count of the last. Fills the rest
        of ``tracked[run]``. The result is the place of the first sample that :meth:`good` must take,
        or the end of the run. Call :meth:`take_run` with what is taken of it.
        """
        steady_run(self.tracker, tracked, run.start, run.stop, scratch)
        if self.lost or tracked.ok[run].all():
            return int(run.stop)
        return int(run.start + tracked.ok[run].argmin())

    def take_run(self, tracked: TrackResult, start: int, stop: int) -> None:
        """Go on after the samples start..stop, at least one, of a run that :meth:`follow_run` began."""
        cycles, phase = tracked.cycles, tracked.phase
        last = int(cycles[stop - 1])
        step = last - int(cycles[stop - 2])
        self.tracker.set_state(float(phase[stop - 2]), float(phase[stop - 1]), last, step)
        self._remember_run(tracked, start, stop)

    def _remember_run(self, tracked: TrackResult, start: int, stop: int) -> None:
        new = slice(max(start, stop - REMEMBERED_SAMPLES), stop)
        self.followed(tracked.cycles[new].tolist(), tracked.phase[new].tolist())

    def followed(self, cycles: Sequence[int], phases: Sequence[float]) -> None:
        """The tracker has followed a run of samples to these places, the last ones of the run."""
        if not self.lost:
            self.places.extend((count, phase, 1.0) for count, phase in zip(cycles, phases, strict=True))

    def _remember_tracker(self) -> None:
        """The two samples that eq. 9 stands on are the last places: the position goes on with its speed."""
        before, last, elapsed = self.tracker.places
        self.places.clear()
        self.places.append((before.cycles, before.phase, 1.0))
        self.places.append((last.cycles, last.phase, elapsed))

    def acceleration(self) -> float:
        """Between the last three places, cycles per interval squared; 0 with fewer."""
        places = [Place(*place) for place in self.places]
        if self._first_after is not None:
            places.append(self._first_after)
        return accelerations(places[-3:])[-1] if len(places) > 2 else 0.0

    def rescale(self, factor: float) -> None:
        """Sampling intervals are counted in another unit: all of them are this many times longer."""
        self.tracker.rescale(factor)
        places = [(cycles, phase, elapsed * factor) for cycles, phase, elapsed in self.places]
        self.places.clear()
        self.places.extend(places)

    def steady_speed(self) -> float:
        """Mean speed over the remembered places, cycles per interval; 0 with fewer than two."""
        if len(self.places) < 2:
            return 0.0
        places = list(self.places)
        (cycles, phase, _), (last_cycles, last_phase, _) = places[0], places[-1]
        return ((last_cycles - cycles) + (last_phase - phase)) / sum(place[2] for place in places[1:])

    def least_speed(self) -> float:
        """The smallest speed of the last samples, cycles per interval: any of them may have been bad."""
        places = list(self.places)[-DOUBTED_SAMPLES - 2 :]
        steps = [((new[0] - old[0]) + (new[1] - old[1])) / new[2] for old, new in itertools.pairwise(places)]
        return min(steps, key=abs, default=0.0)

    def least_speeds(self, cycles: npt.NDArray[np.int64], phase: FloatArray) -> FloatArray:
        """The size of :meth:`least_speed` before each of these samples, which follow the last one."""
        if self.lost or not self.places:
            return np.zeros(len(cycles))
        known = list(self.places)[-DOUBTED_SAMPLES - 2 :]
        steps: FloatArray = np.diff(np.concatenate([[place[0] for place in known], cycles[:-1]])) + np.diff(
            np.concatenate([[place[1] for place in known], phase[:-1]])
        )
        steps[: len(known) - 1] /= [place[2] for place in known[1:]]
        window = DOUBTED_SAMPLES + 1  # steps before each sample; fewer are known at first
        padded = np.concatenate([np.full(window, np.inf), np.abs(steps)])[len(known) - 1 :]
        least = padded[: len(cycles)]
        for later in range(1, window):
            least = np.minimum(least, padded[later : later + len(cycles)])
        return np.where(np.isfinite(least), least, 0.0)

    def good(self, phase: float, elapsed: float, next_one: bool = False) -> tuple[Track, int]:
        """A sample that passed its checks: position and status bits VALID, COASTING, LOST, RESIDUAL.

        ``next_one``: no sample was missed since the one before, however long the interval was.
        """
        settled = not (self._doubt or self.lost)
        if elapsed == 1.0 and settled and (followed := self.tracker.follow(phase)) is not None:
            self.places.append((followed[0], phase, 1.0))
            return followed, VALID
        if self.lost:
            track = self.tracker.look(phase, elapsed)
            self.tracker.accept(track, elapsed)
            return track, LOST if track.ok else LOST | RESIDUAL
        missed = round(elapsed) - 1
        if (
            missed > 0
            and self.tracker.started
            and not (next_one and settled and self._is_certain(phase, elapsed))
        ):
            self.bad(float(missed), missed=True)
            return self.good(phase, elapsed - missed)
        started = self.tracker.started
        limit = self._limit_over(elapsed)
        track = self.tracker.look(phase, elapsed)
        self.tracker.accept(track, elapsed)
        if settled and (track.ok or track.residual < limit):
            if started or self.tracker.step_cycles == 0.0:
                self.places.append((track.cycles, phase, elapsed))
            else:
                self._remember_tracker()  # a known speed: there is a place before the first one
            return track, VALID
        track, bits = self._decide(track, elapsed)
        return track, bits | RESIDUAL if settled else bits

    def advance_over(self, phase: float, elapsed: float) -> float:
        """:meth:`Tracker.advance` over an interval that is not quite one, as sample times give it.

        Only where nothing is in doubt. NOT_USUAL, and nothing changed, where :meth:`good` has to decide.
        """
        tracker = self.tracker
        if not elapsed < MISSED_INTERVALS:
            return NOT_USUAL
        track = tracker.look(phase, elapsed)
        if not (track.ok or track.residual < self._limit_over(elapsed)):
            return NOT_USUAL
        tracker.accept(track, elapsed)
        return track.residual

    def _is_certain(self, phase: float, elapsed: float) -> bool:
        """After an interval of this length no acceleration leads to another cycle with this phase."""
        limit = self.tracker.residual_limit if self.acceleration_limit is None else self.acceleration_limit
        scale = elapsed * (elapsed + self.tracker.elapsed) / 2.0
        residual = self.tracker.look(phase, elapsed).residual
        return residual < self._limit_over(elapsed) and residual + limit * scale < LARGEST_CERTAIN_CYCLES

    def _limit_over(self, elapsed: float) -> float:
        """The residual limit for an interval of this length: an acceleration a leaves a e (e + e') / 2.

        e' is the interval before. Only a limit below that of the paper grows, and not beyond that one.
        """
        limit = self.tracker.residual_limit
        scale = elapsed * (elapsed + self.tracker.elapsed) / 2.0
        grown = max(limit, min(limit * scale, RESIDUAL_LIMIT))
        if self._instant_error:
            uncertain = 4.0 * self._instant_error * abs(self.tracker.step_cycles)
            grown = max(grown, min(grown + uncertain, self._widest_limit))
        return grown

    def bad(self, elapsed: float, missed: bool = False) -> tuple[Track, int]:
        """A sample that failed its checks, or none at all (``missed``): predicted position, status bits."""
        predicted = self.tracker.predict(elapsed)
        if not self.tracker.started:  # no position yet: nothing to coast on, nothing to lose
            return predicted, LOST if self.lost else 0
        self.tracker.skip(elapsed)
        self._first_after = None
        if self.lost:
            return predicted, LOST
        doubt = self._doubted()
        coasted = doubt.wait(elapsed, missed)
        if doubt.is_over(self.coast_samples):
            self.lose()
            return predicted, LOST
        return coasted, COASTING

    def _doubted(self) -> Doubt:
        """The doubt that is, or that begins with this sample."""
        if self._doubt is None:
            before = [Place(*place) for place in self.places]
            self._doubt = Doubt(before, DOUBTED_SAMPLES, self.tracker.residual_limit)
        return self._doubt

    def _decide(self, followed: Track, elapsed: float) -> tuple[Track, int]:
        """A sample while the position is in doubt; ``followed`` is what eq. 9 makes of it."""
        doubt = self._doubted()
        coasted = doubt.meet(followed.phase, elapsed)
        if doubt.only_missed:
            found = doubt.settle(self.acceleration_limit)
            if not isinstance(found, Undecided):
                return self._go_on(found), VALID
        else:
            found = doubt.decide(self.coast_samples)
            if not isinstance(found, Undecided):
                return self._adopt(found), VALID
        if found is Undecided.FOR_EVER or doubt.is_over(self.coast_samples):
            self.lose()
            return followed, LOST if followed.ok else LOST | RESIDUAL
        if coasted is not None:
            return coasted, COASTING
        # It is nowhere near. If the acceleration is beyond the limit, eq. 9 is right (paper, section 4).
        return followed, COASTING | RESIDUAL

    def _go_on(self, places: Sequence[Place]) -> Track:
        """The places after a gap; with a single one the next sample must confirm its speed."""
        known = [Place(*place) for place in [*self.places, *places]]
        before, last = (Track(place.cycles, place.phase, 0.0, True) for place in known[-2:])
        self.tracker.set_places(before, last, places[-1].elapsed)
        if len(places) == 1:
            self._first_after = places[0]
            return last
        self._doubt = self._first_after = None
        self.places.extend(places)
        return last

    def _adopt(self, places: Sequence[Place]) -> Track:
        before, last = (Track(place.cycles, place.phase, 0.0, True) for place in places[-2:])
        self.tracker.set_places(before, last, places[-1].elapsed)
        self._doubt = self._first_after = None
        self.places.clear()
        self.places.extend(places)
        return last


def _nothing() -> None:
    pass
