"""Machines that keep what is declared, whatever they do within it, and their encoder: arrays of episodes.

A motion is given by its acceleration u, never above the declared one. On an even grid u is the second
difference itself: the widest set of motions that the declaration admits. At other instants u is constant from
one nominal instant to the next, so that every divided difference keeps the bound.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import numpy.typing as npt

from canfb import CorrectionTable, phase_in_cycle
from tools.faults.estimator.declared import Declared

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]
Rng = np.random.Generator

TOP_CYCLES = 125.0
AMPLITUDE_COUNTS = 1600.0
NOISE_COUNTS = 0.5
MOST_NOISE = 3.0  # standard deviations; the phase error that is declared bounds the error of every sample
UNCORRECTED = 0.0125  # a smaller phase error than this one needs a table
TABLE_ENTRIES = 1024
SHARP = (0.0, 1.0 / 3.0, 0.5)  # parts of a cycle per sample at which the phases of a machine repeat


def _constant(rng: Rng, samples: int, _: int) -> Array:
    return np.full(samples, rng.choice((-1.0, 1.0)))


def _steps(rng: Rng, samples: int, _: int) -> Array:
    return np.repeat(rng.uniform(-1.0, 1.0, samples), rng.integers(3, 21, samples))[:samples]


def _bang_bang(rng: Rng, samples: int, _: int) -> Array:
    signs = rng.choice((-1.0, 1.0)) * (-1.0) ** np.arange(samples)
    lengths = rng.integers(1, 9, samples)
    u: Array = np.repeat(signs, lengths)[:samples]
    return u


def _ramp(rng: Rng, samples: int, _: int) -> Array:
    ends = rng.choice((-1.0, 1.0)) * np.array((-1.0, 1.0))
    u: Array = np.interp(np.arange(samples), np.sort(rng.uniform(0.0, samples, 2)), ends)
    return u


def _vibration(rng: Rng, samples: int, _: int) -> Array:
    u: Array = np.sin(2.0 * np.pi * (np.arange(samples) / rng.uniform(3.0, 60.0) + rng.uniform()))
    return u


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


MOTIONS: dict[str, Callable[[Rng, int, int], Array]] = {
    "constant acceleration": _constant,
    "steps": _steps,
    "bang-bang": _bang_bang,
    "white": lambda rng, samples, _: rng.uniform(-1.0, 1.0, samples),
    "telegraph": lambda rng, samples, _: rng.choice((-1.0, 1.0), samples),
    "ramp": _ramp,
    "vibration": _vibration,
    "pulse at the fault": _pulse,
    "opposite pulses at the fault": _opposite_pulses,
    "reversal at the fault": _reversal,
}
KINDS = tuple(MOTIONS)


def start_speeds(rng: Rng, episodes: int, reserve: float) -> Array:
    """Cycles per sample: anywhere, every other one close to a whole, a third or half a cycle."""
    top = max(TOP_CYCLES - reserve, 1.0)
    speeds = rng.uniform(-top, top, episodes)
    sharp = np.rint(speeds) + rng.choice(SHARP, episodes) + rng.normal(0.0, 0.002, episodes)
    return np.where(rng.uniform(size=episodes) < 0.5, sharp, speeds)


def derivatives(declared: Declared, rng: Rng, at: npt.NDArray[np.int64], samples: int) -> Array:
    """The acceleration, shape (episodes, samples); half of the episodes use all of the bound.

    ``at`` is the sample at which the fault begins.
    """
    rows = [MOTIONS[KINDS[int(rng.integers(len(KINDS)))]](rng, samples, int(one)) for one in at]
    u = np.stack(rows)
    part = np.where(rng.uniform(size=len(at)) < 0.5, 1.0, rng.uniform(size=len(at)))
    u *= (declared.acceleration * part)[:, None]
    return u


def positions(u: Array, speed: Array, rng: Rng, instants: Array | None = None) -> Array:
    """Positions in cycles, of the shape of ``u``, on the even grid or at ``instants`` (intervals)."""
    start = rng.uniform(0.0, 1.0, len(u))
    if instants is None:
        x: Array = start[:, None] + np.cumsum(speed[:, None] + np.cumsum(u, axis=1), axis=1)
        return x
    length = int(np.max(instants)) + 2
    u = np.pad(u, ((0, 0), (0, max(0, length - u.shape[1]))), mode="edge")
    zero = np.zeros((len(u), 1))
    v = speed[:, None] + np.hstack((zero, np.cumsum(u, axis=1)))
    a = np.hstack((u, zero))
    steps = v[:, :-1] + a[:, :-1] / 2.0
    x = start[:, None] + np.hstack((zero, np.cumsum(steps, axis=1)))
    whole = np.floor(instants).astype(np.int64)
    s = instants - whole
    rows = np.arange(len(u))[:, None]
    at: Array = x[rows, whole] + v[rows, whole] * s + a[rows, whole] * s**2 / 2.0
    return at


def counts(x: Array, rng: Rng) -> tuple[Counts, Counts]:
    """ADC counts of the ideal encoder, 12 bits, half a count of noise."""
    angle = 2.0 * np.pi * np.mod(x, 1.0)
    noise = rng.normal(0.0, 1.0, (2, *x.shape)).clip(-MOST_NOISE, MOST_NOISE) * NOISE_COUNTS
    sine, cosine = (
        np.rint(AMPLITUDE_COUNTS * wave + one).astype(np.int64)
        for wave, one in zip((np.sin(angle), np.cos(angle)), noise, strict=True)
    )
    return sine, cosine


@cache
def table_of(phase_error: float) -> CorrectionTable | None:
    """None where Table 1 alone keeps this error; else the table that corrects it."""
    if phase_error >= UNCORRECTED:
        return None
    truth = np.arange(-8192, 65536 + 8192) / 65536.0
    raw = phase_in_cycle(np.sin(2.0 * np.pi * truth), np.cos(2.0 * np.pi * truth))
    raw = raw - np.rint(raw - truth)
    return CorrectionTable(np.interp(np.arange(TABLE_ENTRIES) / TABLE_ENTRIES, raw, truth))


def phases(sine: Counts, cosine: Counts, table: CorrectionTable | None) -> Array:
    """Phase of each sample as a chain with this table computes it, cycles."""
    raw = phase_in_cycle(sine.astype(np.float64), cosine.astype(np.float64))
    return raw if table is None else table(raw)
