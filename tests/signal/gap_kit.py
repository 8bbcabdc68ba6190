"""Machines whose acceleration does what it likes, around a gap of missed samples; and what became of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import Enum

import numpy as np
import numpy.typing as npt

from canfb.signal.recovery.recovery import Recovery
from canfb.signal.tracker import Tracker

Rng = np.random.Generator
Accelerations = npt.NDArray[np.float64]
BEFORE, AFTER = 34, 16
AT_REST = 3
NOISE_CYCLES = 1e-4  # half a count of 1500, and what is left of the correction
WRONG_CYCLES = 0.25


class Outcome(Enum):
    """Of an episode."""

    RIGHT = "right"  # valid at the end, and never valid and wrong
    LOST = "lost"
    WRONG = "valid and wrong"


def play(accelerations: Accelerations, missed: int, limit: float, known: float | None, rng: Rng) -> Outcome:
    """A machine at rest accelerates so; after ``BEFORE`` samples so many are missed, and the rest comes.

    ``accelerations`` of each sample: the speed changes by it on arriving there.
    """
    accelerations = np.concatenate((np.zeros(AT_REST), accelerations[AT_REST:]))
    positions = rng.uniform() + np.cumsum(np.cumsum(accelerations))
    phases = (positions + rng.normal(0.0, NOISE_CYCLES, len(positions))) % 1.0 % 1.0
    recovery = Recovery(Tracker(limit), 3)
    recovery.acceleration_limit = known
    offset, wrong = None, False
    for k, (position, phase) in enumerate(zip(positions.tolist(), phases.tolist(), strict=True)):
        if BEFORE <= k < BEFORE + missed:
            track, bits = recovery.bad(1.0, missed=True)
        else:
            track, bits = recovery.good(phase, 1.0)
        here = track.cycles + track.phase - position
        if offset is None:
            offset = here
        wrong |= bool(bits & 1) and abs(here - offset) > WRONG_CYCLES
    return Outcome.WRONG if wrong else Outcome.RIGHT if bits & 1 else Outcome.LOST


def length(missed: int) -> int:
    return BEFORE + missed + AFTER


def constant(most: float, missed: int, rng: Rng) -> Accelerations:
    return np.full(length(missed), rng.uniform(-most, most))


def s_curve(most: float, missed: int, rng: Rng) -> Accelerations:
    """A trapezium of the acceleration with flanks of 5 to 30 samples, the gap anywhere in it."""
    flank = int(rng.integers(5, 31))
    k = np.arange(length(missed)) - BEFORE + rng.integers(-5, flank + 10)
    return rng.choice((-1.0, 1.0)) * most * np.clip(k / flank, 0.0, 1.0)


def step(most: float, missed: int, rng: Rng) -> Accelerations:
    """From one acceleration to another, in or near the gap."""
    old, new = rng.choice((0.0, most, -most, rng.uniform(-most, most)), 2)
    k = np.arange(length(missed))
    return np.where(k < BEFORE + rng.integers(-3, missed + 4), old, new)


def begun(most: float, missed: int, rng: Rng) -> Accelerations:
    """From no acceleration to some, or back, in or near the gap."""
    size = rng.uniform(-most, most)
    k = np.arange(length(missed))
    before = k < BEFORE + rng.integers(-3, missed + 4)
    return np.where(before ^ bool(rng.integers(2)), 0.0, size)


def vibration(most: float, missed: int, rng: Rng) -> Accelerations:
    """10..200 Hz at 1 kHz."""
    k = np.arange(length(missed))
    return most * np.sin(2.0 * math.pi * (rng.uniform(0.01, 0.2) * k + rng.uniform()))


def white(most: float, missed: int, rng: Rng) -> Accelerations:
    return rng.uniform(-most, most, length(missed))


def bang_bang(most: float, missed: int, rng: Rng) -> Accelerations:
    """Full one way, then the other, each for 1 to 12 samples, or always for the same number."""
    dwells = rng.integers(1, 13, length(missed)) if rng.uniform() < 0.5 else [rng.integers(1, 13)] * 70
    signs = rng.choice((-1.0, 1.0)) * np.resize((1.0, -1.0), len(dwells))
    return most * np.repeat(signs, dwells)[: length(missed)]


def pulse(most: float, missed: int, rng: Rng) -> Accelerations:
    """Of 1 to 9 samples, anywhere around the gap; the machine does not accelerate else."""
    first = BEFORE + int(rng.integers(-4, missed + 2))
    made = np.zeros(length(missed))
    made[first : first + rng.integers(1, 10)] = (
        rng.choice((-1.0, 1.0)) * most * rng.choice((1.0, rng.uniform()))
    )
    return made


def pulse_seen(most: float, missed: int, rng: Rng) -> Accelerations:
    """As :func:`pulse`, from one to three samples before the gap to one to five after it."""
    made = np.zeros(length(missed))
    made[BEFORE - rng.integers(1, 4) : BEFORE + missed + 2 + rng.integers(0, 5)] = most * rng.choice(
        (-1.0, 1.0)
    )
    return made


def pulse_on_top(most: float, missed: int, rng: Rng) -> Accelerations:
    """As :func:`pulse`, of a machine that accelerates anyway."""
    base = rng.uniform(-most, most)
    made = np.full(length(missed), base)
    first = BEFORE + int(rng.integers(-4, missed + 2))
    made[first : first + rng.integers(1, 10)] = rng.uniform(-most, most)
    return made


def doublet(most: float, missed: int, rng: Rng) -> Accelerations:
    """A push and one the other way, anywhere around the gap."""
    made = np.zeros(length(missed))
    first, half = BEFORE + int(rng.integers(-4, missed + 2)), int(rng.integers(1, 5))
    size = rng.choice((-1.0, 1.0)) * most * rng.choice((1.0, rng.uniform()))
    made[first : first + half], made[first + half : first + 2 * half] = size, -size
    return made


Motion = Callable[[float, int, Rng], Accelerations]
SMOOTH: tuple[Motion, ...] = (constant, s_curve, begun, vibration)
VIOLENT: tuple[Motion, ...] = (step, white, bang_bang, pulse, pulse_seen, pulse_on_top, doublet)
