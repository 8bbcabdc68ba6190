"""Motor, friction, load and encoders in the time of the SYNCs; feedback, position loop and trajectory."""

import contextlib
import math
import struct
from typing import Any

import pytest
from hypothesis import example, given, strategies as st

from canfb import Frame, eds_path
from canfb.device.od.dictionary import Dictionary
from canfb.simulation.cia402.axis import (
    Demand,
    Gains,
    PositionLoop,
    Trajectory,
    approach,
    chosen_gains,
    nearest,
    wrapped,
)
from canfb.simulation.cia402.drive import ServoDrive
from canfb.simulation.cia402.feedback_input import FeedbackInput, SyncInterval, Wrong
from canfb.simulation.cia402.plant import DriveConfig, Motor, Plant, PlantSource
from canfb.simulation.encoder import Encoder, ShaftEncoder
from folding import each

SYNC = Frame(0x80, b"")


FREE = {"coulomb_friction_nm": 0.0, "viscous_friction_nm_s": 0.0, "torque_time_constant_s": 0.0}


def motor(command_nm: float = 0.0, speed_rad_s: float = 0.0, start: float = 0.0, **fields: Any) -> Motor:
    made = Motor(DriveConfig(**fields, start_revolutions=start))
    made.braked = False
    made.command_nm = command_nm
    made.speed_rad_s = speed_rad_s
    return made


def plant(speed: float = 10.0, start: float = 0.0, **fields: int) -> Plant:
    return Plant(motor(0.0, speed, start, **FREE, **fields))


@given(st.lists(st.floats(0.0, 2.0), min_size=1, max_size=20), st.sampled_from([0x80, 0x81]))
def test_the_machine_turns_in_true_time_however_the_syncs_come(steps: list[float], can_id: int) -> None:
    one, now, sync = plant(), 5.0, Frame(can_id, b"")
    one.sync_cob_id = lambda: can_id  # 1005h of the drive
    one.receive(sync, now)
    for step in steps:
        now += step
        one.receive(sync, now)
    assert one.motor.time_s == pytest.approx(now - 5.0)
    assert one.motor.revolutions == pytest.approx(10.0 * (now - 5.0) / (2 * math.pi))
    assert one.syncs == len(steps) + 1


@each(
    "syncs, passed_s",
    [
        ([], 0.0),
        ([(SYNC._replace(timestamp=5.0), 5.003), (SYNC._replace(timestamp=5.25), 5.4)], 0.25),
        ([(SYNC, 5.0), (SYNC._replace(timestamp=5.25), 5.4), (SYNC._replace(timestamp=5.1), 5.5)], 0.25),
        ([(Frame(0x80, b"\x01"), 0.0), (Frame(0x80, b"\x02"), 0.001)], 1e-3),
        (
            [(SYNC, 1.0), (Frame(0x81, b""), 2.0), (Frame(0x80, b"", True), 2.0), (Frame(0x180, b""), 2.0)],
            0.0,
        ),
    ],
)
def test_time_passes_from_the_first_sync_on_by_when_syncs_are_received(
    syncs: list[tuple[Frame, float]], passed_s: float
) -> None:
    one = plant()
    one.go_on_to(100.0)
    for frame, now in syncs:
        assert one.receive(frame, now) == []
    assert one.motor.time_s == pytest.approx(passed_s)
    assert (one.start(0.0), one.tick(0.0), one.deadline()) == ([], [], None)


@each(
    "first_s, torque_s, last_s, acting_s",
    [(1.0, 1.00025, 1.001, 0.75e-3), (1.0, 1.5, 1.6, 0.1), (1.0, 0.5, 1.001, 1e-3)],
)
def test_a_torque_acts_from_its_time_on_but_not_before_the_first_sync(
    first_s: float, torque_s: float, last_s: float, acting_s: float
) -> None:
    one = plant(speed=0.0)
    steps = [
        (first_s, lambda: one.receive(SYNC, first_s)),
        (torque_s, lambda: one.drive(0.1, True, torque_s)),
        (last_s, lambda: one.receive(SYNC, last_s)),
    ]
    for _, step in sorted(steps, key=lambda pair: pair[0]):
        step()
    assert one.motor.speed_rad_s == pytest.approx(100.0 * acting_s)


def test_the_encoder_is_sampled_at_the_time_that_is_asked_for_also_at_one_that_is_over() -> None:
    one = plant()
    shaft = ShaftEncoder(Encoder(), 2500)
    source = PlantSource(shaft, one)
    one.receive(SYNC, 1.0)
    cycles_per_s = 10.0 / (2 * math.pi) * 2500
    for at, want in ((1.5, 0.5), (2.0, 1.0), (1.9995, 0.9995), (2.5, 1.5)):
        source.sample_at(at)
        assert shaft.position_cycles == pytest.approx(want * cycles_per_s)


def test_the_zero_pulse_is_where_the_shaft_passes_a_revolution() -> None:
    one = plant(speed=2 * math.pi * 10)
    source = PlantSource(ShaftEncoder(Encoder(), 2500), one)
    one.receive(SYNC, 0.0)
    pulses = {n: pulse for n in range(31) if (pulse := source.sample_at(n * 0.031).zero_pulse) is not None}
    # 0.31 revolutions from sample to sample, a pulse at each whole one
    passed = [turn / 0.31 for turn in range(1, 10)]
    assert pulses == pytest.approx({math.ceil(at): at % 1.0 for at in passed})


@each(
    "steps, seconds",
    [
        ([], 0.0),
        ([0.0], 0.0),
        ([1e-3] * 50 + [0.2] + [1e-3] * 50 + [5e-3, 1e-5, 1e-5, 1e-5] + [1e-3] * 5, 1e-3),
        ([1e-3] * 20 + [1e-4] * 8, 1e-4),
        ([1e-3] * 20 + [3e-3] * 8, 3e-3),
        ([1e-3] * 20 + [0.5] * 8, 0.5),
    ],
)
def test_the_interval_is_measured_without_pauses_and_late_ones(steps: list[float], seconds: float) -> None:
    interval, now = SyncInterval(), 7.0
    interval.event(now)
    for step in steps:
        now += step
        interval.event(now)
    assert interval.seconds == pytest.approx(seconds, rel=1e-6)
    assert interval.last_s == now


# With 2e-3 Nm s/rad the time constant of the speed is 0.5 s.
@each(
    "viscous, speed, angle",
    [
        (0.0, 210.0, 0.5 * 300.0 * 0.49),
        (1e-13, 210.0, 0.5 * 300.0 * 0.49),
        (2e-3, 150.0 * (1 - math.exp(-1.4)), 150.0 * (0.7 - 0.5 * (1 - math.exp(-1.4)))),
    ],
)
def test_a_constant_torque_accelerates_against_viscous_friction(
    viscous: float, speed: float, angle: float
) -> None:
    one = motor(0.3, **FREE | {"viscous_friction_nm_s": viscous})
    one.run(0.7)
    assert one.speed_rad_s == pytest.approx(speed, rel=1e-9)
    assert one.revolutions == pytest.approx(angle / (2 * math.pi), rel=1e-9)
    assert one.time_s == 0.7


@each("viscous", [0.0, 1e-4])
def test_coulomb_friction_brings_the_shaft_to_rest_and_holds_it(viscous: float) -> None:
    one = motor(0.0, 10.0, **FREE | {"coulomb_friction_nm": 0.01, "viscous_friction_nm_s": viscous})
    one.run(0.9)
    assert one.speed_rad_s > 0
    one.run(0.2)
    assert one.speed_rad_s == 0.0
    rest = one.revolutions
    if not viscous:
        assert rest == pytest.approx(10.0**2 / (2 * 10.0) / (2 * math.pi), rel=1e-9)
    one.command_nm = 0.01
    one.run(1.0)
    assert one.revolutions == rest
    one.command_nm = 0.0100001
    one.run(1.0)
    assert one.revolutions > rest


def test_the_load_comes_at_its_time_and_the_brake_holds_it() -> None:
    one = motor(**FREE | {"load_torque_nm": 0.3, "load_at_s": 0.5, "brake_torque_nm": 1.0})
    one.run(0.5)
    assert one.revolutions == 0.0
    one.run(0.1)
    assert one.speed_rad_s == pytest.approx(-30.0, rel=1e-6)
    one.braked = True
    one.run(1.0)
    rest = one.revolutions
    one.run(1.0)
    assert (one.speed_rad_s, one.revolutions) == (0.0, rest)


def test_the_torque_follows_its_command_with_the_time_constant() -> None:
    one = motor(0.4, torque_time_constant_s=0.002)
    one.run(0.002)
    assert one.torque_nm == pytest.approx(0.4 * (1 - math.exp(-1)), rel=1e-9)
    free = motor(0.4, **FREE | {"torque_time_constant_s": 0.002})
    free.run(0.02)
    impulse = 0.4 * (0.02 - 0.002 * (1 - math.exp(-10)))
    assert free.speed_rad_s == pytest.approx(impulse / 1e-3, rel=1e-9)


@given(st.lists(st.floats(1e-6, 3e-3), min_size=1, max_size=8), st.floats(-0.5, 0.5), st.floats(-50, 50))
def test_how_the_time_is_cut_makes_no_difference_that_matters(
    parts: list[float], command: float, speed: float
) -> None:
    whole, cut = (motor(command, speed) for _ in range(2))
    whole.run(math.fsum(parts))
    for part in parts:
        cut.run(part)
    assert cut.revolutions == pytest.approx(whole.revolutions, abs=5e-7)
    assert cut.time_s == pytest.approx(whole.time_s)


@given(st.floats(-100.0, 100.0))
def test_friction_and_no_torque_never_add_energy(speed: float) -> None:
    one = motor(0.0, speed)
    for _ in range(20):
        before = abs(one.speed_rad_s)
        one.run(1e-3)
        assert abs(one.speed_rad_s) <= before
        assert one.speed_rad_s * speed >= 0


@each("time_s", [-1e-9, math.nan, math.inf, 0.0])
def test_time_does_not_go_back_and_no_time_changes_nothing(time_s: float) -> None:
    one = motor(0.3, 5.0)
    with contextlib.nullcontext() if time_s == 0.0 else pytest.raises(ValueError, match="duration_s"):
        one.run(time_s)
    assert (one.time_s, one.revolutions, one.torque_nm) == (0.0, 0.0, 0.0)


@each("config", [{}, {"load_torque_nm": -0.02, "load_at_s": 2.0, "viscous_friction_nm_s": 1e-3}])
@each("speed", [0.0, 3.0, -50.0])
def test_a_long_pause_in_one_step_is_what_it_is_in_many(config: dict[str, float], speed: float) -> None:
    at_once, often = (motor(0.03, speed, **config) for _ in range(2))
    at_once.run(5.0)
    for _ in range(5000):
        often.run(0.001)
    assert at_once.revolutions == pytest.approx(often.revolutions, rel=1e-7, abs=1e-9)
    assert at_once.speed_rad_s == pytest.approx(often.speed_rad_s, rel=1e-7, abs=1e-9)
    assert at_once.time_s == pytest.approx(5.0)


def test_6063h_is_the_motor_at_the_sync() -> None:
    """Sent with the SYNC itself, not one later; it wraps."""
    one = plant(2.0 * math.pi * 40.0, 2047.9, motor_increments=1 << 20)
    drive = ServoDrive(one, autostart=True)
    for subindex, entry in ((1, 0x60630020), (0, 1)):
        drive.dictionary.entry(0x1A02, subindex).value = entry
    drive.dictionary.entry(0x1802, 1).value = 0x3B0
    one.start(0.0)
    drive.start(0.0)
    for k in range(20):
        now = 1.0 + k * 1e-3
        one.receive(SYNC, now)
        sent = [frame.data for frame in drive.receive(SYNC, now) if frame.can_id == 0x3B0]
        (value,) = struct.unpack("<i", sent[0])
        truth = (2047.9 + 40.0 * k * 1e-3) * (1 << 20)
        assert (value - truth + (1 << 31)) % (1 << 32) - (1 << 31) == pytest.approx(0, abs=1.5)


DICTIONARY = Dictionary.load(eds_path("drive"), 48)
FULL = 4_280_320_000


class Input:
    """A feedback of 20480000 increments, 3000 rpm at 1 kHz: steps up to 2048000 are believed."""

    def __init__(self, full: int = FULL) -> None:
        DICTIONARY.reset()
        DICTIONARY.entry(0x2110, 5).value = full
        self.feedback = FeedbackInput(DICTIONARY)
        self.now = 0.0

    def sync(self, after_s: float = 1e-3) -> None:
        self.now += after_s
        self.feedback.sync(self.now)

    def take(self, raw: int, status: int = 1, *, supervised: bool = True, syncs: int = 1) -> bool:
        for _ in range(syncs):
            self.sync()
        DICTIONARY.entry(0x60E4, 1).value = (raw + (1 << 31)) % (1 << 32) - (1 << 31)
        DICTIONARY.entry(0x2110, 1).value = status
        return self.feedback.take(50.0, 1e-3, supervised=supervised)

    @property
    def wrong(self) -> Wrong:
        assert DICTIONARY.entry(0x2111, 1).value == self.feedback.wrong
        return self.feedback.wrong


@example(FULL, FULL // 2, [-1] + [2_000_000] * 9)
@example(0, 0x7FFFFFFF, [1, -2, 2_048_000, -2_048_000])
@example(101, 51, [-50, 50, 50])
@given(
    st.sampled_from([FULL, 0, 101]),
    st.integers(0, FULL - 1),
    st.lists(st.integers(-2_048_000, 2_048_000), max_size=50),
)
def test_the_first_one_is_near_zero_and_the_others_go_on_where_the_range_wraps(
    full: int, first: int, steps: list[int]
) -> None:
    one, size = Input(full), full or 1 << 32
    position = (first + size // 2) % size - size // 2
    half = (size - 1) // 2
    for step in [0, *(max(-half, min(step, half)) for step in steps)]:
        position += step
        assert one.take(position % size)
        assert one.feedback.position == position


def test_late_positions_give_the_speed_of_their_own_intervals() -> None:
    """Three SYNCs are heard before the positions of the first two."""
    one, position = Input(), 0
    for _ in range(5):
        position += 100_000
        one.take(position)
    for syncs in (2, 1, 0, 1, 1, 2, 0, 1):
        position += 100_000
        assert one.take(position, syncs=syncs)
        assert one.feedback.speed == pytest.approx(100_000 / 20_480)
    assert not one.take(position, syncs=0), "one more than there were SYNCs"


def test_positions_that_come_together_leave_the_last_one() -> None:
    """At rest the first of them may be that of any of the SYNCs; those that follow are newer all the same."""
    one = Input()
    for raw in (100, 101, 100):
        one.take(raw)
    one.take(101, syncs=3)
    for raw in (99, 102):
        one.take(raw, syncs=0)
        assert one.feedback.position == raw
    assert abs(one.feedback.speed) < 0.1
    assert one.take(102 + 20_480)
    assert one.feedback.speed == pytest.approx(1.0), "of one interval, from the last one on"


@given(st.lists(st.floats(-2e-4, 2e-4), min_size=3, max_size=30))
def test_the_speed_is_that_of_true_time_however_the_syncs_jitter(jitter: list[float]) -> None:
    one, last = Input(), 0.0
    for n, late_s in enumerate(jitter):
        at = n * 1e-3 + late_s
        one.sync(at - last)
        last = at
        one.take(round(at * 30 * 20_480_000) % FULL, syncs=0)
        if n > 0:
            assert one.feedback.speed == pytest.approx(30.0, abs=2e-4)


def test_after_very_many_syncs_without_a_position_it_goes_on() -> None:
    one = Input()
    one.take(0)
    for _ in range(10_000):
        one.sync()
    assert one.take(2_048_000 * 5000, syncs=0), "within what the motor can do in that time"
    assert one.take(2_048_000 * 5000 + 20_480)
    assert one.feedback.speed == pytest.approx(1.0)


@each("largest, step", [(0, 2_048_000), (0, -2_048_000), (10, 10)])
def test_a_step_at_the_limit_is_believed_and_one_beyond_it_is_wrong_once(largest: int, step: int) -> None:
    one = Input()
    DICTIONARY.entry(0x2110, 9).value = largest
    one.take(0)
    assert one.take(step % FULL)
    assert one.take(3 * step % FULL, syncs=2)
    assert not one.take((4 * step + (1 if step > 0 else -1)) % FULL)
    assert one.wrong == Wrong.STEP
    assert one.feedback.position == 3 * step
    assert one.take(2_000_000_000)
    assert one.wrong == Wrong(0)


@given(st.integers(0, 0xFFFF), st.integers(0, 0xFFFF), st.integers(0, 0xFFFF))
def test_mask_and_expected_value_decide(status: int, mask: int, expected: int) -> None:
    one = Input()
    DICTIONARY.entry(0x2110, 2).value = mask
    DICTIONARY.entry(0x2110, 3).value = expected
    good = all((status ^ expected) >> bit & 1 == 0 for bit in range(16) if mask >> bit & 1)
    assert one.take(0, status) == good


def test_beyond_the_range_is_wrong() -> None:
    one = Input()
    assert not one.take(FULL)
    assert one.wrong == Wrong.RANGE
    assert Input(0).take(FULL)


@each("code", [0x7300, 0x7305, 0x73FF, 0x1000, 0x7200, 0x7400, 0x8130, 0xFF00])
def test_a_sensor_emergency_lasts_until_0000h_and_no_other_counts(code: int) -> None:
    one = Input()
    one.take(0)
    one.feedback.emergency(code)
    heard = Wrong.EMERGENCY if code >> 8 == 0x73 else Wrong(0)
    assert one.take(10)
    assert one.wrong == heard
    one.feedback.lose()
    assert one.wrong == heard | Wrong.MISSING
    one.feedback.emergency(0)
    assert one.wrong == Wrong.MISSING


def test_a_boot_up_ends_the_emergency_and_the_position() -> None:
    one = Input()
    one.take(5_000_000)
    one.feedback.emergency(0x7300)
    one.feedback.boot_up()
    assert one.wrong == Wrong.MISSING
    assert one.take(100)
    assert one.feedback.position == 100


GAINS = Gains(50.0, 0.2, 0.04, 1.0, 1.0, 1e-3)


def step(loop: PositionLoop, demand: Demand, position: float = 0.0, speed: float = 0.0) -> float:
    return loop.step(
        demand, position, speed, GAINS, period_s=1e-3, torque_limit_nm=0.5, speed_limit_rad_s=300.0
    )


def test_gains_that_are_0_are_chosen_and_others_are_kept() -> None:
    chosen = chosen_gains(0.0, 0.0, 0.0, 1.0, 1e4, 0.5, period_s=1e-3)
    assert (chosen.position, chosen.velocity, chosen.integral_s) == pytest.approx((50.0, 0.2, 0.04))
    assert chosen_gains(50.0, 0.2, 0.04, 1.0, 1e4, 1.0, period_s=5e-3) == GAINS


def test_a_deviation_that_stays_is_integrated_up_to_the_limit() -> None:
    loop = PositionLoop()
    torques = [step(loop, Demand(0.0, 0.5), 0.0, 0.0) for _ in range(500)]
    assert torques[:3] == pytest.approx([0.1, 0.1025, 0.105])
    assert torques[-1] == 0.5
    assert loop.limited
    assert step(loop, Demand(0.0), 0.0, 0.5) < 0.5, "it leaves the limit at once"
    assert step(PositionLoop(), Demand(0.0), 0.0, 0.0) == 0.0


@given(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(-1e4, 1e4), st.floats(-1e3, 1e3))
def test_the_torque_is_within_its_limit(demand: float, speed: float, change: float, position: float) -> None:
    loop = PositionLoop()
    for _ in range(3):
        assert abs(step(loop, Demand(demand, speed, change), position, speed / 2)) <= 0.5


@given(st.floats(-1e4, 1e4))
def test_the_approach_is_no_faster_than_the_motor_brakes(error: float) -> None:
    speed = approach(error, 50.0, 350.0)
    assert speed * error >= 0.0
    assert abs(speed) <= 50.0 * abs(error)
    assert speed * speed / (2 * 350.0) <= abs(error) + 1e-9
    near = approach(error * (1 + 1e-9), 50.0, 350.0)
    assert near == pytest.approx(speed, rel=1e-6, abs=1e-12)


@given(st.integers(-(10**12), 10**12))
def test_what_wraps_is_an_integer32_of_the_same_count(value: int) -> None:
    shown = wrapped(value)
    assert -(1 << 31) <= shown < 1 << 31
    assert (shown - value) % (1 << 32) == 0


@given(st.integers(-(1 << 31), (1 << 31) - 1), st.integers(-(10**12), 10**12))
def test_the_nearest_of_all_positions_that_show_alike(target: int, reference: int) -> None:
    place = nearest(target, reference)
    assert wrapped(place) == target
    assert abs(place - reference) <= 1 << 31


T = 1e-3


@pytest.mark.parametrize("speed", [-100.0, 100.0, 0.05])
def test_a_ramp_takes_the_way_of_its_deceleration(speed: float) -> None:
    trajectory = Trajectory(0.0, speed)
    count = 0
    while trajectory.speed:
        trajectory.brake(1000.0, T)
        count += 1
    assert trajectory.position == pytest.approx(math.copysign(speed * speed / 2000.0, speed), rel=1e-6)
    assert count == pytest.approx(abs(speed) / 1000.0 / T, abs=1)


def test_targets_are_joined_by_straight_lines() -> None:
    trajectory = Trajectory()
    seen = []
    for count in range(12):
        if count in (1, 5):
            trajectory.set_target(8.0 * count, 4)
        trajectory.advance(T)
        seen.append((trajectory.position, trajectory.speed * T))
    assert [position for position, _ in seen] == [0, 2, 4, 6, 8, 16, 24, 32, 40, 40, 40, 40]
    assert [speed for _, speed in seen] == [0, 2, 2, 2, 2, 8, 8, 8, 8, 0, 0, 0]
