"""Draws the healthy part of an episode: a machine that accelerates within its limits, on a healthy wire.

A servo makes moves with limited jerk, reversals and vibration at a SYNC of 1 kHz, with two pairs, sample
times and a known acceleration: 2000 rad/s^2 is 0.8 cycle/T^2 at 2500 cycles, 0.2 per pair interval^2.
"""

import math

import numpy as np

from tools.faults.machine import TOP_CYCLES, Motion
from tools.faults.wire.line import Plan, Slot
from tools.faults.wire.setups import Options, Setup

LONGEST_RAMP = 420
REST, STEADY, AFTER = 12, 24, 70  # slots before the ramp, before and after the fault
# Acceleration of the machine, cycles/T^2, if 2010:02 is not set: as in 2010:0B. With more, the position can
# be wrong after a gap (docs/supervision.md); tools.faults.samples.campaign --exceed measures that.
UNKNOWN_LIMIT = 0.1
SERVO_REST, LEARNED = 110, 420  # slots of rest before the moves, and to the end of the moves at least
TOP_ACCELERATION, TOP_JERK = 0.8, 0.08
DWELL = 30.0
KNOWN = 1.05  # 2010:02 / largest acceleration of the machine, vibration included


def draw_plan(setup: Setup, rng: np.random.Generator, after: int = AFTER, steady: bool = False) -> Plan:
    """A healthy plan; a class of faults then changes it from slot ``fault`` on.

    At the fault the machine has constant speed or, unless ``steady``, may accelerate or reverse.
    """
    if setup.servo:
        return draw_servo(setup, rng, after)
    options = Options(interval_s=float(rng.choice((1e-3, 1e-3, 1e-3, 2.5e-4, 2e-3, 1e-2))))
    options.limit = (None, None, 0.25, 0.25, 0.15, 0.05)[int(rng.integers(6))]
    options.overflow = int(rng.choice((10, 240)))
    options.acceleration = bool(rng.integers(4) == 0)
    options.period = bool(rng.integers(2)) if setup.period is None else setup.period
    limit = options.limit or UNKNOWN_LIMIT
    speed = _speed(rng, limit)
    motion = Motion(start=float(rng.uniform(0.1, 0.9)) + float(rng.integers(-3, 3)))
    # With SYNC jitter an interval may be 1.4 T, which increases the residual of an acceleration 1.5 times.
    size = float(rng.uniform(0.5, 0.7 if setup.times else 0.9)) * limit
    acceleration = float(np.copysign(size, speed))
    ramp = abs(speed) / size
    kind = 1.0 if steady else rng.uniform()
    fault = REST + int(ramp) + 2 + STEADY + int(rng.integers(0, 10))
    if kind < 0.15:
        motion.push(REST, 1e6, acceleration)
        fault = max(REST + int(ramp), REST + STEADY)
    else:
        motion.push(REST, ramp, acceleration)
        if kind < 0.3:  # reversal around the fault
            motion.push(REST + ramp + 10.0, 1e6, -acceleration)
            fault = int(REST + ramp + 10.0 + max(ramp + float(rng.uniform(-5.0, 5.0)), STEADY))
    plan = Plan(setup, options, motion, rng, [Slot() for _ in range(fault + after)], fault)
    plan.accelerating = kind < 0.3
    _draw_wire(plan)
    return plan


def _speed(rng: np.random.Generator, limit: float) -> float:
    top = min(TOP_CYCLES, LONGEST_RAMP * 0.5 * limit)
    kind = rng.uniform()
    if kind < 0.08:
        return 0.0
    size = float(top * rng.uniform() ** 2 if kind < 0.9 else rng.uniform(0.0, top))
    if kind < 0.45:
        size = round(size + 0.5)
    elif kind < 0.6:
        size = round(size + 0.5) + float(rng.normal(0.0, 0.05))
    return size * float(rng.choice((-1.0, 1.0)))


def _draw_wire(plan: Plan) -> None:
    rng, setup = plan.rng, plan.setup
    plan.drift = float(rng.uniform(-1e-4, 1e-4))
    plan.gaussian = bool(rng.integers(2))
    plan.jitter_us = float(rng.uniform(0.0, 100.0))
    if plan.options.interval_s < 1e-3:  # at this rate the bus has no room for other frames
        plan.jitter_us, plan.gaussian, plan.busy = plan.jitter_us * 0.25, False, 0.0
    plan.locked = setup.servo > 2  # 100 us rms jitter would be half of the sampling interval
    if not setup.times:
        plan.locked = bool(rng.uniform() < 0.7)
        keep_regular(plan)


def keep_regular(plan: Plan) -> None:
    """Without sample times allow SYNC jitter only with a locked timer or a slow machine (P6)."""
    if not (plan.setup.times or plan.locked):
        room = 0.05 if plan.options.limit is None else 0.02
        fastest = float(np.abs(np.diff(plan.motion.at(np.arange(plan.end)))).max(initial=0.0))
        most_us = room / 16.0 / max(fastest, plan.options.limit or UNKNOWN_LIMIT) / plan.us
        plan.jitter_us = 0.0 if most_us < 0.5 else min(plan.jitter_us, most_us)
        plan.busy = plan.busy if most_us > 135.0 else 0.0


def torque(plan: Plan) -> None:
    if plan.accelerating:
        return
    rng, limit = plan.rng, plan.options.limit or UNKNOWN_LIMIT
    size = limit * 0.7 * float(rng.uniform(0.5, 1.0)) * float(rng.choice((-1.0, 1.0)))
    begin = plan.fault + float(rng.integers(-4, 4)) + (0.0 if rng.integers(2) else float(rng.uniform()))
    kind = int(rng.integers(5))
    if kind < 2:
        plan.motion.push(begin, 5.0, size)
    elif kind == 2:
        plan.motion.s_curve(begin, float(rng.uniform(6.0, 30.0)), size)
    elif kind == 3:  # a step of the acceleration
        plan.motion.push(begin, plan.end, size)
    else:
        frequency = min(float(rng.uniform(10.0, 200.0)) * plan.options.interval_s, 0.2)
        plan.motion.vibrations.append((begin - 20.0, size, frequency, plan.end + AFTER))


def draw_servo(setup: Setup, rng: np.random.Generator, after: int) -> Plan:
    """A plan with successive moves; the fault is at random in their second half."""
    options = Options(interval_s=1e-3, margin=int(rng.choice((0, 6))), period=bool(rng.integers(2)))
    options.exact = bool(rng.integers(2))
    options.overflow = int(rng.choice((10, 240)))
    motion = Motion(start=float(rng.uniform(0.1, 0.9)) + float(rng.integers(-3, 3)))
    more = (setup.servo / 2) ** 2  # keeps the acceleration per sampling interval^2 of two pairs
    jerk = TOP_JERK * more * float(rng.choice((1.0, 1.0, 0.3, 0.05)))
    options.limit = TOP_ACCELERATION * more * KNOWN
    end, speed = float(SERVO_REST), 0.0
    top = TOP_CYCLES * (1.0 if setup.times else float(rng.choice((1.0, 0.1, 0.01, 0.003))))
    learning = options.margin > 0 and bool(rng.integers(2))  # a long move first: measures the noise
    slots = LEARNED if not learning else 1500
    while end < slots:
        target = float(rng.uniform(-1.0, 1.0)) * top * float(rng.choice((1.0, 1.0, 0.05)))
        if learning and end < 200.0:
            target = 37.37
        end = move(motion, end, target - speed, TOP_ACCELERATION * more, jerk, rng)
        speed = target
        end += 1300.0 if learning and end < 400.0 else float(rng.uniform(0.0, DWELL))
    vibrate(motion, rng, jerk, end + 1e6)
    fault = int(end) - int(rng.integers(10, 200))
    plan = Plan(setup, options, motion, rng, [Slot() for _ in range(fault + after)], max(fault, SERVO_REST))
    plan.accelerating = True
    _draw_wire(plan)
    return plan


def move(
    motion: Motion, begin: float, change: float, most: float, jerk: float, rng: np.random.Generator
) -> float:
    """Add a change of speed, limited in acceleration and jerk; returns its end."""
    size = abs(change)
    acceleration = min(most * float(rng.choice((1.0, 0.5))), math.sqrt(size * jerk))
    if size == 0.0 or acceleration == 0.0:
        return begin
    rise = acceleration / jerk
    hold = size / acceleration - rise
    signed = math.copysign(jerk, change)
    for at, one in ((0.0, signed), (rise, -signed), (rise + hold, -signed), (2.0 * rise + hold, signed)):
        motion.jerks.append((begin + at, one))
    return begin + 2.0 * rise + hold


def vibrate(motion: Motion, rng: np.random.Generator, jerk: float, end: float) -> None:
    """Add a vibration of 10 to 200 Hz in half of the episodes, with 2 % of the jerk of the moves."""
    if rng.integers(2):
        return
    frequency = float(rng.uniform(0.01, 0.2))  # in 1/T
    size = 0.02 * jerk / (2.0 * math.pi * frequency)
    motion.vibrations.append((float(SERVO_REST), size, frequency, end))
