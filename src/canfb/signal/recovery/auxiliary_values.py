"""The values of another sensor, one for each SYNC: what came late, twice, not at all, or again."""

from __future__ import annotations

from canfb.signal.recovery.speed_search import PHASE_CYCLES
from canfb.signal.second_position import RANGE, Pair, SecondScale, only_count, step_increments

MOST_LATE = 3  # intervals by which a value may be late and is still known as that
ON_TIME_VALUES = 100  # in a row that fit their own sample: they are not late
SUDDEN_CYCLES = 0.5  # a value that moved so far in one interval and then repeats itself is frozen
AGREEING_VALUES = 8  # in a row with the same shift of the count,
STEADY_CYCLES = 0.1  # and differ by no more: if they drift apart, one does not follow the machine
STILL_CYCLES = 0.25
STILL_PAIRS = 8


class AuxiliaryValues:
    """Unwraps them, and says which of them mean something.

    ``missing`` intervals in a row had no certain value. ``late``: so many values are missing, so that those
    that come may be late by as many intervals. ``is_ambiguous``: the sensor may have turned by more than half
    of its range, and so where it stands is not known any more.
    """

    def __init__(self, scale: SecondScale) -> None:
        self._scale = scale
        self.restart()

    def restart(self, keep: bool = False) -> None:
        """After a start. ``keep``: where the sensor stood still counts."""
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

    def take(self, values: int, increments: int) -> int | None:
        """The value of an interval in which so many came, unwrapped; None if it is not certain."""
        self.is_ambiguous = False
        if values != 1:
            if self._begun:
                self.late = max(0, min(MOST_LATE, self.late + 1 - max(values, 0)))
            self._on_time = 0
            self.missing += 1
            return None
        step = 0 if self._last is None else step_increments(self._last, increments)
        intervals = self.missing + 1
        self.missing = 0
        begun, self._begun = self._begun, True
        self.is_ambiguous = max(abs(step), abs(self._step) * intervals) > RANGE // 4
        self._last = increments
        self._increments += step
        if step == 0:
            self._is_frozen |= abs(self._step) * self._scale.increment_cycles > max(
                SUDDEN_CYCLES, 2.0 * self._scale.increment_cycles
            )
            return self._increments
        self._step = step // intervals if begun else 0
        self._is_frozen = False
        self._since = None
        return self._increments

    def fits(self, fits_earlier: bool) -> None:
        """The last value fits its own sample, and perhaps an earlier one, if it is late."""
        self._on_time += 1
        if not fits_earlier or self._on_time >= ON_TIME_VALUES:
            self.late = 0

    def is_stale(self, pair: Pair, moving: bool) -> bool:
        """The value is the one before again, although the machine has moved: it says nothing.

        ``moving``: the position of the pair is right. Otherwise only its phase is, and a value that stops
        suddenly says nothing either.
        """
        if self._since is None:
            self._since = pair
            return False
        since = self._since
        moved = (pair.cycles - since.cycles) + (pair.phase - since.phase)
        if not moving:
            moved -= round(moved)
        allowed = self._scale.increment_cycles + (STILL_CYCLES if moving else PHASE_CYCLES + STILL_CYCLES)
        return abs(moved) > allowed or (self._is_frozen and not moving)


class CountSearch:
    """The shift of the count in which several values in a row agree, the only one within a limit."""

    def __init__(self, scale: SecondScale) -> None:
        self._steady_cycles = STEADY_CYCLES + 2.0 * scale.increment_cycles
        self.restart()

    def restart(self) -> None:
        """The next value is the first."""
        self._first: tuple[int, float] | None = None
        self._values = 0

    def feed(self, difference_cycles: float, limit_cycles: float) -> int | None:
        """The shift, None as long as it is not certain."""
        shift_cycles, first = only_count(difference_cycles, limit_cycles), self._first
        if shift_cycles is None:
            self.restart()
            return None
        if (
            first is None
            or first[0] != shift_cycles
            or abs(first[1] - difference_cycles) > self._steady_cycles
        ):
            self._first, self._values = (shift_cycles, difference_cycles), 1
            return None
        self._values += 1
        return shift_cycles if self._values >= AGREEING_VALUES else None


class Standstill:
    """Neither sensor has moved for :data:`STILL_PAIRS` pairs."""

    def __init__(self, scale: SecondScale) -> None:
        self._scale = scale
        self.restart()

    def restart(self) -> None:
        """Nothing is known."""
        self._first: Pair | None = None
        self._pairs = 0

    def feed(self, pair: Pair) -> bool:
        """True if the machine stands still at this pair."""
        first, scale = self._first, self._scale
        if first is not None:
            moved = (pair.cycles - first.cycles) + (pair.phase - first.phase)
            other = abs(scale.moved_cycles(first, pair))
            if abs(moved) <= STILL_CYCLES and other <= max(STILL_CYCLES, 2.0 * scale.increment_cycles):
                self._pairs += 1
                return self._pairs >= STILL_PAIRS
        self._first, self._pairs = pair, 1
        return False
