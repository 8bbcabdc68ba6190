"""What lies between an encoder and the counts of its tracks: a low-pass on each, and a converter."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from canfb.signal.phase import FloatArray


@dataclass(frozen=True, kw_only=True)
class AnalogPath:
    """Its response at a steady speed. The delays are far shorter than a machine takes to change its speed.

    sine_corner_hz, cosine_corner_hz   of a low-pass of one pole on that track, 0.0: none
    cosine_delay_s                     the cosine is sampled this much after the sine
    delay_s                            both tracks come this much late, beside their low-pass
    """

    sine_corner_hz: float = 0.0
    cosine_corner_hz: float = 0.0
    cosine_delay_s: float = 0.0
    delay_s: float = 0.0

    @property
    def is_ideal(self) -> bool:
        """The speed does not count."""
        return self == IDEAL_PATH

    def lag_s(self, hertz: float) -> float:
        """How late the sine track is at so many cycles per second."""
        lag_s = self.delay_s
        if self.sine_corner_hz:
            ratio = hertz / self.sine_corner_hz
            lag_s += (math.atan(ratio) / ratio if ratio else 1.0) / (2.0 * math.pi * self.sine_corner_hz)
        return lag_s


IDEAL_PATH = AnalogPath()


def low_pass(order: int, hertz: FloatArray | float, corner_hz: float) -> tuple[FloatArray, FloatArray]:
    """What a low-pass of one pole leaves of a harmonic, and by how many radians it is late."""
    ratio = order * np.asarray(hertz, np.float64) / corner_hz if corner_hz else np.zeros(np.shape(hertz))
    return 1.0 / np.sqrt(1.0 + ratio * ratio), np.arctan(ratio)
