"""Tracks behind an analog path: a low-pass as a differential equation, in small steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from canfb.calibration.over_speeds import TracksAtSpeed
from canfb.signal.phase import FloatArray

RATE_HZ = 1000.0
CYCLES = 2500
STEPS = 8192  # of a cycle


@dataclass(frozen=True)
class Machine:
    """An encoder and what is behind it; offsets and sizes in counts, noise before rounding."""

    cosine_delay_s: float = 0.0
    corner_hz: float = 0.0
    cosine_corner_hz: float = 0.0
    third: float = 0.01
    second: float = 0.004
    phase_error: float = 0.05
    noise: float = 0.5

    def shapes(self, hertz: float) -> FloatArray:
        """Both analog tracks over a cycle, counts, shape (2, STEPS + 1)."""
        x = 2.0 * np.pi * np.arange(STEPS + 1) / STEPS
        sine = 1510.0 * (np.sin(x) + self.third * np.sin(3 * x + 0.4) + self.second * np.cos(2 * x))
        cosine = 1440.0 * (np.cos(x - self.phase_error) + self.third * np.cos(3 * x - 1.1))
        return np.array(
            [
                35.0 + low_passed(sine, hertz, self.corner_hz),
                -20.0 + low_passed(cosine, hertz, self.cosine_corner_hz or self.corner_hz),
            ]
        )

    def at(
        self, rpm: float, samples: int, seed: int, ripple: float = 1e-3
    ) -> tuple[TracksAtSpeed, FloatArray]:
        """Counts at this speed, which ripples, and the true positions in cycles."""
        rng = np.random.default_rng(seed)
        hertz = rpm / 60.0 * CYCLES
        time = np.arange(samples) / RATE_HZ
        swing = ripple * hertz * np.sin(2.0 * np.pi * 0.83 * time)
        position = rng.uniform() + np.cumsum(hertz + swing) / RATE_HZ
        tracks = self.shapes(hertz)
        if ripple > 0.01:  # between the shapes at the ends
            ends = self.shapes(hertz * (1.0 - ripple)), self.shapes(hertz * (1.0 + ripple))
            part = (swing / (ripple * hertz) + 1.0) / 2.0
        else:
            ends, part = (tracks, tracks), np.zeros(samples)
        places = np.arange(STEPS + 1) / STEPS
        at_cosine = position + (hertz + swing) * self.cosine_delay_s
        counts = [
            np.rint(
                (1.0 - part) * np.interp(at % 1.0, places, low)
                + part * np.interp(at % 1.0, places, high)
                + rng.normal(0.0, self.noise, samples)
            )
            for at, low, high in zip((position, at_cosine), *ends, strict=True)
        ]
        mean = float(np.mean(hertz + swing))
        return TracksAtSpeed(counts[0], counts[1], RATE_HZ, mean), position


def low_passed(track: FloatArray, hertz: float, corner_hz: float) -> FloatArray:
    """What y' = 2 pi corner (track - y) makes of a track that comes again and again ``hertz`` times a second.

    The track is straight from one step to the next. The first and the last value are one.
    """
    if not corner_hz or not hertz:
        return track
    time = abs(1.0 / hertz / (len(track) - 1)) * 2.0 * np.pi * corner_hz
    kept = np.exp(-time)
    ahead = track if hertz > 0 else track[::-1]
    # exact over a step from a to b: y + (b - y) ..., for a straight line
    rise = np.diff(ahead)
    settled = ahead[1:] - rise / time
    value, cycle = float(ahead.mean()), np.empty(len(ahead))
    for _ in range(2 + int(40.0 / (time * (len(track) - 1)))):
        for n in range(len(rise)):
            cycle[n] = value
            value = settled[n] + (value - (ahead[n] - rise[n] / time)) * kept
        cycle[-1] = value
    return cycle if hertz > 0 else cycle[::-1]
