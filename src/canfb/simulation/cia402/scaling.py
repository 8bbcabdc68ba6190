"""Between the units of the objects and revolutions, seconds and torques."""

from __future__ import annotations

import math

from canfb.device.od.dictionary import Dictionary

_HALF, _FULL = 1 << 31, 1 << 32


def wrapped(value: int) -> int:
    """The INTEGER32 that a count of any size shows as: it wraps."""
    return (value + _HALF) % _FULL - _HALF


def saturated(value: float, bits: int) -> int:
    """The nearest signed integer of this many bits; 0 for NaN."""
    if math.isnan(value):
        return 0
    highest = (1 << (bits - 1)) - 1
    return round(max(-highest - 1, min(highest, value)))


def nearest(target: int, reference: float) -> int:
    """The position, of those that show as the INTEGER32 ``target``, that is next to ``reference``."""
    place = round(reference)
    return place + wrapped(target - place)


class Scaling:
    """Reads the objects that say what a unit is."""

    def __init__(self, dictionary: Dictionary) -> None:
        entry = dictionary.entry
        self._increments, self._turns = entry(0x608F, 1), entry(0x608F, 2)
        self._speed, self._torque, self._rated = entry(0x6080), entry(0x6072), entry(0x6076)
        self._time, self._exponent = entry(0x60C2, 1), entry(0x60C2, 2)

    @property
    def units(self) -> float:
        """Units of position in a revolution, 608Fh."""
        return float(max(1, self._increments.value) / max(1, self._turns.value))

    @property
    def largest_speed(self) -> float:
        """6080h, revolutions per second."""
        return float(self._speed.value / 60.0)

    @property
    def rated_nm(self) -> float:
        """6076h, Nm."""
        return float(max(1, self._rated.value) / 1000.0)

    @property
    def largest_torque_nm(self) -> float:
        """6072h, Nm."""
        return float(self._torque.value / 1000.0 * self.rated_nm)

    def per_mille(self, torque_nm: float) -> int:
        """A torque in 1/1000 of the rated one."""
        return saturated(1000.0 * torque_nm / self.rated_nm, 16)

    @property
    def interpolation_s(self) -> float:
        """60C2h, seconds; 0.0 for each SYNC."""
        return float(self._time.value * 10.0**self._exponent.value)
