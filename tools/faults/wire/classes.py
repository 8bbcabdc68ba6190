"""The classes of wire faults: each changes a healthy plan from its slot ``fault`` on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from tools.faults.wire import around, clocks, unheard, untimely
from tools.faults.wire.setups import Setup
from tools.faults.wire.unheard import Change


def always(_: Setup) -> bool:
    return True


def never(_: Setup) -> bool:
    return False


def with_times(setup: Setup) -> bool:
    return setup.times


def is_servo(setup: Setup) -> bool:
    return setup.servo


def with_stamps(setup: Setup) -> bool:
    return setup.stamps


def with_any_time(setup: Setup) -> bool:
    """Without, what a host takes a period late may be of the next SYNC until a later frame shows it."""
    return setup.stamps or setup.times


def with_counter(setup: Setup) -> bool:
    return setup.counter


@dataclass(frozen=True)
class WireClass:
    """A class of wire faults.

    ``torque``: part of the episodes with a torque pulse beside the fault. ``survives``: what is declared
    keeps the position, so that a loss is a goal missed; ``valid``: in these set-ups each sample after the
    start is to be valid.
    """

    name: str
    change: Change
    torque: float = 0.5
    after: int = 70
    of: Callable[[Setup], bool] = always
    survives: bool = False
    valid: Callable[[Setup], bool] = never


def aimed(name: str, change: Change, of: Callable[[Setup], bool], survives: bool = False) -> WireClass:
    """A class that brings its own machine (:mod:`tools.faults.wire.clocks`)."""
    return WireClass(name, change, torque=0.0, of=of, survives=survives)


CLASSES: tuple[WireClass, ...] = (
    WireClass("healthy", around.healthy, valid=always),
    WireClass("healthy, late host", around.late_host, valid=with_any_time),
    WireClass("healthy, zero pulses", around.zero_pulses, valid=always),
    WireClass(
        "healthy, at the limit", around.at_the_limit, torque=0.0, of=clocks.timed, valid=always
    ),
    WireClass("stall", around.stall, after=220),
    WireClass("stall, one lost", around.stall_with_loss, after=220),
    WireClass("pulse, 1..3 lost", unheard.pulse_and_one_lost, torque=0.0, of=clocks.any_but_servo),
    WireClass("pulse in the gap", unheard.pulse_in_the_gap, torque=0.0, of=clocks.any_but_servo),
    *(WireClass(f"PDO lost, {n}", unheard.lost_pdos(n)) for n in (1, 2, 3, 5)),
    WireClass("PDO with the time lost", unheard.time_lost, of=is_servo),
    WireClass("PDOs lost, 15 %", unheard.scattered_losses),
    WireClass("PDO lost, every n-th", unheard.every_nth),
    WireClass("PDO lost, late host", around.late_host_and_lost),
    WireClass("deaf, 1..30", unheard.deaf(lambda rng: int(rng.integers(1, 31))), after=100),
    WireClass("deaf, late host", around.late_host_and_deaf, after=100),
    WireClass("deaf, whole turn", unheard.whole_turn, after=300, of=with_counter),
    WireClass("deaf, event timer", unheard.deaf_event_timer, after=110),
    WireClass("SYNC unheard by module", unheard.sync_unheard_by_module),
    WireClass("SYNC unheard by interface", unheard.sync_unheard_by_interface),
    WireClass("SYNC unheard by both", unheard.sync_unheard_by_both),
    WireClass("SYNC unheard, 8 % each", unheard.sync_unheard_now_and_then),
    WireClass("SYNC stops, SDO", unheard.sync_stops),
    WireClass("SYNC stops, event timer", unheard.sync_stops_event_timer),
    WireClass("SYNC of odd kind", unheard.odd_sync, after=120),
    WireClass("SYNC counter wrong once", unheard.wrong_counter, of=with_counter),
    WireClass("SYNC doubled", untimely.sync_doubled),
    WireClass("SYNC doubled, later", untimely.sync_doubled_later),
    WireClass("SYNC doubled, late host", around.late_host_and_doubled),
    WireClass("SYNC, second producer", untimely.second_producer),
    WireClass("SYNC period changes", untimely.period_changes, after=150),
    WireClass("1006h wrong", untimely.wrong_1006, torque=0.0),
    WireClass("PDO doubled", untimely.pdo_doubled),
    WireClass("PDO replayed", untimely.pdo_replayed),
    WireClass("PDOs slow", untimely.slow_pdos),
    WireClass("PDOs late for good", untimely.late_for_good),
    WireClass("PDO late", untimely.pdo_late),
    WireClass("PDOs late by 1 and 2", untimely.pdos_swapped),
    WireClass("PDO late, next lost", untimely.late_and_lost),
    WireClass("stamp, one bad", untimely.one_bad_stamp, of=with_times),
    WireClass("stamps, 10 % bad", untimely.many_bad_stamps, of=with_times),
    WireClass("stamp, clock steps", untimely.clock_steps, of=with_times),
    WireClass("stamp, clock stands", untimely.stamp_stands, of=with_times),
    WireClass("receive times off", untimely.rx_stamp_off, of=with_stamps),
    WireClass("coarse track, any loss", around.coarse_and_loss),
    WireClass("zero pulse false, coarse", around.false_pulse_with_coarse, after=260),
    WireClass("zero pulse false", around.false_pulse, after=260),
    WireClass("zero pulse, first false", around.first_pulse_false, after=200),
    WireClass("RPDO2 doubled", around.extra_doubled),
    WireClass("RPDO2 lost", around.extra_lost),
    WireClass("NMT pause", around.pause, torque=0.0, after=110),
    WireClass("bus-off", around.bus_off, torque=0.0, after=110),
    WireClass("bus-off, 1029h = 1", around.bus_off_stays, torque=0.0, after=110),
    WireClass("foreign ADC PDO", around.foreign_pdos),
    WireClass("interface restarts", untimely.interface_restarts),
    WireClass("RPDO 1, TPDO 254", around.synchronous(1, 254, around.any_loss)),
    WireClass("RPDO 255, TPDO 1", around.synchronous(255, 1, around.any_loss)),
    WireClass("RPDO 1, TPDO 1", around.synchronous(1, 1, around.any_loss)),
    WireClass("TPDO 1, predict", around.predicting),
    aimed("stamp, bad again", clocks.bad_stamp_again, clocks.timed, survives=True),
    aimed("stamp, bad again after reset", clocks.bad_stamp_after_reset, clocks.timed, survives=True),
    aimed("stamp, bad at the start", clocks.bad_stamp_early, clocks.timed),
    aimed("stamp, late once", clocks.late_stamp_once, clocks.timed, survives=True),
    aimed("stamp, set in a burst", clocks.clock_set_in_a_burst, clocks.timed),
    aimed("SYNC, producer shifts", clocks.producer_shifts, clocks.untimed_with_stamps),
    aimed("SYNC, producer shifts, times", clocks.producer_shifts, clocks.timed_with_stamps, survives=True),
    aimed("SYNC, another rate", clocks.producer_changes_rate, clocks.untimed_with_stamps),
    aimed("SYNC, another rate, times", clocks.producer_changes_rate, clocks.timed),
    aimed("SYNC faster, TPDO 1", clocks.faster_sync, clocks.without_counter),
    aimed("lost, then NMT", clocks.lost_then_started, clocks.any_but_servo),
    aimed("reset node in motion", clocks.reset_in_motion, clocks.any_but_servo),
    aimed("NMT pause, short", clocks.short_pause, clocks.any_but_servo),
    aimed("deaf, creeping", clocks.creeping_deaf, clocks.timed_without_counter),
    aimed("PDO lost, 1, at the limit", clocks.one_lost_at_the_limit, clocks.timed),
    aimed("1006h ten times, PDO lost", clocks.wrong_1006_and_lost, clocks.any_but_servo, survives=True),
    aimed("stall, one burst", clocks.stall_in_one_burst, clocks.counter_alone, survives=True),
    aimed("stall of all", clocks.everything_stalls, clocks.timed, survives=True),
)  # fmt: skip
