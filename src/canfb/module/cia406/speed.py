"""Speed and acceleration in measuring units (CiA 406, 6030h and 6040h; their scale is 2003h)."""

from __future__ import annotations

import math
from collections.abc import Callable

from canfb import objects as od
from canfb.device.od.dictionary import Dictionary, Entry
from canfb.module.cia406.position import PositionScale
from canfb.module.interval import SamplingInterval
from canfb.signal.feedback import Feedback

SPEED, ACCELERATION = 0x6030, 0x6040
CHANNEL = 1
LOWEST, HIGHEST = -0x8000, 0x7FFF


def saturated(value: float) -> int:
    """The nearest INTEGER16: 7FFFh and 8000h for what is beyond it; 0 for no number."""
    if math.isnan(value):
        return 0
    return round(max(float(LOWEST), min(value, float(HIGHEST))))


class MotionObjects:
    """Objects 6030h and 6040h of channel 1, computed when they are read.

    Measuring units per second, or per second squared, times 2003:01 over 2003:02, or 2003:03 over
    2003:04; a divisor of 0 stands for the measuring units per revolution in force. The defaults give
    min^-1 and revolutions per s^2. Both keep the last value without a valid position, and are 0
    before the first one and while the sampling interval is not known.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        interval: SamplingInterval,
        last_valid: Callable[[], Feedback | None],
        scale: Callable[[], PositionScale],
    ) -> None:
        self._interval, self._last_valid, self._scale = interval, last_valid, scale
        entry = dictionary.entry
        speed = entry(*od.SCALE_SPEED_MULTIPLIER), entry(*od.SCALE_SPEED_DIVISOR)
        acceleration = entry(*od.SCALE_ACCELERATION_MULTIPLIER), entry(*od.SCALE_ACCELERATION_DIVISOR)
        entry(SPEED, CHANNEL).on_read = lambda: self._speed(*speed)
        entry(ACCELERATION, CHANNEL).on_read = lambda: self._acceleration(*acceleration)

    def _speed(self, factor: Entry, divisor: Entry) -> int:
        last, interval_s = self._last_valid(), self._interval.sample_s
        if last is None or interval_s <= 0.0:
            return 0
        return self._scaled(last.speed_cycles, interval_s, factor, divisor)

    def _acceleration(self, factor: Entry, divisor: Entry) -> int:
        last, interval_s = self._last_valid(), self._interval.sample_s
        if last is None or interval_s <= 0.0:
            return 0
        return self._scaled(last.acceleration_cycles, interval_s * interval_s, factor, divisor)

    def _scaled(self, cycles: float, time: float, factor: Entry, divisor: Entry) -> int:
        scale = self._scale()
        per_turn = scale.units_per_revolution
        units = cycles * per_turn / scale.cycles_per_revolution
        value = units * factor.value / (divisor.value or abs(per_turn))
        # A period of next to nothing overflows; it is a speed beyond any range.
        return saturated(value / time if time > 0.0 else math.copysign(math.inf, value) if value else 0.0)
