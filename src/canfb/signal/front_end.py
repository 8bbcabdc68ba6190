"""What the analog path does to the tracks at speed: a delay between them, and less amplitude.

A converter with a multiplexer takes the cosine ``cosine_delay_s`` after the sine. At f cycles per second
the machine turns by d = 2 pi f cosine_delay meanwhile, so the counts are those of

    sine = A sin x,    cosine = A cos(x + d - phase_error),

with x the angle at the instant of the sine. That is a phase error of ``phase_error - d`` in place of
``phase_error``, and :class:`Conditioning` removes it exactly:

    c = (cosine + s sin(d - phase_error)) / cos(d - phase_error)

with s, cosine after offset and gain; for tracks at a right angle (cosine + s sin d) / cos d. A low-pass of
one pole with the corner frequency fc takes the amplitude to A / sqrt(1 + (f / fc)^2). The inverse of it is
a common gain, so that the amplitude, and its limits, are those of a slow machine.

Both depend on the speed alone, so they are five coefficients as at standstill, renewed after each sample
with the speed expected at the next one. Every way of a sample then conditions as it always does.
"""

from __future__ import annotations

import math
from math import sqrt, tan

from canfb.signal.conditioning import Coefficients, Conditioning

LARGEST_RAD = 1.47  # |d - phase_error|: beyond it the tracks are less than 6 degrees from being the same one
AHEAD_INTERVALS = 1.5  # from the middle of the last interval, whose speed is known, to the next sample
SAME_INTERVAL = 2e-4  # of it


class FrontEnd:
    """Coefficients of a conditioning at a speed, which is in cycles per sampling interval.

    ``corner_hz`` is that of the low-pass, 0.0: none. ``unit_s`` is the sampling interval in seconds; while
    it is 0.0, not known, the machine is taken to stand.
    """

    __slots__ = (
        "_conditioning",
        "_corner",
        "_corner_hz",
        "_delay",
        "_gains",
        "_offsets",
        "_phase_error",
        "unit_s",
    )

    def __init__(self, conditioning: Conditioning, corner_hz: float) -> None:
        self._conditioning, self._corner_hz = conditioning, corner_hz
        used = tuple(map(float, conditioning.values))
        self._offsets, self._gains, self._phase_error = used[:2], used[2:4], used[4]
        self.use_interval(0.0)

    def use_interval(self, unit_s: float) -> None:
        """Speeds are per interval of this length from now on, seconds; 0.0: not known."""
        self.unit_s = unit_s
        hertz = 1.0 / unit_s if unit_s > 0.0 else 0.0  # at one cycle per interval
        self._delay = 2.0 * math.pi * hertz * self._conditioning.cosine_delay_s
        self._corner = hertz / self._corner_hz if self._corner_hz else 0.0

    def turned_rad(self, speed_cycles: float) -> float:
        """d at this speed."""
        return self._delay * speed_cycles

    def coefficients(self, speed_cycles: float, amplitude_known: bool = True) -> Coefficients:
        """As :meth:`Conditioning.coefficients`, at this speed.

        All zero, so that there is no phase, where the delay makes both tracks the same. With
        ``amplitude_known`` False the attenuation is left in.
        """
        angle = self._phase_error - self._delay * speed_cycles
        if not -LARGEST_RAD < angle < LARGEST_RAD:
            return 0.0, 0.0, 0.0, 0.0, 0.0
        skew = tan(angle)
        (offset_s, offset_c), (gain_s, gain_c) = self._offsets, self._gains
        if self._corner and amplitude_known:
            ratio = self._corner * speed_cycles
            rise = sqrt(1.0 + ratio * ratio)
            gain_s *= rise
            gain_c *= rise
        return offset_s, gain_s, offset_c, gain_c * sqrt(1.0 + skew * skew), skew
