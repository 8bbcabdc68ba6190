"""Coasting over bad samples with third-order prediction; :mod:`canfb.signal.recovery.trial` decides.

While the position is lost, eq. 9 counts: its error is then a speed that is wrong by whole cycles per
interval, which the coarse track can find, and not an acceleration.
"""

from __future__ import annotations

from canfb.signal.blocks import Scratch
from canfb.signal.recovery.bridge import Place
from canfb.signal.recovery.parabola import MotionLimits, Parabola, Spot
from canfb.signal.recovery.recovery import MISSED_INTERVALS, Recovery
from canfb.signal.recovery.trial import Trial, TrialResult
from canfb.signal.supervision import COASTING, LOST, RESIDUAL, VALID
from canfb.signal.third_order import SECOND, THIRD, ThirdOrderTracker
from canfb.signal.tracker import NOT_USUAL, Track, TrackResult


class JerkRecovery(Recovery):
    """As :class:`Recovery`, for a :class:`ThirdOrderTracker`: jerk is limited, acceleration is not."""

    __slots__ = ("_before_run", "_limits", "_parabola", "_trial")

    order = THIRD

    def __init__(self, tracker: ThirdOrderTracker, coast_samples: int) -> None:
        self._parabola = tracker
        self._limits = MotionLimits(tracker.residual_limit, tracker.start_limit)
        self._trial: Trial | None = None
        self._before_run = tracker.full_state()
        super().__init__(tracker, coast_samples)

    def set_motion(self, limits: MotionLimits) -> None:
        """Take new limits, between two samples."""
        super().set_motion(limits)
        self._parabola.start_limit = limits.start_limit
        self._parabola.acceleration_limit = limits.largest_second_difference
        self._limits = limits
        if self._trial is not None:
            self._trial.limits = limits

    def restart(self, cycles: int = 0, speed_cycles: float = 0.0) -> None:
        """As :meth:`Recovery.restart`."""
        self._trial = None
        super().restart(cycles, speed_cycles)

    def take_over(self, old: Recovery) -> None:
        """As :meth:`Recovery.take_over`; the acceleration is not known yet."""
        super().take_over(old)
        self._parabola.predict_by(SECOND if self.lost else THIRD)

    def resume(self) -> None:
        """As :meth:`Recovery.resume`."""
        if self._trial is not None:
            self.restart()
        super().resume()

    def lose(self) -> None:
        """As :meth:`Recovery.lose`; eq. 9 counts from here on."""
        self._trial = None
        self._parabola.predict_by(SECOND)
        super().lose()

    def found(self, cycles: int, step_cycles: int) -> None:
        """As :meth:`Recovery.found`. Another speed may have had another acceleration: it is forgotten."""
        super().found(cycles, step_cycles)
        if step_cycles:
            self._parabola.predict_by(self._parabola.order)

    def vouch(self) -> None:
        """As :meth:`Recovery.vouch`."""
        super().vouch()
        self._parabola.predict_by(THIRD)

    def restart_count(self) -> None:
        """As :meth:`Recovery.restart_count`; the acceleration stays known, which eq. 9 could not follow."""
        self.on_lost()

    @property
    def in_doubt(self) -> bool:
        """True while the next samples must decide where the position is; not when it is lost."""
        return self._trial is not None

    def follow_run(self, tracked: TrackResult, run: slice, scratch: Scratch) -> int:
        """As :meth:`Recovery.follow_run`; three places are before the run."""
        self._before_run = self._parabola.full_state()
        return super().follow_run(tracked, run, scratch)

    def take_run(self, tracked: TrackResult, start: int, stop: int) -> None:
        """As :meth:`Recovery.take_run`."""
        if self._parabola.order == SECOND:
            super().take_run(tracked, start, stop)
            return
        self._parabola.set_full_state(*self._before_run)
        if stop - start < 3:
            for phase in tracked.phase[start:stop].tolist():
                self._parabola.advance(phase)
        else:
            first, middle, last = tracked.cycles[stop - 3 : stop].tolist()
            step, bend = last - middle, last - 2 * middle + first
            third, before, phase = tracked.phase[stop - 3 : stop].tolist()
            self._parabola.set_full_state(third, before, phase, last, step, bend)
        self._remember_run(tracked, start, stop)

    def rescale(self, factor: float) -> None:
        """As :meth:`Recovery.rescale`."""
        super().rescale(factor)
        if self._trial is not None:
            self._trial.rescale(factor)

    def good(self, phase: float, elapsed: float, next_one: bool = False) -> tuple[Track, int]:
        """As :meth:`Recovery.good`."""
        settled = not (self._trial or self.lost)
        if elapsed == 1.0 and settled and (followed := self._parabola.follow(phase)) is not None:
            self.places.append((followed[0], phase, 1.0))
            return followed, VALID
        if self.lost:
            return self._count_on(phase, elapsed)
        if not self._parabola.started:
            track = self._parabola.look(phase, elapsed)
            self._accept(track, elapsed)
            return track, VALID
        if settled and (elapsed < MISSED_INTERVALS or next_one):
            continued = self._continued(phase, elapsed)
            if continued is not None:
                self._accept(continued, elapsed)
                return continued, VALID
        missed = round(elapsed) - 1
        if missed > 0:
            self.bad(float(missed), missed=True)
            return self.good(phase, elapsed - missed)
        return self._contradicted(phase, elapsed) if settled else self._meet(phase, elapsed)

    def advance_over(self, phase: float, elapsed: float) -> float:
        """As :meth:`Recovery.advance_over`."""
        continued = self._continued(phase, elapsed) if elapsed < MISSED_INTERVALS else None
        if continued is None:
            return NOT_USUAL
        self._parabola.accept(continued, elapsed)
        return continued.residual

    def _continued(self, phase: float, elapsed: float) -> Track | None:
        """Where the motion goes on with this phase; None if that is not one place. Nothing changes."""
        cycles = self._parabola_now().continuations(phase, elapsed, self._limits)
        if len(cycles) != 1:
            return None
        return self._parabola.look(phase, elapsed)._replace(cycles=cycles[0], ok=True)

    def bad(self, elapsed: float, missed: bool = False) -> tuple[Track, int]:
        """As :meth:`Recovery.bad`."""
        predicted = self._parabola.predict(elapsed)
        if not self._parabola.started:
            return predicted, LOST if self.lost else 0
        if not self.lost:
            trial = self._begin_trial()
            trial.wait(elapsed, missed)
            if not trial.is_over(self.coast_samples):
                self._parabola.skip(elapsed)
                return trial.track, COASTING
            self.lose()
        self._parabola.skip(elapsed)
        return predicted, LOST

    def _contradicted(self, phase: float, elapsed: float) -> tuple[Track, int]:
        """A residual over the limit."""
        followed = self._parabola.look(phase, elapsed)
        trial = self._begin_trial()
        trial.contradicted(phase, elapsed)
        if trial.is_over(self.coast_samples):
            self.lose()
            return self._count_on(phase, elapsed, LOST | RESIDUAL)
        self._parabola.skip(elapsed)
        return trial.track._replace(residual=followed.residual), COASTING | RESIDUAL

    def _meet(self, phase: float, elapsed: float) -> tuple[Track, int]:
        """A sample while the position is in doubt."""
        trial = self._begin_trial()
        verdict = trial.meet(phase, elapsed)
        if verdict is TrialResult.DECIDED:
            return self._adopt_three(trial.places), VALID
        if verdict is TrialResult.LOST or trial.is_over(self.coast_samples):
            self.lose()
            return self._count_on(phase, elapsed)
        self._parabola.skip(elapsed)
        return trial.track, COASTING

    def _count_on(self, phase: float, elapsed: float, bits: int = LOST) -> tuple[Track, int]:
        """A sample of a position that is lost."""
        track = self._parabola.look(phase, elapsed)
        self._parabola.accept(track, elapsed)
        return track, bits if track.ok else bits | RESIDUAL

    def _accept(self, track: Track, elapsed: float) -> None:
        self._parabola.accept(track, elapsed)
        self.places.append((track.cycles, track.phase, elapsed))

    def _adopt_three(self, places: list[Place]) -> Track:
        third, before, last = (Track(place.cycles, place.phase, 0.0, True) for place in places)
        self._parabola.set_three(third, before, last, places[1].elapsed, places[2].elapsed)
        self._trial = None
        self.places.extend(places)
        return last

    def _begin_trial(self) -> Trial:
        if self._trial is None:
            before = [Place(*place) for place in self.places]
            self._trial = Trial(before, self._limits, self._parabola.step_cycles)
        return self._trial

    def _parabola_now(self) -> Parabola:
        """The samples that predict the next one; their times count up to the last, at 0."""
        spots, time = [], 0.0
        for cycles, phase, elapsed in list(self.places)[-self._parabola.known :][::-1]:
            spots.append(Spot(cycles, phase, time))
            time -= elapsed
        return Parabola(tuple(spots[::-1]), self._parabola.step_cycles)
