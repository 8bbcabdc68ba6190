"""Stalls of a computer, 1 to 500 ms, at 100, 500 and 1000 Hz, with sample times.

What stalls is the module alone, whose frames wait or, beyond its queue, are dropped; the SYNC producer
alone; or all of them. A stall without dropped frames hides nothing. Else the position has to be kept where
one motion only fits; where two do it may be lost, but never valid and wrong. A short plan has several
stalls that are to be kept; after a loss the rest of them would show nothing.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tools.faults.wire.clocks import a_speed, longest_bridged, machine, producer_stalls
from tools.faults.wire.draw import torque
from tools.faults.wire.line import Plan

WHO = ("module", "module, queue", "producer", "all")
RATES_HZ = (100, 500, 1000)
SHORTEST_S, LONGEST_S = 1e-3, 0.5
IN_A_ROW = 8
BETWEEN = 40  # periods from one stall to the next
QUEUES = (20, 64, 277)  # frames; a slot is two of them
LIMITS = (0.02, 0.05, 0.1)  # cycles/T^2
SPARE = 1.1  # a torque pulse on top of a vibration, which is declared then


def stalls(who: str, rate_hz: int, is_short: bool) -> Callable[[Plan], None]:
    """Of one machine; ``is_short``: one motion only fits behind each."""

    def change(plan: Plan) -> None:
        rng = plan.rng
        plan.options.interval_s = 1.0 / rate_hz
        limit = float(rng.choice(LIMITS))
        bridged = longest_bridged(limit * SPARE)
        lengths = _lengths(rng, who, rate_hz, bridged, is_short)
        after = int(sum(lengths)) + BETWEEN * (len(lengths) + 1)
        machine(plan, a_speed(plan, 0.0, 40.0), after, limit=limit)
        plan.options.coast = min(int(max(lengths)) + 4, 255)
        plan.jitter_us = float(rng.uniform(0.0, 0.05)) * plan.options.interval_s * 1e6
        plan.gaussian, plan.busy = False, 0.0
        begin = plan.fault + 0.7 + float(rng.uniform(0.0, 0.3))
        for length in lengths:
            _put(plan, who, begin, begin + length, bridged if is_short else 0)
            begin = float(int(begin + length) + BETWEEN) + float(rng.uniform(0.0, 1.0))
        if rng.integers(2):
            torque(plan)

    return change


def _lengths(rng: np.random.Generator, who: str, rate_hz: int, bridged: int, is_short: bool) -> list[float]:
    most = LONGEST_S * rate_hz
    if is_short and who in ("producer", "all"):
        most = min(most, bridged)
    least = min(SHORTEST_S * rate_hz, most / 2.0)
    lengths = np.exp(rng.uniform(np.log(least), np.log(most), IN_A_ROW if is_short else 1))
    return [float(one) for one in lengths]


def _put(plan: Plan, who: str, begin: float, end: float, bridged: int) -> None:
    """One stall; ``bridged``: so many samples at most are dropped, 0: as many as the queue drops."""
    first, last = int(begin), int(end - 1.0)  # slot n is due at n + 1
    if who != "producer":
        plan.stalls.append((begin, end))
    if who in ("producer", "all"):
        producer_stalls(plan, begin, end)
    elif who == "module, queue":
        heard = first + int(plan.rng.choice(QUEUES)) // 2
        if bridged:
            heard = max(heard, last - bridged + 1)
        for slot in plan.slots[heard:last]:
            slot.to_module, slot.pdo_lost = False, True
