"""The motions of a servo: moves limited in jerk, reversals and vibration, at a SYNC of 1 kHz.

Two pairs for each SYNC, sample times, a known acceleration and a margin by the measured noise. In cycles and
T at 1 kHz and 2500 cycles: 2000 rad/s^2 is 0.8, which is 0.2 from pair to pair.
"""

from __future__ import annotations

import math

import numpy as np

from tools.faults.wire.line import Plan, Slot
from tools.faults.wire.motion import Motion
from tools.faults.wire.setups import Options, Setup

REST, STEADY, LEARNED = 110, 12, 420  # slots
TOP_SPEED, TOP_ACCELERATION, TOP_JERK = 125.0, 0.8, 0.08
DWELL = 30.0
KNOWN = 1.05  # 2010:02, of the acceleration that the machine does, vibration included


def draw_servo(setup: Setup, rng: np.random.Generator, after: int) -> Plan:
    """Moves one after the other; the fault is anywhere in the second half of them."""
    options = Options(interval_s=1e-3, margin=int(rng.choice((0, 6))), period=bool(rng.integers(2)))
    options.exact = bool(rng.integers(2))
    options.overflow = int(rng.choice((10, 240)))
    motion = Motion(start=float(rng.uniform(0.1, 0.9)) + float(rng.integers(-3, 3)))
    share = float(rng.choice((1.0, 1.0, 0.3, 0.05)))
    jerk = TOP_JERK * share
    options.limit = TOP_ACCELERATION * KNOWN
    end, speed = float(REST), 0.0
    learning = options.margin > 0 and bool(rng.integers(2))  # the noise is known before the fault
    slots = LEARNED if not learning else 1500
    while end < slots:
        target = float(rng.uniform(-1.0, 1.0)) * TOP_SPEED * float(rng.choice((1.0, 1.0, 0.05)))
        if learning and end < 200.0:
            target = 37.37
        end = move(motion, end, target - speed, jerk, rng)
        speed = target
        end += 1300.0 if learning and end < 400.0 else float(rng.uniform(0.0, DWELL))
    vibrate(motion, rng, jerk, end + 1e6)
    fault = int(end) - int(rng.integers(10, 200))
    plan = Plan(setup, options, motion, rng, [Slot() for _ in range(fault + after)], max(fault, REST))
    plan.accelerating = True
    plan.drift = float(rng.uniform(-1e-4, 1e-4))
    plan.gaussian = bool(rng.integers(2))
    plan.jitter_us = float(rng.uniform(0.0, 100.0))
    return plan


def move(motion: Motion, begin: float, change: float, jerk: float, rng: np.random.Generator) -> float:
    """A change of speed, limited in acceleration and jerk; when it is over."""
    size = abs(change)
    acceleration = min(TOP_ACCELERATION * float(rng.choice((1.0, 0.5))), math.sqrt(size * jerk))
    if size == 0.0 or acceleration == 0.0:
        return begin
    rise = acceleration / jerk
    hold = size / acceleration - rise
    signed = math.copysign(jerk, change)
    for at, one in ((0.0, signed), (rise, -signed), (rise + hold, -signed), (2.0 * rise + hold, signed)):
        motion.jerks.append((begin + at, one))
    return begin + 2.0 * rise + hold


def vibrate(motion: Motion, rng: np.random.Generator, jerk: float, end: float) -> None:
    """In some episodes a vibration of 10 to 200 Hz on top: its acceleration is below 2 % of the known one."""
    if rng.integers(2):
        return
    frequency = float(rng.uniform(0.01, 0.2))  # 1/T
    size = 0.02 * jerk / (2.0 * math.pi * frequency)
    motion.vibrations.append((float(REST), size, frequency, end))
