"""The position of another sensor on the same machine, such as the motor encoder of a drive, in cycles.

Its increments are 32 bits and wrap. One is N d / n cycles, so distances are counted in 1/n cycle, and only
the last result is rounded.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

from canfb.checks import within

if TYPE_CHECKING:
    from canfb.signal.witness.witness import Pair

RANGE = 1 << 32  # increments after which a value wraps
U32 = 0xFFFFFFFF
MOST_TOLERANCE_REVOLUTIONS = 0.25
STEADY_CYCLES = 0.1  # values that agree on a count differ by no more
UNIT_INCREMENTS = 1 << 20  # default per revolution


@dataclass(frozen=True, kw_only=True)
class SecondSensor:
    """The other sensor (2014h); ValueError for a bad value.

    increments               of it in these ``revolutions``, 1..4294967295 (2014:01)
    revolutions              of the encoder, 1..4294967295 (2014:02): above 1 with a gear between the two
    reversed                 True: it counts down where the encoder counts up (2014:03)
    tolerance_revolutions    how far the two positions may differ by compliance, backlash and age of the
                             value, 0..0.25 revolutions of the encoder (2014:04); 0: it is not used
    invalidates              True: the position is not valid while the two disagree (2014:05)
    """

    increments: int = UNIT_INCREMENTS
    revolutions: int = 1
    reversed: bool = False
    tolerance_revolutions: float = 0.0
    invalidates: bool = False

    def __post_init__(self) -> None:
        within(
            self,
            increments=(1, U32),
            revolutions=(1, U32),
            tolerance_revolutions=(0.0, MOST_TOLERANCE_REVOLUTIONS),
            reversed=bool,
            invalidates=bool,
        )


class SecondScale:
    """Distances of the two sensors in cycles."""

    slope = 1.0  # the other sensor drives the machine
    period_cycles = math.inf

    def __init__(self, sensor: SecondSensor, cycles_per_revolution: int) -> None:
        cycles = Fraction(cycles_per_revolution * sensor.revolutions, sensor.increments)
        self._cycles = -cycles.numerator if sensor.reversed else cycles.numerator
        self._per = cycles.denominator
        self.step_cycles = self.noise_cycles = float(cycles)
        """One increment in cycles: how far the truth may be from a value."""
        self.steady_cycles = STEADY_CYCLES + 2.0 * self.step_cycles
        self.tolerance_cycles = sensor.tolerance_revolutions * cycles_per_revolution

    def difference_cycles(self, since: Pair, now: Pair) -> float:
        """How much further the other sensor has moved than the encoder."""
        return self.moved_cycles(since, now, now.cycles - since.cycles) - (now.phase - since.phase)

    def moved_cycles(self, since: Pair, now: Pair, less_cycles: int = 0) -> float:
        """How far the other sensor has moved, cycles, less ``less_cycles``: the nearest float."""
        moved = (int(now.value) - int(since.value)) * self._cycles
        return (moved - less_cycles * self._per) / self._per


def step_increments(before: int, value: int) -> int:
    """From one value, unwrapped or not, to another over the wrap, at most half the range."""
    return (value - before + RANGE // 2) % RANGE - RANGE // 2
