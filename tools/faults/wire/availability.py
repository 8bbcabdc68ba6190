"""What a healthy machine, and one lost PDO, must not cost.

:func:`endurance`: 3000 rpm, SYNC jitter of sigma 100 us, host delays up to 5 ms, 100 ppm drift, sample times.
:func:`one_lost`: one PDO lost at half the acceleration limit, for motions of every kind.
"""

from __future__ import annotations

import numpy as np

from tools.faults.wire.draw import TOP_CYCLES
from tools.faults.wire.judge import Verdict
from tools.faults.wire.line import Line, Plan, Slot
from tools.faults.wire.motion import Motion
from tools.faults.wire.play import play_plan
from tools.faults.wire.setups import SETUPS, Options, Setup

CHUNK = 20_000
RAMP = 0.12  # cycles/T^2
MOTIONS = ("constant", "s-curve", "step", "vibration")
LIMITS = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3)
PHASE_MARGIN = 0.05  # cycles that the module adds to the largest acceleration
NOISE_CYCLES = 0.03  # of a second difference: Table 1 without a correction table


def setup_of(name: str) -> Setup:
    """The set-up with this name."""
    return next(one for one in SETUPS if one.name == name)


def endurance(seed: int, samples: int, setup: str = "times") -> Verdict:
    """One chunk of a healthy machine, from standstill, at 3000 rpm with a ripple of 20 Hz."""
    rng = np.random.default_rng([seed, 3000])
    motion = Motion(start=0.4)
    motion.push(20.0, TOP_CYCLES / RAMP, RAMP)
    motion.vibrations.append((40.0 + TOP_CYCLES / RAMP, 0.02, 0.02, float(samples)))
    options = Options(period=setup_of(setup).period is not False)
    plan = Plan(setup_of(setup), options, motion, rng, [Slot() for _ in range(samples)], samples)
    plan.jitter_us, plan.gaussian, plan.busy = 100.0, True, 0.0
    plan.drift, plan.host = 1e-4, "late"
    return play_plan(plan, fresh=True).verdict


def one_lost(motion: str, limit: float, seed: int, setup: str) -> dict[str, int]:
    """One PDO lost at half the acceleration ``limit``, cycles/T^2; what is kept."""
    rng = np.random.default_rng([seed, MOTIONS.index(motion), round(limit * 1000)])
    speed = float(rng.choice((0.0, 3.0, 7.3, 12.0, 25.5)))
    moving = Motion(start=0.4)
    moving.push(15.0, speed / (0.6 * limit), 0.6 * limit)
    fault = 15 + int(speed / (0.6 * limit)) + 45
    _push(moving, motion, 0.5 * limit, fault, rng)
    one = setup_of(setup)
    options = Options(limit=limit, period=one.period is not False)
    plan = Plan(one, options, moving, rng, [Slot() for _ in range(fault + 60)], fault, locked=not one.times)
    plan.slots[fault].pdo_lost = True
    played = play_plan(plan)
    verdict = played.verdict
    kept = verdict.outcome in ("kept", "flagged") and verdict.right_at_end
    wrong = int(verdict.wrong > 0)
    if is_unique(played.line, fault, limit + PHASE_MARGIN):
        return {"one motion fits": 1, "kept": int(kept), "wrong": wrong}
    return {"two fit": 1, "kept of two": int(kept), "wrong": wrong}


def _push(moving: Motion, motion: str, size: float, fault: int, rng: np.random.Generator) -> None:
    size *= float(rng.choice((-1.0, 1.0)))
    at = fault + 1.0 + float(rng.uniform(-4.0, 4.0))
    if motion == "constant":
        moving.push(fault - 20.0, 60.0, size)
    elif motion == "s-curve":
        moving.s_curve(at - 12.0, 24.0, size)
    elif motion == "step":
        moving.push(at, 60.0, size)
    else:
        moving.vibrations.append((fault - 25.0, size, float(rng.uniform(0.01, 0.2)), fault + 60.0))


def is_unique(line: Line, lost: int, limit: float) -> bool:
    """Whether one motion only has second differences below ``limit`` and shows the samples that came.

    With e what another motion is ahead by: e = d at the lost sample, any number; m one later, m + q two
    later, both whole numbers, and q more each sample from there on. Its second differences are those of the
    machine, w, plus d, m - 2 d and q - m + d.
    """
    x = line.positions
    w = [x[lost + n] - 2.0 * x[lost + n - 1] + x[lost + n - 2] for n in range(3)]
    room = limit + NOISE_CYCLES
    for m in range(-3, 4):
        for q in range(-3, 4):
            if m == q == 0:
                continue
            low = max(-room - w[0], (m + w[1] - room) / 2.0, m - q - room - w[2])
            high = min(room - w[0], (m + w[1] + room) / 2.0, m - q + room - w[2])
            if low < high:
                return False
    return True
