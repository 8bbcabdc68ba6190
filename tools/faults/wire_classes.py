"""The classes of wire faults: each changes a healthy plan from its slot ``fault`` on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wire_line import Plan
from wire_setups import Setup

Change = Callable[[Plan], None]


def always(_: Setup) -> bool:
    return True


def with_times(setup: Setup) -> bool:
    return setup.times


def with_stamps(setup: Setup) -> bool:
    return setup.stamps


def with_counter(setup: Setup) -> bool:
    return setup.counter


@dataclass(frozen=True)
class WireClass:
    """A class of wire faults. ``torque``: part of the episodes with a torque pulse beside the fault."""

    name: str
    change: Change
    torque: float = 0.5
    after: int = 70
    of: Callable[[Setup], bool] = always


def lost_pdos(count: int) -> Change:
    def change(plan: Plan) -> None:
        for slot in plan.slots[plan.fault : plan.fault + count]:
            slot.pdo_lost = True

    return change


def _pulse_and_one_lost(plan: Plan) -> None:
    """Up to 0.25 cycle/T^2 for 3 to 9 samples around those that are lost."""
    plan.options.limit = (None, 0.25)[int(plan.rng.integers(2))]
    size = float(plan.rng.uniform(0.13, 0.25)) * float(plan.rng.choice((-1.0, 1.0)))
    begin = plan.fault + 1.0 + float(plan.rng.integers(-5, 2))
    plan.motion.push(begin, float(plan.rng.choice((4.0, 5.0, 6.0, 8.0))), size)
    for slot in plan.slots[plan.fault : plan.fault + int(plan.rng.integers(1, 4))]:
        slot.pdo_lost = True


def _pulse_in_the_gap(plan: Plan) -> None:
    """A short pulse near the limit, just where the samples are missing: another motion may look smoother."""
    rng = plan.rng
    limit = plan.options.limit = (0.3, 0.25, 0.15)[int(rng.integers(3))]
    lost = int(rng.integers(1, 4))
    size = float(rng.uniform(0.7, 0.98)) * limit * float(rng.choice((-1.0, 1.0)))
    begin = plan.fault + float(rng.choice((-1.0, 0.0, 0.5)))
    plan.motion.push(begin, float(rng.uniform(1.0, lost + 3.0)), size)
    for slot in plan.slots[plan.fault : plan.fault + lost]:
        slot.pdo_lost = True


def _scattered_losses(plan: Plan) -> None:
    for slot in plan.slots[plan.fault : plan.fault + 40]:
        slot.pdo_lost = plan.rng.uniform() < 0.15


def deaf(count: Callable[[np.random.Generator], int]) -> Change:
    """The module hears nothing for a while: neither SYNC nor PDO."""

    def change(plan: Plan) -> None:
        for slot in plan.slots[plan.fault : plan.fault + count(plan.rng)]:
            slot.to_module, slot.pdo_lost = False, True

    return change


def _whole_turn(plan: Plan) -> None:
    overflow = plan.options.overflow
    turns = 1 if overflow > 100 else int(plan.rng.integers(1, 4))
    for slot in plan.slots[plan.fault : plan.fault + turns * overflow]:
        slot.to_module, slot.pdo_lost = False, True


def _sync_unheard_by_module(plan: Plan) -> None:
    for slot in plan.slots[plan.fault : plan.fault + int(plan.rng.choice((1, 1, 1, 2, 3, 10)))]:
        slot.to_module = False


def _sync_unheard_by_interface(plan: Plan) -> None:
    for slot in plan.slots[plan.fault : plan.fault + int(plan.rng.choice((1, 1, 1, 2, 3, 10)))]:
        slot.to_interface = False


def _sync_unheard_by_both(plan: Plan) -> None:
    for slot in plan.slots[plan.fault : plan.fault + int(plan.rng.choice((1, 1, 1, 2, 3, 10)))]:
        slot.to_module = slot.to_interface = False


def _sync_unheard_now_and_then(plan: Plan) -> None:
    for slot in plan.slots[plan.fault : plan.fault + 50]:
        kind = plan.rng.integers(12)
        slot.to_module, slot.to_interface = kind != 0, kind != 1


def _stop(plan: Plan, resume: bool = True) -> None:
    length = int(plan.rng.choice((5, 20, 60)))
    last = plan.fault + length if resume and plan.rng.integers(2) else len(plan.slots)
    for slot in plan.slots[plan.fault : last]:
        slot.produced = False


def _sync_stops(plan: Plan) -> None:
    _stop(plan)
    _read_outage(plan)


def _read_outage(plan: Plan) -> None:
    for n in range(0, int(plan.end) - plan.fault - 2, 4):
        plan.reads.append(plan.fault + n + float(plan.rng.uniform()))


def _event_timer(plan: Plan) -> None:
    interval_ms = plan.options.interval_s * 1e3
    plan.options.event_timer_ms = max(1, round(interval_ms * float(plan.rng.choice((1.0, 3.0, 7.0)))))


def _sync_stops_event_timer(plan: Plan) -> None:
    _event_timer(plan)
    _stop(plan)


def _deaf_event_timer(plan: Plan) -> None:
    _event_timer(plan)
    deaf(lambda rng: int(rng.integers(3, 50)))(plan)


def _odd_sync(plan: Plan) -> None:
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
        _event_timer(plan)
    _read_outage(plan)


def _wrong_counter(plan: Plan) -> None:
    """One SYNC with a counter that is possible, but not its own."""
    slot = plan.slots[plan.fault]
    slot.payload = bytes([int(plan.rng.integers(1, plan.options.overflow + 1))])


def _doubled(plan: Plan, *, late_us: tuple[float, float]) -> None:
    for at in range(int(plan.rng.choice((1, 1, 2, 5)))):
        slot = plan.slots[plan.fault + 3 * at]
        to = int(plan.rng.integers(3))
        slot.again.append((float(plan.rng.uniform(*late_us)), to != 1, to != 0))


def _sync_doubled(plan: Plan) -> None:
    _doubled(plan, late_us=(47.0, 120.0))


def _sync_doubled_later(plan: Plan) -> None:
    """After the ADC PDO, up to 0.7 T."""
    _doubled(plan, late_us=(120.0, 0.7 / plan.us))


def _pdo_doubled(plan: Plan) -> None:
    for at in range(int(plan.rng.choice((1, 1, 2, 5)))):
        later = (
            float(plan.rng.uniform(60.0, 200.0))
            if plan.rng.integers(2)
            else float(plan.rng.uniform(0.2, 1.6)) / plan.us
        )
        plan.slots[plan.fault + 3 * at].pdo_again_us.append(later)


def _pdo_late(plan: Plan) -> None:
    """Now and then after the next SYNC."""
    for at in range(int(plan.rng.choice((1, 2, 5)))):
        plan.slots[plan.fault + 3 * at].pdo_late_us = float(plan.rng.uniform(0.85, 1.4)) / plan.us


def _pdos_swapped(plan: Plan) -> None:
    """Two PDOs late by one and two cycles, in either order."""
    first, second = (1.0, 2.0) if plan.rng.integers(2) else (2.0, 1.0)
    gap = int(plan.rng.integers(1, 4))
    plan.slots[plan.fault].pdo_late_us = (first - float(plan.rng.uniform(0.0, 0.1))) / plan.us
    plan.slots[plan.fault + gap].pdo_late_us = (second - float(plan.rng.uniform(0.0, 0.1))) / plan.us


def _late_and_lost(plan: Plan) -> None:
    """A late PDO in place of one that is lost: as many PDOs as SYNCs."""
    slots, at = plan.slots, plan.fault
    slots[at].pdo_late_us = float(plan.rng.uniform(0.9, 1.0)) / plan.us
    slots[at + 1].pdo_lost = True


def _one_bad_stamp(plan: Plan) -> None:
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


def _many_bad_stamps(plan: Plan) -> None:
    for slot in plan.slots[plan.fault : plan.fault + 40]:
        if plan.rng.uniform() < 0.1:
            slot.stamp = int(plan.rng.integers(1 << 32))


def _clock_steps(plan: Plan) -> None:
    """The interface's clock jumps and stays there: it was started again."""
    step = (
        int(plan.rng.integers(1 << 32)) if plan.rng.integers(2) else int(plan.rng.integers(-200_000, 200_000))
    )
    for slot in plan.slots[plan.fault :]:
        slot.stamp_add = step


def _stamp_stands(plan: Plan) -> None:
    """The clock of the interface has stopped."""
    stamp = int(plan.rng.integers(1 << 32))
    for slot in plan.slots[plan.fault : plan.fault + int(plan.rng.choice((2, 5, 40)))]:
        slot.stamp = stamp


def _stall(plan: Plan) -> None:
    long = float(10.0 ** plan.rng.uniform(0.7, 2.7)) * 1e-3 / plan.options.interval_s
    begin = plan.fault + float(plan.rng.uniform())
    plan.stalls.append((begin, min(begin + long, plan.end - 10.0)))


def _stall_with_loss(plan: Plan) -> None:
    """A stall in whose burst one PDO, or one SYNC, is missing."""
    _stall(plan)
    begin, end = plan.stalls[0]
    at = int(plan.rng.integers(int(begin), max(int(begin) + 1, int(end))))
    if plan.rng.integers(2):
        plan.slots[at].pdo_lost = True
    else:
        plan.slots[at].to_module = False


def _at_the_limit(plan: Plan) -> None:
    """0.95 of the acceleration that 2010:02 allows, under SYNC jitter."""
    limit = plan.options.limit = 0.15
    plan.motion.pieces.clear()
    for begin in range(20, len(plan.slots), 60):
        plan.motion.push(begin, 25.0, 0.95 * limit)
        plan.motion.push(begin + 30.0, 25.0, -0.95 * limit)


def _late_host(plan: Plan) -> None:
    plan.host = "late"


def _late_host_and_lost(plan: Plan) -> None:
    plan.host = "late"
    lost_pdos(int(plan.rng.integers(1, 4)))(plan)


def _late_host_and_doubled(plan: Plan) -> None:
    plan.host = "late"
    _sync_doubled(plan)


def _late_host_and_deaf(plan: Plan) -> None:
    plan.host = "late"
    count = int(plan.rng.integers(1, 12))
    deaf(lambda _: count)(plan)


def _pulses(plan: Plan) -> None:
    plan.options.extra = True


def _false_pulse(plan: Plan) -> None:
    plan.options.extra = True
    plan.slots[plan.fault].false_pulse = float(plan.rng.uniform())


def _first_pulse_false(plan: Plan) -> None:
    plan.options.extra = True
    plan.slots[6 + int(plan.rng.integers(4))].false_pulse = float(plan.rng.uniform())


def _extra_doubled(plan: Plan) -> None:
    """RPDO2 comes twice, the second time after the next SYNC."""
    plan.options.extra = True
    for at in range(int(plan.rng.choice((1, 1, 3)))):
        plan.slots[plan.fault + 4 * at].extra_again_us.append(float(plan.rng.uniform(0.8, 1.3)) / plan.us)


def _extra_lost(plan: Plan) -> None:
    plan.options.extra = True
    for slot in plan.slots[plan.fault : plan.fault + int(plan.rng.integers(1, 4))]:
        slot.extra_lost = True


def _pause(plan: Plan) -> None:
    """PRE-OPERATIONAL, STOPPED or a communication reset; the interface and the SYNC go on."""
    begin = plan.fault + float(plan.rng.uniform())
    end = begin + float(plan.rng.choice((1.0, 3.0, 10.0, 40.0)))
    plan.actions.append((begin, "nmt", bytes([int(plan.rng.choice((128, 2, 130)))])))
    plan.actions.append((end, "nmt", bytes([1])))


def _bus_off(plan: Plan) -> None:
    begin = plan.fault + float(plan.rng.uniform())
    length = float(plan.rng.choice((1.0, 3.0, 10.0, 40.0)))
    plan.actions.append((begin, "bus_off", b""))
    plan.actions.append((begin + length, "bus_back", b""))
    plan.actions.append((begin + length + 0.3, "nmt", bytes([1])))
    for number in range(int(begin), int(begin + length) + 1):
        plan.slots[number].to_module, plan.slots[number].pdo_lost = False, True


def _bus_off_stays(plan: Plan) -> None:
    """Bus-off of a module that stays in OPERATIONAL (1029h:01)."""
    plan.options.stays = True
    _bus_off(plan)


def _foreign_pdos(plan: Plan) -> None:
    """Another node sends an ADC PDO now and then: its counts are no sample.

    Where they pass for one they are a legal motion (docs/faults.md), off by less than the residual limit.
    """
    plan.tolerance = 0.9
    for slot in plan.slots[plan.fault : plan.fault + int(plan.rng.choice((1, 1, 10)))]:
        slot.foreign_us = float(plan.rng.uniform(0.05, 0.95)) / plan.us


def _interface_restarts(plan: Plan) -> None:
    """The interface is away for a while; its clock begins again."""
    back = plan.fault + int(plan.rng.integers(1, 30))
    add = int(plan.rng.integers(1 << 32))
    for slot in plan.slots[plan.fault : back]:
        slot.pdo_lost = True
    for slot in plan.slots[back:]:
        slot.stamp_add = add


def synchronous(rpdo: int, tpdo: int, change: Change) -> Change:
    """A fault with these transmission types."""

    def changed(plan: Plan) -> None:
        plan.options.rpdo_type, plan.options.tpdo_type = rpdo, tpdo
        change(plan)

    return changed


def _any_loss(plan: Plan) -> None:
    kind = int(plan.rng.integers(5))
    if kind == 0:
        _sync_unheard_by_module(plan)
    elif kind == 1:
        _sync_unheard_by_interface(plan)
    elif kind == 2:
        lost_pdos(int(plan.rng.integers(1, 4)))(plan)
    elif kind == 3:
        deaf(lambda rng: int(rng.integers(1, 8)))(plan)
    else:
        _pdo_late(plan)


def _every_third(plan: Plan) -> None:
    for slot in plan.slots[plan.fault :: 3]:
        slot.pdo_lost = True


def _second_producer(plan: Plan) -> None:
    """Another SYNC producer is there for a while, half a period or so beside the first."""
    beside = float(plan.rng.choice((0.5, 0.5, plan.rng.uniform(0.25, 0.75)))) / plan.us
    for slot in plan.slots[plan.fault : plan.fault + int(plan.rng.choice((1, 5, 60)))]:
        slot.again.append((beside, True, True))


def _period_changes(plan: Plan) -> None:
    """Every second, or every second and third, SYNC is left out from now on: another period."""
    keep = int(plan.rng.choice((2, 3)))
    for number, slot in enumerate(plan.slots[plan.fault :]):
        slot.produced = number % keep == 0


def _wrong_1006(plan: Plan) -> None:
    """1006h is not the period of the bus."""
    plan.options.period = True
    plan.options.period_factor = float(plan.rng.choice((0.5, 2.0, 0.25, 4.0, 1.5, 0.9)))


def _late_for_good(plan: Plan) -> None:
    """Each PDO comes one whole period late from now on."""
    for slot in plan.slots[plan.fault :]:
        slot.pdo_late_us = 1.0 / plan.us


def _replayed(plan: Plan) -> None:
    """The interface sends a PDO of some cycles ago again, between two others or in place of one."""
    back = int(plan.rng.integers(1, 6))
    plan.slots[plan.fault - back].pdo_again_us.append((back + float(plan.rng.uniform(0.0, 0.7))) / plan.us)
    if plan.rng.integers(2):
        plan.slots[plan.fault].pdo_lost = True


def _slow_pdos(plan: Plan) -> None:
    """PDOs that come around the next SYNC, before or after it."""
    for slot in plan.slots[plan.fault : plan.fault + 40]:
        slot.pdo_late_us = float(plan.rng.uniform(0.4, 0.9)) / plan.us


def _rx_stamp_off(plan: Plan) -> None:
    """Receive times are off now and then: 0.9 ms, or by seconds."""
    plan.bad_rx = 0.1


def _false_pulse_with_coarse(plan: Plan) -> None:
    plan.options.coarse = True
    _false_pulse(plan)


def _coarse_and_loss(plan: Plan) -> None:
    plan.options.coarse = True
    _any_loss(plan)


def healthy(plan: Plan) -> None:
    """Nothing."""


CLASSES: tuple[WireClass, ...] = (
    WireClass("healthy", healthy),
    WireClass("healthy, late host", _late_host),
    WireClass("healthy, zero pulses", _pulses),
    WireClass("healthy, at the limit", _at_the_limit, torque=0.0, of=with_times),
    WireClass("stall", _stall, after=220),
    WireClass("stall, one lost", _stall_with_loss, after=220),
    WireClass("pulse, 1..3 lost", _pulse_and_one_lost, torque=0.0),
    WireClass("pulse in the gap", _pulse_in_the_gap, torque=0.0),
    *(WireClass(f"PDO lost, {n}", lost_pdos(n)) for n in (1, 2, 3, 5)),
    WireClass("PDOs lost, 15 %", _scattered_losses),
    WireClass("PDO lost, every third", _every_third),
    WireClass("PDO lost, late host", _late_host_and_lost),
    WireClass("deaf, 1..30", deaf(lambda rng: int(rng.integers(1, 31))), after=100),
    WireClass("deaf, late host", _late_host_and_deaf, after=100),
    WireClass("deaf, whole turn", _whole_turn, after=300, of=with_counter),
    WireClass("deaf, event timer", _deaf_event_timer, after=110),
    WireClass("SYNC unheard by module", _sync_unheard_by_module),
    WireClass("SYNC unheard by interface", _sync_unheard_by_interface),
    WireClass("SYNC unheard by both", _sync_unheard_by_both),
    WireClass("SYNC unheard, 8 % each", _sync_unheard_now_and_then),
    WireClass("SYNC stops, SDO", _sync_stops),
    WireClass("SYNC stops, event timer", _sync_stops_event_timer),
    WireClass("SYNC of odd kind", _odd_sync, after=120),
    WireClass("SYNC counter wrong once", _wrong_counter, of=with_counter),
    WireClass("SYNC doubled", _sync_doubled),
    WireClass("SYNC doubled, later", _sync_doubled_later),
    WireClass("SYNC doubled, late host", _late_host_and_doubled),
    WireClass("SYNC, second producer", _second_producer),
    WireClass("SYNC period changes", _period_changes, after=150),
    WireClass("1006h wrong", _wrong_1006, torque=0.0),
    WireClass("PDO doubled", _pdo_doubled),
    WireClass("PDO replayed", _replayed),
    WireClass("PDOs slow", _slow_pdos),
    WireClass("PDOs late for good", _late_for_good),
    WireClass("PDO late", _pdo_late),
    WireClass("PDOs late by 1 and 2", _pdos_swapped),
    WireClass("PDO late, next lost", _late_and_lost),
    WireClass("stamp, one bad", _one_bad_stamp, of=with_times),
    WireClass("stamps, 10 % bad", _many_bad_stamps, of=with_times),
    WireClass("stamp, clock steps", _clock_steps, of=with_times),
    WireClass("stamp, clock stands", _stamp_stands, of=with_times),
    WireClass("receive times off", _rx_stamp_off, of=with_stamps),
    WireClass("coarse track, any loss", _coarse_and_loss),
    WireClass("zero pulse false, coarse", _false_pulse_with_coarse, after=260),
    WireClass("zero pulse false", _false_pulse, after=260),
    WireClass("zero pulse, first false", _first_pulse_false, after=200),
    WireClass("RPDO2 doubled", _extra_doubled),
    WireClass("RPDO2 lost", _extra_lost),
    WireClass("NMT pause", _pause, torque=0.0, after=110),
    WireClass("bus-off", _bus_off, torque=0.0, after=110),
    WireClass("bus-off, 1029h = 1", _bus_off_stays, torque=0.0, after=110),
    WireClass("foreign ADC PDO", _foreign_pdos),
    WireClass("interface restarts", _interface_restarts),
    WireClass("RPDO 1, TPDO 254", synchronous(1, 254, _any_loss)),
    WireClass("RPDO 255, TPDO 1", synchronous(255, 1, _any_loss)),
    WireClass("RPDO 1, TPDO 1", synchronous(1, 1, _any_loss)),
)  # fmt: skip
