"""The drive on the bus: how well it follows, and what it makes of feedback, bus and load that fail."""

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from drive_bench import DRIVE_ID, MODULE_ID, SYNC, UNITS, DriveBench, cruising
from hypothesis import event, example, given, strategies as st

from canfb import Frame, ModuleConfig, Sample
from canfb.cia301.codes import NmtState
from canfb.simulation.cia402.drive import ServoDrive
from canfb.simulation.cia402.plant import DriveConfig, Motor, Plant
from canfb.simulation.cia402.state_machine import POWERED, SWITCHED_ON, State
from drawing import examples
from folding import each

HEARTBEAT_MS = 20


def assert_fault(bench: DriveBench, error: int) -> None:
    assert bench.state is State.FAULT
    assert bench.read(0x603F) == error
    assert bench.read(0x6041) & 0x4F == 0x08
    assert (bench.motor.command_nm, bench.motor.torque_nm) == (0.0, 0.0)
    assert (bench.read(0x6074), bench.read(0x6077)) == (0, 0)
    assert bench.motor.braked


def restart_module(bench: DriveBench) -> None:
    """What brings a lost position back: the machine stands still, and the module starts again."""
    bench.cycle(4000)
    assert bench.motor.speed_rad_s == 0.0
    bench.module_master.nmt.send_command(0x81)
    bench.cycle(2)
    bench.module_master.nmt.state = "OPERATIONAL"
    bench.cycle(10)


@each("synchronous", [False, True])
@each(
    "spoil",
    [
        lambda sample: Sample(0, 0),
        lambda sample: Sample(2047, 2047),
        lambda sample: Sample(-sample.sine, -sample.cosine),
    ],
)
def test_wrong_feedback_takes_the_torque_away_in_the_same_cycle(
    spoil: Callable[[Sample], Sample], synchronous: bool
) -> None:
    bench = cruising(synchronous=synchronous)
    bench.source.change = spoil
    bench.onward()
    assert_fault(bench, 0x7305)
    assert bench.emergencies(MODULE_ID)[-1] == 0x7300
    (emergency,) = [frame for frame in bench.heard if frame.can_id == 0x80 + DRIVE_ID]
    code, register, wrong, status = struct.unpack("<HBHHx", emergency.data)
    assert (code, register) == (0x7305, 0x21)
    assert wrong & 0x04, "the EMCY of the module came first"
    assert status == 1, "its last PDO was good"
    assert bench.read(0x1001) == 0x21
    assert bench.read(0x1003, 1) & 0xFFFF == 0x7305


def test_the_fault_stays_until_it_is_reset_and_the_feedback_is_good() -> None:
    bench = cruising()
    bench.source.change = lambda sample: Sample(0, 0)
    bench.onward(10)
    bench.source.change = lambda sample: sample
    place = bench.motor.revolutions
    for controlword in (0x06, 0x07, 0x0F, 0x00, 0x80, 0x0F):  # a reset among them: the position is lost
        bench.control(controlword)
        bench.onward()
        assert_fault(bench, 0x7305)
    restart_module(bench)
    assert bench.motor.revolutions > place, "it coasted"
    assert_fault(bench, 0x7305)
    bench.control(0x00)
    bench.control(0x80)
    assert bench.state is State.SWITCH_ON_DISABLED
    assert bench.read(0x603F) == 0
    assert Frame(0x1B0, bytes.fromhex("5002080573")) not in bench.heard, "6041h with the error that is over"
    assert bench.emergencies() == [0x7305, 0x0000]
    place = bench.motor.revolutions
    bench.enable()
    bench.cycle(100)
    assert bench.motor.revolutions == pytest.approx(place, abs=1e-4), "where it stood, not where it was to go"
    assert bench.read(0x6041) == 0x1237


@pytest.mark.parametrize("tolerated", [0, 2])
def test_feedback_that_stops_coming_is_a_fault_after_n_syncs(tolerated: int) -> None:
    bench = cruising(1.0)
    bench.write(0x2110, tolerated, 6)
    missed = bench.read(0x2111, 3)
    bench.module_master.nmt.state = "STOPPED"
    for _ in range(tolerated + 1):
        bench.onward()
        assert bench.state is State.OPERATION_ENABLED
    bench.onward()
    assert_fault(bench, 0x7305)
    assert bench.read(0x2111, 1) == 0x02
    assert bench.read(0x2111, 3) == missed + tolerated + 1


@each("of_module, command, error", [(True, 0x81, 0x7305), (False, 0x82, 0x8100)])
def test_a_restart_is_a_fault_at_once_and_is_told_once(of_module: bool, command: int, error: int) -> None:
    bench = cruising()
    (bench.module_master if of_module else bench.master).nmt.send_command(command)
    assert_fault(bench, error)
    assert bench.emergencies() == [error]
    moved: list[frozenset[int]] = []
    bench.drive.follow_can_ids(lambda: moved.append(bench.drive.can_ids().data))
    for code in (0xA1, 0x80 + MODULE_ID):  # of a bus that filters, it gets EMCY and boot-up
        bench.write(0x2110, code, 7)
        assert {code, 0x680 + code} <= moved[-1]


@each("option, state", [
    *enumerate([State.OPERATION_ENABLED, State.FAULT, State.SWITCH_ON_DISABLED, State.QUICK_STOP_ACTIVE]),
])  # fmt: skip
def test_6007h_says_what_a_lost_heartbeat_does(option: int, state: State) -> None:
    bench = cruising()
    bench.write(0x6007, option)
    bench.write(0x1029, 1, 1)  # stay in Operational
    bench.write(0x1016, MODULE_ID << 16 | HEARTBEAT_MS, 1)
    bench.bus.send(Frame(0x700 + MODULE_ID, b"\x05"))
    bench.onward(HEARTBEAT_MS + 1)
    assert bench.state is state
    bench.onward(300)
    ends = {State.QUICK_STOP_ACTIVE: State.SWITCH_ON_DISABLED}
    assert bench.state is ends.get(state, state)


@each("timeout_ms", [10, 100, 0])
def test_without_sync_the_torque_goes_off_in_time_unless_it_is_switched_off(timeout_ms: int) -> None:
    bench = cruising()
    bench.module_master.sdo[0x2010][6].raw = 255  # else the module says first that its position is not valid
    bench.onward()
    bench.write(0x2110, timeout_ms, 8)
    bench.bus.run_until(bench.bus.now + (timeout_ms or 250) / 1000 - 1e-6)
    assert bench.state is State.OPERATION_ENABLED
    bench.bus.run_until(bench.bus.now + 2e-6)
    if timeout_ms:
        assert_fault(bench, 0x8700)
    else:
        assert bench.state is State.OPERATION_ENABLED


def test_a_preset_under_power_is_a_position_that_cannot_be() -> None:
    bench = cruising(0.0)
    bench.bus.send(Frame(0x1A0, struct.pack("<IHH", 1_000_000_000, 1, 0)))
    assert bench.state is State.OPERATION_ENABLED, "a second position in the same cycle is not looked at"
    bench.interface_master.nmt.state = "STOPPED"
    bench.bus.run_until(bench.bus.now + 1e-3)
    bench.bus.send(SYNC)
    bench.bus.send(Frame(0x1A0, struct.pack("<IHH", 1_000_000_000, 1, 0)))
    assert_fault(bench, 0x7320)
    assert bench.drive.feedback.position < 1000


def test_a_preset_while_it_is_off_moves_6064h() -> None:
    bench = DriveBench()
    bench.module_master.sdo[0x6003].raw = 10 * 20_480_000
    bench.cycle(3)
    assert bench.read(0x6064) == pytest.approx(10 * UNITS, abs=2)
    bench.enable()
    bench.cycle(50)
    assert bench.state is State.OPERATION_ENABLED
    assert bench.motor.revolutions == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize(("option", "ramp"), [(0, False), (2, True)])
def test_a_following_error_is_a_fault_with_the_reaction_of_605eh(option: int, ramp: bool) -> None:
    bench = cruising()
    bench.write(0x605E, option)
    before = bench.motor.revolutions
    bench.write(0x6072, 20)  # less torque than friction needs
    count = 0
    while bench.state is State.OPERATION_ENABLED:
        bench.onward()
        count += 1
        assert count < 2000
        bench.speed_rev_s += 0.05
    assert bench.read(0x603F) == 0x8611
    assert bench.emergencies() == [0x8611]
    if not ramp:
        assert_fault(bench, 0x8611)
        return
    assert bench.state is State.FAULT_REACTION_ACTIVE
    bench.write(0x6072, 1000)
    bench.cycle(400)
    assert_fault(bench, 0x8611)
    assert abs(bench.motor.speed_rad_s) < 0.1
    assert bench.motor.revolutions > before


def test_the_time_of_6066h_passes_before_the_fault() -> None:
    bench = DriveBench()
    bench.enable()
    bench.write(0x6065, 10)
    bench.write(0x6066, 7)
    bench.write(0x6072, 0)
    place = bench.read(0x6064)
    for _ in range(7):
        bench.target(place + 1000)
        bench.cycle()
        assert bench.read(0x6041) & 0x2000
        assert bench.state is State.OPERATION_ENABLED
        assert abs(bench.read(0x60F4) - 1000) < 10
    bench.cycle()
    assert bench.read(0x603F) == 0x8611


@each("what", ["feedback", "SYNC"])
def test_what_is_lost_during_a_reaction_ends_the_ramp(what: str) -> None:
    bench = cruising()
    bench.write(0x6065, 10)
    bench.write(0x6066, 0)
    bench.place += 1000
    bench.onward()
    assert bench.state is State.FAULT_REACTION_ACTIVE
    if what == "feedback":
        bench.source.change = lambda sample: Sample(0, 0)
        bench.cycle()
    else:
        bench.bus.run_until(bench.bus.now + 0.2)
    assert_fault(bench, 0x8611)


INCREMENTS = 20_480_000


@dataclass
class Rig:
    """A drive with a feedback that is right unless the test spoils it."""

    def __post_init__(self) -> None:
        self.plant = Plant(Motor(DriveConfig(node_id=DRIVE_ID)))
        self.drive = ServoDrive(self.plant, ModuleConfig(node_id=MODULE_ID), autostart=True)
        self.now = 1.0
        self.drive.start(self.now)
        self.status, self.offset, self.silent = 1, 0, False

    def give(self, can_id: int, data: bytes, rtr: bool = False) -> None:
        frame = Frame(can_id, data, rtr)
        self.plant.receive(frame, self.now)
        self.drive.receive(frame, self.now)
        self.check()

    def cycle(self, count: int = 1) -> None:
        for _ in range(count):
            self.wait(1e-3)
            self.give(SYNC.can_id, SYNC.data)
            if not self.silent:
                raw = round(self.plant.motor.revolutions * INCREMENTS) + self.offset
                self.give(0x180 + MODULE_ID, struct.pack("<IHH", raw % 4_280_320_000, self.status, 0))

    def wait(self, seconds: float) -> None:
        end = self.now + seconds
        while (due := self.drive.deadline()) is not None and due <= end:
            self.now = max(self.now, due)
            self.drive.tick(self.now)
            self.check()
        self.now = end

    def control(self, word: int) -> None:
        mode = self.drive.dictionary.entry(0x6060).value
        self.give(0x200 + DRIVE_ID, struct.pack("<Hb", word, mode))

    def check(self) -> None:
        drive, motor = self.drive, self.plant.motor
        assert motor.braked == (drive.power not in POWERED or drive.state is not NmtState.OPERATIONAL)
        if motor.braked:
            assert (motor.command_nm, motor.torque_nm) == (0.0, 0.0)
        if drive.power in SWITCHED_ON:
            assert not drive.feedback.wrong
        assert abs(motor.command_nm) <= 0.5
        assert (drive.error != 0) == (drive.power in (State.FAULT, State.FAULT_REACTION_ACTIVE))
        shown = drive.dictionary.entry(0x6041).value
        assert shown & 0x6F == drive.power.value or drive.power.value & 0x4F == shown & 0x4F


IDS = [0x000, 0x080, 0x0A0, 0x100, 0x1A0, 0x230, 0x330, 0x630, 0x720, 0x7E5]
WORDS = [0x00, 0x02, 0x06, 0x07, 0x0F, 0x1F, 0x3F, 0x5F, 0x80, 0x10F, 0x8F]


def target(units: int) -> tuple[int, bytes]:
    return 0x300 + DRIVE_ID, struct.pack("<i", units)


def mode(number: int) -> tuple[int, bytes]:
    return 0x600 + DRIVE_ID, struct.pack("<BHBb3x", 0x2F, 0x6060, 0, number)


FRAMES: list[st.SearchStrategy[tuple[Any, ...]]] = [
    st.integers(-UNITS, UNITS).map(target),
    st.sampled_from([0, 1, 8, 3]).map(mode),
    st.sampled_from([0x7300, 0x0000, 0x8130]).map(
        lambda code: (0x80 + MODULE_ID, struct.pack("<HB5x", code, 1))
    ),
    st.sampled_from([1, 1, 2, 128, 129, 130]).map(lambda command: (0x000, bytes([command, DRIVE_ID]))),
    st.just((0x700 + MODULE_ID, b"\x00")),
    st.tuples(st.sampled_from(IDS), st.binary(max_size=8), st.booleans()),
]
ACTIONS: list[st.SearchStrategy[tuple[str, Any]]] = [
    *[st.tuples(st.just("control"), st.sampled_from(WORDS))] * 2,
    *[st.tuples(st.just("cycle"), st.integers(1, 30))] * 2,
    st.tuples(st.just("wait"), st.sampled_from([0.01, 0.2])),
    st.tuples(st.just("status"), st.sampled_from([1, 1, 1, 0, 2])),
    st.tuples(st.just("silent"), st.booleans()),
    st.tuples(st.just("offset"), st.sampled_from([0, 0, 5, 30_000_000, -1_000_000_000])),
    *(st.tuples(st.just("give"), frame) for frame in FRAMES),
]


# Stopped in a fault reaction.
@example([("give", target(UNITS)), ("give", mode(8)), ("cycle", 11), ("give", (0, bytes([2, DRIVE_ID])))])
@examples(150)
@given(st.lists(st.one_of(ACTIONS), max_size=40))
def test_no_frame_raises_and_no_torque_without_a_state_that_allows_it(actions: list[tuple[str, Any]]) -> None:
    rig = Rig()
    rig.cycle(5)
    for word in (0x06, 0x07, 0x0F):
        rig.control(word)
    assert rig.drive.power is State.OPERATION_ENABLED
    for name, value in actions:
        match name:
            case "give":
                rig.give(*value)
            case "control" | "cycle" | "wait":
                getattr(rig, name)(value)
            case _:
                setattr(rig, name, value)
    event(rig.drive.power.name)


CYCLE = UNITS / 2500  # Units of the drive in a cycle of the encoder.
NO_WINDOW = 0xFFFFFFFF


def enabled(**fields: Any) -> DriveBench:
    bench = DriveBench(**fields)
    bench.enable()
    bench.write(0x6065, NO_WINDOW)
    return bench


def test_a_step_of_one_revolution() -> None:
    bench = enabled()
    start = bench.read(0x6064)
    truth = bench.follow([start + UNITS] * 600)
    overshoot = (truth.max() - start - UNITS) / UNITS
    assert overshoot < 1e-4
    settled_ms = np.flatnonzero(np.abs(truth - start - UNITS) > UNITS / 1000)[-1] + 1
    ideal_ms = 2000 * math.sqrt(2 * math.pi / 500)  # all of the torque, half of the way each
    assert ideal_ms < settled_ms < 1.6 * ideal_ms
    assert 1e-6 < abs(truth[-1] - start - UNITS) < 10


# The friction reverses with the motion, which is most of the error.
FREE = {"coulomb_friction_nm": 0.0, "viscous_friction_nm_s": 0.0}


@each("fields, rms, peak", [
    ({}, (0.05, 0.25), (0.2, 0.8)),
    ({"synchronous": True}, (0.05, 0.25), (0.2, 0.8)),
    (FREE, (0.002, 0.05), (0.005, 0.1)),
])  # fmt: skip
def test_a_sine_is_followed(
    fields: dict[str, Any], rms: tuple[float, float], peak: tuple[float, float]
) -> None:
    """Half a revolution at 1 Hz: up to 20 rad/s^2."""
    bench = enabled(**fields)
    times = np.arange(2000) * 1e-3
    targets = bench.read(0x6064) + np.round(0.5 * UNITS * (1 - np.cos(2 * np.pi * times)))
    error = (targets - bench.follow(targets))[1000:] / CYCLE
    assert rms[0] < np.sqrt(np.mean(error**2)) < rms[1]
    assert peak[0] < np.abs(error).max() < peak[1]


def test_a_load_is_held() -> None:
    bench = enabled(load_torque_nm=0.25, load_at_s=0.2, coulomb_friction_nm=0.0)
    bench.follow([0] * 150)
    truth = bench.follow([0] * 850) / CYCLE
    assert -20 < truth.min() < -1, "the load pulls backwards"
    assert abs(truth[-1]) < 0.2
    assert bench.read(0x6077) == pytest.approx(500, abs=10)
    assert bench.read(0x6074) == pytest.approx(500, abs=10)


def test_6064h_is_the_shaft_at_the_sync() -> None:
    bench, speed_rev_s = enabled(), -40.0
    place = float(bench.read(0x6064))
    for count in range(1200):
        place += math.copysign(min(count * 0.05, abs(speed_rev_s)), speed_rev_s) * UNITS * 1e-3
        bench.target(round(place))
        bench.cycle()
        assert abs(bench.read(0x6064) - bench.shaft_units) < 0.02 * CYCLE
    assert bench.read(0x606C) / UNITS == pytest.approx(speed_rev_s, rel=1e-3)
    assert bench.read(0x6063) == bench.drive.feedback.position
    assert bench.read(0x6062) - bench.read(0x6064) == pytest.approx(bench.read(0x60F4), abs=2)


@pytest.mark.parametrize(("period_s", "cycles"), [(5e-4, 2500), (5e-3, 128)])
def test_the_gains_suit_any_rate_of_sync(period_s: float, cycles: int) -> None:
    bench = enabled(period_s=period_s, cycles_per_revolution=cycles)
    times = np.minimum(np.arange(round(1.5 / period_s)) * period_s, 1.0)
    bench.follow(np.round(UNITS * (1 - np.cos(np.pi * times)) / 2))
    assert bench.read(0x2101, 1) == pytest.approx(period_s, rel=1e-3)
    assert bench.shaft_units == pytest.approx(UNITS, abs=200)


@pytest.mark.parametrize(("synchronous", "dead_us"), [(False, 0), (True, 1000)])
def test_the_dead_time_is_a_period_if_the_feedback_is_synchronous(synchronous: bool, dead_us: int) -> None:
    bench = enabled(synchronous=synchronous)
    bench.cycle(10)
    assert bench.read(0x2101, 2) == pytest.approx(dead_us, abs=1)
    bench.write(0x1006, 1010)  # by a master
    bench.cycle(2)
    assert bench.read(0x2101, 1) == pytest.approx(1.01e-3, rel=1e-6)
