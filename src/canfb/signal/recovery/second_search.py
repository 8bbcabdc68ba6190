"""From pairs of positions of both sensors: the count, and a standstill."""

from __future__ import annotations

from canfb.signal.second_position import Pair, SecondScale, only_count

AGREEING_VALUES = 8  # in a row with the same shift of the count,
STEADY_CYCLES = 0.1  # and differ by no more: if they drift apart, one does not follow the machine
STILL_CYCLES = 0.25
STILL_PAIRS = 8


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
