"""A sensor that knows the position without counting, held against the counted one.

It has a value and a tolerance, and is believed k times in a row. What it may take away: three values beyond
the tolerance contradict the position. What it may give: the speed that the count lacks
(:mod:`.speed_search`), and the count, where just one is within the tolerance, eight times.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

from canfb.signal.witness.speed_search import PHASE_CYCLES, SpeedSearch

DISAGREEING = 3  # values in a row: a single one may be a fault of the bus
HYSTERESIS = 0.75  # a disagreement ends below this part of the tolerance
PROVISIONAL = 2.0  # times the tolerance, for an offset that was learned in motion
AGREEING = 8  # values in a row with the same shift of the count


class Pair(NamedTuple):
    """What both say of one instant.

    cycles, phase   the counted position
    value           of the sensor, unwrapped: increments, or revolutions
    time            sampling intervals since the start
    """

    cycles: int
    phase: float
    value: float | int
    time: float


class WitnessScale(Protocol):
    """Distances of the sensor in cycles.

    tolerance_cycles  how far it may be from the position
    step_cycles       of its value: so far it may be further off
    slope             its error changes by so much of a way, until it is twice the tolerance
    noise_cycles      of a value
    steady_cycles     values that agree on a count differ by no more: if they drift, one does not follow
    period_cycles     period of its value
    """

    tolerance_cycles: float
    step_cycles: float
    slope: float
    noise_cycles: float
    steady_cycles: float
    period_cycles: float

    def moved_cycles(self, since: Pair, now: Pair) -> float:
        """How far the sensor has moved."""

    def difference_cycles(self, since: Pair, now: Pair) -> float:
        """How much further it has moved than the count."""


class Witness:
    """``origin`` is a pair at which both stood for the same place, None: not known; ``firm``: for good."""

    def __init__(self, scale: WitnessScale) -> None:
        self.use(scale)
        self.restart(keep=False)

    def use(self, scale: WitnessScale) -> None:
        self.scale = scale
        self._search = SpeedSearch(scale.slope, 2.0 * scale.tolerance_cycles, scale.noise_cycles)
        self.restart_search()

    def restart(self, keep: bool) -> None:
        if not keep:
            self.forget()
        self.proven = False
        """It has shown the speed since the start."""
        self.disagreeing = 0
        """Values in a row that contradict the position."""
        self.restart_search()

    def forget(self) -> None:
        self.origin: Pair | None = None
        self.firm = False
        self.disagreeing = 0

    def restart_search(self) -> None:
        self._search.restart()
        self._first: Pair | None = None
        self._agreeing, self._shift, self._away = 0, 0, 0.0

    @property
    def disagrees(self) -> bool:
        return self.disagreeing >= DISAGREEING

    @property
    def limit_cycles(self) -> float:
        scale = self.scale
        return scale.tolerance_cycles * (1.0 if self.firm else PROVISIONAL) + scale.step_cycles

    def away_cycles(self, pair: Pair) -> float:
        """How much further the sensor stands than the position; 0.0 while that is not known."""
        if self.origin is None:
            return 0.0
        away, period = self.scale.difference_cycles(self.origin, pair), self.scale.period_cycles
        return away if math.isinf(period) else away - period * math.floor(away / period + 0.5)

    def fits(self, pair: Pair) -> bool:
        """The value is within the tolerance, or within 3/4 of it after one that was not."""
        return abs(self.away_cycles(pair)) <= self.limit_cycles * (HYSTERESIS if self.disagreeing else 1.0)

    def missing_speed(self, pair: Pair) -> int | None:
        """What the counted speed lacks, cycles per interval; None: not certain."""
        self._first = first = self._first or pair
        scale = self.scale
        return self._search.feed(
            pair.time, scale.difference_cycles(first, pair), scale.moved_cycles(first, pair)
        )

    def missing_count(self, pair: Pair) -> tuple[int, bool]:
        """What the count lacks, cycles, and whether that is certain; else it is a count near the sensor."""
        away, limit = self.away_cycles(pair), self.limit_cycles
        shift = only_count(away, limit + PHASE_CYCLES)
        if shift is None:
            self._agreeing = 0
            return (0 if abs(away) <= limit else round(away)), False
        if not self._agreeing or shift != self._shift or abs(away - self._away) > self.scale.steady_cycles:
            self._agreeing, self._shift, self._away = 0, shift, away
        self._agreeing += 1
        return (shift, True) if self._agreeing >= AGREEING else (0, False)


def only_count(away_cycles: float, limit_cycles: float) -> int | None:
    """Whole cycles that bring the rest within the limit; None unless just one."""
    low, high = -(-(away_cycles - limit_cycles) // 1), (away_cycles + limit_cycles) // 1
    return int(low) if low == high else None
