"""What comes twice, late, out of order, at another rate, or with a wrong time."""

from __future__ import annotations

from tools.faults.wire.line import Plan


def doubled(plan: Plan, *, late_us: tuple[float, float]) -> None:
    for at in range(int(plan.rng.choice((1, 1, 2, 5)))):
        slot = plan.slots[plan.fault + 3 * at]
        to = int(plan.rng.integers(3))
        slot.again.append((float(plan.rng.uniform(*late_us)), to != 1, to != 0))


def sync_doubled(plan: Plan) -> None:
    doubled(plan, late_us=(47.0, 120.0))


def sync_doubled_later(plan: Plan) -> None:
    """After the ADC PDO, up to 0.7 T."""
    doubled(plan, late_us=(120.0, 0.7 / plan.us))


def second_producer(plan: Plan) -> None:
    """Another SYNC producer is there for a while, half a period or so beside the first."""
    beside = float(plan.rng.choice((0.5, 0.5, plan.rng.uniform(0.25, 0.75)))) / plan.us
    for slot in plan.slots[plan.fault : plan.fault + int(plan.rng.choice((1, 5, 60)))]:
        slot.again.append((beside, True, True))


def period_changes(plan: Plan) -> None:
    """Every second, or every second and third, SYNC is left out from now on: another period."""
    keep = int(plan.rng.choice((2, 3)))
    for number, slot in enumerate(plan.slots[plan.fault :]):
        slot.produced = number % keep == 0


def wrong_1006(plan: Plan) -> None:
    """1006h is not the period of the bus."""
    plan.options.period = True
    plan.options.period_factor = float(plan.rng.choice((0.5, 2.0, 0.25, 4.0, 1.5, 0.9)))


def pdo_doubled(plan: Plan) -> None:
    for at in range(int(plan.rng.choice((1, 1, 2, 5)))):
        later = (
            float(plan.rng.uniform(60.0, 200.0))
            if plan.rng.integers(2)
            else float(plan.rng.uniform(0.2, 1.6)) / plan.us
        )
        plan.slots[plan.fault + 3 * at].pdo_again_us.append(later)


def pdo_replayed(plan: Plan) -> None:
    """The interface sends a PDO of some cycles ago again, between two others or in place of one."""
    back = int(plan.rng.integers(1, 6))
    plan.slots[plan.fault - back].pdo_again_us.append((back + float(plan.rng.uniform(0.0, 0.7))) / plan.us)
    if plan.rng.integers(2):
        plan.slots[plan.fault].pdo_lost = True


def slow_pdos(plan: Plan) -> None:
    """PDOs that come around the next SYNC, before or after it."""
    for slot in plan.slots[plan.fault : plan.fault + 40]:
        slot.pdo_late_us = float(plan.rng.uniform(0.4, 0.9)) / plan.us


def late_for_good(plan: Plan) -> None:
    """Each PDO comes one whole period late from now on."""
    for slot in plan.slots[plan.fault :]:
        slot.pdo_late_us = 1.0 / plan.us


def pdo_late(plan: Plan) -> None:
    """Now and then after the next SYNC."""
    for at in range(int(plan.rng.choice((1, 2, 5)))):
        plan.slots[plan.fault + 3 * at].pdo_late_us = float(plan.rng.uniform(0.85, 1.4)) / plan.us


def pdos_swapped(plan: Plan) -> None:
    """Two PDOs late by one and two cycles, in either order."""
    first, second = (1.0, 2.0) if plan.rng.integers(2) else (2.0, 1.0)
    gap = int(plan.rng.integers(1, 4))
    plan.slots[plan.fault].pdo_late_us = (first - float(plan.rng.uniform(0.0, 0.1))) / plan.us
    plan.slots[plan.fault + gap].pdo_late_us = (second - float(plan.rng.uniform(0.0, 0.1))) / plan.us


def late_and_lost(plan: Plan) -> None:
    """A late PDO in place of one that is lost: as many PDOs as SYNCs."""
    slots, at = plan.slots, plan.fault
    slots[at].pdo_late_us = float(plan.rng.uniform(0.9, 1.0)) / plan.us
    slots[at + 1].pdo_lost = True


def one_bad_stamp(plan: Plan) -> None:
    slot = plan.slots[plan.fault]
    kind = int(plan.rng.integers(5))
    if kind == 0:
        slot.stamp = int(plan.rng.integers(1 << 32))
    elif kind == 1:
        slot.stamp = 0
    elif kind == 2:  # late or early by whole periods
        slot.stamp_add = int(plan.rng.integers(-3, 4)) * round(plan.options.interval_s / 1e-7)
    else:
        slot.stamp_add = int(10.0 ** plan.rng.uniform(1.0, 7.0)) * int(plan.rng.choice((-1, 1)))


def many_bad_stamps(plan: Plan) -> None:
    for slot in plan.slots[plan.fault : plan.fault + 40]:
        if plan.rng.uniform() < 0.1:
            slot.stamp = int(plan.rng.integers(1 << 32))


def clock_steps(plan: Plan) -> None:
    """The interface's clock jumps and stays there: it was started again."""
    step = (
        int(plan.rng.integers(1 << 32)) if plan.rng.integers(2) else int(plan.rng.integers(-200_000, 200_000))
    )
    for slot in plan.slots[plan.fault :]:
        slot.stamp_add = step


def stamp_stands(plan: Plan) -> None:
    """The clock of the interface has stopped."""
    stamp = int(plan.rng.integers(1 << 32))
    for slot in plan.slots[plan.fault : plan.fault + int(plan.rng.choice((2, 5, 40)))]:
        slot.stamp = stamp


def interface_restarts(plan: Plan) -> None:
    """The interface is away for a while; its clock begins again."""
    back = plan.fault + int(plan.rng.integers(1, 30))
    add = int(plan.rng.integers(1 << 32))
    for slot in plan.slots[plan.fault : back]:
        slot.pdo_lost = True
    for slot in plan.slots[back:]:
        slot.stamp_add = add


def rx_stamp_off(plan: Plan) -> None:
    """Receive times are off now and then: 0.9 ms, or by seconds."""
    plan.bad_rx = 0.1
