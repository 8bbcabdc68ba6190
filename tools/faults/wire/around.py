"""What happens around the wire: the host, the NMT state, zero pulses, transmission types, other nodes."""

from __future__ import annotations

from tools.faults.wire.line import Plan
from tools.faults.wire.unheard import (
    Change,
    deaf,
    lost_pdos,
    sync_unheard_by_interface,
    sync_unheard_by_module,
)
from tools.faults.wire.untimely import pdo_late, sync_doubled


def healthy(plan: Plan) -> None:
    """Nothing."""


def at_the_limit(plan: Plan) -> None:
    """0.95 of the acceleration that 2010:02 allows, under SYNC jitter."""
    limit = plan.options.limit = 0.15
    plan.motion.pieces.clear()
    for begin in range(20, len(plan.slots), 60):
        plan.motion.push(begin, 25.0, 0.95 * limit)
        plan.motion.push(begin + 30.0, 25.0, -0.95 * limit)


def late_host(plan: Plan) -> None:
    plan.host = "late"


def late_host_and_lost(plan: Plan) -> None:
    plan.host = "late"
    lost_pdos(int(plan.rng.integers(1, 4)))(plan)


def late_host_and_doubled(plan: Plan) -> None:
    plan.host = "late"
    sync_doubled(plan)


def late_host_and_deaf(plan: Plan) -> None:
    plan.host = "late"
    count = int(plan.rng.integers(1, 12))
    deaf(lambda _: count)(plan)


def stall(plan: Plan) -> None:
    long = float(10.0 ** plan.rng.uniform(0.7, 2.7)) * 1e-3 / plan.options.interval_s
    begin = plan.fault + float(plan.rng.uniform())
    plan.stalls.append((begin, min(begin + long, plan.end - 10.0)))


def stall_with_loss(plan: Plan) -> None:
    """A stall in whose burst one PDO, or one SYNC, is missing."""
    stall(plan)
    begin, end = plan.stalls[0]
    at = int(plan.rng.integers(int(begin), max(int(begin) + 1, int(end))))
    if plan.rng.integers(2):
        plan.slots[at].pdo_lost = True
    else:
        plan.slots[at].to_module = False


def zero_pulses(plan: Plan) -> None:
    plan.options.extra = True


def false_pulse(plan: Plan) -> None:
    plan.options.extra = True
    plan.slots[plan.fault].false_pulse = float(plan.rng.uniform())


def first_pulse_false(plan: Plan) -> None:
    plan.options.extra = True
    plan.slots[6 + int(plan.rng.integers(4))].false_pulse = float(plan.rng.uniform())


def false_pulse_with_coarse(plan: Plan) -> None:
    plan.options.coarse = True
    false_pulse(plan)


def extra_doubled(plan: Plan) -> None:
    """RPDO2 comes twice, the second time after the next SYNC."""
    plan.options.extra = True
    for at in range(int(plan.rng.choice((1, 1, 3)))):
        plan.slots[plan.fault + 4 * at].extra_again_us.append(float(plan.rng.uniform(0.8, 1.3)) / plan.us)


def extra_lost(plan: Plan) -> None:
    plan.options.extra = True
    for slot in plan.slots[plan.fault : plan.fault + int(plan.rng.integers(1, 4))]:
        slot.extra_lost = True


def pause(plan: Plan) -> None:
    """PRE-OPERATIONAL, STOPPED or a communication reset; the interface and the SYNC go on."""
    begin = plan.fault + float(plan.rng.uniform())
    end = begin + float(plan.rng.choice((1.0, 3.0, 10.0, 40.0)))
    plan.actions.append((begin, "nmt", bytes([int(plan.rng.choice((128, 2, 130)))])))
    plan.actions.append((end, "nmt", bytes([1])))


def bus_off(plan: Plan) -> None:
    begin = plan.fault + float(plan.rng.uniform())
    length = float(plan.rng.choice((1.0, 3.0, 10.0, 40.0)))
    plan.actions.append((begin, "bus_off", b""))
    plan.actions.append((begin + length, "bus_back", b""))
    plan.actions.append((begin + length + 0.3, "nmt", bytes([1])))
    for number in range(int(begin), int(begin + length) + 1):
        plan.slots[number].to_module, plan.slots[number].pdo_lost = False, True


def bus_off_stays(plan: Plan) -> None:
    """Bus-off of a module that stays in OPERATIONAL (1029h:01)."""
    plan.options.stays = True
    bus_off(plan)


def foreign_pdos(plan: Plan) -> None:
    """Another node sends an ADC PDO now and then: its counts are no sample.

    Where they pass for one they are a legal motion (docs/supervision.md), off by less than the
    residual limit.
    """
    plan.tolerance = 0.9
    for slot in plan.slots[plan.fault : plan.fault + int(plan.rng.choice((1, 1, 10)))]:
        slot.foreign_us = float(plan.rng.uniform(0.05, 0.95)) / plan.us


def synchronous(rpdo: int, tpdo: int, change: Change) -> Change:
    """A fault with these transmission types."""

    def changed(plan: Plan) -> None:
        plan.options.rpdo_type, plan.options.tpdo_type = rpdo, tpdo
        change(plan)

    return changed


def any_loss(plan: Plan) -> None:
    kind = int(plan.rng.integers(5))
    if kind == 0:
        sync_unheard_by_module(plan)
    elif kind == 1:
        sync_unheard_by_interface(plan)
    elif kind == 2:
        lost_pdos(int(plan.rng.integers(1, 4)))(plan)
    elif kind == 3:
        deaf(lambda rng: int(rng.integers(1, 8)))(plan)
    else:
        pdo_late(plan)


def predicting(plan: Plan) -> None:
    """Synchronous PDOs with the position of their SYNC (2013h), which does not jitter here."""
    plan.options.rpdo_type, plan.options.tpdo_type = int(plan.rng.choice((1, 255))), 1
    plan.options.predict = int(plan.rng.choice((1, 2)))
    plan.jitter_us, plan.busy, plan.tolerance = 0.0, 0.0, 1.3
    any_loss(plan)


def coarse_and_loss(plan: Plan) -> None:
    plan.options.coarse = True
    any_loss(plan)
