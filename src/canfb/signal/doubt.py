"""All motions that the machine can have made since a sample was missing or flagged, or contradicted.

The idea is that of integer ambiguity resolution (GNSS), with bounds in place of probabilities. A
:class:`Candidate` is one sequence of cycle counts; each sample gives it one successor for each count in its
window (:mod:`canfb.signal.bounded_motion`). If all candidates left agree, the position is right as long as
the declaration holds (docs/supervision.md).

A sample K contradicts if no candidate can take it. Up to m neighbouring samples may be bad unnoticed; the
residual exceeds the limit at most r samples after them. So the search starts again from each of the samples
K - (m + r - 1) .. K, and leaves out m samples there. The candidate left must pass three tests, which may
refuse a position, but never choose one:

- chance: a window of width w takes a random phase with probability w; M residuals have a spread of at most
  w with probability M w^(M-1),
- a frozen input: equal phases after a motion,
- a jump: all samples fit the motion before or the one after, so none was bad.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from canfb.objects import LossCause
from canfb.signal.bounded_motion import HOLE_INTERVALS, ORDER, BoundedMotion, Spot, Window
from canfb.signal.speeds import apart

FALSE_ACCEPTANCE = 1e-5  # probability, per decision, that random phases are accepted
MOST_CANDIDATES = 256
MOST_ROWS = 2  # rows of bad samples within one doubt; a third contradiction loses the position
MOST_INTERVALS = 32.0  # intervals with samples until a doubt loses the position; some ten samples decide
SAME_TIME = 1e-9  # intervals: rounding
SPOTS_KEPT = 8  # samples that a candidate keeps, for junctions and the windows of short intervals
NO_RESIDUALS = (0, math.inf, -math.inf)


class Candidate(NamedTuple):
    """One motion: the samples that it uses, and the cycle count of each.

    time       of its last entry, intervals
    spots      the last samples, oldest first: before the last hole, and the run after it
    run        number of samples after the last hole
    leaves     number of samples still to be left out
    chance     expected number of such candidates if the phases were random
    joined     the same, up to the end of the junction
    residuals  of the samples after the junction: number, smallest, largest, cycles
    """

    time: float
    spots: tuple[Spot, ...]
    run: int
    leaves: int = 0
    chance: float = 1.0
    joined: float = 1.0
    residuals: tuple[int, float, float] = NO_RESIDUALS

    @property
    def last(self) -> Spot:
        return self.spots[-1]

    @property
    def run_spots(self) -> tuple[Spot, ...]:
        return self.spots[-self.run :] if self.run else ()

    @property
    def is_settled(self) -> bool:
        return self.run >= ORDER and not self.leaves

    @property
    def probability(self) -> float:
        number, least, most = self.residuals
        spread = number * max(0.0, most - least) ** (number - 1) if number > 1 else 1.0
        return min(self.chance, self.joined * spread)

    def over_hole(self, elapsed: float, left_out: bool = False) -> Candidate:
        """The candidate after an entry that it does not use, ``elapsed`` intervals later."""
        return self._replace(
            time=self.time + elapsed,
            run=0,
            leaves=max(0, self.leaves - left_out),
            joined=self.chance,
            residuals=NO_RESIDUALS,
        )

    def window(self, time: float, motion: BoundedMotion) -> Window:
        """Where a sample at ``time`` can be."""
        run = self.run_spots
        if self.run >= ORDER:
            return motion.window(run, time)
        return motion.beyond(self.spots[: len(self.spots) - len(run)], run, time)

    def successors(self, phase: float, elapsed: float, motion: BoundedMotion) -> Iterable[Candidate]:
        """The candidates after a sample ``elapsed`` intervals later: one for each count in its window."""
        start = self.over_hole(0.0) if self.run and elapsed >= HOLE_INTERVALS else self
        time = self.time + elapsed
        window, joins = start.window(time, motion), start.run < ORDER
        chance = start.chance * window.width
        for cycles in window.counts(phase):
            yield Candidate(
                time,
                (*start.spots[-SPOTS_KEPT:], Spot(time, cycles, phase)),
                start.run + 1,
                0,
                chance,
                chance if joins else start.joined,
                start.residuals if joins else _noted(start.residuals, window, cycles + phase),
            )

    def rescaled(self, factor: float) -> Candidate:
        return self._replace(
            time=self.time * factor,
            spots=tuple(spot._replace(time=spot.time * factor) for spot in self.spots),
        )

    def future(self) -> tuple[object, ...]:
        # All that decides which samples the candidate can take from now on.
        recent = self.spots[-ORDER:] if self.run >= ORDER else self.spots[-ORDER - self.run :]
        places = tuple((round(spot.time - self.time, 9), spot.cycles, spot.phase) for spot in recent)
        return places, min(self.run, ORDER), self.leaves

    def joined_by(self, other: Candidate) -> Candidate:
        """One candidate for two with the same future."""
        number, least, most = self.residuals
        number_, least_, most_ = other.residuals
        common = 0
        for one, two in zip(reversed(self.spots), reversed(other.spots), strict=False):
            shift = self.time - other.time
            if one[1:] != two[1:] or abs(one.time - two.time - shift) > SAME_TIME:
                break
            common += 1
        return self._replace(
            spots=self.spots[-common:],
            run=min(self.run, other.run),
            chance=self.chance + other.chance,
            joined=self.joined + other.joined,
            residuals=(min(number, number_), min(least, least_), max(most, most_)),
        )


def _noted(residuals: tuple[int, float, float], window: Window, position: float) -> tuple[int, float, float]:
    number, least, most = residuals
    residual = position - window.base - (window.low + window.high) / 2.0
    return number + 1, min(least, residual), max(most, residual)


def merged(candidates: Iterable[Candidate]) -> list[Candidate] | None:
    """One candidate for all with the same future; None if there are too many to follow."""
    unique: dict[tuple[object, ...], Candidate] = {}
    for one in candidates:
        key = one.future()
        other = unique.get(key)
        unique[key] = one if other is None else other.joined_by(one)
        if len(unique) > MOST_CANDIDATES:
            return None
    return list(unique.values())


class LogEntry(NamedTuple):
    """One sample: phase, None if missing or flagged; intervals since the last; candidates before it."""

    phase: float | None
    elapsed: float
    before: Sequence[Candidate]


class Decision(NamedTuple):
    """The candidate that is right, whether the doubt has ended, and why the position is ``lost``."""

    candidate: Candidate | None = None
    settled: bool = False
    lost: LossCause | None = None


class Doubt:
    """Follows candidates from the last certain samples on, until one is right or the position is lost.

    ``log``: the entries before, which a contradiction goes back into. ``start``: the first candidates.
    """

    def __init__(
        self, motion: BoundedMotion, bad_samples: int, log: Sequence[LogEntry], start: list[Candidate]
    ) -> None:
        self.motion = motion
        self.bad_samples = bad_samples
        self.log = list(log)
        self.candidates = start
        self._begun = len(self.log)
        self._first_spots = start[0].spots
        self.only_missing = True  # no sample contradicted, and none was flagged
        self._contradicted: int | None = None  # number of the last entry that no candidate could take
        self._rows = 0  # number of contradictions
        self.followed = 0.0  # intervals with samples since the doubt began

    def skip(self, elapsed: float, flagged: bool) -> None:
        """Enter a missing or a ``flagged`` sample, ``elapsed`` intervals later."""
        self.only_missing &= not flagged
        self._enter(None, elapsed)
        self._follow(self._advance(self.candidates, len(self.log) - 1))

    def suspect(self) -> None:
        """Go back if a sample that eq. 9 counted, with its wider bound, contradicts the bound in doubt."""
        number = self._first_misfit(len(self.log))
        if number < len(self.log):
            self.only_missing = False
            self._contradicted = number
            if not self._go_back(number):
                self.candidates = []

    def take(self, phase: float, elapsed: float, refused: bool = False) -> Decision:
        """Take a good sample ``elapsed`` intervals later; ``refused``: over the limit of usual samples."""
        self.followed += elapsed
        self._enter(phase, elapsed)
        number = len(self.log) - 1
        if not self._follow([] if refused else self._advance(self.candidates, number)):
            return Decision(lost=LossCause.UNDECIDED)
        if not self.candidates:
            self.only_missing = False
            self._contradicted = self._first_misfit(number)
            self._rows += 1
            if self._rows > MOST_ROWS:
                return Decision(lost=LossCause.CONTRADICTED)
            if not self._go_back(self._contradicted):
                return Decision(lost=LossCause.UNDECIDED)
        return self._decide()

    def declare(self, motion: BoundedMotion, bad_samples: int) -> None:
        self.motion, self.bad_samples = motion, bad_samples

    def rescale(self, factor: float) -> None:
        self.candidates = [one.rescaled(factor) for one in self.candidates]
        self.log = [
            LogEntry(phase, elapsed * factor, tuple(one.rescaled(factor) for one in before))
            for phase, elapsed, before in self.log
        ]

    def _enter(self, phase: float | None, elapsed: float) -> None:
        self.log.append(LogEntry(phase, elapsed, tuple(self.candidates)))

    def _follow(self, found: Iterable[Candidate]) -> bool:
        candidates = merged(found)
        self.candidates = candidates or []
        return candidates is not None

    def _advance(self, candidates: Iterable[Candidate], number: int) -> Iterable[Candidate]:
        phase, elapsed, _ = self.log[number]
        for one in candidates:
            if phase is None or one.leaves:
                yield one.over_hole(elapsed, left_out=phase is not None)
            else:
                yield from one.successors(phase, elapsed, self.motion)

    def _go_back(self, contradicted: int) -> bool:
        """Search again, with m samples left out from each entry that can be the first bad one."""
        now = len(self.log)
        found: list[Candidate] = []
        for start in range(max(0, contradicted - self._reach), contradicted + 1):
            if self.log[start].phase is None:
                continue
            some: list[Candidate] | None = [
                one._replace(leaves=self.bad_samples) for one in self.log[start].before if not one.leaves
            ]
            for number in range(start, now):
                some = merged(self._advance(some or (), number))
                if some is None:
                    return False
            found += some or ()
        return self._follow(found)

    def _decide(self) -> Decision:
        candidates = self.candidates
        if not candidates:
            return Decision(lost=LossCause.CONTRADICTED)
        one = candidates[0]
        counts = {other.last.cycles for other in candidates}
        settled = all(other.is_settled for other in candidates)
        if self.only_missing and len(counts) == 1:
            return Decision(one, settled=settled and len(candidates) == 1)
        if len(candidates) == 1:
            if settled and not self.only_missing and self._is_proven(one):
                return Decision(lost=LossCause.JUMP) if self._is_jump(one) else Decision(one, settled=True)
        elif settled and all(
            abs(one.elapsed - round(one.elapsed)) <= SAME_TIME for one in self.log[self._begun :]
        ):
            # At whole intervals their positions will always differ by whole cycles: no phase can decide.
            return Decision(lost=LossCause.AMBIGUOUS)
        if self.followed > MOST_INTERVALS:
            return Decision(lost=LossCause.UNDECIDED)
        return Decision()

    def _is_proven(self, one: Candidate) -> bool:
        """True if neither random phases nor a frozen input explain the candidate."""
        stood = sum(self._is_near(spot, one) for spot in self._first_spots)
        return one.probability <= FALSE_ACCEPTANCE and (stood >= ORDER or self._moves(one))

    def _moves(self, one: Candidate) -> bool:
        return not all(self._is_near(spot, one) for spot in one.run_spots)

    def _is_near(self, spot: Spot, one: Candidate) -> bool:
        # Within the errors of two phases: the machine may stand.
        return abs(apart(spot.phase, one.last.phase)) <= 2.0 * self.motion.phase_error

    def _is_jump(self, one: Candidate) -> bool:
        # The run is extended backwards. If its motion takes all samples back to the contradiction, no sample
        # was bad, and the position has jumped.
        first, spots = self._contradicted, one.run_spots
        if first is None or not self._moves(one):  # the machine stands where it stood before
            return False
        time = spots[0].time
        for number in range(len(self.log) - len(spots), first, -1):
            time -= self.log[number].elapsed
            phase = self.log[number - 1].phase
            if phase is None:
                continue
            backwards = tuple(spot._replace(time=-spot.time) for spot in reversed(spots))
            window = self.motion.window(backwards, -time)
            counts = window.counts(phase)
            if not counts:
                return False
            spots = (Spot(time, counts[len(counts) // 2], phase), *spots)[:SPOTS_KEPT]
        return True

    def _first_misfit(self, contradicted: int) -> int:
        # The first bad sample may be further back, within the bound of eq. 9 but not within that in doubt.
        for number in range(max(0, contradicted - self._reach), contradicted):
            phase, elapsed, before = self.log[number]
            if phase is None or len(before) != 1:
                continue
            if not before[0].window(before[0].time + elapsed, self.motion).counts(phase):
                return number
        return contradicted

    @property
    def _reach(self) -> int:
        # From the first bad sample to the one that contradicts, at most.
        return self.bad_samples + ORDER - 1
