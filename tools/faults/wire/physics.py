"""What no module can see: the few wire faults whose frames are those of a healthy machine.

README.md has the cases P1 to P9 with their proofs. P1: a gap, or SYNCs too many, that may be a late host. P3:
PDOs late by a period for good. P4: a sample time that is off by no more than the wire can be. P7: a PDO that
answers another SYNC, when its answer is due. P8: a step of SYNC within the noise of receive times. P9: as P4,
for the speed, too.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

from tools.faults.machine import within_half
from tools.faults.wire.line import Line, Plan
from tools.faults.wire.setups import Setup

LATEST_HOST_S = 5e-3
STAMP_NOISE_S, STAMP_RIGHT_S = 1e-4, 1.05e-4  # of a step; of a time: 75 us (docs/time.md), and 30 us of noise
STEP_PART = 0.55  # of the uniform noise: 1.9 standard deviations
STEP_SYNCS = 64
EARLY = 0.45  # T: a SYNC by its jitter, at most


def host_may_be_late(setup: Setup, interval_s: float) -> bool:
    """Whether a gap of one period may be the host's: nothing but the moment of the call has a time."""
    return not (setup.counter or setup.stamps) and interval_s <= LATEST_HOST_S


def stamp_tolerance(setup: Setup, interval_s: float) -> float:
    """How far a sample time may be off unseen, T: by receive times, or by the jitter of the SYNC."""
    return min(0.45, (STAMP_RIGHT_S if setup.stamps else LATEST_HOST_S) / interval_s)


def step_note(plan: Plan, step: float) -> str:
    """P8, P8 for some SYNCs, or nothing, for a SYNC that is off by ``step``, T."""
    part = abs(step) * plan.options.interval_s / STAMP_NOISE_S
    return "P8" if part <= STEP_PART else "P8 for a while" if part <= 1.0 else ""


def unseen(plan: Plan, until: float = math.inf) -> str:
    """P1, P3, or nothing; by what comes ``until`` then, T: no module knows the rest."""
    if plan.setup.times:
        return ""
    late = [n for n, slot in enumerate(plan.slots) if slot.pdo_late_us * plan.us > 0.99]
    if not plan.options.answer_s and late and late == list(range(late[0], len(plan.slots))):
        return "P3"
    acted = any(at <= until for at, _, _ in plan.actions)
    return "P1" if not plan.setup.stamps and not acted and _is_short(plan, until) else ""


def _is_short(plan: Plan, until: float) -> bool:
    unheard = [
        not one.produced or (not one.to_module and (one.pdo_lost or not one.to_interface))
        for one in plan.slots
    ]
    end = min(until, plan.end)  # slot n is due at n + 1
    known = itertools.takewhile(lambda n: n + 1 <= end or unheard[n], range(len(unheard)))
    runs = [sum(1 for _ in group) for bit, group in itertools.groupby(unheard[n] for n in known) if bit]
    turn = plan.options.overflow if plan.setup.counter else 1
    if any(run % turn for run in runs):
        return False
    slots = plan.slots[: int(end)]
    extra = 0 if plan.setup.counter else sum(to_module for s in slots for _, to_module, _ in s.again)
    return 0.0 < (sum(runs) + extra) * plan.options.interval_s <= LATEST_HOST_S


def answers_another(line: Line) -> bool:
    """A PDO comes when that of a later SYNC than its own is due, heard or not (P7)."""
    due = [slot + 2.0 - EARLY for slot in line.sample_slots]  # slot n is due at n + 1
    return any(event.what == "pdo" and event.time >= due[event.number] for event in line.events)


def is_smooth(shown: Sequence[tuple[float, float]], limit: float, whole: float) -> bool:
    """Whether a motion within ``limit`` (cycles/T^2) goes through all (time, position); modulo ``whole``."""
    speeds = []
    for (time, position), (next_time, next_position) in itertools.pairwise(shown):
        if next_time > time:
            moved = within_half(next_position - position, whole)
            speeds.append((moved / (next_time - time), next_time - time))
    return all(
        abs(speed - before) <= limit * (intervals + earlier) / 2
        for (before, earlier), (speed, intervals) in itertools.pairwise(speeds)
    )
