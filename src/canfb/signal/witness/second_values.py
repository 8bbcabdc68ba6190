"""The values of another sensor, one for each SYNC: what came late, twice, not at all, or again."""

from __future__ import annotations

from canfb.signal.second_position import RANGE, SecondScale, step_increments
from canfb.signal.witness.speed_search import PHASE_CYCLES
from canfb.signal.witness.witness import Pair

MOST_LATE = 3  # intervals by which a value may be late and is still known as that
ON_TIME_VALUES = 100  # in a row that fit their own sample: they are not late
SUDDEN_CYCLES = 0.5  # a value that moved so far in one interval and then repeats itself is frozen
STILL_CYCLES = 0.25
STILL_PAIRS = 8


class SecondValues:
    """Unwraps them, and says which of them mean something.

    missing       intervals in a row without a certain value
    late          missing values: those that come may be late by as many intervals
    is_ambiguous  the sensor may have turned by more than half of its range: where it stands is not known
    """

    def __init__(self, scale: SecondScale) -> None:
        self._scale = scale
        self.restart()

    def restart(self, keep: bool = False) -> None:
        if not keep:
            self._last: int | None = None
            self._increments = 0
        self.missing = self.late = 0
        self.is_ambiguous = False
        self._begun = False
        self._on_time = 0  # values in a row that fitted their own sample
        self._step = 0  # the last one
        self._is_frozen = False
        self._since: Pair | None = None  # the first pair with this value
        self.restart_standstill()

    def restart_standstill(self) -> None:
        self._still: Pair | None = None
        self._still_pairs = 0

    def take(self, values: int, increments: int) -> int | None:
        """The value of an interval with this number of ``values``, unwrapped; None: not certain."""
        self.is_ambiguous = False
        if values != 1:
            if self._begun:
                self.late = max(0, min(MOST_LATE, self.late + 1 - max(values, 0)))
            self._on_time = 0
            self.missing += 1
            return None
        step = 0 if self._last is None else step_increments(self._last, increments)
        intervals, self.missing = self.missing + 1, 0
        begun, self._begun = self._begun, True
        self.is_ambiguous = max(abs(step), abs(self._step) * intervals) > RANGE // 4
        self._last = increments
        self._increments += step
        if step:
            self._step = step // intervals if begun else 0
            self._is_frozen, self._since = False, None
        else:
            increment = self._scale.step_cycles
            self._is_frozen |= abs(self._step) * increment > max(SUDDEN_CYCLES, 2.0 * increment)
        return self._increments

    def fits(self, fits_earlier: bool) -> None:
        """The last value fits its own sample, and perhaps an earlier one, if it is late."""
        self._on_time += 1
        if not fits_earlier or self._on_time >= ON_TIME_VALUES:
            self.late = 0

    def is_stale(self, pair: Pair, moving: bool) -> bool:
        """The value is the one before again, although the machine has moved.

        ``moving``: the position of the pair is right; else only its phase is.
        """
        self._since = since = self._since or pair
        moved = (pair.cycles - since.cycles) + (pair.phase - since.phase)
        if not moving:
            moved -= round(moved)
        allowed = self._scale.step_cycles + STILL_CYCLES + (0.0 if moving else PHASE_CYCLES)
        return abs(moved) > allowed or (self._is_frozen and not moving)

    def stands_still(self, pair: Pair) -> bool:
        """Neither sensor has moved for :data:`STILL_PAIRS` pairs, this one the last."""
        first, scale = self._still, self._scale
        if first is not None:
            moved = (pair.cycles - first.cycles) + (pair.phase - first.phase)
            other = abs(scale.moved_cycles(first, pair))
            if abs(moved) <= STILL_CYCLES and other <= max(STILL_CYCLES, 2.0 * scale.step_cycles):
                self._still_pairs += 1
                return self._still_pairs >= STILL_PAIRS
        self._still, self._still_pairs = pair, 1
        return False
