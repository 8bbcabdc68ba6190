"""Cycle count by second-order prediction (paper, eq. 9) with error detection (eq. 12).

i(k) = 2 i(k-1) - i(k-2) + round(2 p(k-1) - p(k-2) - p(k)) is exact over any range. Between samples that are
not one interval apart the last speed is carried over the elapsed intervals.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from canfb.signal.phase import FloatArray

RESIDUAL_LIMIT = 1.0 / 3.0
NOT_USUAL = -1.0  # in place of a residual
MOST_SPEED_CYCLES = float(1 << 31)  # at a start: beyond it a float holds too little of the phase


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
    size. The first step differs from that by less than half a cycle; a start at another speed is wrong by
    whole cycles per sample, and eq. 12 shows it at the second sample at most. From then on only the change of
    speed is limited (eq. 10). ``residual_limit`` in cycles, 0 < limit <= 0.5 (eq. 12; the paper: 1/3).
    ValueError otherwise.
    """

    __slots__ = (
        "_gap",
        "_phase",
        "_phase_before",
        "_start_speed",
        "_started",
        "_step",
        "cycles",
        "elapsed",
        "residual_limit",
        "step_cycles",
    )

    def __init__(self, residual_limit: float = RESIDUAL_LIMIT, speed_cycles: float = 0.0) -> None:
        self.residual_limit = check_residual_limit(residual_limit)
        self.restart(0, speed_cycles)

    def restart(self, cycles: int = 0, speed_cycles: float = 0.0) -> None:
        """Forget the phase; the next one starts with this cycle count and speed (cycles per sample).
        ValueError for a speed that is not finite or above 2**31 in size.
        """
        self._start_speed = check_speed(speed_cycles)
        self.cycles = cycles
        """Cycle count of the last sample, i(k-1)."""
        self._step = 0  # i(k-1) - i(k-2)
        self._phase = 0.0  # p(k-1)
        self._phase_before = 0.0  # p(k-2)
        self.elapsed = 1.0  # intervals between samples k-2 and k-1
        self._gap = 0.0  # intervals since sample k-1 that brought no phase
        self._started = False
        self.step_cycles = 0.0
        """Speed between the last two samples, in cycles per sampling interval."""

    def halt(self) -> None:
        """Keep the position and forget the speed."""
        self._step, self._phase_before = 0, self._phase
        self.elapsed, self._gap = 1.0, 0.0
        self._find_speed()

    def rescale(self, factor: float) -> None:
        """Count intervals in another unit, ``factor`` times as many."""
        self.elapsed *= factor
        self._gap *= factor
        self._find_speed()

    @property
    def started(self) -> bool:
        """True once there was a phase."""
        return self._started

    @property
    def places(self) -> tuple[Track, Track, float]:
        """The last two samples that were taken, and the intervals between them."""
        before = Track(self.cycles - self._step, self._phase_before, 0.0, True)
        return before, Track(self.cycles, self._phase, 0.0, True), self.elapsed

    @property
    def is_steady(self) -> bool:
        """The next sample is one interval after two that were one interval apart."""
        return self._started and self._gap == 0.0 and self.elapsed == 1.0

    def state(self) -> tuple[float, float, int, int]:
        """(p(k-2), p(k-1), i(k-1), i(k-1) - i(k-2)) of a steady tracker."""
        return self._phase_before, self._phase, self.cycles, self._step

    def set_state(self, phase_before: float, phase: float, cycles: int, step: int) -> None:
        """Set what :meth:`state` gives; the tracker is steady then.

        ``phase_before``, ``phase``: of the last two samples; ``step``: cycles between them; ``cycles``: the
        count of the last.
        """
        self._started, self.elapsed, self._gap = True, 1.0, 0.0
        self._phase_before, self._phase, self.cycles, self._step = phase_before, phase, cycles, step
        self._find_speed()

    def set_places(self, before: Track, last: Track, elapsed: float) -> None:
        """Go on from two samples, ``before`` and ``last``, ``elapsed`` intervals apart."""
        self.set_state(before.phase, last.phase, last.cycles, last.cycles - before.cycles)
        self.elapsed = elapsed
        self._find_speed()

    def shift(self, cycles: int, step_cycles: int) -> None:
        """Add ``cycles`` to the cycle count, and ``step_cycles`` per interval to the speed."""
        self.cycles += cycles
        self._step += round(step_cycles * self.elapsed)
        self._find_speed()

    def update(self, phase: float, elapsed: float = 1.0) -> Track:
        """Take one phase, ``elapsed`` > 0 sampling intervals after the one before, and track it.

        ``phase`` in cycles, 0 <= phase < 1; NaN: a sample without one, the position is then the predicted
        one, not ok. Raises ValueError outside these ranges. The count follows the phase even if the
        residual is over the limit, as in the paper; the sample is then not ok.
        """
        if not 0.0 <= phase < 1.0 and phase == phase:
            raise ValueError(f"phase must be 0 <= phase < 1 cycle, not {phase!r}")
        if not 0.0 < elapsed < math.inf:
            raise ValueError(f"elapsed must be a positive number of sampling intervals, not {elapsed!r}")
        track = self.look(phase, elapsed)
        if phase == phase:
            self.accept(track, elapsed)
        else:
            self.skip(elapsed)
        return track

    def look(self, phase: float, elapsed: float = 1.0) -> Track:
        """Result of :meth:`update` for this phase, without a change. Arguments unchecked."""
        if phase != phase:
            return self.predict(elapsed)
        if not self._started:
            return Track(self.cycles, phase, 0.0, True)
        elapsed += self._gap
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
        """:meth:`look` and :meth:`accept` in one, for a sample whose residual is below ``limit``.

        Only for a tracker that has started, and not behind a gap. The result is its residual; NOT_USUAL, and
        nothing changed, for any other.
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
        if self._started:
            self._step = track.cycles - self.cycles
            self._phase_before = self._phase
            self.elapsed = elapsed + self._gap
        else:
            self._started = True
            whole, self._phase_before = split(track.phase - self._start_speed)
            self._step = -whole
        self.cycles = track.cycles
        self._phase = track.phase
        self._gap = 0.0
        self._find_speed()

    def skip(self, elapsed: float = 1.0) -> None:
        """Step over a sample without a usable phase; the next prediction spans the gap."""
        if self._started:
            self._gap += elapsed

    def predict(self, elapsed: float = 1.0) -> Track:
        """Position after ``elapsed`` intervals at the last speed; residual 0.5, never ok."""
        if not self._started:
            return Track(self.cycles, 0.0, 0.5, False)
        whole, part = self._carry(elapsed + self._gap)
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

    cycles: npt.NDArray[np.int64]
    phase: FloatArray
    residual: FloatArray
    ok: npt.NDArray[np.bool_]

    @classmethod
    def empty(cls, samples: int) -> TrackResult:
        """Arrays of this length, any content."""
        return cls(
            np.empty(samples, np.int64), np.empty(samples), np.empty(samples), np.empty(samples, np.bool_)
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
