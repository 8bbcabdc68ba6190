"""The feedback of the drive, its position loop, and the trajectory that it follows."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.device.od.dictionary import Dictionary
from canfb.eds_files import eds_path
from canfb.simulation.cia402.axis import nearest, saturated, wrapped
from canfb.simulation.cia402.feedback_input import FeedbackInput, Wrong
from canfb.simulation.cia402.loop import Demand, Gains, PositionLoop, Trajectory, approach, chosen_gains
from folding import each

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


@pytest.mark.parametrize(
    ("full", "raw", "position"),
    [
        (FULL, FULL - 1, -1),
        (FULL, FULL // 2 - 1, FULL // 2 - 1),
        (FULL, FULL // 2, -FULL // 2),
        (0, 0xFFFFFFFF, -1),
        (0, 0x7FFFFFFF, 0x7FFFFFFF),
        (0, 0x80000000, -0x80000000),
        (101, 50, 50),
        (101, 51, -50),
    ],
)
def test_the_first_one_is_on_the_side_of_zero_where_it_is_near(full: int, raw: int, position: int) -> None:
    one = Input(full)
    assert one.take(raw)
    assert one.feedback.position == position


@each("full", [FULL, 0])
def test_it_goes_on_where_the_range_wraps(full: int) -> None:
    one, position = Input(full), -3_000_000
    for _ in range(4300):
        assert one.take(position % (full or 1 << 32))
        assert one.feedback.position == position
        position += 1_000_000
    assert position > (full or 1 << 32)
    for _ in range(8600):
        position -= 1_000_000
        assert one.take(position % (full or 1 << 32))
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


@each("step", [2_048_001, -2_048_001, 2_000_000_000])
def test_a_step_that_the_machine_cannot_make_is_wrong_once(step: int) -> None:
    one = Input()
    one.take(0)
    assert not one.take(step % FULL)
    assert one.wrong == Wrong.STEP
    assert one.feedback.position == 0
    assert one.take((step + 100) % FULL)
    assert one.wrong == Wrong(0)


@each("largest, step", [(0, 2_048_000), (0, -2_048_000), (10, 10)])
def test_a_step_at_the_limit_is_believed(largest: int, step: int) -> None:
    one = Input()
    DICTIONARY.entry(0x2110, 9).value = largest
    one.take(0)
    assert one.take(step % FULL)
    assert one.take(3 * step % FULL, syncs=2)
    assert not one.take((4 * step + (1 if step > 0 else -1)) % FULL)


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
    chosen = chosen_gains(Gains(0.0, 0.0, 0.0, 1.0, 0.5, 1e-3), 1e-3)
    assert (chosen.position, chosen.velocity, chosen.integral_s) == pytest.approx((50.0, 0.2, 0.04))
    assert chosen_gains(GAINS, 5e-3) == GAINS


def test_the_torque_is_the_sum_of_its_parts() -> None:
    demand = Demand(1e-5, 0.1, 10.0)
    loop = PositionLoop()
    assert step(loop, demand, 0.0, 0.1) == pytest.approx(0.2 * 50 * 6.283185e-5 + 1e-3 * 10.0, rel=1e-6)
    assert not loop.limited


def test_a_deviation_that_stays_is_integrated_up_to_the_limit() -> None:
    loop = PositionLoop()
    torques = [step(loop, Demand(0.0, 0.5), 0.0, 0.0) for _ in range(500)]
    assert torques[:3] == pytest.approx([0.1, 0.1025, 0.105])
    assert torques[-1] == 0.5
    assert loop.limited
    assert step(loop, Demand(0.0), 0.0, 0.5) < 0.5, "it leaves the limit at once"
    loop.reset()
    assert step(loop, Demand(0.0), 0.0, 0.0) == 0.0


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


@pytest.mark.parametrize(
    ("value", "shown"),
    [(1.4, 1), (-1.6, -2), (40000.0, 32767), (-1e99, -32768), (float("inf"), 32767), (float("nan"), 0)],
)
def test_what_does_not_fit_is_saturated(value: float, shown: int) -> None:
    assert saturated(value, 16) == shown


T = 1e-3


@pytest.mark.parametrize("speed", [-100.0, 100.0, 0.05])
def test_a_ramp_takes_the_way_of_its_deceleration(speed: float) -> None:
    trajectory = Trajectory()
    trajectory.place(0.0, speed)
    count = 1
    while not trajectory.brake(1000.0, T):
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
