"""Objects 6030h and 6040h with their scale 2003h, and 6200h: against exact fractions."""

from __future__ import annotations

from fractions import Fraction

import pytest
from canopen import SdoAbortedError
from hypothesis import given
from hypothesis import strategies as st
from module_bench import Bench

from canfb.device.od.dictionary import Dictionary
from canfb.eds_files import eds_path
from canfb.module.cia406.position import STILL, PositionScale, saturated, show_motion
from canfb.module.interval import SamplingInterval
from canfb.timing.syncs import Syncs
from drawing import examples

U32 = st.integers(0, 0xFFFFFFFF)
CYCLES = st.floats(-1e6, 1e6)


def nearest(value: Fraction) -> int:
    return max(-0x8000, min(round(value), 0x7FFF))


@examples(300)
@given(
    CYCLES,
    CYCLES,
    st.integers(1, 1048576),
    st.integers(1, 0xFFFFFFFF),
    st.booleans(),
    st.integers(1, 0xFFFFFFFF),
    st.tuples(U32, U32, U32, U32),
)
def test_speed_and_acceleration_are_scaled_and_saturated(
    speed: float,
    acceleration: float,
    cycles: int,
    units: int,
    reverse: bool,
    period_us: int,
    factors: tuple[int, int, int, int],
) -> None:
    dictionary = Dictionary.load(eds_path("canfb-module"), 32)
    dictionary.entry(0x1006).value = period_us
    for subindex, factor in enumerate(factors, 1):
        dictionary.entry(0x2003, subindex).value = factor
    last = STILL._replace(speed_cycles=speed, acceleration_cycles=acceleration)
    scale = PositionScale(cycles, units, 0xFFFFFFFF, reverse, 0)
    interval = SamplingInterval(dictionary.entry(0x1006), Syncs())
    show_motion(dictionary, interval, lambda: last, lambda: scale)
    period, sign = Fraction(period_us, 1_000_000), -1 if reverse else 1
    for index, value, time, factor, divisor in (
        (0x6030, speed, period, factors[0], factors[1]),
        (0x6040, acceleration, period**2, factors[2], factors[3]),
    ):
        exact = sign * Fraction(value) * units / cycles / time * factor / (divisor or units)
        given_value = dictionary.entry(index, 1).current()
        assert abs(given_value - nearest(exact)) <= 1, index  # a float may round the other way
        if abs(exact) > 32768:
            assert given_value == (0x7FFF if exact > 0 else -0x8000)


@pytest.mark.parametrize(("value", "object_value"), [
    (32767.4, 32767), (32767.6, 32767), (1e300, 32767), (float("inf"), 32767), (-32768.4, -32768),
    (-1e300, -32768), (float("-inf"), -32768), (float("nan"), 0), (-0.4, 0), (1.6, 2),
])  # fmt: skip
def test_saturation(value: float, object_value: int) -> None:
    assert saturated(value) == object_value


def turning(bench: Bench, step: float = 0.25, samples: int = 40) -> None:
    """Cycles per sample, at 1 kHz and with one cycle per revolution as configured below."""
    bench.sdo[0x1006].raw = 1000
    for n in range(samples):
        bench.at(n * step)


def test_the_defaults_are_per_minute_and_revolutions_per_square_second(make_bench: type[Bench]) -> None:
    bench = make_bench(cycles_per_revolution=100)
    bench.start()
    turning(bench)
    assert bench.sdo[0x6030][1].raw == pytest.approx(0.25 * 10 * 60, abs=1)  # 2.5 revolutions per second
    bench.sdo[0x6000].raw = 1
    assert bench.sdo[0x6030][1].raw == pytest.approx(-150, abs=1)
    bench.sdo[0x2003][1].raw, bench.sdo[0x2003][2].raw = 1, 8192
    assert bench.sdo[0x6030][1].raw == pytest.approx(-250, abs=1)  # cycles per second
    bench.at(0.25 * 39 + 0.375)
    assert bench.sdo[0x6040][1].raw == pytest.approx(-0.125 * 1e6 / 100, rel=1e-3)


def test_the_cyclic_timer_is_the_event_timer_of_tpdo1(bench: Bench) -> None:
    bench.sdo[0x6200].raw = 25
    assert bench.sdo[0x1800][5].raw == 25
    bench.sdo[0x1800][5].raw = 40
    assert bench.sdo[0x6200].raw == 40
    bench.at(0.0)
    before = len(bench.heard)
    bench.bus.run_until(bench.bus.now + 0.1)
    assert len([frame for frame in bench.heard[before:] if frame.can_id == 0x1A0]) in (2, 3)
    bench.sdo[0x6200].raw = 0
    before = len(bench.heard)
    bench.bus.run_until(bench.bus.now + 0.2)
    assert not [frame for frame in bench.heard[before:] if frame.can_id == 0x1A0]
    with pytest.raises(SdoAbortedError) as error:
        bench.remote.sdo.download(0x6200, 0, b"\1\0\0\0")
    assert error.value.code == 0x06070012
