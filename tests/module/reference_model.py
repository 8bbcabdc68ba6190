"""A module in plain arithmetic: from ADC counts, one pair for each SYNC, to the fields of its position PDO.

Slow, and written from docs/supervision.md and docs/supervision.md, not from the code: nothing of canfb but
the bits of the status word. Positions are plain numbers of cycles, and all motions in doubt are polygons of
what the machine can have done, step by step, where the module has windows and facets in closed form.

It knows prediction by eq. 9, the checks of one sample, missing and flagged samples, one contradiction
(residual over the limit) in a run of good samples, coasting and loss. What is beyond that raises `Beyond`.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from canfb.objects import StatusBit as Bit

CYCLES_PER_REVOLUTION = 2500
UNITS_PER_REVOLUTION = 8192 * CYCLES_PER_REVOLUTION  # 6501h
RANGE = UNITS_PER_REVOLUTION * ((1 << 32) // UNITS_PER_REVOLUTION)  # whole revolutions in 32 bits
ROUNDING = 1e-9
REMEMBERED = 24  # good samples until nothing before them matters
CHANCE = 1e-5
MOST_CANDIDATES, MOST_INTERVALS = 256, 32
NO_RESIDUALS = (0, math.inf, -math.inf)
Point = tuple[float, float]


class Beyond(Exception):
    """A situation that this model does not describe."""


class Published(NamedTuple):
    """The fields of the position PDO: 6004h, status word, residual in 1/65536 cycle."""

    position: int
    status: int
    residual: int


@dataclass(frozen=True)
class Limits:
    """What is declared, in counts and cycles; the defaults are those of 2001h and 2010h."""

    full_scale: int = 2048
    low: int = 410
    high: int = 2560
    residual: float = 21845 / 65536
    acceleration: float = 6554 / 65536  # in doubt
    phase_error: float = 819 / 65536
    bad: int = 1
    coast: int = 3


def raw_phase(sine: float, cosine: float) -> float:
    """Table 1: the smaller track over the larger one, by quadrants about the axes."""
    if abs(sine) <= abs(cosine):
        return (0.125 * sine / cosine + (0.0 if cosine > 0 else 0.5)) % 1.0
    return (0.25 if sine > 0 else 0.75) - 0.125 * cosine / sine


def corrected(raw: float, table: Sequence[float]) -> float:
    """Linear interpolation between the entries, which go on behind the last one with entry 0 + 1."""
    if not table:
        return raw
    n, part = divmod(raw * len(table), 1.0)
    first, second = table[int(n)], [*table, table[0] + 1.0][int(n) + 1]
    return (first + part * (second - first)) % 1.0


@dataclass(frozen=True)
class Motion:
    """One motion that fits the samples: time and position of each, ``run`` of them since the last hole."""

    spots: tuple[Point, ...]
    run: int = 2
    leaves: int = 0  # samples still to be left out
    chance: float = 1.0  # that random phases would have got so far
    joined: float = 1.0  # the same, up to the second sample behind the hole
    residuals: tuple[int, float, float] = NO_RESIDUALS  # behind that: how many, smallest, largest

    @property
    def settled(self) -> bool:
        return self.run >= 2 and not self.leaves

    @property
    def probability(self) -> float:
        m, least, most = self.residuals
        spread = m * (most - least) ** (m - 1) if m > 1 else 1.0
        return min(self.chance, self.joined * spread)

    def future(self) -> object:
        """What the next samples are held against."""
        return self.spots[-2 - (self.run if self.run < 2 else 0) :], min(self.run, 2), self.leaves


@dataclass
class ReferenceModel:
    """Feed it with :meth:`sample` and :meth:`missed`, once for each SYNC."""

    limits: Limits = Limits()
    table: Sequence[float] = ()
    units_per_revolution: int = UNITS_PER_REVOLUTION  # negative: the code sequence is reversed
    offset: int = 0  # of the preset, 6509h
    now: int = 0
    before: Point | None = None  # the last two samples that were counted: eq. 9 stands on them
    last: Point | None = None
    good: list[Point] = field(default_factory=list)  # in a row, since nothing is in doubt
    motions: list[Motion] | None = None  # in doubt
    only_missing: bool = True
    contradicted: list[tuple[int, float]] | None = None  # time and phase of the samples from there on
    followed: int = 0  # samples in doubt
    certain: Sequence[Point] = ()  # the last samples before the doubt
    coasted: int = 0
    after_fault: bool = False
    lost: bool = False

    def sample(self, sine: int, cosine: int) -> Published:
        """A pair of counts."""
        self.now += 1
        faults = self._faults(sine, cosine)
        if faults:
            return self._bad(faults)
        return self._good(corrected(raw_phase(sine, cosine), self.table))

    def missed(self) -> Published | None:
        """A SYNC without a sample; None: nothing is sent, because the position is lost already."""
        self.now += 1
        known = self.lost
        published = self._bad(Bit.MISSED)
        return None if known else published

    def invalid(self) -> Published:
        """A pair of counts that the interface flags."""
        self.now += 1
        return self._bad(0)

    def _faults(self, sine: int, cosine: int) -> int:
        limits = self.limits
        low, high, margin = float(limits.low), float(limits.high), 0
        if self.after_fault:  # hysteresis, until a sample passes
            quarter = (high - low) / 4
            low, high, margin = low + min(low / 32, quarter), high - min(high / 32, quarter), 2
        clipped = min(sine, cosine) <= margin - limits.full_scale
        clipped = clipped or max(sine, cosine) >= limits.full_scale - 1 - margin
        amplitude = not low <= math.sqrt(sine * sine + cosine * cosine) <= high
        self.after_fault = clipped or amplitude
        return clipped * Bit.CLIPPED | amplitude * Bit.AMPLITUDE

    def _published(self, position: float, status: int, residual: float = 0.5) -> Published:
        if self.table:
            status |= Bit.TABLE_ACTIVE
        units = math.floor(position * self.units_per_revolution / CYCLES_PER_REVOLUTION)
        return Published((units + self.offset) % RANGE, int(status), math.floor(residual * 65536))

    def _predicted(self) -> float:
        """Eq. 9, over as many intervals as have passed."""
        assert self.before is not None
        assert self.last is not None
        (t0, x0), (t1, x1) = self.before, self.last
        return x1 + (x1 - x0) / (t1 - t0) * (self.now - t1)

    def _lose(self) -> None:
        self.lost, self.motions, self.good = True, None, []

    def _bad(self, bits: int) -> Published:
        if self.last is None:
            return self._published(0.0, bits)
        predicted = self._predicted()
        self.coasted += 1
        if self.lost or self.coasted > self.limits.coast:
            self._lose()
            return self._published(predicted, bits | Bit.LOST)
        self._doubt()
        self.only_missing &= bits == Bit.MISSED
        self._advance(None)
        return self._published(predicted, bits | Bit.COASTING)

    def _good(self, phase: float) -> Published:
        if self.last is None:  # at standstill
            self.before, self.last = (self.now - 1.0, phase), (float(self.now), phase)
            self.good = [self.before, self.last]
            return self._published(phase, Bit.VALID, 0.0)
        predicted = self._predicted()
        position = round(predicted - phase) + phase
        residual = abs(predicted - position)
        if min(abs(residual - 0.5), abs(residual - self.limits.residual)) < ROUNDING:
            raise Beyond("rounding decides")
        refused = residual >= self.limits.residual
        self.coasted = 0
        if self.lost:
            self._count(self.last, (self.now, position))
            return self._published(position, Bit.LOST | refused * Bit.RESIDUAL, residual)
        if self.motions is None and not refused:
            self._count(self.last, (self.now, position))
            self.good.append((self.now, position))
            return self._published(position, Bit.VALID, residual)
        bits = 0
        if self.motions is None:
            bits = Bit.RESIDUAL
            self._contradict(phase)
        else:
            self._advance(phase)
        self.followed += 1
        return self._decide(phase, position, residual, bits)

    def _count(self, before: Point, last: Point) -> None:
        self.before, self.last = before, last

    # Which motions are left?

    def _doubt(self) -> None:
        """A sample is missing or flagged: from here on every motion is followed."""
        if self.motions is None:
            if self._misfits(self.good[-self.limits.bad - 3 :]):
                raise Beyond("a sample before fits the bound of usual samples only")
            self.certain = self.good[-8:]
            self.motions = [Motion(tuple(self.certain), run=max(2, len(self.certain)))]
            self.only_missing, self.followed, self.contradicted = True, 0, None

    def _misfits(self, spots: Sequence[Point]) -> bool:
        """Whether one of them is outside of the window of the two before it."""
        window = self.limits.acceleration + 4 * self.limits.phase_error + ROUNDING
        return any(
            abs(c - 2 * b + a) > window
            for (_, a), (_, b), (_, c) in zip(spots, spots[1:], spots[2:], strict=False)
        )

    def _contradict(self, phase: float) -> None:
        """A residual over the limit: from one of the last samples on, some in a row were bad."""
        reach = self.limits.bad + 1
        if len(self.good) < REMEMBERED:
            raise Beyond("a contradiction in the first samples after a doubt")
        if self._misfits(self.good[-reach - 2 :]):
            raise Beyond("a sample before fits the bound of usual samples only")
        samples = [*((int(t), x % 1.0) for t, x in self.good[-reach:]), (self.now, phase)]
        found: list[Motion] = []
        for first in range(len(samples)):
            spots = self.good[: len(self.good) - reach + first]
            some = [Motion(tuple(spots[-8:]), run=8, leaves=self.limits.bad)]
            for t, p in samples[first:]:
                some = merged([one for motion in some for one in self._successors(motion, t, p)])
            found += some
        self.motions, self.certain = merged(found), self.good[-8:]
        self.only_missing, self.followed, self.contradicted = False, 0, [(self.now, phase)]

    def _advance(self, phase: float | None) -> None:
        assert self.motions is not None
        if phase is not None and self.contradicted is not None:
            self.contradicted.append((self.now, phase))
        self.motions = merged(
            [one for motion in self.motions for one in self._successors(motion, self.now, phase)]
        )
        if phase is not None and not self.motions:
            raise Beyond("a contradiction in doubt")

    def _successors(self, motion: Motion, now: int, phase: float | None) -> Iterator[Motion]:
        """With a sample, for each cycle count that it can have; with none, or one left out, over a hole."""
        if phase is None or motion.leaves:
            leaves = max(0, motion.leaves - (phase is not None))
            yield replace(motion, run=0, leaves=leaves, joined=motion.chance, residuals=NO_RESIDUALS)
            return
        low, high = self._window(motion, now)
        chance = motion.chance * max(0.0, high - low)
        for count in range(math.ceil(low - phase - ROUNDING), math.floor(high - phase + ROUNDING) + 1):
            spots = (*motion.spots[-8:], (float(now), count + phase))
            if motion.run < 2:
                yield replace(motion, spots=spots, run=motion.run + 1, chance=chance, joined=chance)
            else:
                residual = count + phase - (low + high) / 2
                m, least, most = motion.residuals
                more = m + 1, min(least, residual), max(most, residual)
                yield replace(motion, spots=spots, run=motion.run + 1, chance=chance, residuals=more)

    def _window(self, motion: Motion, now: int) -> Point:
        """Where the next sample can be: by eq. 9, or step by step over the hole before the run."""
        e, bound = self.limits.phase_error, self.limits.acceleration
        if motion.run >= 2:
            (_, a), (_, b) = motion.spots[-2:]
            return 2 * b - a - bound - 4 * e, 2 * b - a + bound + 4 * e
        run = dict(motion.spots[len(motion.spots) - motion.run :])
        (t0, x0), (t1, x1) = motion.spots[: len(motion.spots) - motion.run][-2:]
        states = [(x0 - e, x1 - e), (x0 - e, x1 + e), (x0 + e, x1 + e), (x0 + e, x1 - e)]
        gap = t1 - t0
        for t in range(int(t1) + 1, now + 1):
            size = bound * (1.0 + gap) / 2.0
            states = hull([(b, b + (b - a) / gap + way) for a, b in states for way in (-size, size)])
            gap = 1.0
            if t in run:
                states = cut(cut(states, run[t] + e, 1.0), run[t] - e, -1.0)
        return min((b for _, b in states), default=math.inf) - e, max(
            (b for _, b in states), default=-math.inf
        ) + e

    def _decide(self, phase: float, position: float, residual: float, bits: int) -> Published:
        motions = self.motions
        assert motions is not None
        if not motions:
            raise Beyond("none is left")
        counts = {math.floor(one.spots[-1][1]) for one in motions}
        settled = all(one.settled for one in motions)
        one = motions[0]
        if self.only_missing and len(counts) == 1:
            self._count(*one.spots[-2:])
            if settled and len(motions) == 1:
                self._settle(one)
            return self._published(one.spots[-1][1], Bit.VALID, 0.0)
        proven = len(motions) == 1 and settled and not self.only_missing and self._is_proven(one)
        if proven and not self._is_jump(one):
            self._settle(one)
            return self._published(one.spots[-1][1], Bit.VALID, 0.0)
        if proven or (len(motions) > 1 and settled) or self.followed > MOST_INTERVALS:
            self._lose()
            assert self.last is not None
            self._count(self.last, (self.now, position))
            over = residual >= self.limits.residual
            return self._published(position, Bit.LOST | bits | over * Bit.RESIDUAL, residual)
        runs = [one.spots[-1][1] for one in motions if one.run]
        shown = min(runs, key=lambda x: abs(x - position)) if runs else self._predicted()
        return self._published(shown, Bit.COASTING | bits, residual)

    def _settle(self, one: Motion) -> None:
        self._count(*one.spots[-2:])
        self.good = list(one.spots[max(-8, -one.run) :])
        self.motions = None

    def _is_proven(self, one: Motion) -> bool:
        """Random phases, or an input that stands still, would not look like this."""
        if one.probability > CHANCE:
            return False
        here = one.spots[-1][1]

        def stands(spots: Sequence[Point]) -> int:
            """How many of them show the phase of the last sample."""
            return sum(abs((x - here + 0.5) % 1.0 - 0.5) <= 2 * self.limits.phase_error for _, x in spots)

        run = one.spots[max(-9, -one.run) :]
        return stands(run) < len(run) or stands(self.certain) >= 2

    def _is_jump(self, one: Motion) -> bool:
        """All samples back to the contradiction fit this motion, too: what came before was another one."""
        if self.contradicted is None:
            return False
        spots = list(one.spots[max(-9, -one.run) :])
        window = self.limits.acceleration + 4 * self.limits.phase_error
        for t, phase in reversed([one for one in self.contradicted if one[0] < spots[0][0]]):
            (t0, x0), (t1, x1) = spots[:2]
            if (t0 - t, t1 - t0) != (1.0, 1.0):
                raise Beyond("a hole in what is looked back at")
            back = 2 * x0 - x1
            x = round(back - phase) + phase
            if abs(x - back) > window + ROUNDING:
                return False
            spots.insert(0, (float(t), x))
        return True


def merged(motions: Sequence[Motion]) -> list[Motion]:
    """One for all that the next samples cannot tell apart."""
    unique: dict[object, Motion] = {}
    for one in motions:
        key = one.future()
        other = unique.get(key)
        if other is not None:
            common = sum(
                one.spots[-n:] == other.spots[-n:]
                for n in range(1, min(len(one.spots), len(other.spots)) + 1)
            )
            (m, least, most), (n, least_, most_) = one.residuals, other.residuals
            one = replace(
                other,
                spots=other.spots[-common:],
                run=min(one.run, other.run),
                chance=one.chance + other.chance,
                joined=one.joined + other.joined,
                residuals=(min(m, n), min(least, least_), max(most, most_)),
            )
        unique[key] = one
        if len(unique) > MOST_CANDIDATES:
            raise Beyond("more motions than can be followed")
    return list(unique.values())


def hull(points: Sequence[Point]) -> list[Point]:
    """The corners of the convex polygon around these points, in order."""
    around: list[Point] = []
    for some in (sorted(points), sorted(points, reverse=True)):
        side: list[Point] = []
        for x, y in some:
            while len(side) > 1 and (side[-1][0] - side[-2][0]) * (y - side[-2][1]) <= (
                side[-1][1] - side[-2][1]
            ) * (x - side[-2][0]):
                side.pop()
            side.append((x, y))
        around += side[:-1]
    return around


def cut(corners: Sequence[Point], at: float, sign: float) -> list[Point]:
    """What of a polygon has its second coordinate at most (sign 1) or at least (sign -1) ``at``."""
    kept: list[Point] = []
    for (a, b), (c, d) in zip(corners, [*corners[1:], *corners[:1]], strict=True):
        inside, other = sign * (at - b) >= -ROUNDING, sign * (at - d) >= -ROUNDING
        if inside:
            kept.append((a, b))
        if inside is not other:
            part = (at - b) / (d - b)
            kept.append((a + part * (c - a), at))
    return kept
