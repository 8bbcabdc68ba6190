"""The classes of wire faults: each changes a healthy plan from its slot ``fault`` on.

A change is a function of the plan, or several in a row. Those of one line are made of the functions at the
head of this page; an aimed class brings its own machine (:mod:`tools.faults.wire.clocks`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tools.faults.wire import clocks
from tools.faults.wire.clocks import RATES_HZ, WHO, stalls
from tools.faults.wire.line import TICK_S, Plan
from tools.faults.wire.setups import Setup

Change = Callable[[Plan], object]


def one_of(*values: float) -> Callable[[Plan], Any]:
    return lambda plan: plan.rng.choice(values).item()


def between(least: int, most: int) -> Callable[[Plan], int]:
    return lambda plan: int(plan.rng.integers(least, most + 1))


def periods_us(least: float, most: float) -> Callable[[Plan], float]:
    """Of the SYNC, as microseconds."""
    return lambda plan: float(plan.rng.uniform(least, most)) / plan.us


def drawn(value: Any, plan: Plan) -> Any:
    return value(plan) if callable(value) else value


def put(thing: object, fields: dict[str, Any], plan: Plan) -> None:
    vars(thing).update({name: drawn(value, plan) for name, value in fields.items()})


def slots(
    count: int | Callable[[Plan], int] | None,
    step: int | Callable[[Plan], int] = 1,
    skip: int = 0,
    **fields: Any,
) -> Change:
    """Set these fields of slots, from the fault on; None: of all. A value may be drawn for each slot."""

    def change(plan: Plan) -> None:
        apart, number, first = drawn(step, plan), drawn(count, plan), plan.fault + skip
        last = None if number is None else first + number * apart
        for slot in plan.slots[first:last:apart]:
            put(slot, fields, plan)

    return change


def options(**fields: Any) -> Change:
    return lambda plan: put(plan.options, fields, plan)


def wire(**fields: Any) -> Change:
    return lambda plan: put(plan, fields, plan)


def any_of(*changes: Change) -> Change:
    return lambda plan: changes[int(plan.rng.integers(len(changes)))](plan)


def at_the_limit(plan: Plan) -> None:
    """0.95 of the acceleration that 2010:02 allows, under SYNC jitter."""
    limit = plan.options.limit = 0.15
    plan.motion.pieces.clear()
    for begin in range(20, len(plan.slots), 60):
        plan.motion.push(begin, 25.0, 0.95 * limit)
        plan.motion.push(begin + 30.0, 25.0, -0.95 * limit)


def stall(plan: Plan) -> None:
    long = float(10.0 ** plan.rng.uniform(0.7, 2.7)) * 1e-3 / plan.options.interval_s
    begin = plan.fault + float(plan.rng.uniform())
    plan.stalls.append((begin, min(begin + long, plan.end - 10.0)))


def lose_one_in_the_burst(plan: Plan) -> None:
    """One PDO, or one SYNC, of those that wait."""
    begin, end = plan.stalls[0]
    at = int(plan.rng.integers(int(begin), max(int(begin) + 1, int(end))))
    if plan.rng.integers(2):
        plan.slots[at].pdo_lost = True
    else:
        plan.slots[at].to_module = False


def pulse_and_some_lost(plan: Plan) -> None:
    """Up to 0.25 cycle/T^2 for 3 to 9 samples around those that are lost."""
    plan.options.limit = (None, 0.25)[int(plan.rng.integers(2))]
    size = float(plan.rng.uniform(0.13, 0.25)) * float(plan.rng.choice((-1.0, 1.0)))
    begin = plan.fault + 1.0 + float(plan.rng.integers(-5, 2))
    plan.motion.push(begin, float(plan.rng.choice((4.0, 5.0, 6.0, 8.0))), size)
    slots(between(1, 3), pdo_lost=True)(plan)


def pulse_in_the_gap(plan: Plan) -> None:
    """A short pulse near the limit, just where the samples are missing: another motion may look smoother."""
    rng = plan.rng
    limit = plan.options.limit = (0.3, 0.25, 0.15)[int(rng.integers(3))]
    lost = int(rng.integers(1, 4))
    size = float(rng.uniform(0.7, 0.98)) * limit * float(rng.choice((-1.0, 1.0)))
    begin = plan.fault + float(rng.choice((-1.0, 0.0, 0.5)))
    plan.motion.push(begin, float(rng.uniform(1.0, lost + 3.0)), size)
    slots(lost, pdo_lost=True)(plan)


def time_lost(plan: Plan) -> None:
    """The PDO with the sample time alone: once, or now and then."""
    chance = float(plan.rng.choice((0.0, 0.1)))
    first, *later = plan.slots[plan.fault :]
    first.times_lost = True
    for slot in later:
        slot.times_lost = bool(plan.rng.uniform() < chance)


def whole_turns(plan: Plan) -> int:
    overflow = plan.options.overflow
    return overflow * (1 if overflow > 100 else int(plan.rng.integers(1, 4)))


def unheard_now_and_then(plan: Plan) -> None:
    for slot in plan.slots[plan.fault : plan.fault + 50]:
        kind = plan.rng.integers(12)
        slot.to_module, slot.to_interface = kind != 0, kind != 1


def sync_stops(plan: Plan) -> None:
    length = int(plan.rng.choice((5, 20, 60)))
    slots(length if plan.rng.integers(2) else None, produced=False)(plan)


def read_outage(plan: Plan) -> None:
    for n in range(0, int(plan.end) - plan.fault - 2, 4):
        plan.reads.append(plan.fault + n + float(plan.rng.uniform()))


def event_timer(plan: Plan) -> None:
    interval_ms = plan.options.interval_s * 1e3
    plan.options.event_timer_ms = max(1, round(interval_ms * float(plan.rng.choice((1.0, 3.0, 7.0)))))


def odd_sync(plan: Plan) -> None:
    """SYNCs of a length, or with a counter, that this set-up does not have."""
    kind = int(plan.rng.integers(2))
    length = int(plan.rng.choice((1, 4, 60)))
    for number, slot in enumerate(plan.slots[plan.fault : plan.fault + length], plan.fault):
        if not plan.setup.counter:
            slot.payload = bytes([number % 10 + 1] * (1 + kind))
        elif kind:
            slot.payload = b""
        else:
            slot.payload = bytes([int(plan.rng.choice((0, plan.options.overflow + 1, 255)))])
    if plan.rng.integers(2):
        event_timer(plan)


def doubled(least_us: float, most: Callable[[Plan], float]) -> Change:
    """SYNCs that the module, the interface, or both hear twice."""

    def again(plan: Plan) -> list[tuple[float, bool, bool]]:
        to = int(plan.rng.integers(3))
        return [(float(plan.rng.uniform(least_us, most(plan))), to != 1, to != 0)]

    return slots(one_of(1, 1, 2, 5), step=3, again=again)


def second_producer(plan: Plan) -> None:
    """Another SYNC producer is there for a while, half a period or so beside the first."""
    beside = float(plan.rng.choice((0.5, 0.5, plan.rng.uniform(0.25, 0.75)))) / plan.us
    slots(one_of(1, 5, 60), again=lambda _: [(beside, True, True)])(plan)


def period_changes(plan: Plan) -> None:
    """Every second, or every second and third, SYNC is left out from now on: another period."""
    keep = int(plan.rng.choice((2, 3)))
    for number, slot in enumerate(plan.slots[plan.fault :]):
        slot.produced = number % keep == 0


def pdo_again(plan: Plan) -> list[float]:
    soon = plan.rng.integers(2)
    return [float(plan.rng.uniform(60.0, 200.0)) if soon else periods_us(0.2, 1.6)(plan)]


def pdo_replayed(plan: Plan) -> None:
    """The interface sends a PDO of some cycles ago again, between two others or in place of one."""
    back = int(plan.rng.integers(1, 6))
    plan.slots[plan.fault - back].pdo_again_us.append((back + float(plan.rng.uniform(0.0, 0.7))) / plan.us)
    if plan.rng.integers(2):
        plan.slots[plan.fault].pdo_lost = True


def pdos_swapped(plan: Plan) -> None:
    """Two PDOs late by one and two cycles, in either order."""
    lates = (1.0, 2.0) if plan.rng.integers(2) else (2.0, 1.0)
    gap = int(plan.rng.integers(1, 4))
    for at, late in zip((0, gap), lates, strict=True):
        plan.slots[plan.fault + at].pdo_late_us = (late - float(plan.rng.uniform(0.0, 0.1))) / plan.us


def any_stamp(plan: Plan) -> int:
    return int(plan.rng.integers(1 << 32))


def one_bad_stamp(plan: Plan) -> None:
    """Any, zero, late or early by whole periods, or by 1 us to 1 s."""
    slot = plan.slots[plan.fault]
    kind = int(plan.rng.integers(5))
    if kind < 2:
        slot.stamp = 0 if kind else any_stamp(plan)
    elif kind == 2:
        slot.stamp_add = int(plan.rng.integers(-3, 4)) * round(plan.options.interval_s / TICK_S)
    else:
        slot.stamp_add = int(10.0 ** plan.rng.uniform(1.0, 7.0)) * int(plan.rng.choice((-1, 1)))


def clock_steps(plan: Plan) -> None:
    """The interface's clock jumps and stays there: it was started again."""
    step = any_stamp(plan) if plan.rng.integers(2) else int(plan.rng.integers(-200_000, 200_000))
    slots(None, stamp_add=step)(plan)


def clock_stands(plan: Plan) -> None:
    slots(one_of(2, 5, 40), stamp=any_stamp(plan))(plan)


def interface_restarts(plan: Plan) -> None:
    """The interface is away for a while; its clock begins again."""
    back = int(plan.rng.integers(1, 30))
    slots(None, stamp_add=any_stamp(plan))(plan)
    slots(back, stamp_add=0, pdo_lost=True)(plan)


def first_pulse_false(plan: Plan) -> None:
    plan.slots[6 + int(plan.rng.integers(4))].false_pulse = float(plan.rng.uniform())


def pause(plan: Plan) -> None:
    """PRE-OPERATIONAL, STOPPED or a communication reset; the interface and the SYNC go on."""
    begin = plan.fault + float(plan.rng.uniform())
    end = begin + float(plan.rng.choice((1.0, 3.0, 10.0, 40.0)))
    plan.actions.append((begin, "nmt", bytes([int(plan.rng.choice((128, 2, 130)))])))
    plan.actions.append((end, "nmt", bytes([1])))


def bus_off(plan: Plan) -> None:
    begin = plan.fault + float(plan.rng.uniform())
    end = begin + float(plan.rng.choice((1.0, 3.0, 10.0, 40.0)))
    plan.actions += [(begin, "bus_off", b""), (end, "bus_back", b""), (end + 0.3, "nmt", bytes([1]))]
    for slot in plan.slots[int(begin) : int(end) + 1]:
        slot.to_module, slot.pdo_lost = False, True


SOME = one_of(1, 1, 1, 2, 3, 10)
LATE_HOST = wire(host="late")
ZERO_PULSES, COARSE = options(extra=True), options(coarse=True)
PDO_LATE = slots(one_of(1, 2, 5), step=3, pdo_late_us=periods_us(0.85, 1.4))
UNHEARD_BY_MODULE, UNHEARD_BY_INTERFACE = slots(SOME, to_module=False), slots(SOME, to_interface=False)
SYNC_DOUBLED = doubled(47.0, lambda _: 120.0)
FALSE_PULSE = slots(1, false_pulse=lambda plan: float(plan.rng.uniform()))
# Synchronous PDOs with the position of their SYNC (2013h), which does not jitter here.
PREDICTED = options(rpdo_type=one_of(1, 255), tpdo_type=1, predict=one_of(1, 2))


def lost(count: int | Callable[[Plan], int]) -> Change:
    return slots(count, pdo_lost=True)


def deaf(count: Callable[[Plan], int]) -> Change:
    """The module hears nothing for a while: neither SYNC nor PDO."""
    return slots(count, to_module=False, pdo_lost=True)


any_loss = any_of(UNHEARD_BY_MODULE, UNHEARD_BY_INTERFACE, lost(between(1, 3)), deaf(between(1, 7)), PDO_LATE)


@dataclass(frozen=True)
class WireClass:
    """A class of wire faults; the set-ups of ``of`` and ``valid`` are those that fit (:meth:`Setup.fits`).

    torque      part of the episodes with a torque pulse beside the fault
    after       slots after the fault
    survives    what is declared keeps the position, so that a loss is a goal missed
    valid       in these set-ups each sample after the start is to be valid
    """

    name: str
    changes: tuple[Change, ...]
    torque: float = 0.5
    after: int = 70
    of: str = ""
    survives: bool = False
    valid: str | None = None

    def change(self, plan: Plan) -> None:
        for change in self.changes:
            change(plan)

    def demands_validity(self, setup: Setup) -> bool:
        return self.valid is not None and setup.fits(self.valid)


def wire_class(
    name: str, *changes: Change, torque: float = 0.5, after: int = 70, of: str = "", valid: str | None = None
) -> WireClass:
    return WireClass(name, changes, torque, after, of, False, valid)


def aimed(name: str, change: Change, of: str, survives: bool = False) -> WireClass:
    return WireClass(name, (change,), torque=0.0, of=of, survives=survives)


_TABLE = (
    wire_class("healthy", valid=""),
    # Without a time, what a host takes a period late may be of the next SYNC until a later frame shows it.
    wire_class("healthy, late host", LATE_HOST, valid="stamps|times"),
    wire_class("healthy, zero pulses", ZERO_PULSES, valid=""),
    wire_class("healthy, at the limit", at_the_limit, torque=0.0, of="times !servo", valid=""),
    wire_class("stall", stall, after=220),
    wire_class("stall, one lost", stall, lose_one_in_the_burst, after=220),
    wire_class("pulse, 1..3 lost", pulse_and_some_lost, torque=0.0, of="!servo"),
    wire_class("pulse in the gap", pulse_in_the_gap, torque=0.0, of="!servo"),
    *(wire_class(f"PDO lost, {n}", lost(n)) for n in (1, 2, 3, 5)),
    wire_class("PDO with the time lost", time_lost, of="servo"),
    wire_class("PDOs lost, 15 %", slots(40, pdo_lost=lambda plan: plan.rng.uniform() < 0.15)),
    wire_class("PDO lost, every n-th", slots(None, step=one_of(3, 6, 8, 12), pdo_lost=True)),
    wire_class("PDO lost, late host", LATE_HOST, lost(between(1, 3))),
    wire_class("deaf, 1..30", deaf(between(1, 30)), after=100),
    wire_class("deaf, late host", LATE_HOST, deaf(between(1, 11)), after=100),
    wire_class("deaf, whole turn", deaf(whole_turns), after=300, of="counter"),
    wire_class("deaf, event timer", event_timer, deaf(between(3, 49)), after=110),
    wire_class("SYNC unheard by module", UNHEARD_BY_MODULE),
    wire_class("SYNC unheard by interface", UNHEARD_BY_INTERFACE),
    wire_class("SYNC unheard by both", slots(SOME, to_module=False, to_interface=False)),
    wire_class("SYNC unheard, 8 % each", unheard_now_and_then),
    wire_class("SYNC stops, SDO", sync_stops, read_outage),
    wire_class("SYNC stops, event timer", event_timer, sync_stops),
    wire_class("SYNC of odd kind", odd_sync, read_outage, after=120),
    wire_class(
        "SYNC counter wrong once",
        slots(1, payload=lambda plan: bytes([int(plan.rng.integers(1, plan.options.overflow + 1))])),
        of="counter",
    ),
    wire_class("SYNC doubled", SYNC_DOUBLED),
    wire_class("SYNC doubled, later", doubled(120.0, lambda plan: 0.7 / plan.us)),
    wire_class("SYNC doubled, late host", LATE_HOST, SYNC_DOUBLED),
    wire_class("SYNC, second producer", second_producer),
    wire_class("SYNC period changes", period_changes, after=150),
    wire_class(
        "1006h wrong",
        options(period=True, period_factor=one_of(0.5, 2.0, 0.25, 4.0, 1.5, 0.9)),
        torque=0.0,
    ),
    wire_class("PDO doubled", slots(one_of(1, 1, 2, 5), step=3, pdo_again_us=pdo_again)),
    wire_class("PDO replayed", pdo_replayed),
    wire_class("PDOs slow", slots(40, pdo_late_us=periods_us(0.4, 0.9))),
    wire_class("PDOs late for good", slots(None, pdo_late_us=lambda plan: 1.0 / plan.us)),
    wire_class("PDO late", PDO_LATE),
    wire_class("PDOs late by 1 and 2", pdos_swapped),
    wire_class(
        "PDO late, next lost", slots(1, pdo_late_us=periods_us(0.9, 1.0)), slots(1, skip=1, pdo_lost=True)
    ),
    wire_class("stamp, one bad", one_bad_stamp, of="times"),
    wire_class(
        "stamps, 10 % bad",
        slots(40, stamp=lambda plan: any_stamp(plan) if plan.rng.uniform() < 0.1 else None),
        of="times",
    ),
    wire_class("stamp, clock steps", clock_steps, of="times"),
    wire_class("stamp, clock stands", clock_stands, of="times"),
    wire_class("receive times off", wire(bad_rx=0.1), of="stamps"),
    wire_class("coarse track, any loss", COARSE, any_loss),
    wire_class("zero pulse false, coarse", COARSE, ZERO_PULSES, FALSE_PULSE, after=260),
    wire_class("zero pulse false", ZERO_PULSES, FALSE_PULSE, after=260),
    wire_class("zero pulse, first false", ZERO_PULSES, first_pulse_false, after=200),
    wire_class(
        "RPDO2 doubled",
        ZERO_PULSES,
        slots(one_of(1, 1, 3), step=4, extra_again_us=lambda plan: [periods_us(0.8, 1.3)(plan)]),
    ),
    wire_class("RPDO2 lost", ZERO_PULSES, slots(between(1, 3), extra_lost=True)),
    wire_class("NMT pause", pause, torque=0.0, after=110),
    wire_class("bus-off", bus_off, torque=0.0, after=110),
    wire_class("bus-off, 1029h = 1", options(stays=True), bus_off, torque=0.0, after=110),
    # Counts that pass for a sample are a legal motion, off by less than the residual limit.
    wire_class(
        "foreign ADC PDO",
        wire(tolerance=0.9),
        slots(one_of(1, 1, 10), foreign_us=periods_us(0.05, 0.95)),
    ),
    wire_class("interface restarts", interface_restarts),
    wire_class("RPDO 1, TPDO 254", options(rpdo_type=1, tpdo_type=254), any_loss),
    wire_class("RPDO 255, TPDO 1", options(rpdo_type=255, tpdo_type=1), any_loss),
    wire_class("RPDO 1, TPDO 1", options(rpdo_type=1, tpdo_type=1), any_loss),
    wire_class("TPDO 1, predict", PREDICTED, wire(jitter_us=0.0, busy=0.0, tolerance=1.3), any_loss),
    aimed("stamp, bad again", clocks.bad_stamp_again, "times !servo", survives=True),
    aimed("stamp, bad again after reset", clocks.bad_stamp_after_reset, "times !servo", survives=True),
    aimed("stamp, bad at the start", clocks.bad_stamp_early, "times !servo"),
    aimed("stamp, late once", clocks.late_stamp_once, "times !servo", survives=True),
    aimed("stamp, set in a burst", clocks.clock_set_in_a_burst, "times !servo"),
    aimed("SYNC, producer shifts", clocks.producer_shifts, "stamps !times"),
    aimed(
        "SYNC, producer shifts, times", clocks.producer_shifts, "times !servo stamps", survives=True
    ),
    aimed("SYNC, another rate", clocks.producer_changes_rate, "stamps !times"),
    aimed("SYNC, another rate, times", clocks.producer_changes_rate, "times !servo"),
    aimed("SYNC faster, TPDO 1", clocks.faster_sync, "!counter !servo"),
    aimed("lost, then NMT", clocks.lost_then_started, "!servo"),
    aimed("reset node in motion", clocks.reset_in_motion, "!servo"),
    aimed("NMT pause, short", clocks.short_pause, "!servo"),
    aimed("deaf, creeping", clocks.creeping_deaf, "times !servo !counter"),
    aimed("PDO lost, 1, at the limit", clocks.one_lost_at_the_limit, "times !servo"),
    aimed("1006h ten times, PDO lost", clocks.wrong_1006_and_lost, "!servo", survives=True),
    aimed("stall, one burst", clocks.stall_in_one_burst, "counter !times !stamps", survives=True),
    aimed("stall of all", clocks.everything_stalls, "times !servo", survives=True),
)  # fmt: skip
CLASSES = {one.name: one for one in _TABLE}
STALLS = {
    name: WireClass(name, (stalls(who, rate_hz, is_short),), torque=0.0, of="times !servo", survives=is_short)
    for who in WHO
    for rate_hz in RATES_HZ
    for is_short in (True, False)
    for name in [f"{'stalls' if is_short else 'longer stall'} of {who}, {rate_hz} Hz"]
}
"""Played with --stalls: they take longer."""
