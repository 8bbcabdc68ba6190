"""The true motion of the machine: position in cycles as a function of true time, and the tracks it shows.

Time is in nominal SYNC periods T throughout, so speeds are cycles/T and accelerations cycles/T^2.
A position is a float64: within 10^-8 cycle at 10^7 cycles.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
AMPLITUDE_COUNTS, FULL_SCALE, NOISE_COUNTS = 1500.0, 2048, 0.5


@dataclass
class Motion:
    """Position = pieces of constant acceleration, from standstill at ``start``, plus vibrations.

    ``pieces`` are (begin, acceleration), each adding from ``begin`` on until it is taken back by another.
    ``vibrations`` are (begin, acceleration amplitude, frequency in 1/T, end): whole periods of
    a sin(2 pi f t), which leave speed offsets that are part of the motion.
    """

    start: float = 0.0
    pieces: list[tuple[float, float]] = field(default_factory=list)
    vibrations: list[tuple[float, float, float, float]] = field(default_factory=list)
    jerks: list[tuple[float, float]] = field(default_factory=list)  # as pieces, of constant jerk

    def push(self, begin: float, duration: float, acceleration: float) -> None:
        """Add a constant acceleration for a while."""
        self.pieces.append((begin, acceleration))
        self.pieces.append((begin + duration, -acceleration))

    def s_curve(self, begin: float, duration: float, acceleration: float, steps: int = 8) -> None:
        """Add a torque that rises and falls as a triangle, in small steps of a part of T."""
        for n in range(steps):
            begin_n = begin + duration * 0.5 * n / steps
            self.push(begin_n, duration * (1.0 - n / steps), acceleration / steps)

    def at(self, times: npt.ArrayLike) -> FloatArray:
        """Position in cycles at these true times."""
        t = np.asarray(times, dtype=np.float64)
        x = np.full(t.shape, self.start)
        for begin, acceleration in self.pieces:
            since = np.maximum(t - begin, 0.0)
            x += 0.5 * acceleration * since * since
        for begin, jerk in self.jerks:
            since = np.maximum(t - begin, 0.0)
            x += jerk / 6.0 * since * since * since
        for begin, acceleration, frequency, end in self.vibrations:
            w = 2.0 * np.pi * frequency
            shaking = np.clip(t - begin, 0.0, end - begin)
            x += acceleration / w * shaking - acceleration / w**2 * np.sin(w * shaking)
        return x

    def largest_acceleration(self, end: float) -> float:
        """In cycles/T^2, up to time ``end``; without jerks."""
        steps = sorted(self.pieces)
        constant = np.cumsum([0.0, *(size for _, size in steps)])
        shaking = sum(abs(size) for _, size, _, _ in self.vibrations)  # a sin(2 pi f t)
        inside = [True, *(begin < end for begin, _ in steps)]
        return float(np.abs(constant[inside]).max()) + shaking

    def speed(self, time: float) -> float:
        """Cycles per T at this time."""
        before, after = self.at([time - 5e-4, time + 5e-4])
        return float(after - before) / 1e-3


def counts(
    position: FloatArray, rng: np.random.Generator, exact: bool = False
) -> tuple[list[int], list[int]]:
    """ADC counts of sine and cosine at these positions: 12 bits, half a count of noise.

    ``exact``: tracks whose quotient is the phase, as after a reference measurement (Table 1 of the paper).
    """
    angle = 2.0 * np.pi * np.mod(position, 1.0)
    if exact:
        octant, part = np.divmod(8.0 * np.mod(position, 1.0), 1.0)
        odd = octant % 2 == 1
        within = np.where(odd, np.pi / 4.0 - np.arctan(1.0 - part), np.arctan(part))
        angle = octant * np.pi / 4.0 + within
    tracks = (AMPLITUDE_COUNTS * np.sin(angle), AMPLITUDE_COUNTS * np.cos(angle))
    noisy = (track + rng.normal(0.0, NOISE_COUNTS, len(position)) for track in tracks)
    sine, cosine = (np.clip(np.rint(one), -FULL_SCALE, FULL_SCALE - 1).astype(int).tolist() for one in noisy)
    return sine, cosine
