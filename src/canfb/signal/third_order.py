"""Cycle count by third-order prediction: constant acceleration in place of the constant speed of eq. 9.

It goes beyond the paper. The position is extrapolated by the parabola through the last three samples,

    i(k) = 3 i(k-1) - 3 i(k-2) + i(k-3) + round(3 p(k-1) - 3 p(k-2) + p(k-3) - p(k)),

in exact integers as eq. 9. So the jerk is limited, to half a cycle per interval cubed, and not the
acceleration. Samples that are not one interval apart are extrapolated by divided differences (Newton).

The residual is a third difference. An error of one phase is in it once, three times, three times and once
(eq. 12: once, twice, once): errors of the phase count up to eight times, not four times.
"""

from __future__ import annotations

import math
from typing import Any

from canfb.signal.tracker import NOT_USUAL, RESIDUAL_LIMIT, Track, Tracker, split

SECOND, THIRD = 2, 3
ORDERS = (SECOND, THIRD)


class ThirdOrderTracker(Tracker):
    """The recursion with constant acceleration, one sample at a time; otherwise as :class:`Tracker`.

    It starts as :class:`Tracker` does: the second sample is less than half a cycle from the speed at the
    start. The third one is predicted by eq. 9, so the speed changes by less than half a cycle there. From
    then on only the change of the acceleration is limited. A start at another acceleration gives an
    acceleration that is wrong by whole cycles per interval squared, and no residual shows it.

    ``start_limit`` is the residual limit of the samples that eq. 9 predicts, cycles; ``acceleration_limit``
    the largest acceleration that :meth:`follow` takes, cycles per interval squared.
    """

    __slots__ = (
        "_bend",
        "_elapsed_before",
        "_known",
        "_phase_third",
        "_steady",
        "acceleration_limit",
        "order",
        "start_limit",
    )

    def __init__(self, residual_limit: float = RESIDUAL_LIMIT, speed_cycles: float = 0.0) -> None:
        super().__init__(residual_limit, speed_cycles)
        self.start_limit = self.residual_limit
        self.acceleration_limit = math.inf

    def restart(self, cycles: int = 0, speed_cycles: float = 0.0) -> None:
        """As :meth:`Tracker.restart`."""
        super().restart(cycles, speed_cycles)
        self.order = THIRD
        """THIRD; SECOND: eq. 9 predicts until :meth:`predict_by` is called again."""
        self._bend = 0  # i(k-1) - 2 i(k-2) + i(k-3)
        self._phase_third = 0.0  # p(k-3)
        self._elapsed_before = 1.0  # intervals between samples k-3 and k-2
        self._known = 0  # samples, up to 3
        self._steady = False

    def predict_by(self, order: int) -> None:
        """Predict by this order from now on. The acceleration is forgotten: eq. 9 predicts one sample."""
        self.order = order
        self._known = min(self._known, 2)
        self._steady = False

    def take_over(self, old: Tracker) -> None:
        """As :meth:`Tracker.take_over`; eq. 9 predicts two samples, for the acceleration is not known yet."""
        super().take_over(old)
        self._known = int(self._started)

    def halt(self) -> None:
        """Keep the position and forget speed and acceleration."""
        super().halt()
        self._known, self._steady = min(self._known, 1), False

    def rescale(self, factor: float) -> None:
        """As :meth:`Tracker.rescale`."""
        super().rescale(factor)
        self._elapsed_before *= factor
        self._find_steady()

    @property
    def is_steady(self) -> bool:
        """True if the next sample is one interval after samples that were one interval apart."""
        return self._steady if self.order == THIRD else super().is_steady

    @property
    def speed_limit(self) -> float:
        """Residual limit of a sample that eq. 9 predicts, cycles.

        1/3 at most while it predicts all: an acceleration that grows is seen on its way from 1/3 to 2/3.
        """
        return self.start_limit if self.order == THIRD else min(self.start_limit, RESIDUAL_LIMIT)

    @property
    def known(self) -> int:
        """So many of the last samples predict the next one: 3, fewer after a start."""
        return self._known

    @property
    def elapsed_before(self) -> float:
        """Intervals between the two samples before the last one."""
        return self._elapsed_before

    def snapshot(self) -> tuple[float | int, ...]:
        """As :meth:`Tracker.snapshot`."""
        return self.full_state() if self.order == THIRD else self.state()

    def restore(self, snapshot: tuple[Any, ...]) -> None:
        """As :meth:`Tracker.restore`."""
        self.set_full_state(*snapshot) if self.order == THIRD else self.set_state(*snapshot)

    def full_state(self) -> tuple[float, float, float, int, int, int]:
        """(p(k-3), p(k-2), p(k-1), i(k-1), first and second difference of i) of a steady tracker."""
        return self._phase_third, self._phase_before, self._phase, self.cycles, self._step, self._bend

    def set_full_state(
        self, third: float, before: float, phase: float, cycles: int, step: int, bend: int
    ) -> None:
        """Set what :meth:`full_state` gives; the tracker is steady then.

        ``third``, ``before`` and ``phase`` are those of the last three samples, ``step`` the cycles from one
        to the next, and ``bend`` by how many these differ from those before.
        """
        super().set_state(before, phase, cycles, step)
        self._phase_third, self._bend = third, bend
        self._elapsed_before, self._known = 1.0, 3
        self._find_steady()

    def set_state(self, phase_before: float, phase: float, cycles: int, step: int) -> None:
        """As :meth:`Tracker.set_state`; the acceleration is not known."""
        super().set_state(phase_before, phase, cycles, step)
        self._known, self._steady = 2, False

    def set_three(
        self, third: Track, before: Track, last: Track, elapsed_before: float, elapsed: float
    ) -> None:
        """Go on from three samples, ``third``, ``before`` and ``last``, oldest first.

        ``elapsed_before`` intervals are between the first two, ``elapsed`` between the last two.
        """
        self.set_places(before, last, elapsed)
        self._phase_third, self._elapsed_before = third.phase, elapsed_before
        self._bend = self._step - (before.cycles - third.cycles)
        self._known = 3
        self._find_steady()

    def shift(self, cycles: int, step_cycles: int) -> None:
        """As :meth:`Tracker.shift`; the acceleration stays."""
        step = self._step
        super().shift(cycles, step_cycles)
        self._bend += self._step - step - round(step_cycles * self._elapsed_before)

    def look(self, phase: float, elapsed: float = 1.0) -> Track:
        """As :meth:`Tracker.look`."""
        if phase != phase or not self._started or not self._by_parabola:
            track = super().look(phase, elapsed)
            return track if phase != phase else track._replace(ok=track.residual < self.speed_limit)
        elapsed += self._gap
        if elapsed == self._elapsed == self._elapsed_before:
            cycles = self.cycles + self._step + self._bend
            c = 3.0 * (self._phase - self._phase_before) + self._phase_third - phase
        else:
            whole, c = self._carry_on(elapsed)
            cycles = self.cycles + whole
            c = self._phase + c - phase
        turns = round(c)
        residual = abs(turns - c)
        return Track(cycles + turns, phase, residual, residual < self.residual_limit)

    def advance(self, phase: float) -> float:
        """As :meth:`Tracker.advance`; NOT_USUAL also where the acceleration is over its limit."""
        if not self._steady:
            return NOT_USUAL
        before, earlier = self._phase, self._phase_before
        c = 3.0 * (before - earlier) + self._phase_third - phase
        turns = round(c)
        residual = abs(turns - c)
        if not residual < self.residual_limit:
            return NOT_USUAL
        bend = self._bend + turns
        step = self._step + bend
        speed = step + (phase - before)
        if not abs(speed - self.step_cycles) < self.acceleration_limit:
            return NOT_USUAL
        self._bend, self._step = bend, step
        self.cycles += step
        self.step_cycles = speed
        self._phase_third = earlier
        self._phase_before = before
        self._phase = phase
        return residual

    def accept(self, track: Track, elapsed: float = 1.0) -> None:
        """As :meth:`Tracker.accept`."""
        if self._started:
            step = self._step
            self._phase_third, self._elapsed_before = self._phase_before, self._elapsed
            super().accept(track, elapsed)
            self._bend = self._step - step
            self._known = min(self._known + 1, 3)
        else:
            super().accept(track, elapsed)
            self._known = 1
        self._find_steady()

    def skip(self, elapsed: float = 1.0) -> None:
        """Step over ``elapsed`` intervals, as :meth:`Tracker.skip`."""
        super().skip(elapsed)
        self._steady = False

    def predict(self, elapsed: float = 1.0) -> Track:
        """Position after ``elapsed`` intervals with the last acceleration; residual 0.5, never ok."""
        if not self._started or not self._by_parabola:
            return super().predict(elapsed)
        whole, part = self._carry_on(elapsed + self._gap)
        turns, phase = split(self._phase + part)
        return Track(self.cycles + whole + turns, phase, 0.5, False)

    @property
    def _by_parabola(self) -> bool:
        return self.order == THIRD and self._known == 3

    def _find_steady(self) -> None:
        self._steady = self._by_parabola and self._gap == 0.0 and self._elapsed == self._elapsed_before == 1.0

    def _carry_on(self, elapsed: float) -> tuple[int, float]:
        """Displacement on the parabola over ``elapsed`` intervals: whole cycles and a small rest."""
        weight, weight_before = step_weights(elapsed, self._elapsed, self._elapsed_before)
        displacement = self._step * weight - (self._step - self._bend) * weight_before
        whole = math.floor(displacement)
        rest = (self._phase - self._phase_before) * weight
        return whole, (displacement - whole) + rest - (self._phase_before - self._phase_third) * weight_before


def step_weights(elapsed: float, last: float, before: float) -> tuple[float, float]:
    """How often the last step, and less the one before it, count in the displacement over ``elapsed``.

    ``last`` and ``before`` are the intervals that these two steps took. 2 and 1 where all are equal.
    """
    curved = elapsed * (elapsed + last) / (last + before)
    return (elapsed + curved) / last, curved / before


def tracker_of(order: int, residual_limit: float = RESIDUAL_LIMIT, speed_cycles: float = 0.0) -> Tracker:
    """A tracker that predicts by this order, 2 or 3. ValueError for another one."""
    kind = ThirdOrderTracker if check_order("order", order) == THIRD else Tracker
    return kind(residual_limit, speed_cycles)


def check_order(name: str, order: object) -> int:
    """``order`` if it is 2 or 3; else ValueError, which calls it ``name``."""
    if isinstance(order, bool) or not isinstance(order, int) or order not in ORDERS:
        raise ValueError(f"{name} must be 2 (constant speed) or 3 (constant acceleration), not {order!r}")
    return order
