"""What is not heard: ADC PDOs and SYNCs that the module, the interface or both miss."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tools.faults.wire.line import Plan

Change = Callable[[Plan], None]
"""Changes a healthy plan from its slot ``fault`` on."""


def lost_pdos(count: int) -> Change:
    def change(plan: Plan) -> None:
        for slot in plan.slots[plan.fault : plan.fault + count]:
            slot.pdo_lost = True

    return change


def pulse_and_one_lost(plan: Plan) -> None:
    """Up to 0.25 cycle/T^2 for 3 to 9 samples around those that are lost."""
    plan.options.limit = (None, 0.25)[int(plan.rng.integers(2))]
    size = float(plan.rng.uniform(0.13, 0.25)) * float(plan.rng.choice((-1.0, 1.0)))
    begin = plan.fault + 1.0 + float(plan.rng.integers(-5, 2))
    plan.motion.push(begin, float(plan.rng.choice((4.0, 5.0, 6.0, 8.0))), size)
    for slot in plan.slots[plan.fault : plan.fault + int(plan.rng.integers(1, 4))]:
        slot.pdo_lost = True


def pulse_in_the_gap(plan: Plan) -> None:
    """A short pulse near the limit, just where the samples are missing: another motion may look smoother."""
    rng = plan.rng
    limit = plan.options.limit = (0.3, 0.25, 0.15)[int(rng.integers(3))]
    lost = int(rng.integers(1, 4))
    size = float(rng.uniform(0.7, 0.98)) * limit * float(rng.choice((-1.0, 1.0)))
    begin = plan.fault + float(rng.choice((-1.0, 0.0, 0.5)))
    plan.motion.push(begin, float(rng.uniform(1.0, lost + 3.0)), size)
    for slot in plan.slots[plan.fault : plan.fault + lost]:
        slot.pdo_lost = True


def time_lost(plan: Plan) -> None:
    """The PDO with the sample time alone: once, or now and then."""
    chance = float(plan.rng.choice((0.0, 0.1)))
    for number in range(plan.fault, len(plan.slots)):
        plan.slots[number].times_lost = number == plan.fault or bool(plan.rng.uniform() < chance)


def scattered_losses(plan: Plan) -> None:
    for slot in plan.slots[plan.fault : plan.fault + 40]:
        slot.pdo_lost = plan.rng.uniform() < 0.15


def every_nth(plan: Plan) -> None:
    """A PDO is lost regularly: the position comes and goes, and each time there is something to report."""
    for slot in plan.slots[plan.fault :: int(plan.rng.choice((3, 6, 8, 12)))]:
        slot.pdo_lost = True


def deaf(count: Callable[[np.random.Generator], int]) -> Change:
    """The module hears nothing for a while: neither SYNC nor PDO."""

    def change(plan: Plan) -> None:
        for slot in plan.slots[plan.fault : plan.fault + count(plan.rng)]:
            slot.to_module, slot.pdo_lost = False, True

    return change


def whole_turn(plan: Plan) -> None:
    overflow = plan.options.overflow
    turns = 1 if overflow > 100 else int(plan.rng.integers(1, 4))
    for slot in plan.slots[plan.fault : plan.fault + turns * overflow]:
        slot.to_module, slot.pdo_lost = False, True


def sync_unheard_by_module(plan: Plan) -> None:
    for slot in plan.slots[plan.fault : plan.fault + int(plan.rng.choice((1, 1, 1, 2, 3, 10)))]:
        slot.to_module = False


def sync_unheard_by_interface(plan: Plan) -> None:
    for slot in plan.slots[plan.fault : plan.fault + int(plan.rng.choice((1, 1, 1, 2, 3, 10)))]:
        slot.to_interface = False


def sync_unheard_by_both(plan: Plan) -> None:
    for slot in plan.slots[plan.fault : plan.fault + int(plan.rng.choice((1, 1, 1, 2, 3, 10)))]:
        slot.to_module = slot.to_interface = False


def sync_unheard_now_and_then(plan: Plan) -> None:
    for slot in plan.slots[plan.fault : plan.fault + 50]:
        kind = plan.rng.integers(12)
        slot.to_module, slot.to_interface = kind != 0, kind != 1


def stop(plan: Plan, resume: bool = True) -> None:
    length = int(plan.rng.choice((5, 20, 60)))
    last = plan.fault + length if resume and plan.rng.integers(2) else len(plan.slots)
    for slot in plan.slots[plan.fault : last]:
        slot.produced = False


def sync_stops(plan: Plan) -> None:
    stop(plan)
    read_outage(plan)


def read_outage(plan: Plan) -> None:
    for n in range(0, int(plan.end) - plan.fault - 2, 4):
        plan.reads.append(plan.fault + n + float(plan.rng.uniform()))


def event_timer(plan: Plan) -> None:
    interval_ms = plan.options.interval_s * 1e3
    plan.options.event_timer_ms = max(1, round(interval_ms * float(plan.rng.choice((1.0, 3.0, 7.0)))))


def sync_stops_event_timer(plan: Plan) -> None:
    event_timer(plan)
    stop(plan)


def deaf_event_timer(plan: Plan) -> None:
    event_timer(plan)
    deaf(lambda rng: int(rng.integers(3, 50)))(plan)


def odd_sync(plan: Plan) -> None:
    """SYNCs of a length, or with a counter, that this set-up does not have."""
    counter = plan.setup.counter
    kind = int(plan.rng.integers(2))
    length = int(plan.rng.choice((1, 4, 60)))
    for number, slot in enumerate(plan.slots[plan.fault : plan.fault + length], plan.fault):
        if not counter:
            slot.payload = bytes([number % 10 + 1] * (1 + kind))
        elif kind:
            slot.payload = b""
        else:
            slot.payload = bytes([int(plan.rng.choice((0, plan.options.overflow + 1, 255)))])
    if plan.rng.integers(2):
        event_timer(plan)
    read_outage(plan)


def wrong_counter(plan: Plan) -> None:
    """One SYNC with a counter that is possible, but not its own."""
    slot = plan.slots[plan.fault]
    slot.payload = bytes([int(plan.rng.integers(1, plan.options.overflow + 1))])
