"""The classes of wire faults: each changes a healthy plan from its slot ``fault`` on.

A class is a sequence of changes, i.e. functions of the plan. One-line changes are composed from the functions
at the top of this file; an aimed class has its own machine (:mod:`tools.faults.wire.clocks`).
"""

from collections.abc import Callable
from functools import partial
from typing import Any

from tools.faults.wire import clocks
from tools.faults.wire.clocks import RATES_HZ, WHO, stalls
from tools.faults.wire.draw import UNKNOWN_LIMIT
from tools.faults.wire.line import TICK_S, Plan
from tools.faults.wire.setups import CYCLES_PER_REVOLUTION, TWO_PI, Setup, sdo_write

Change = Callable[[Plan], object]


def one_of(*values: float) -> Callable[[Plan], Any]:
    return lambda plan: plan.rng.choice(values).item()


def between(least: int, most: int) -> Callable[[Plan], int]:
    return lambda plan: int(plan.rng.integers(least, most + 1))


def periods_us(least: float, most: float) -> Callable[[Plan], float]:
    """A random time between ``least`` and ``most`` periods of SYNC, in microseconds."""
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
    """Set these fields of ``count`` slots from the fault on; None: all. A function draws a value per slot."""

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
    """0.95 of the acceleration that 2010:02 allows, with SYNC jitter."""
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
    """Lose one of the PDOs or SYNCs that wait during the stall."""
    begin, end = plan.stalls[0]
    at = int(plan.rng.integers(int(begin), max(int(begin) + 1, int(end))))
    if plan.rng.integers(2):
        plan.slots[at].pdo_lost = True
    else:
        plan.slots[at].to_module = False


def pulse_and_some_lost(plan: Plan) -> None:
    """Acceleration of up to 0.25 cycle/T^2 for 3 to 9 samples around the lost ones."""
    plan.options.limit = (None, 0.25)[int(plan.rng.integers(2))]
    size = float(plan.rng.uniform(0.13, 0.25)) * float(plan.rng.choice((-1.0, 1.0)))
    begin = plan.fault + 1.0 + float(plan.rng.integers(-5, 2))
    plan.motion.push(begin, float(plan.rng.choice((4.0, 5.0, 6.0, 8.0))), size)
    slots(between(1, 3), pdo_lost=True)(plan)


def pulse_in_the_gap(plan: Plan) -> None:
    """A short pulse near the limit while samples are missing: a wrong motion may look smoother."""
    rng = plan.rng
    limit = plan.options.limit = (0.3, 0.25, 0.15)[int(rng.integers(3))]
    lost = int(rng.integers(1, 4))
    size = float(rng.uniform(0.7, 0.98)) * limit * float(rng.choice((-1.0, 1.0)))
    begin = plan.fault + float(rng.choice((-1.0, 0.0, 0.5)))
    plan.motion.push(begin, float(rng.uniform(1.0, lost + 3.0)), size)
    slots(lost, pdo_lost=True)(plan)


def time_lost(plan: Plan) -> None:
    """Lose only the PDO with the sample time: once, or repeatedly."""
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
    """SYNCs with a length or counter that does not fit this set-up."""
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
    """SYNCs that the module, the interface, or both receive twice."""

    def again(plan: Plan) -> list[tuple[float, bool, bool]]:
        to = int(plan.rng.integers(3))
        return [(float(plan.rng.uniform(least_us, most(plan))), to != 1, to != 0)]

    return slots(one_of(1, 1, 2, 5), step=3, again=again)


def second_producer(plan: Plan) -> None:
    """A second SYNC producer for some time, shifted by about half a period."""
    beside = float(plan.rng.choice((0.5, 0.5, plan.rng.uniform(0.25, 0.75)))) / plan.us
    slots(one_of(1, 5, 60), again=lambda _: [(beside, True, True)])(plan)


def period_changes(plan: Plan) -> None:
    """From now on only every second or third SYNC is sent: the period changes."""
    keep = int(plan.rng.choice((2, 3)))
    for number, slot in enumerate(plan.slots[plan.fault :]):
        slot.produced = number % keep == 0


def pdo_again(plan: Plan) -> list[float]:
    soon = plan.rng.integers(2)
    return [float(plan.rng.uniform(60.0, 200.0)) if soon else periods_us(0.2, 1.6)(plan)]


def pdo_replayed(plan: Plan) -> None:
    """The interface repeats an old PDO, between two others or instead of one."""
    back = int(plan.rng.integers(1, 6))
    plan.slots[plan.fault - back].pdo_again_us.append((back + float(plan.rng.uniform(0.0, 0.7))) / plan.us)
    if plan.rng.integers(2):
        plan.slots[plan.fault].pdo_lost = True


def pdos_swapped(plan: Plan) -> None:
    """Two PDOs are late by about one and two periods, in either order."""
    lates = (1.0, 2.0) if plan.rng.integers(2) else (2.0, 1.0)
    gap = int(plan.rng.integers(1, 4))
    for at, late in zip((0, gap), lates, strict=True):
        plan.slots[plan.fault + at].pdo_late_us = (late - float(plan.rng.uniform(0.0, 0.1))) / plan.us


def any_stamp(plan: Plan) -> int:
    return int(plan.rng.integers(1 << 32))


def one_bad_stamp(plan: Plan) -> None:
    """One wrong sample time: random, zero, or wrong by whole periods or by 1 us to 1 s."""
    slot = plan.slots[plan.fault]
    kind = int(plan.rng.integers(5))
    if kind < 2:
        slot.stamp = 0 if kind else any_stamp(plan)
    elif kind == 2:
        slot.stamp_add = int(plan.rng.integers(-3, 4)) * round(plan.options.interval_s / TICK_S)
    else:
        slot.stamp_add = int(10.0 ** plan.rng.uniform(1.0, 7.0)) * int(plan.rng.choice((-1, 1)))


def clock_steps(plan: Plan) -> None:
    """The clock of the interface steps once, as after a restart."""
    step = any_stamp(plan) if plan.rng.integers(2) else int(plan.rng.integers(-200_000, 200_000))
    slots(None, stamp_add=step)(plan)


def clock_stands(plan: Plan) -> None:
    slots(one_of(2, 5, 40), stamp=any_stamp(plan))(plan)


def interface_restarts(plan: Plan) -> None:
    """The interface is silent for some time; its clock restarts."""
    back = int(plan.rng.integers(1, 30))
    slots(None, stamp_add=any_stamp(plan))(plan)
    slots(back, stamp_add=0, pdo_lost=True)(plan)


def first_pulse_false(plan: Plan) -> None:
    plan.slots[6 + int(plan.rng.integers(4))].false_pulse = float(plan.rng.uniform())


def pause(plan: Plan) -> None:
    """PRE-OPERATIONAL, STOPPED or a communication reset; interface and SYNC continue."""
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


def settings_written(plan: Plan) -> None:
    """Settings are written while the machine moves, all of which the machine still keeps."""
    rng, interval_s = plan.rng, plan.options.interval_s
    limit = max(plan.options.limit or 0.0, UNKNOWN_LIMIT) * float(rng.uniform(1.2, 3.0))
    settings = (
        (0x2010, 2, "f", limit * TWO_PI / CYCLES_PER_REVOLUTION / interval_s**2),
        (0x2010, 3, "B", int(rng.integers(0, 20))),
        (0x2010, 6, "B", int(rng.integers(1, 3))),
        (0x2010, 9, "B", int(rng.integers(0, 8))),
        (0x2010, 10, "B", int(rng.integers(1, 5))),
        (0x2010, 13, "f", 0.45 * interval_s),
        (0x2010, 14, "f", interval_s * float(rng.uniform(0.5, 3.0))),
        (0x1006, 0, "I", round(interval_s * 1e6) * int(rng.integers(2))),
        (0x2002, 8, "B", int(rng.integers(2))),
    )
    for _ in range(int(rng.integers(1, 4))):
        at = plan.fault + float(rng.uniform(0.0, 40.0))
        plan.actions.append((at, "write", sdo_write(*settings[int(rng.integers(len(settings)))]).data))


SOME = one_of(1, 1, 1, 2, 3, 10)
LATE_HOST = wire(host="late")
ZERO_PULSES, COARSE, SECOND = options(extra=True), options(coarse=True), options(second=one_of(0.01, 1e-4))
WITNESS = any_of(ZERO_PULSES, COARSE, SECOND)
EXTRA_DOUBLED = slots(one_of(1, 1, 3), step=4, extra_again_us=lambda plan: [periods_us(0.8, 1.3)(plan)])
EXTRA_LOST = slots(between(1, 3), extra_lost=True)
PDO_LATE = slots(one_of(1, 2, 5), step=3, pdo_late_us=periods_us(0.85, 1.4))
UNHEARD_BY_MODULE, UNHEARD_BY_INTERFACE = slots(SOME, to_module=False), slots(SOME, to_interface=False)
SYNC_DOUBLED = doubled(47.0, lambda _: 120.0)
FALSE_PULSE = slots(1, false_pulse=lambda plan: float(plan.rng.uniform()))
# Synchronous PDOs with the position extrapolated to their SYNC (2013h); a SYNC without jitter.
PREDICTED = options(rpdo_type=one_of(1, 255), tpdo_type=1, predict=one_of(1, 2))
STEADY = wire(jitter_us=0.0, busy=0.0, tolerance=1.3)


def lost(count: int | Callable[[Plan], int]) -> Change:
    return slots(count, pdo_lost=True)


def deaf(count: Callable[[Plan], int]) -> Change:
    """The module receives nothing for some time: neither SYNC nor PDO."""
    return slots(count, to_module=False, pdo_lost=True)


losses = (UNHEARD_BY_MODULE, UNHEARD_BY_INTERFACE, lost(between(1, 3)), deaf(between(1, 7)))
any_loss = any_of(*losses, PDO_LATE)
ANY_FAULT = (
    *(unheard_now_and_then, sync_stops, second_producer, period_changes, pdo_replayed, pdos_swapped, pause),
    *(bus_off, any_loss, SYNC_DOUBLED, doubled(120.0, lambda plan: 0.7 / plan.us)),
    *(slots(one_of(1, 1, 2, 5), step=3, pdo_again_us=pdo_again), slots(10, pdo_late_us=periods_us(0.4, 0.9))),
)
ANY_FAULT_OF_TIME = (one_bad_stamp, clock_steps, clock_stands, interface_restarts)


def two_faults(plan: Plan) -> None:
    """Two faults, one after or during the other, without combinations that no module can detect."""
    faults = [*ANY_FAULT, *ANY_FAULT_OF_TIME * plan.setup.times]
    if plan.setup.fits("times|counter|stamps"):
        faults.append(stall)  # in other set-ups additional SYNCs during a stall are undetectable (P1)
    begin = plan.fault
    for later in (0, int(plan.rng.integers(0, 40))):
        plan.fault = begin + later
        faults[int(plan.rng.integers(len(faults)))](plan)
    plan.fault = begin
    for slot in plan.slots:
        slot.again = slot.again if slot.to_interface else []  # excludes case P7


class WireClass:
    """A class of wire faults; ``of`` and ``valid`` select set-ups (:meth:`Setup.fits`).

    torque      part of the episodes with a torque pulse near the fault
    after       slots after the fault
    survives    the position must be kept, as the declarations cover the fault: a loss misses the goal
    valid       in these set-ups each sample after the start must be valid
    """

    def __init__(
        self,
        *changes: Change,
        torque: float = 0.5,
        after: int = 70,
        of: str = "",
        survives: bool = False,
        valid: str | None = None,
    ) -> None:
        self._changes, self._valid = changes, valid
        self.torque, self.after, self.of, self.survives = torque, after, of, survives

    def change(self, plan: Plan) -> None:
        for change in self._changes:
            change(plan)

    def demands_validity(self, setup: Setup) -> bool:
        return self._valid is not None and setup.fits(self._valid)


aimed = partial(WireClass, torque=0.0)
"""Without a torque pulse: the motion is that of the plan, or of the class itself."""

CLASSES = {
    "healthy": WireClass(valid=""),
    # Without times, a frame that the host reads a period late may belong to the next SYNC.
    "healthy, late host": WireClass(LATE_HOST, valid="stamps|times"),
    "healthy, zero pulses": WireClass(ZERO_PULSES, valid=""),
    "healthy, at the limit": aimed(at_the_limit, of="times !servo", valid=""),
    "stall": WireClass(stall, after=220),
    "stall, one lost": WireClass(stall, lose_one_in_the_burst, after=220),
    "pulse, 1..3 lost": aimed(pulse_and_some_lost, of="!servo"),
    "pulse in the gap": aimed(pulse_in_the_gap, of="!servo"),
    **{f"PDO lost, {n}": WireClass(lost(n)) for n in (1, 2, 3, 5)},
    "PDO with the time lost": WireClass(time_lost, of="servo times"),
    "PDOs lost, 15 %": WireClass(slots(40, pdo_lost=lambda plan: plan.rng.uniform() < 0.15)),
    "PDO lost, every n-th": WireClass(slots(None, step=one_of(3, 6, 8, 12), pdo_lost=True)),
    "PDO lost, late host": WireClass(LATE_HOST, lost(between(1, 3))),
    "deaf, 1..30": WireClass(deaf(between(1, 30)), after=100),
    "deaf, late host": WireClass(LATE_HOST, deaf(between(1, 11)), after=100),
    "deaf, whole turn": WireClass(deaf(whole_turns), after=300, of="counter"),
    "deaf, event timer": WireClass(event_timer, deaf(between(3, 49)), after=110),
    "SYNC unheard by module": WireClass(UNHEARD_BY_MODULE),
    "SYNC unheard by interface": WireClass(UNHEARD_BY_INTERFACE),
    "SYNC unheard by both": WireClass(slots(SOME, to_module=False, to_interface=False)),
    "SYNC unheard, 8 % each": WireClass(unheard_now_and_then),
    "SYNC stops, SDO": WireClass(sync_stops, read_outage),
    "SYNC stops, event timer": WireClass(event_timer, sync_stops),
    "SYNC of odd kind": WireClass(odd_sync, read_outage, after=120),
    "SYNC counter wrong once": WireClass(
        slots(1, payload=lambda plan: bytes([int(plan.rng.integers(1, plan.options.overflow + 1))])),
        of="counter",
    ),
    "SYNC doubled": WireClass(SYNC_DOUBLED),
    "SYNC doubled, later": WireClass(doubled(120.0, lambda plan: 0.7 / plan.us)),
    "SYNC doubled, late host": WireClass(LATE_HOST, SYNC_DOUBLED),
    "SYNC, second producer": WireClass(second_producer),
    "SYNC period changes": WireClass(period_changes, after=150),
    "1006h wrong": aimed(options(period=True, period_factor=one_of(0.5, 2.0, 0.25, 4.0, 1.5, 0.9))),
    "PDO doubled": WireClass(slots(one_of(1, 1, 2, 5), step=3, pdo_again_us=pdo_again)),
    "PDO replayed": WireClass(pdo_replayed),
    "PDOs slow": WireClass(slots(40, pdo_late_us=periods_us(0.4, 0.9))),
    "PDOs late for good": WireClass(slots(None, pdo_late_us=lambda plan: 1.0 / plan.us)),
    "PDOs behind later SYNCs": WireClass(clocks.answers_behind_later_syncs, of="stamps", survives=True),
    "PDOs behind later SYNCs, some lost": WireClass(
        clocks.answers_behind_later_syncs, any_of(*losses), of="stamps"
    ),
    "PDO late": WireClass(PDO_LATE),
    "PDOs late by 1 and 2": WireClass(pdos_swapped),
    "PDO late, next lost": WireClass(
        slots(1, pdo_late_us=periods_us(0.9, 1.0)), slots(1, skip=1, pdo_lost=True)
    ),
    "stamp, one bad": WireClass(one_bad_stamp, of="times"),
    "stamp, one bad, TPDO 1": WireClass(options(tpdo_type=1), one_bad_stamp, of="times"),
    "stall of all, TPDO 1": aimed(clocks.everything_stalls, options(tpdo_type=1), of="times !servo"),
    "stamps, 10 % bad": WireClass(
        slots(40, stamp=lambda plan: any_stamp(plan) if plan.rng.uniform() < 0.1 else None), of="times"
    ),
    "stamp, clock steps": WireClass(clock_steps, of="times"),
    "stamp, clock stands": WireClass(clock_stands, of="times"),
    "receive times off": WireClass(wire(bad_rx=0.1), of="stamps"),
    "coarse track, any loss": WireClass(COARSE, any_loss),
    "zero pulse false, coarse": WireClass(COARSE, ZERO_PULSES, FALSE_PULSE, after=260),
    "zero pulse false": WireClass(ZERO_PULSES, FALSE_PULSE, after=260),
    "zero pulse, first false": WireClass(ZERO_PULSES, first_pulse_false, after=200),
    "RPDO2 doubled": WireClass(ZERO_PULSES, EXTRA_DOUBLED),
    "RPDO2 lost": WireClass(ZERO_PULSES, EXTRA_LOST),
    "RPDO2 lost, SYNC lost": WireClass(
        any_of(ZERO_PULSES, COARSE), EXTRA_LOST, any_of(UNHEARD_BY_MODULE, sync_stops)
    ),
    "second position, any loss": WireClass(SECOND, any_of(any_loss, EXTRA_DOUBLED, EXTRA_LOST), after=160),
    "witness, pause or bus-off": aimed(WITNESS, any_of(pause, bus_off), after=160),
    "witness, deaf": WireClass(WITNESS, deaf(between(1, 60)), after=200),
    "NMT pause": aimed(pause, after=110),
    "bus-off": aimed(bus_off, after=110),
    "bus-off, 1029h = 1": aimed(options(stays=True), bus_off, after=110),
    # Counts that are accepted are within the residual limit of the expected sample: a legal motion.
    "foreign ADC PDO": WireClass(
        wire(tolerance=0.9), slots(one_of(1, 1, 10), foreign_us=periods_us(0.05, 0.95))
    ),
    "interface restarts": WireClass(interface_restarts),
    "RPDO 1, TPDO 254": WireClass(options(rpdo_type=1, tpdo_type=254), any_loss),
    "RPDO 255, TPDO 1": WireClass(options(rpdo_type=255, tpdo_type=1), any_loss),
    "RPDO 1, TPDO 1": WireClass(options(rpdo_type=1, tpdo_type=1), any_loss),
    "TPDO 1, predict": WireClass(PREDICTED, STEADY, any_loss),
    "predict, SYNC stops or slows": aimed(PREDICTED, STEADY, any_of(period_changes, pause), after=150),
    "predict, another rate": aimed(
        clocks.producer_changes_rate, PREDICTED, wire(tolerance=1.3), of="times stamps !servo"
    ),
    "stamp, bad again": aimed(clocks.bad_stamp_again, of="times !servo", survives=True),
    "stamp, bad again after reset": aimed(clocks.bad_stamp_after_reset, of="times !servo", survives=True),
    "stamp, bad at the start": aimed(clocks.bad_stamp_early, of="times !servo"),
    "stamp, late once": aimed(clocks.late_stamp_once, of="times !servo", survives=True),
    "stamp, set in a burst": aimed(clocks.clock_set_in_a_burst, of="times !servo"),
    "SYNC, producer shifts": aimed(clocks.producer_shifts, of="stamps !times"),
    "SYNC, producer shifts, times": aimed(clocks.producer_shifts, of="times !servo stamps", survives=True),
    "SYNC, another rate": aimed(clocks.producer_changes_rate, of="stamps !times"),
    "SYNC, another rate, doubled": aimed(clocks.producer_changes_rate, SYNC_DOUBLED, of="stamps !times"),
    "SYNC, another rate, times": aimed(clocks.producer_changes_rate, of="times"),
    "SYNC faster, TPDO 1": aimed(clocks.faster_sync, of="!counter !servo"),
    "lost, then NMT": aimed(clocks.lost_then_started, of="!servo"),
    "reset node in motion": aimed(clocks.reset_in_motion, of="!servo"),
    "NMT pause, short": aimed(clocks.short_pause, of="!servo"),
    "NMT pause, samples later": aimed(clocks.samples_later, of="!servo"),
    "deaf, creeping": aimed(clocks.creeping_deaf, of="times !servo !counter"),
    "PDO lost, 1, at the limit": aimed(clocks.one_lost_at_the_limit, of="times !servo"),
    "1006h ten times, PDO lost": aimed(clocks.wrong_1006_and_lost, of="!servo", survives=True),
    "start, stalls": aimed(clocks.stalls_at_the_start, of="times !servo", survives=True),
    "stall, one burst": aimed(clocks.stall_in_one_burst, of="counter !times !stamps", survives=True),
    "two faults": WireClass(two_faults, after=260),
    "settings written": WireClass(settings_written, any_of(any_loss, SYNC_DOUBLED, slots(0)), after=160),
    "two faults, TPDO 1": WireClass(options(tpdo_type=1), two_faults, after=260),
    "two faults, coarse": WireClass(COARSE, two_faults, after=260),
    "two faults, witness": WireClass(any_of(ZERO_PULSES, SECOND), two_faults, after=260),
    "stall of all": aimed(clocks.everything_stalls, of="times !servo", survives=True),
}
STALLS = {
    name: aimed(stalls(who, rate_hz, is_short), of="times !servo", survives=is_short)
    for who in WHO
    for rate_hz in RATES_HZ
    for is_short in (True, False)
    for name in [f"{'stalls' if is_short else 'longer stall'} of {who}, {rate_hz} Hz"]
}
"""Played with --stalls: they take longer."""
