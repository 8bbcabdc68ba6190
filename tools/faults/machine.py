"""The machines of all campaigns: motions with bounded acceleration, and the tracks of an encoder.

On a grid of samples a motion is given by its acceleration u, one value for each interval. On the even grid u
is the second difference itself, which gives all motions within the bound. At other instants u is constant
between nominal instants, so that every divided difference is within the bound.
:class:`Motion` is a position at any time. Speeds are cycles per interval T, accelerations cycles/T^2.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cache

import numpy as np
import numpy.typing as npt

from canfb import CorrectionTable, phase_in_cycle

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]
Rng = np.random.Generator

TOP_CYCLES = 125.0  # 3000 rpm, 2500 cycles per revolution, 1 kHz
FULL_SCALE = 2048  # 12 bits
AMPLITUDE_COUNTS, NOISE_COUNTS = 1600.0, 0.5
UNCORRECTED = 0.0125  # phase error, cycles; a smaller declared error requires a table
TABLE_ENTRIES = 1024
SHARP = (0.0, 1.0 / 3.0, 0.5)  # parts of a cycle per sample at which the phases of a machine repeat


def _ramp(rng: Rng, samples: int, _: int) -> Array:
    ends = rng.choice((-1.0, 1.0)) * np.array((-1.0, 1.0))
    return np.asarray(np.interp(np.arange(samples), np.sort(rng.uniform(0.0, samples, 2)), ends))


def _bang_bang(rng: Rng, samples: int, _: int) -> Array:
    signs = rng.choice((-1.0, 1.0)) * (-1.0) ** np.arange(samples)
    return np.asarray(np.repeat(signs, rng.integers(1, 9, samples))[:samples])


def _steps(rng: Rng, samples: int, _: int) -> Array:
    return np.repeat(rng.uniform(-1.0, 1.0, samples), rng.integers(3, 21, samples))[:samples]


def _vibration(rng: Rng, samples: int, _: int) -> Array:
    periods = np.arange(samples) / rng.uniform(3.0, 60.0) + rng.uniform()
    return np.asarray(np.sin(2.0 * np.pi * periods))


def _pulse(rng: Rng, samples: int, at: int) -> Array:
    u = np.zeros(samples)
    first = at + int(rng.integers(-3, 4))
    u[first : first + int(rng.integers(1, 8))] = rng.choice((-1.0, 1.0))
    return u


def _opposite_pulses(rng: Rng, samples: int, at: int) -> Array:
    u, size = np.zeros(samples), float(rng.choice((-1.0, 1.0)))
    first, length = at + int(rng.integers(-3, 4)), int(rng.integers(1, 5))
    second = first + length + int(rng.integers(0, 4))
    u[first : first + length], u[second : second + length] = size, -size
    return u


def _reversal(rng: Rng, samples: int, at: int) -> Array:
    size = float(rng.choice((-1.0, 1.0)))
    return np.where(np.arange(samples) < at + int(rng.integers(-1, 4)), size, -size)


# The acceleration as a part of its bound: (rng, samples, sample at which the fault begins)
ACCELERATIONS: tuple[Callable[[Rng, int, int], Array], ...] = (
    lambda rng, samples, _: np.full(samples, rng.choice((-1.0, 1.0))),
    *(_steps, _bang_bang),
    lambda rng, samples, _: rng.uniform(-1.0, 1.0, samples),
    lambda rng, samples, _: rng.choice((-1.0, 1.0), samples),
    *(_ramp, _vibration, _pulse, _opposite_pulses, _reversal),
)


def accelerations(bound: float, rng: Rng, at: Iterable[int], samples: int) -> Array:
    """Accelerations, shape (episodes, samples), for faults at ``at``; half of them use all of ``bound``."""
    kinds = len(ACCELERATIONS)
    u = np.stack([ACCELERATIONS[int(rng.integers(kinds))](rng, samples, int(one)) for one in at])
    part = np.where(rng.uniform(size=len(u)) < 0.5, 1.0, rng.uniform(size=len(u)))
    return np.asarray(u * (bound * part)[:, None])


def start_speeds(rng: Rng, episodes: int, reserve: float) -> Array:
    """Random speeds; every other one is close to a whole, 1/3 or 1/2 cycle per sample."""
    top = max(TOP_CYCLES - reserve, 1.0)
    speeds = rng.uniform(-top, top, episodes)
    sharp = np.rint(speeds) + rng.choice(SHARP, episodes) + rng.normal(0.0, 0.002, episodes)
    return np.where(rng.uniform(size=episodes) < 0.5, sharp, speeds)


def positions(u: Array, speed: Array, rng: Rng, instants: Array | None = None) -> Array:
    """Positions in cycles, of the shape of ``u``, on the even grid or at ``instants`` (intervals)."""
    start = rng.uniform(0.0, 1.0, len(u))
    if instants is None:
        return np.asarray(start[:, None] + np.cumsum(speed[:, None] + np.cumsum(u, axis=1), axis=1))
    length = int(np.max(instants)) + 2
    u = np.pad(u, ((0, 0), (0, max(0, length - u.shape[1]))), mode="edge")
    zero = np.zeros((len(u), 1))
    v = speed[:, None] + np.hstack((zero, np.cumsum(u, axis=1)))
    a = np.hstack((u, zero))
    x = start[:, None] + np.hstack((zero, np.cumsum(v[:, :-1] + a[:, :-1] / 2.0, axis=1)))
    whole = np.floor(instants).astype(np.int64)
    s = instants - whole
    rows = np.arange(len(u))[:, None]
    return np.asarray(x[rows, whole] + v[rows, whole] * s + a[rows, whole] * s**2 / 2.0)


@dataclass
class Motion:
    """Position at any time, in T: from standstill at ``start``, with the sum of the following.

    ``pieces`` are (begin, acceleration), ``jerks`` (begin, jerk), both without an end: a later one with the
    opposite sign cancels them. ``vibrations`` are (begin, acceleration amplitude a, frequency f in 1/T, end):
    a sin(2 pi f t); the speed that remains at the end is kept.
    """

    start: float = 0.0
    pieces: list[tuple[float, float]] = field(default_factory=list)
    vibrations: list[tuple[float, float, float, float]] = field(default_factory=list)
    jerks: list[tuple[float, float]] = field(default_factory=list)

    def push(self, begin: float, duration: float, acceleration: float) -> None:
        self.pieces += [(begin, acceleration), (begin + duration, -acceleration)]

    def s_curve(self, begin: float, duration: float, acceleration: float, steps: int = 8) -> None:
        """Add a triangular pulse of acceleration, in small steps."""
        for n in range(steps):
            begin_n = begin + duration * 0.5 * n / steps
            self.push(begin_n, duration * (1.0 - n / steps), acceleration / steps)

    def at(self, times: npt.ArrayLike) -> Array:
        """Position in cycles at these times."""
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
        """Largest acceleration up to time ``end``, without jerks."""
        steps = sorted(self.pieces)
        constant = np.cumsum([0.0, *(size for _, size in steps)])
        shaking = sum(abs(size) for _, size, _, _ in self.vibrations)
        inside = [True, *(begin < end for begin, _ in steps)]
        return float(np.abs(constant[inside]).max()) + shaking

    def speed(self, time: float) -> float:
        before, after = self.at([time - 5e-4, time + 5e-4])
        return float(after - before) / 1e-3


def counts(
    x: Array, rng: Rng, *, exact: bool = False, amplitude: float = AMPLITUDE_COUNTS, most_noise: float = 3.0
) -> tuple[Counts, Counts]:
    """ADC counts of an ideal encoder, 12 bits, half a count of noise.

    ``exact``: tracks for which Table 1 of the paper gives the exact phase, as after a reference measurement.
    ``most_noise``: limit of the noise, standard deviations: every sample must keep a declared phase error.
    """
    angle = 2.0 * np.pi * np.mod(x, 1.0)
    if exact:
        octant, part = np.divmod(8.0 * np.mod(x, 1.0), 1.0)
        odd = octant % 2 == 1
        angle = octant * np.pi / 4.0 + np.where(odd, np.pi / 4.0 - np.arctan(1.0 - part), np.arctan(part))
    noise = rng.normal(0.0, 1.0, (2, *x.shape)).clip(-most_noise, most_noise) * NOISE_COUNTS
    tracks = (amplitude * np.sin(angle) + noise[0], amplitude * np.cos(angle) + noise[1])
    sine, cosine = (np.clip(np.rint(one), -FULL_SCALE, FULL_SCALE - 1).astype(np.int64) for one in tracks)
    return sine, cosine


def within_half(value: float, whole: float) -> float:
    """``value`` modulo ``whole``, wrapped to ± ``whole`` / 2."""
    return (value + whole / 2) % whole - whole / 2


def ideal_tracks(phase: Array) -> tuple[Array, Array]:
    angle = 2.0 * np.pi * phase
    return np.sin(angle), np.cos(angle)


def exact_table(
    tracks: Callable[[Array], tuple[Array, Array]] = ideal_tracks, entries: int = TABLE_ENTRIES
) -> CorrectionTable:
    """Table of an error-free reference measurement with these tracks over the phase."""
    truth = np.arange(-8192, 65536 + 8192) / 65536.0
    raw = phase_in_cycle(*tracks(truth))
    raw = raw - np.rint(raw - truth)
    return CorrectionTable(np.interp(np.arange(entries) / entries, raw, truth))


@cache
def table_of(phase_error: float) -> CorrectionTable | None:
    """The table required for this phase error; None if Table 1 alone suffices."""
    return None if phase_error >= UNCORRECTED else exact_table()


def phases(sine: Counts, cosine: Counts, table: CorrectionTable | None) -> Array:
    """Phase of each sample, computed by a chain with this table, cycles."""
    raw = phase_in_cycle(sine.astype(np.float64), cosine.astype(np.float64))
    return raw if table is None else table(raw)
