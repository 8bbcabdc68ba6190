"""Cycle count by second-order prediction (paper, eq. 9) with error detection (eq. 12).

i(k) = 2 i(k-1) - i(k-2) + round(2 p(k-1) - p(k-2) - p(k)) is exact over any range. At uneven intervals, the
last speed is extrapolated over the elapsed time.

Over arrays the result is the same bit for bit: the cycle count is a double cumulative sum of integers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from operator import index
from typing import NamedTuple

import numpy as np

from canfb.signal.blocks import Scratch, blocks
from canfb.signal.phase import ArrayLike, BoolArray, FloatArray, IntArray, real_array

RESIDUAL_LIMIT = 1.0 / 3.0
NOT_USUAL = -1.0  # in place of a residual, from Tracker.advance
MOST_SPEED_CYCLES = float(1 << 31)  # at a start; a larger float leaves too few bits for the phase


class Track(NamedTuple):
    """Position after one sample.

    cycles      cycle count, int
    phase       phase within the cycle, 0 <= phase < 1
    residual    |round(c) - c| of eq. 12 in cycles, 0..0.5
    ok          residual < residual limit, and there was a phase
    """

    cycles: int
    phase: float
    residual: float
    ok: bool


class Tracker:
    """The recursion of eq. 9, one sample at a time.

    It starts at cycle count 0 with the first phase and ``speed_cycles``, cycles per sample, at most 2**31 in
    size. The true speed must be within half a cycle per sample of that: else the speed stays wrong by whole
    cycles per sample, which eq. 12 can show at the second sample only. From then on only the change of speed
    is limited (eq. 10). ``residual_limit`` in cycles, 0 < limit <= 0.5 (eq. 12; the paper: 1/3). ValueError
    otherwise.
    """

    __slots__ = (
        "_phase",
        "_phase_before",
        "_start_speed",
        "_step",
        "cycles",
        "elapsed",
        "gap",
        "residual_limit",
        "started",
        "step_cycles",
    )

    def __init__(self, residual_limit: float = RESIDUAL_LIMIT, speed_cycles: float = 0.0) -> None:
        self.residual_limit = check_residual_limit(residual_limit)
        self.restart(0, speed_cycles)

    def restart(self, cycles: int = 0, speed_cycles: float = 0.0) -> None:
        """Forget the phase; the next one starts at this cycle count and speed (cycles per sample).
        ValueError for a speed that is not finite or above 2**31 in size.
        """
        self._start_speed = check_speed(speed_cycles)
        self.cycles = index(cycles)
        """Cycle count of the last sample, i(k-1)."""
        self._step = 0  # i(k-1) - i(k-2)
        self._phase = 0.0  # p(k-1)
        self._phase_before = 0.0  # p(k-2)
        self.elapsed = 1.0  # intervals between samples k-2 and k-1
        self.gap = 0.0  # intervals since sample k-1 without a phase that was counted
        self.started = False
        """True once there was a phase."""
        self.step_cycles = 0.0
        """Speed between the last two samples, in cycles per sampling interval."""

    def halt(self) -> None:
        """Keep the position and forget the speed."""
        self._step, self._phase_before = 0, self._phase
        self.elapsed, self.gap = 1.0, 0.0
        self._find_speed()

    def rescale(self, factor: float) -> None:
        """Count intervals in a unit that is shorter by ``factor``."""
        self.elapsed *= factor
        self.gap *= factor
        self._find_speed()

    @property
    def places(self) -> tuple[Track, Track, float]:
        """The last two samples that were taken, and the intervals between them."""
        before = Track(self.cycles - self._step, self._phase_before, 0.0, True)
        return before, Track(self.cycles, self._phase, 0.0, True), self.elapsed

    @property
    def is_steady(self) -> bool:
        """True if the last two samples are one interval apart, without a gap after them."""
        return self.started and self.gap == 0.0 and self.elapsed == 1.0

    def set_places(self, before: Track, last: Track, elapsed: float = 1.0) -> None:
        """Continue from two samples, ``before`` and ``last``, ``elapsed`` intervals apart."""
        self.started, self.elapsed, self.gap = True, elapsed, 0.0
        self._phase_before, self._phase = before.phase, last.phase
        self.cycles, self._step = last.cycles, last.cycles - before.cycles
        self._find_speed()

    def go_on(self, result: TrackResult, stop: int) -> None:
        """Continue after ``result[:stop]``, ``stop`` > 0: samples that were counted one interval apart."""
        new = range(max(0, stop - 2), stop)
        counted = (Track(int(result.cycles[at]), float(result.phase[at]), 0.0, True) for at in new)
        *_, before, last = self.places[1], *counted
        self.set_places(before, last)

    def shift(self, cycles: int, step_cycles: int) -> None:
        """Add ``cycles`` to the cycle count, and ``step_cycles`` per interval to the speed."""
        self.cycles += cycles
        self._step += round(step_cycles * self.elapsed)
        self._find_speed()

    def update(self, phase: float, elapsed: float = 1.0) -> Track:
        """Take one phase, ``elapsed`` > 0 sampling intervals after the one before, and track it.

        ``phase`` in cycles, 0 <= phase < 1. NaN: the sample has no phase; the result is the predicted
        position, not ok. As in the paper, the count follows the phase even if the residual is over the limit;
        the sample is then not ok. ValueError outside these ranges.
        """
        if not 0.0 <= phase < 1.0 and phase == phase:
            raise ValueError(f"phase must be 0 <= phase < 1 cycle, not {phase!r}")
        if not 0.0 < elapsed < math.inf:
            raise ValueError(f"elapsed must be a positive number of sampling intervals, not {elapsed!r}")
        track = self.look(float(phase), elapsed)
        if phase == phase:
            self.accept(track, elapsed)
        else:
            self.skip(elapsed)
        return track

    def look(self, phase: float, elapsed: float = 1.0) -> Track:
        """The result of :meth:`update`, without a change of state. Arguments are not checked."""
        if phase != phase:
            return self.predict(elapsed)
        if not self.started:
            return Track(self.cycles, phase, 0.0, True)
        elapsed += self.gap
        if elapsed == self.elapsed:
            cycles = self.cycles + self._step
            c = 2.0 * self._phase - self._phase_before - phase
        else:
            whole, c = self._carry(elapsed)
            cycles = self.cycles + whole
            c = self._phase + c - phase
        turns = round(c)
        residual = abs(turns - c)
        return Track(cycles + turns, phase, residual, residual < self.residual_limit)

    def advance(self, phase: float, elapsed: float, limit: float) -> float:
        """:meth:`look` and :meth:`accept` in one, if the residual is below ``limit``: returns the residual.

        Otherwise returns NOT_USUAL and changes nothing. Only after a start, and not after a gap.
        """
        before = self._phase
        if elapsed == self.elapsed:
            whole, c = self._step, 2.0 * before - self._phase_before - phase
        else:
            whole, c = self._carry(elapsed)
            c = before + c - phase
        turns = round(c)
        residual = abs(turns - c)
        if not residual < limit:
            return NOT_USUAL
        self._step = step = whole + turns
        self.cycles += step
        self.step_cycles = (step + (phase - before)) / elapsed
        self._phase_before, self._phase, self.elapsed = before, phase, elapsed
        return residual

    def accept(self, track: Track, elapsed: float = 1.0) -> None:
        """Make ``track``, from :meth:`look`, the last sample of the recursion."""
        if self.started:
            self._step = track.cycles - self.cycles
            self._phase_before = self._phase
            self.elapsed = elapsed + self.gap
        else:
            self.started = True
            whole, self._phase_before = split(track.phase - self._start_speed)
            self._step = -whole
        self.cycles = track.cycles
        self._phase = track.phase
        self.gap = 0.0
        self._find_speed()

    def skip(self, elapsed: float = 1.0) -> None:
        """Pass a sample without a usable phase; the next prediction spans the gap."""
        self.gap += elapsed

    def predict(self, elapsed: float = 1.0) -> Track:
        """Position after ``elapsed`` intervals at the last speed; residual 0.5, never ok."""
        if not self.started:
            return Track(self.cycles, 0.0, 0.5, False)
        whole, part = self._carry(elapsed + self.gap)
        turns, phase = split(self._phase + part)
        return Track(self.cycles + whole + turns, phase, 0.5, False)

    def _find_speed(self) -> None:
        self.step_cycles = (self._step + (self._phase - self._phase_before)) / self.elapsed

    def _carry(self, elapsed: float) -> tuple[int, float]:
        ratio = elapsed / self.elapsed
        displacement = self._step * ratio
        whole = math.floor(displacement)
        return whole, (displacement - whole) + (self._phase - self._phase_before) * ratio


@dataclass(frozen=True)
class TrackResult:
    """Positions of an array of samples: arrays of one length, as the fields of :class:`Track`.

    cycles int64, phase float64 (cycles), residual float64 (cycles, 0..0.5), ok bool.
    """

    cycles: IntArray
    phase: FloatArray
    residual: FloatArray
    ok: BoolArray

    @classmethod
    def empty(cls, samples: int) -> TrackResult:
        """Arrays of this length, not initialised."""
        return cls(
            np.empty(samples, np.int64), np.empty(samples), np.empty(samples), np.empty(samples, np.bool_)
        )

    def part(self, samples: slice) -> TrackResult:
        """Views of these samples."""
        return TrackResult(
            self.cycles[samples], self.phase[samples], self.residual[samples], self.ok[samples]
        )


def split(position: float) -> tuple[int, float]:
    """A position in cycles as whole cycles and phase, 0 <= phase < 1."""
    whole = math.floor(position)
    phase = position - whole
    return (whole, phase) if phase < 1.0 else (whole + 1, 0.0)


def check_speed(speed_cycles: float) -> float:
    """``speed_cycles`` as a float if it is a speed to start with, cycles per sample; else ValueError."""
    if (
        not isinstance(speed_cycles, (int, float, np.number))
        or isinstance(speed_cycles, (bool, np.complexfloating))
        or not abs(speed_cycles) <= MOST_SPEED_CYCLES
    ):
        raise ValueError(
            f"speed_cycles must be a number of cycles per sample, at most 2**31 in size, not {speed_cycles!r}"
        )
    return float(speed_cycles)


def check_residual_limit(limit: float) -> float:
    """``limit`` as a float if 0 < limit <= 0.5, ValueError otherwise (eq. 12)."""
    if not isinstance(limit, (int, float, np.floating)) or not 0.0 < limit <= 0.5:
        raise ValueError(f"residual_limit must be above 0 and at most 0.5 cycle, not {limit!r}")
    return float(limit)


def track(phase: ArrayLike, residual_limit: float = RESIDUAL_LIMIT, speed_cycles: float = 0.0) -> TrackResult:
    """:class:`Tracker` over an array of phases, vectorised; bit for bit the same result.

    ``phase`` has shape (n,), cycles, 0 <= phase < 1, NaN where a sample has no phase. ``speed_cycles`` is
    the speed at the first phase, cycles per sample. ``ok`` is eq. 12 alone; :func:`canfb.process`
    shows where the position is certain. ValueError for anything else.
    """
    phases = real_array("phase", phase)
    if phases.ndim != 1:
        raise ValueError(f"phase must have one dimension, not {phases.ndim}")
    wrong = np.flatnonzero((phases < 0.0) | (phases >= 1.0))
    if len(wrong):
        raise ValueError(f"phase must be 0 <= phase < 1 cycle, not {phases[wrong[0]]!r} at {wrong[0]}")
    result = TrackResult.empty(len(phases))
    result.phase[:] = phases
    tracker = Tracker(residual_limit, speed_cycles)
    for part, scratch in blocks(len(phases)):
        at = part.start
        np.isnan(phases[part], out=scratch.bit)
        for gap in [*(np.flatnonzero(scratch.bit) + at).tolist(), part.stop]:
            while at < min(gap + 1, part.stop):
                if at < gap and tracker.is_steady:
                    run = result.part(slice(at, gap))
                    count_run(tracker, run, scratch)
                    tracker.go_on(run, gap - at)
                    at = gap
                else:
                    one = tracker.update(float(phases[at]))
                    result.cycles[at], result.phase[at], result.residual[at], result.ok[at] = one
                    at += 1
    return result


def count_run(tracker: Tracker, run: TrackResult, scratch: Scratch) -> None:
    """Count samples one interval apart, all with a phase, by an integer cumulative sum.

    ``tracker`` must be steady, and is not changed.
    """
    before, last, _ = tracker.places
    phase, residual = run.phase, run.residual
    c, turns, steps = (room[: len(phase)] for room in (scratch.a, scratch.b, scratch.index))
    twice = np.multiply(phase, 2.0, out=turns)
    c[0] = 2.0 * last.phase - before.phase
    c[1:2] = twice[:1] - last.phase
    np.subtract(twice[1:-1], phase[:-2], out=c[2:])
    c -= phase
    np.rint(c, out=turns)
    np.subtract(turns, c, out=c)
    np.abs(c, out=residual)
    np.less(residual, tracker.residual_limit, out=run.ok)
    steps[:] = turns
    steps[0] += last.cycles - before.cycles
    np.add.accumulate(steps, out=steps)
    steps[0] += last.cycles
    np.add.accumulate(steps, out=run.cycles)
