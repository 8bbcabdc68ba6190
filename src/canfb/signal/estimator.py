"""The cycle count from successive phases: counted, in doubt, or lost.

Usually eq. 9 counts. In doubt, :mod:`canfb.signal.doubt` follows all motions that keep what is declared and
fit the samples.

    counted --- a sample is missing, flagged or contradicts ---> in doubt
    in doubt --- one motion is left ---> counted
    in doubt --- none is left, or several that no sample can separate, or it takes too long ---> lost
    lost --- a start at standstill, or a witness ---> counted

While the position is lost, eq. 9 runs on; its speed may be wrong by whole cycles per interval.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Callable

from canfb.objects import LossCause
from canfb.signal import speeds
from canfb.signal.bounded_motion import HOLE_INTERVALS, LONG_INTERVAL, ORDER, SHORT_INTERVAL, Spot
from canfb.signal.doubt import SPOTS_KEPT, Candidate, Decision, Doubt, LogEntry
from canfb.signal.limits import Declared
from canfb.signal.speed_hypotheses import Found
from canfb.signal.speeds import Place, StillPhase
from canfb.signal.starts import START_SAMPLES, SpeedVerdict, Starts
from canfb.signal.supervision import COASTING, LOST, RESIDUAL, VALID
from canfb.signal.tracker import Track, Tracker, TrackResult

HALF_CYCLE = 0.5
REMEMBERED_SAMPLES = 20  # r + 2 (m + r - 1) for r = 2: enough to go back to before m = 8 bad samples


class Estimator:
    """Feeds a :class:`Tracker` with good samples, and decides on its position after any other.

    ``places``: the last samples that were counted, as cycle count, phase, intervals since the one before.
    """

    __slots__ = (
        "_at_start",
        "_coasted",
        "_doubt",
        "_error",
        "_instant_error",
        "_known",
        "_largest",
        "_past",
        "_past_places",
        "_speeds",
        "_virtual",
        "declared",
        "loss_cause",
        "lost",
        "on_lost",
        "on_speed",
        "phases_keep",
        "places",
        "still",
        "timed",
        "tracker",
    )

    def __init__(self, declared: Declared) -> None:
        self.tracker = Tracker(declared.residual_limit)
        self.on_lost: Callable[[], None] = lambda: None
        """Called when the position is lost."""
        self.on_speed: Callable[[], None] = lambda: None
        """Called when the speed of a lost position is known."""
        self.phases_keep = True
        """The phases do not depend on the assumed speed. If they do, uneven times cannot show the speed."""
        self.timed = False
        """Samples bring their time, and the next interval may be uneven."""
        self.loss_cause = LossCause.NONE
        """Why the position was lost the last time."""
        self.places: deque[Place] = deque(maxlen=REMEMBERED_SAMPLES)
        self.restart()
        self.declare(declared)

    def declare(self, declared: Declared) -> None:
        self.declared = declared
        self.tracker.residual_limit = declared.residual_limit
        usual = declared.usual
        self._largest = usual.largest
        self._error, self._instant_error = usual.phase_error, usual.instant_error
        if self._doubt is not None:
            self._doubt.declare(declared.in_doubt, declared.bad_samples)

    def restart(self, cycles: int = 0, speed_cycles: float = 0.0) -> None:
        """Start at this cycle count and speed, cycles per interval. Uneven times check a speed of 0.0."""
        self.tracker.restart(cycles, speed_cycles)
        self._known = speed_cycles != 0.0
        self.lost = False
        self.still = StillPhase()  # counts samples while the position is lost
        self._virtual: Place | None = None  # before the first sample, by the assumed speed
        self._speeds = Starts()
        self._forget()

    def _forget(self) -> None:
        self._doubt: Doubt | None = None
        self._past: Doubt | None = None  # the last doubt, while a contradiction can go back into it
        self._coasted = 0.0  # intervals since the last good sample
        self.places.clear()

    def resume(self) -> None:
        """Continue at standstill from the last position, even in doubt; from cycle count 0 if it was lost."""
        if self.lost or not self.places:
            self.restart()
        else:
            self.tracker.halt()
            self._begin_places()

    def lose(self, cause: LossCause, starts: bool = True) -> None:
        """Lose the position; eq. 9 counts on. ``starts``: a first sample still to come has a known count."""
        if not self.lost:
            stood = speeds.stood_still(self.places)
            self.still = StillPhase(self.places[-1][1] if stood else None)
        if cause is not LossCause.START:
            self._speeds = Starts(self.tracker.cycles if starts and not self.tracker.started else None)
        self.lost = True
        self.loss_cause = cause
        self._forget()
        self.on_lost()

    def found(self, cycles: int, step_cycles: int) -> None:
        # A witness corrects the cycle count, and the speed by whole cycles per interval.
        self.tracker.shift(cycles, step_cycles)
        if step_cycles and not self.lost:
            self._speeds.stop()  # they are relative to a count at the assumed speed
        if step_cycles or self._doubt is not None or self.lost:
            self._remember_tracker()
        else:
            self._change_places(lambda place: (place[0] + cycles, place[1], place[2]))
            self._past = None

    def confirm_count(self) -> None:
        self.lost = False
        self._remember_tracker()

    def _begin_places(self) -> None:
        self._remember_tracker()
        self._virtual = self.places[0]
        if not self.tracker.step_cycles:
            self.places.popleft()

    def _remember_tracker(self) -> None:
        before, last, elapsed = self.tracker.places
        self._forget()
        self.places.append((before.cycles, before.phase, 1.0))
        self.places.append((last.cycles, last.phase, elapsed))
        if self.tracker.gap and not self.lost:  # the samples in it were not counted
            self._doubted().skip(self.tracker.gap, flagged=True)

    def rescale(self, factor: float) -> None:
        self.tracker.rescale(factor)
        self._speeds.rescale(factor)
        self._coasted *= factor
        self._change_places(lambda place: (place[0], place[1], place[2] * factor))
        for doubt in (self._doubt, self._past):
            if doubt is not None:
                doubt.rescale(factor)

    def _change_places(self, change: Callable[[Place], Place]) -> None:
        virtual = None if self._virtual is None else change(self._virtual)
        places = [virtual if place is self._virtual else change(place) for place in self.places]
        self._virtual = virtual
        self.places.clear()
        self.places.extend(place for place in places if place is not None)

    def go_on(self, run: TrackResult, taken: int) -> None:
        """Continue after the first ``taken`` > 0 samples of a ``run`` on arrays, counted by eq. 9."""
        new = slice(max(0, taken - REMEMBERED_SAMPLES), taken)
        counts, phases = run.cycles[new].tolist(), run.phase[new].tolist()
        self.tracker.go_on(run, taken)
        if not self.lost:
            self.places.extend((count, phase, 1.0) for count, phase in zip(counts, phases, strict=True))

    @property
    def searches(self) -> bool:
        """True while uneven sample times may still determine the speed."""
        return self._speeds.active is not None

    @property
    def in_doubt(self) -> bool:
        """True while the next samples must decide on the position; not when it is lost."""
        return self._doubt is not None

    @property
    def undecided(self) -> bool:
        """True while several motions are left."""
        return self._doubt is not None and len(self._doubt.candidates) > 1

    @property
    def contradicted(self) -> bool:
        # Samples are not only missing: one was flagged, or fits no motion.
        return self._doubt is not None and not self._doubt.only_missing

    def good(self, phase: float, elapsed: float) -> tuple[Track, int]:
        """Take a sample that passed its checks: position and bits VALID, COASTING, LOST, RESIDUAL."""
        follows_speeds = self._follows_speeds(elapsed)
        track, bits = self._taken(phase, elapsed)
        if not follows_speeds:
            return track, bits
        count = None if self._doubt else self.tracker.cycles
        verdict = self._speeds.take(phase, elapsed, self.lost, count)
        if verdict is SpeedVerdict.FALSE_START:
            self.lose(LossCause.START)
            return self._count_on(phase, elapsed, LOST | RESIDUAL)
        if verdict is SpeedVerdict.OPEN and bits & VALID:
            return track, bits & ~VALID | COASTING
        if not isinstance(verdict, Found):
            return track, bits
        origin = self._speeds.origin
        last = track.cycles if origin is None else origin + verdict.last[0]
        before = Track(last + verdict.before[0] - verdict.last[0], verdict.before[1], 0.0, True)
        self.tracker.set_places(before, Track(last, phase, 0.0, True), verdict.elapsed)
        if origin is None:
            self.on_speed()
            return self.tracker.places[1], bits
        self.confirm_count()
        return self.tracker.places[1], VALID

    def _taken(self, phase: float, elapsed: float) -> tuple[Track, int]:
        tracker = self.tracker
        if self.lost:
            return self._count_on(phase, elapsed)
        if not tracker.started:
            track = tracker.look(phase)
            tracker.accept(track)
            self._begin_places()
            # Uneven times may still come after an even interval. They confirm the start and this sample.
            return track, COASTING if self._follows_speeds(1.0) else VALID
        if self._coasted + max(0, round(elapsed) - 1) > self.declared.coasting + 0.5:
            self.lose(LossCause.COASTED)
            return self._count_on(phase, elapsed)
        self._coasted = 0.0
        bits = 0
        if self._doubt is None and elapsed < LONG_INTERVAL:
            counted = self._counted(phase, elapsed)
            if counted is not None:
                self.places.append((counted.cycles, phase, elapsed))
                return counted, VALID
            bits = RESIDUAL if elapsed < HOLE_INTERVALS else 0
            if bits and self._start_is_assumed:
                self.lose(LossCause.START)
                return self._count_on(phase, elapsed, LOST | bits)
        return self._decide(phase, elapsed, bits)

    def _follows_speeds(self, elapsed: float) -> bool:
        return self.phases_keep and self._speeds.begin(
            self.declared, self.timed, elapsed, self.lost, self._start_places(), self._coasted
        )

    def _start_places(self) -> list[Place]:
        places, doubt = self.places, self._doubt
        in_doubt = doubt is not None and doubt.followed > 0.0
        assumed = self._virtual is not None and not (self._known or self.lost)
        if not assumed or in_doubt or not 0 < len(places) <= START_SAMPLES:
            return []
        return list(places)

    @property
    def _start_is_assumed(self) -> bool:
        samples = len(self.places) - (self.places[0] is self._virtual)
        even = all(place[2] == 1.0 for place in itertools.islice(self.places, 1, None))
        is_new = self._virtual is not None and samples < (ORDER if even else START_SAMPLES)
        return is_new or self.searches  # uneven times are checking the assumed speed

    def limit_over(self, elapsed: float) -> float:
        """Limit of the residual of a usual sample, ``elapsed`` intervals after the last one.

        Only if nothing is in doubt. 0.0: :meth:`good` has to decide.
        """
        known, last = len(self.places), self.tracker.elapsed
        if (
            known < 2
            or last < SHORT_INTERVAL
            or elapsed >= LONG_INTERVAL
            or (known <= START_SAMPLES and self._start_places())
        ):
            return 0.0
        error = self._error + self._instant_error * abs(self.tracker.step_cycles)
        radius = self._largest * elapsed * (elapsed + last) / 2.0 + error * (2.0 + 2.0 * elapsed / last)
        return radius if radius < HALF_CYCLE else 0.0

    def _counted(self, phase: float, elapsed: float) -> Track | None:
        """Take a sample in turn if the declared motion leaves one position only."""
        tracker, limit = self.tracker, self.limit_over(elapsed)
        if limit > 0.0:
            residual = tracker.advance(phase, elapsed, limit)
            return Track(tracker.cycles, phase, residual, True) if residual >= 0.0 else None
        spots = self._spots()
        counts = self.declared.usual.window(spots, spots[-1].time + elapsed).counts(phase)
        if len(counts) != 1:
            return None
        track = tracker.look(phase, elapsed)._replace(cycles=counts[0], ok=True)
        tracker.accept(track, elapsed)
        return track

    def bad(self, elapsed: float, missed: bool = False) -> tuple[Track, int]:
        """Take a sample that failed its checks, or was ``missed``: predicted position, status bits."""
        self._speeds.skip(elapsed)
        predicted = self.tracker.predict(elapsed)
        if not self.tracker.started:  # no position yet: nothing to coast on, nothing to lose
            return predicted, LOST if self.lost else 0
        self.tracker.skip(elapsed)
        if self.lost:
            return predicted, LOST
        self._coasted += elapsed
        if self._coasted > self.declared.coasting + 0.5:
            self.lose(LossCause.COASTED)
            return predicted, LOST
        self._doubted().skip(elapsed, not missed)
        return predicted, COASTING

    def _count_on(self, phase: float, elapsed: float, bits: int = LOST) -> tuple[Track, int]:
        self.still.take(phase)
        track = self.tracker.look(phase, elapsed)
        self.tracker.accept(track, elapsed)
        return track, bits if track.ok else bits | RESIDUAL

    def _decide(self, phase: float, elapsed: float, bits: int) -> tuple[Track, int]:
        verdict = self._doubted(bool(bits)).take(phase, elapsed, bool(bits))
        if verdict.lost is not None:
            self.lose(verdict.lost)
            return self._count_on(phase, elapsed, LOST | bits)
        if verdict.candidate is not None:
            return self._adopt(verdict), VALID
        followed, predicted = (self.tracker.look(one, elapsed) for one in (phase, math.nan))
        self.tracker.skip(elapsed)
        counts = [one.last.cycles for one in self._doubt.candidates if one.run] if self._doubt else []
        if counts:  # not valid: show the candidate nearest to eq. 9
            nearest = min(counts, key=lambda cycles: abs(cycles - followed.cycles))
            return followed._replace(cycles=nearest), COASTING | bits
        return predicted._replace(residual=followed.residual), COASTING | bits

    def _adopt(self, verdict: Decision) -> Track:
        candidate = verdict.candidate
        assert candidate is not None
        spots = candidate.run_spots if verdict.settled else candidate.spots
        elapsed = [1.0, *(b.time - a.time for a, b in itertools.pairwise(spots))]
        before, last = (Track(spot.cycles, spot.phase, 0.0, True) for spot in spots[-2:])
        self.tracker.set_places(before, last, elapsed[-1])
        self.places.clear()
        self.places.extend((spot.cycles, spot.phase, e) for spot, e in zip(spots, elapsed, strict=True))
        self._past_places = len(self.places)
        if verdict.settled:
            self._doubt, self._past = None, self._doubt
            if not self._at_start:  # the few places left are not the first ones after a start
                self._virtual = None
        return Track(candidate.last.cycles, candidate.last.phase, 0.0, True)

    def _spots(self) -> tuple[Spot, ...]:
        places, virtual = list(self.places)[-SPOTS_KEPT:], self._virtual
        if len(places) > 2 and places[0] is virtual:
            del places[0]
        time = 0.0
        spots: list[Spot] = []
        for place in reversed(places):
            cycles, phase, elapsed = place
            error = self.declared.start_error if place is virtual else 0.0
            spots.append(Spot(time, cycles, phase, error))
            time -= elapsed
        if len(spots) == 1 and virtual is not None:
            cycles, phase, elapsed = virtual
            spots.append(Spot(-elapsed, cycles, phase, self.declared.start_error))
        return tuple(reversed(spots))

    def _doubted(self, refused: bool = False) -> Doubt:
        if self._doubt is None:
            self._at_start = self._start_is_assumed  # the doubt began while the start was assumed
            log = self._log()
            spots = self._spots()
            start = Candidate(0.0, spots, max(ORDER, len(spots)))
            self._doubt = Doubt(self.declared.in_doubt, self.declared.bad_samples, log, [start])
            if self.declared.assumes and not refused:  # with a refused sample, take() goes back
                self._doubt.suspect()
        return self._doubt

    def _log(self) -> list[LogEntry]:
        """The last 2 (m + r - 1) samples as entries; those of the last doubt have its candidates."""
        needed = 2 * (self.declared.bad_samples + ORDER - 1)
        entries: list[LogEntry] = []
        first = ORDER  # the first place that the places before it predict
        if self._past is not None and len(self.places) < REMEMBERED_SAMPLES:
            first, entries = self._past_places, self._past.log[:]
        time = 0.0
        spots: list[Spot] = []
        for number, place in enumerate(self.places):
            cycles, phase, elapsed = place
            time += elapsed
            if number >= first:
                before = tuple(spots[-SPOTS_KEPT:])
                candidate = Candidate(time - elapsed, before, max(ORDER, len(before)))
                entries.append(LogEntry(phase, elapsed, (candidate,)))
            error = self.declared.start_error if place is self._virtual else 0.0
            spots.append(Spot(time, cycles, phase, error))
        return entries[-needed:]
