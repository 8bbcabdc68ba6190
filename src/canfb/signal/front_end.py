"""What the analog path does to the tracks at speed: a delay between them, and less amplitude.

A converter with a multiplexer takes the cosine ``cosine_delay_s`` after the sine. At f cycles per second
that turns it by d = 2 pi f cosine_delay: a phase error of ``phase_error - d``, which :class:`Conditioning`
removes exactly. A low-pass with the corner frequency fc leaves A / sqrt(1 + (f / fc)^2); its inverse is a
common gain, so that the limits of the amplitude are those of a slow machine. Where the corner frequencies
differ, so do the gains, and d has arctan(f / fc of the sine) - arctan(f / fc of the cosine) besides.
"""

from __future__ import annotations

import math
from math import atan, sqrt, tan

from canfb.signal.conditioning import Coefficients, Conditioning
from canfb.signal.harmonics import Corners, Row, harmonic_rows

LARGEST_RAD = 1.47  # |d - phase_error|: beyond it the tracks are less than 6 degrees from being the same one
AHEAD_INTERVALS = 1.5  # from the middle of the last interval, whose speed is known, to the next sample
SAME_INTERVAL = 2e-4  # of it


class FrontEnd:
    """Coefficients of a conditioning at a speed, cycles per sampling interval of ``unit_s`` seconds; 0.0:
    not known, and the machine is taken to stand.
    """

    __slots__ = (
        "_conditioning",
        "_corner",
        "_corners",
        "_cosine_corner",
        "_delay",
        "_differ",
        "_gains",
        "_hertz",
        "_offsets",
        "_phase_error",
        "_rows",
        "unit_s",
        "varies",
    )

    def __init__(self, conditioning: Conditioning, corners: Corners) -> None:
        self._conditioning, self._corners = conditioning, corners
        self.use_conditioning(conditioning)
        self._differ = corners.of_cosine_hz != corners.corner_hz
        self._rows = harmonic_rows(conditioning, corners)
        self.varies = self._rows is not None or bool(corners.corner_hz and conditioning.delay_s)
        """More than the coefficients depends on the speed: :meth:`row`, :meth:`lag_intervals`."""
        self.use_interval(0.0)

    def use_conditioning(self, conditioning: Conditioning) -> None:
        used = tuple(map(float, conditioning.values[:5]))
        self._offsets, self._gains, self._phase_error = used[:2], used[2:4], used[4]

    def use_interval(self, unit_s: float) -> None:
        self.unit_s = unit_s
        self._hertz = hertz = 1.0 / unit_s if unit_s > 0.0 else 0.0  # at one cycle per interval
        self._delay = 2.0 * math.pi * hertz * self._conditioning.cosine_delay_s
        corners = self._corners
        self._corner = hertz / corners.corner_hz if corners.corner_hz else 0.0
        self._cosine_corner = hertz / corners.of_cosine_hz if corners.of_cosine_hz else 0.0

    def hertz(self, speed_cycles: float) -> float:
        return speed_cycles * self._hertz

    def turned_rad(self, speed_cycles: float) -> float:
        turned = self._delay * speed_cycles
        if self._differ:
            turned += atan(self._corner * speed_cycles) - atan(self._cosine_corner * speed_cycles)
        return turned

    def row(self, speed_cycles: float) -> Row:
        return () if self._rows is None else self._rows.row(speed_cycles * self._hertz)

    def lag_intervals(self, speed_cycles: float) -> float:
        """2002:07 at this speed: a low-pass delays by arctan(u) / u of it, u = f / fc."""
        if not self._hertz:
            return 0.0
        lag = self._conditioning.delay_s * self._hertz
        ratio = self._corner * speed_cycles
        if ratio:
            lag -= (1.0 - atan(ratio) / ratio) * self._hertz / (2.0 * math.pi * self._corners.corner_hz)
        return lag

    def coefficients(self, speed_cycles: float, amplitude_known: bool = True) -> Coefficients:
        """As :meth:`Conditioning.coefficients`, at this speed; all zero where the delay makes both tracks
        the same.

        With ``amplitude_known`` False the attenuation is left in.
        """
        angle = self._phase_error - self.turned_rad(speed_cycles)
        (offset_s, offset_c), (gain_s, gain_c) = self._offsets, self._gains
        if self._cosine_corner and amplitude_known:
            gain_s *= _rise(self._corner * speed_cycles)
            gain_c *= _rise(self._cosine_corner * speed_cycles)
        if not -LARGEST_RAD < angle < LARGEST_RAD:
            return 0.0, 0.0, 0.0, 0.0, 0.0
        skew = tan(angle)
        return offset_s, gain_s, offset_c, gain_c * sqrt(1.0 + skew * skew), skew


def _rise(ratio: float) -> float:
    return sqrt(1.0 + ratio * ratio)
