"""Contradictory times: of SYNC, receive times, sample times, counter, 1006h, host.

These faults are aimed: with the error e of a time and the speed v, v e is a whole number of cycles, so that
the phases alone do not reveal the error. Each needs its own machine (:func:`machine`).

At the end: stalls of a computer, 1 to 500 ms, at 100, 500 and 1000 Hz, with sample times (:func:`stalls`).
"""

import math
from collections.abc import Callable

import numpy as np

from tools.faults.machine import Motion
from tools.faults.wire.draw import torque
from tools.faults.wire.line import TICK_S, Plan, Slot
from tools.faults.wire.physics import stamp_tolerance, step_note

LOADED = 64  # slots at the start during which the computer is loaded
REST, STEADY = 14, 40  # slots at rest, and at constant speed before the fault
PHASE_ERROR = 0.0125  # largest one of an uncorrected encoder, cycles
RESTARTED_T = 3.0  # duration of a reset, the configuration and the start, T


def machine(plan: Plan, speed: float, after: int, *, limit: float = 0.25, rest: int = REST) -> None:
    """A machine that accelerates from rest to ``speed`` cycles/T; the fault follows at constant speed."""
    size = 0.7 * limit
    ramp = abs(speed) / size
    plan.options.limit = limit
    plan.motion = Motion(start=float(plan.rng.uniform(0.1, 0.9)))
    plan.motion.push(rest, ramp, math.copysign(size, speed))
    plan.fault = rest + int(ramp) + STEADY + int(plan.rng.integers(10))
    plan.slots = [Slot() for _ in range(plan.fault + after)]
    plan.accelerating = False


def a_speed(plan: Plan, least: float, most: float) -> float:
    return float(plan.rng.uniform(least, most)) * float(plan.rng.choice((-1.0, 1.0)))


def off_by_cycles(plan: Plan, speed: float) -> int:
    """An error of a sample time, ticks, during which the machine moves a whole number of cycles.

    It is larger than an undetectable error (P4) and less than a period; 0 if no error is both.
    """
    interval_s = plan.options.interval_s
    least = stamp_tolerance(plan.setup, interval_s) + 0.03
    errors = [k / abs(speed) for k in range(1, 120) if least < k / abs(speed) < 0.9]
    if not errors:
        return 0
    size = float(plan.rng.choice(errors)) * interval_s / TICK_S
    return round(size) * int(plan.rng.choice((-1, 1)))


def bad_stamp_again(plan: Plan) -> None:
    """A wrong sample time, and later the same error again."""
    speed, later = a_speed(plan, 2.0, 20.0), int(plan.rng.choice((30, 600)))
    machine(plan, speed, later + 40)
    bad = off_by_cycles(plan, speed)
    for at in (0, later):
        plan.slots[plan.fault + at].stamp_add = bad


def restart(plan: Plan, at: float) -> None:
    """Reset node at this time, then configuration and NMT start."""
    plan.actions.append((at, "nmt", bytes([129])))
    plan.actions.append((at + 0.5, "configure", b""))
    plan.actions.append((at + RESTARTED_T, "nmt", bytes([1])))


def bad_stamp_after_reset(plan: Plan) -> None:
    """A wrong sample time; the machine stops; reset node; the machine starts; the same error again."""
    speed = a_speed(plan, 2.0, 12.0)
    machine(plan, speed, 0)
    size = 0.175
    ramp = abs(speed) / size
    down = plan.fault + 20
    rest = down + int(ramp) + 10
    up = rest + 30
    second = up + int(ramp) + 30
    plan.slots = [Slot() for _ in range(second + 30)]
    plan.motion.push(down, ramp, math.copysign(size, -speed))
    plan.motion.push(up, ramp, math.copysign(size, speed))
    bad = off_by_cycles(plan, speed)
    plan.slots[plan.fault].stamp_add = plan.slots[second].stamp_add = bad
    restart(plan, float(rest))


def bad_stamp_early(plan: Plan) -> None:
    """A wrong sample time within the first 32 samples, while the machine accelerates."""
    size = a_speed(plan, 0.12, 0.24)
    machine(plan, 1e-6, 60)
    begin = 6
    plan.motion.push(begin, 1e6, size)
    plan.options.limit = 0.25
    least = stamp_tolerance(plan.setup, plan.options.interval_s) + 0.03
    fits = [n for n in range(begin + 3, 31) if least < 1.0 / (abs(size) * (n + 1 - begin)) < 0.9]
    plan.fault = int(plan.rng.choice(fits)) if fits else 30
    error = 1.0 / abs(size * (plan.fault + 1 - begin)) * plan.options.interval_s / TICK_S
    plan.slots[plan.fault].stamp_add = round(error) * int(plan.rng.choice((-1, 1)))
    plan.slots = plan.slots[: plan.fault + 30]


def _even(plan: Plan) -> None:
    """The interface samples at a SYNC without jitter, which would limit the speed."""
    plan.locked, plan.jitter_us, plan.busy = False, 0.0, 0.0


def producer_shifts(plan: Plan) -> None:
    """Another producer takes over, with equal period; the machine moves whole cycles in the phase shift."""
    speed = a_speed(plan, 4.0, 40.0)
    machine(plan, speed, 100)
    _even(plan)
    cycles = int(plan.rng.integers(1, max(2, int(0.45 * abs(speed)) + 1)))
    shift = cycles / abs(speed) * (1 if plan.rng.integers(3) else -1)
    plan.slots[plan.fault - 1].produced = plan.rng.integers(2) == 0 or shift > 0.0
    plan.note = step_note(plan, shift)
    for slot in plan.slots[plan.fault :]:
        slot.late_us = shift / plan.us


def producer_changes_rate(plan: Plan) -> None:
    """The period changes so that the machine moves whole cycles more or fewer in each."""
    speed, part = a_speed(plan, 4.0, 40.0), 0.65 if plan.setup.servo else 0.35
    machine(plan, speed, 100)
    _even(plan)
    plan.options.follows = True
    rates = [k / abs(speed) for k in range(-40, 41) if k and -part < k / abs(speed) < part + 0.1]
    rate = float(plan.rng.choice(rates))
    plan.note = "P8 for a while" if step_note(plan, rate) else ""  # the deviation grows with each SYNC
    for n, slot in enumerate(plan.slots[plan.fault :], 1):
        slot.late_us = n * rate / plan.us


def faster_sync(plan: Plan) -> None:
    """The rate of SYNC increases; each SYNC must trigger the synchronous PDOs."""
    plan.options.interval_s, plan.options.tpdo_type, plan.options.period = 25e-3, 1, False
    machine(plan, a_speed(plan, 0.0, 1.0), 40)
    _even(plan)
    rate = float(plan.rng.choice((0.8, 0.6, 0.4)))
    for n, slot in enumerate(plan.slots[plan.fault :], 1):
        slot.late_us = n * (rate - 1.0) / plan.us


def lost_then_started(plan: Plan) -> None:
    """The position is lost in motion; the master stops and starts the module while the machine turns."""
    machine(plan, a_speed(plan, 3.0, 40.0), 140)
    for slot in plan.slots[plan.fault : plan.fault + 30]:
        slot.to_module, slot.pdo_lost = False, True
    begin = plan.fault + 36.0 + float(plan.rng.uniform())
    length = float(plan.rng.choice((0.3, 1.0, 8.0)))
    plan.actions.append((begin, "nmt", bytes([int(plan.rng.choice((128, 2)))])))
    plan.actions.append((begin + length, "nmt", bytes([1])))


def reset_in_motion(plan: Plan) -> None:
    """Reset node while the machine turns by more than half a cycle in each period."""
    machine(plan, a_speed(plan, 3.0, 40.0), 90)
    restart(plan, plan.fault + float(plan.rng.uniform()))


def short_pause(plan: Plan) -> None:
    """NMT stop shortly after a SYNC and start within a period, while a slow machine accelerates."""
    limit, rest = float(plan.rng.choice((0.15, 0.25))), REST + STEADY
    machine(plan, 1e-6, 0, limit=limit)
    size = a_speed(plan, 0.5, 0.95) * limit
    plan.motion.push(rest, 20.0, size)
    plan.fault = rest + int(float(plan.rng.uniform(0.3, 0.7)) / abs(size))
    plan.slots = [Slot() for _ in range(plan.fault + 70)]
    begin = plan.fault + 1.0 + float(plan.rng.uniform(0.0, 0.5))
    plan.actions.append((begin, "nmt", bytes([int(plan.rng.choice((128, 2)))])))
    plan.actions.append((begin + float(10.0 ** plan.rng.uniform(-3.0, 0.0)), "nmt", bytes([1])))


def samples_later(plan: Plan) -> None:
    """NMT stop and start while the machine creeps; samples return 1 to 80 periods later."""
    machine(plan, a_speed(plan, 0.005, 0.5), 190, limit=float(plan.rng.choice((0.05, 0.25))))
    begin, later = plan.fault + float(plan.rng.uniform()), int(plan.rng.integers(1, 81))
    end = begin + float(10.0 ** plan.rng.uniform(-2.0, 1.0))
    plan.actions.append((begin, "nmt", bytes([int(plan.rng.choice((128, 2, 130)))])))
    plan.actions.append((end, "nmt", bytes([1])))
    for slot in plan.slots[plan.fault : int(end) + later]:
        slot.pdo_lost = True


def creeping_deaf(plan: Plan) -> None:
    """The queue of a stalled host overflows while the machine creeps: 5 to 80 periods are lost."""
    limit = float(plan.rng.choice((0.05, 0.25)))
    machine(plan, a_speed(plan, 0.01, 0.15), 190, limit=limit)
    kept, lost = int(plan.rng.integers(0, 8)), int(plan.rng.integers(5, 81))
    plan.stalls.append((plan.fault + 0.5, plan.fault + kept + lost + 0.6))
    for slot in plan.slots[plan.fault + kept : plan.fault + kept + lost]:
        slot.to_module, slot.pdo_lost = False, True


def one_lost_at_the_limit(plan: Plan) -> None:
    """One PDO is lost at the full acceleration that 2010:02 allows, with SYNC jitter of 40 us."""
    limit = float(plan.rng.uniform(0.16, 0.2))
    machine(plan, 1e-6, 0, limit=limit)
    plan.motion.push(REST, 1e6, limit * float(plan.rng.choice((-1.0, 1.0))))
    plan.fault = REST + int(plan.rng.integers(30, 120))
    plan.slots = [Slot() for _ in range(plan.fault + 50)]
    plan.jitter_us, plan.gaussian = 40.0, False
    plan.slots[plan.fault].pdo_lost = True


def wrong_1006_and_lost(plan: Plan) -> None:
    """1006h is ten times the period, and a PDO is lost."""
    machine(plan, a_speed(plan, 0.5, 40.0), 90)
    plan.options.period, plan.options.period_factor = True, 10.0
    if not plan.setup.times:
        _even(plan)
    plan.slots[plan.fault].pdo_lost = True


def stall_in_one_burst(plan: Plan) -> None:
    """The host stalls once; no frame is lost, and SYNC has a counter."""
    plan.options.interval_s, plan.options.overflow = 1e-3, 240
    machine(plan, a_speed(plan, 0.0, 40.0), 260)
    plan.locked, plan.jitter_us = True, float(plan.rng.uniform(0.0, 50.0))
    long = float(plan.rng.choice((20.0, 50.0, 100.0)))
    begin = plan.fault + float(plan.rng.uniform())
    plan.stalls.append((begin, begin + long))


def everything_stalls(plan: Plan) -> None:
    """Module, interface and SYNC producer run on one computer, which stalls.

    Of the SYNCs due during the stall only the last is sent, late; the next one follows in time. The stall is
    so short that only one motion is possible: floor((T + 1)^2 / 4) 2 A + 4 eps (T + 1) <= 1.
    """
    plan.options.interval_s = interval_s = float(plan.rng.choice((1e-2, 1e-2, 2e-3, 1e-3)))
    limit = float(plan.rng.choice((0.02, 0.05, 0.1)))
    most = longest_bridged(limit)
    machine(plan, a_speed(plan, 0.0, 40.0), 90, limit=limit)
    plan.options.coast = most + 1
    plan.jitter_us = float(plan.rng.uniform(0.0, 0.05)) * interval_s * 1e6
    plan.gaussian, plan.busy = False, 0.0
    long = float(plan.rng.uniform(1.0, most))
    begin = plan.fault + 0.7 + float(plan.rng.uniform(0.0, 0.3))
    _put(plan, "all", begin, begin + long)


def _producer_stalls(plan: Plan, begin: float, end: float) -> None:
    """Of the SYNCs due during the stall only the last is sent, at its end."""
    last = int(end - 1.0)  # slot n is due at n + 1
    for slot in plan.slots[int(begin) : last]:
        slot.produced = False
    # It must precede the next one for any jitter of both; a frame of 135 us may occupy the bus.
    most = 1.0 - (2.0 * plan.jitter_us + 135.0) * plan.us
    plan.slots[last].late_us = min(max(0.0, end - (last + 1.0)), most) / plan.us


def longest_bridged(limit: float) -> int:
    """Whole periods of the longest stall after which two motions with equal phases differ by < 1 cycle."""
    return max(n for n in range(2, 41) if n**2 // 4 * 2.0 * limit + 4.0 * PHASE_ERROR * n <= 1.0) - 1


def stalls_at_the_start(plan: Plan) -> None:
    """Module, interface and SYNC producer are processes of one loaded computer.

    From the first SYNC on the interface samples late, with correct sample times; SYNCs and PDOs are late, or
    not sent. The machine starts to move after this.
    """
    rng, limit = plan.rng, float(plan.rng.choice(LIMITS))
    machine(plan, a_speed(plan, 0.0, 100.0 * limit), 0, limit=limit, rest=REST + LOADED)
    plan.options.interval_s, plan.host, plan.fault = 1e-2, "late", 1
    plan.jitter_us, plan.gaussian, plan.busy = 1000.0, False, 0.0
    for slot in plan.slots:
        slot.sample_late_us = min(float(rng.exponential(300.0)), plan.jitter_us)
    at = 1.0
    while (at := at + float(rng.exponential(5.0))) < LOADED:
        long = float(rng.uniform(0.0, 1.5))
        who = str(rng.choice(("all", "producer", "interface")))
        if who == "interface":
            plan.slots[int(at)].pdo_late_us = min(long, 0.8) / plan.us
        else:
            _put(plan, who, at, at + 1.0 + long)
        at += 3.0


def answers_behind_later_syncs(plan: Plan) -> None:
    """All PDOs are late by the same time, up to three periods; 2010:0E declares half a period more."""
    late = float(plan.rng.uniform(0.0, 3.0))
    plan.options.answer_s = (late + 0.5) * plan.options.interval_s
    for slot in plan.slots:
        slot.pdo_late_us = late / plan.us


def late_stamp_once(plan: Plan) -> None:
    """One sample time is late by 50 to 400 us, as if the timer was read late: only that sample may be bad."""
    plan.options.interval_s = 1e-3
    machine(plan, a_speed(plan, 5.0, 40.0), 60)
    plan.slots[plan.fault].stamp_add = round(float(plan.rng.uniform(500.0, 4000.0)))


def clock_set_in_a_burst(plan: Plan) -> None:
    """The host stalls; meanwhile the clock of the interface steps by periods, temporarily or for good.

    It looks as if frames had been lost: at whole cycles per period the phases fit, too.
    """
    plan.options.interval_s = 1e-3
    machine(plan, float(round(a_speed(plan, 0.6, 20.0))), 200)
    plan.jitter_us = float(plan.rng.uniform(0.0, 50.0))
    begin, long = plan.fault + float(plan.rng.uniform()), float(plan.rng.uniform(3.0, 80.0))
    plan.stalls.append((begin, begin + long))
    first = plan.fault + int(plan.rng.integers(0, int(long) + 1))
    last = first + int(plan.rng.choice((1, 2, 1000)))
    periods = int(plan.rng.integers(1, int(long) + 2))
    for slot in plan.slots[first:last]:
        slot.stamp_add = round(periods * plan.options.interval_s / TICK_S)


WHO = ("module", "module, queue", "producer", "all")
RATES_HZ = (100, 500, 1000)
SHORTEST_S, LONGEST_S = 1e-3, 0.5
IN_A_ROW = 8
BETWEEN = 40  # periods from one stall to the next
QUEUES = (20, 64, 277)  # length of a receive queue, frames; a slot has two frames
LIMITS = (0.02, 0.05, 0.1)  # largest acceleration, cycles/T^2
SPARE = 1.1  # declared / usual acceleration, for a torque pulse in addition to a vibration


def stalls(who: str, rate_hz: int, is_short: bool) -> Callable[[Plan], None]:
    """Stalls of ``who``; frames for a stalled module wait, or are dropped if its queue is full.

    ``is_short``: after each of several stalls only one motion fits, so the position must be kept. After a
    long stall it may be lost, but must not be valid and wrong; then a single stall is played.
    """

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


def _put(plan: Plan, who: str, begin: float, end: float, bridged: int = 0) -> None:
    """Add a stall; ``bridged``: most samples that are dropped, 0: all that the queue drops."""
    first, last = int(begin), int(end - 1.0)  # slot n is due at n + 1
    if who != "producer":
        plan.stalls.append((begin, end))
    if who in ("producer", "all"):
        _producer_stalls(plan, begin, end)
    elif who == "module, queue":
        heard = first + int(plan.rng.choice(QUEUES)) // 2
        if bridged:
            heard = max(heard, last - bridged + 1)
        for slot in plan.slots[heard:last]:
            slot.to_module, slot.pdo_lost = False, True
