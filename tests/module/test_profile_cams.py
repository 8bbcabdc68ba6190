"""Cams 6300h to 6337h and work area 6400h to 6402h, alone against a model and in the module."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from module_bench import Bench

from canfb.module.cia406.cams import OUT_OF_RANGE, OVERFLOW, UNDERFLOW, Cam, limit_position, work_area_state

RANGE = 1000


def model(positions: list[int], low: int, high: int, hysteresis: int, total_range: int = RANGE) -> list[bool]:
    """By counting: the positions of the cam, those of its band, and a state that goes through them."""
    width = (high - low) % total_range
    on = {(low + n) % total_range for n in range(width + 1)}
    band = {(low + n) % total_range for n in range(-hysteresis, width + hysteresis + 1)}
    states, active = [], False
    for position in positions:
        active = position in (band if active else on)
        states.append(active)
    return states


PLACES = st.integers(0, RANGE - 1)


@given(st.integers(1, 30) | st.just(RANGE), st.data())
def test_a_cam_is_that_of_the_model(total_range: int, data: st.DataObject) -> None:
    places = st.integers(0, total_range - 1)
    low, high, back = data.draw(places), data.draw(places), data.draw(st.booleans())
    hysteresis = data.draw(st.integers(0, 700))
    positions = data.draw(st.lists(places, max_size=40))
    cam = Cam()
    cam.configure(low - total_range if back else low, high, hysteresis, total_range)
    assert [cam.update(p) for p in positions] == model(positions, low, high, hysteresis, total_range)


@pytest.mark.parametrize(("low", "high", "on"), [
    (10, 20, range(10, 21)), (-10, 5, [*range(6), *range(990, 1000)]), (900, 5000, range(900, 1000)),
    (-5000, 3, range(4)), (2000, 3000, ()), (2000, 7, range(8)), (-3000, -2000, ()),
    (700, -1500, range(700, 1000)),
    (0, 0, range(1)), (0, -1, range(1000)), (-1100, -1500, range(1000)),
    (-2147483648, 2147483647, range(1000)),
])  # fmt: skip
def test_limits_at_and_beyond_the_ends(low: int, high: int, on: list[int]) -> None:
    cam = Cam()
    cam.configure(low, high, 0, RANGE)
    assert [position for position in range(RANGE) if cam.update(position)] == list(on)


@given(st.integers(0, 4280320000 - 1))
def test_a_position_of_32_bits_is_a_limit_as_it_is(position: int) -> None:
    limit = position if position < 2**31 else position - 2**32
    assert limit_position(limit, 4280320000) == position


@given(PLACES, PLACES, PLACES)
def test_the_work_area(position: int, low: int, high: int) -> None:
    inside = model([position], low, high, 0) == [True]
    state = work_area_state(position, low, high, RANGE)
    assert (state == 0) is inside
    if not inside:
        above, below = (position - high) % RANGE, (low - position) % RANGE
        over = position > high if low <= high else above <= below
        assert state == OUT_OF_RANGE | (OVERFLOW if over else UNDERFLOW)


def scaled(bench: Bench) -> Bench:
    """1000 units per cycle, range 10 cycles."""
    bench.sdo[0x6001].raw, bench.sdo[0x6002].raw = 2_500_000, 10_000
    bench.sdo[0x6000].raw = 4
    return bench


def walk(bench: Bench, *cycles: float) -> list[int]:
    """The cam states at these positions, reached in steps of less than the residual limit."""
    states = []
    for end in cycles:
        while abs(end - bench.place) > 1e-9:
            bench.place += max(-0.2, min(end - bench.place, 0.2))
            bench.at(bench.place)
        bench.at(bench.place)
        states.append(bench.sdo[0x6300][1].raw)
    return states


@pytest.fixture
def machine(bench: Bench) -> Bench:
    scaled(bench).place = 0.5
    bench.at(0.5)
    return bench


def set_cam(bench: Bench, number: int, low: int, high: int, hysteresis: int = 0) -> None:
    for base, value in ((0x630F, low), (0x631F, high), (0x632F, hysteresis)):
        bench.sdo[base + number][1].raw = value
    bench.sdo[0x6301][1].raw |= 1 << number - 1


def test_hysteresis_is_followed_without_anybody_reading(machine: Bench) -> None:
    set_cam(machine, 2, 1000, 2000, 300)
    assert walk(machine, 2.2) == [2]  # it was on in between
    set_cam(machine, 3, 0, 1)
    assert machine.sdo[0x6300][1].raw == 2  # another cam does not matter
    machine.sdo[0x6322][1].raw = 3000
    machine.sdo[0x6331][1].raw = 301
    assert machine.sdo[0x6300][1].raw == 4  # new parameters: from the position alone


def test_polarity_inverts_and_a_disabled_cam_is_0(machine: Bench) -> None:
    machine.sdo[0x6302][1].raw = 0b110
    set_cam(machine, 1, 0, 1000)
    set_cam(machine, 2, 0, 1000)
    assert machine.sdo[0x6300][1].raw == 0b01
    machine.sdo[0x6301][1].raw = 0b10
    assert machine.sdo[0x6300][1].raw == 0
    assert walk(machine, 1.5) == [0b10]


def test_code_sequence_scaling_and_preset_act_on_cams(machine: Bench) -> None:
    set_cam(machine, 1, 9000, 9999)
    assert walk(machine, 0.5) == [0]
    machine.sdo[0x6000].raw = 5
    assert machine.sdo[0x6300][1].raw == 1
    machine.sdo[0x6003].raw = 5000
    assert (machine.sdo[0x6004].raw, machine.sdo[0x6300][1].raw) == (5000, 0)


def test_cams_and_work_area_keep_their_state_without_a_valid_position(machine: Bench) -> None:
    set_cam(machine, 1, 1000, 3000, 5)
    machine.sdo[0x6401][1].raw, machine.sdo[0x6402][1].raw = 1200, 9000
    assert walk(machine, 0.9, 1.1) == [0, 1]
    assert machine.sdo[0x6400][1].raw == OUT_OF_RANGE | UNDERFLOW
    for _ in range(20):
        machine.at(0.0, amplitude=10)
        assert machine.sdo[0x6503].raw == 1
        assert (machine.sdo[0x6300][1].raw, machine.sdo[0x6400][1].raw) == (1, 5)


def test_nothing_is_told_before_the_first_valid_position() -> None:
    bench = Bench()
    bench.sdo[0x6301][1].raw = bench.sdo[0x6302][1].raw = 0xFF
    bench.sdo[0x6401][1].raw = 5
    bench.start()
    bench.at(0.0, amplitude=10)
    assert (bench.sdo[0x6300][1].raw, bench.sdo[0x6400][1].raw) == (0, 0)
