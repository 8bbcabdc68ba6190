"""From cycles to measuring units: position, speed, acceleration (CiA 406)."""

from __future__ import annotations

import math
from collections.abc import Callable

from canfb import objects as od
from canfb.device.od.dictionary import Dictionary, Entry
from canfb.module.interval import SamplingInterval
from canfb.signal.sample import Feedback

PHASE_UNITS = 1 << 32  # 2011:03 counts the phase in 1/2^32 cycle
PHASE_SCALE = float(PHASE_UNITS)
MAX_UNITS_PER_CYCLE = 8192  # a 12-bit converter resolves 1/5800 cycle
U32 = 0xFFFFFFFF


def single_turn_resolution(cycles_per_revolution: int) -> int:
    """6501h, units per revolution without scaling: 8192 per cycle, fewer beyond 32 bits."""
    units = MAX_UNITS_PER_CYCLE
    while cycles_per_revolution * units > U32:
        units //= 2
    return cycles_per_revolution * units


def distinguishable_revolutions(resolution: int) -> int:
    """6502h: whole revolutions that 6002h can hold."""
    return min(U32 // resolution, 0xFFFF)


class PositionScale:
    """Exact integer scaling of a position to measuring units.

    ``units_per_revolution`` and ``total_range`` are the 6001h and 6002h in force; ``reverse`` is the code
    sequence of 6000h; ``offset`` is 6509h. ``binary`` is the number of units per cycle if that is a power of
    two, else 0: ``cycles * binary + int(phase * binary_factor)`` is :meth:`units`, without long integers.
    """

    __slots__ = (
        "_denominator",
        "_numerator",
        "binary",
        "binary_factor",
        "cycles_per_revolution",
        "offset",
        "total_range",
        "units_per_revolution",
    )

    def __init__(
        self,
        cycles_per_revolution: int,
        units_per_revolution: int,
        total_range: int,
        reverse: bool,
        offset: int,
    ) -> None:
        numerator = -units_per_revolution if reverse else units_per_revolution
        self.cycles_per_revolution = cycles_per_revolution
        self.units_per_revolution = numerator  # negative when the code sequence is reversed
        denominator = cycles_per_revolution * PHASE_UNITS
        # Lowest terms are small for usual resolutions, and long integers take longer to divide.
        common = math.gcd(numerator, denominator)
        self._numerator, self._denominator = numerator // common, denominator // common
        per_cycle, rest = divmod(numerator, cycles_per_revolution)
        is_power = rest == 0 and 0 < per_cycle <= PHASE_UNITS and per_cycle & (per_cycle - 1) == 0
        self.binary = per_cycle if is_power else 0
        self.binary_factor = float(self.binary)
        self.total_range = total_range
        self.offset = offset

    def units(self, cycles: int, phase: float) -> int:
        """Units since the start, unwrapped, rounded down; 0 <= phase < 1."""
        return (cycles * PHASE_UNITS + int(phase * PHASE_SCALE)) * self._numerator // self._denominator

    def position(self, cycles: int, phase: float) -> int:
        """6004h: (units + offset) modulo ``total_range``."""
        return (self.units(cycles, phase) + self.offset) % self.total_range

    def offset_for(self, cycles: int, phase: float, preset: int) -> int:
        """The offset at which 6004h is ``preset``: -R/2 <= offset < R/2, R ``total_range``."""
        offset = (preset - self.units(cycles, phase)) % self.total_range
        return offset - self.total_range if 2 * offset >= self.total_range else offset


SPEED, ACCELERATION = 0x6030, 0x6040
CHANNEL = 1
STILL = Feedback(0.0, 0.0, 0.0, math.nan, 0, 0.0, 0.0, 0, 0.0, 0.0, 0, 0)  # before the first sample


def saturated(value: float, bits: int = 16) -> int:
    """The nearest signed integer of this many bits; 0 for NaN."""
    highest = (1 << bits - 1) - 1
    return 0 if math.isnan(value) else round(max(-highest - 1, min(value, highest)))


def show_motion(
    dictionary: Dictionary,
    interval: SamplingInterval,
    last_valid: Callable[[], Feedback | None],
    scale: Callable[[], PositionScale],
) -> None:
    """Objects 6030h and 6040h of channel 1.

    Measuring units per second times 2003:01 / 2003:02, and per second squared times 2003:03 / 2003:04; a
    divisor of 0 means the measuring units per revolution. Both are those of the last valid position, and 0
    before it or while the sampling interval is not known.
    """
    entry = dictionary.entry
    speed = entry(*od.SCALE_SPEED_MULTIPLIER), entry(*od.SCALE_SPEED_DIVISOR)
    acceleration = entry(*od.SCALE_ACCELERATION_MULTIPLIER), entry(*od.SCALE_ACCELERATION_DIVISOR)

    def scaled(cycles: float, power: int, factor: Entry, divisor: Entry) -> int:
        in_force, time = scale(), interval.sample_s**power
        if interval.sample_s <= 0.0:
            return 0
        per_turn = in_force.units_per_revolution
        units = cycles * per_turn / in_force.cycles_per_revolution
        value = units * factor.value / (divisor.value or abs(per_turn))
        # A tiny interval would overflow: the speed is then beyond any range.
        return saturated(value / time if time > 0.0 else math.copysign(math.inf, value) if value else 0.0)

    dictionary.read_live(
        {
            (SPEED, CHANNEL): lambda: scaled((last_valid() or STILL).speed_cycles, 1, *speed),
            (ACCELERATION, CHANNEL): lambda: scaled(
                (last_valid() or STILL).acceleration_cycles, 2, *acceleration
            ),
        }
    )
