"""Undetectable wire faults: those whose frames are also frames of a healthy machine.

README.md has the cases P1 to P9 with their proofs. P1: a gap, or additional SYNCs, that may be a late host.
P3: PDOs late by a period for good. P4: a sample time with an error within the uncertainty of the wire. P7: a
PDO that answers another SYNC, when the answer to that is due. P8: a step of SYNC within the noise of receive
times. P9: as P4, but the speed is wrong as well.
"""

import itertools
import math
from collections.abc import Sequence

from tools.faults.machine import within_half
from tools.faults.wire.line import Line, Plan
from tools.faults.wire.setups import Setup

LATEST_HOST_S = 5e-3
STAMP_NOISE_S, STAMP_RIGHT_S = 1e-4, 1.05e-4  # undetectable step of SYNC; error of a time (P4)
STEP_PART = 0.55  # part of the uniform noise below which a step is never detected: 1.9 standard deviations
STEP_SYNCS = 64
EARLY = 0.45  # by how much jitter may make a SYNC early, T


def host_may_be_late(setup: Setup, interval_s: float) -> bool:
    """Whether a gap of one period may be a late host: only the time of the call is known."""
    return not (setup.counter or setup.stamps) and interval_s <= LATEST_HOST_S


def stamp_tolerance(setup: Setup, interval_s: float) -> float:
    """Largest undetectable error of a sample time, T, by the uncertainty of receive times or host."""
    return min(0.45, (STAMP_RIGHT_S if setup.stamps else LATEST_HOST_S) / interval_s)


def step_note(plan: Plan, step: float) -> str:
    """Note on a SYNC shifted by ``step``, T: "P8", "P8 for a while" (for some SYNCs), or ""."""
    part = abs(step) * plan.options.interval_s / STAMP_NOISE_S
    return "P8" if part <= STEP_PART else "P8 for a while" if part <= 1.0 else ""


def unseen(plan: Plan, until: float = math.inf) -> str:
    """Case "P1", "P3" or "", by the events up to ``until``, T: later ones are not known yet."""
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
    """Whether a PDO comes when the PDO of a later SYNC is due, received or not (P7)."""
    due = [slot + 2.0 - EARLY for slot in line.sample_slots]  # slot n is due at n + 1
    return any(event.what == "pdo" and event.time >= due[event.number] for event in line.events)


def is_smooth(shown: Sequence[tuple[float, float]], limit: float, whole: float) -> bool:
    """Whether a motion within ``limit`` (cycles/T^2) fits all (time, position), modulo ``whole``."""
    speeds = []
    for (time, position), (next_time, next_position) in itertools.pairwise(shown):
        if next_time > time:
            moved = within_half(next_position - position, whole)
            speeds.append((moved / (next_time - time), next_time - time))
    return all(
        abs(speed - before) <= limit * (intervals + earlier) / 2
        for (before, earlier), (speed, intervals) in itertools.pairwise(speeds)
    )
