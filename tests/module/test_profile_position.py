"""6000h to 600Ch and 6509h against a model in plain integers; 6030h and 6040h against exact fractions."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from fractions import Fraction

import pytest
from canopen import SdoAbortedError
from hypothesis import example, given
from hypothesis import strategies as st
from module_bench import Bench

from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.cia301.frame import Frame
from canfb.device.od.dictionary import Dictionary
from canfb.device.storage.storage import MemoryStore
from canfb.eds_files import eds_path
from canfb.module.cia406.position import (
    STILL,
    PositionScale,
    distinguishable_revolutions,
    saturated,
    show_motion,
    single_turn_resolution,
)
from canfb.module.feedback_module import FeedbackModule
from canfb.module.interval import SamplingInterval
from canfb.module.module_config import ModuleConfig
from canfb.timing.syncs import Syncs
from drawing import examples

U32 = 0xFFFFFFFF
EIGHTHS = [(0, 1000), (1000, 1000), (1000, 0), (1000, -1000), (0, -1000), (-1000, -1000), (-1000, 0),
           (-1000, 1000)]  # fmt: skip
"""Sine and cosine in eighths of a cycle: Table 1 is exact there."""
KEPT = (0x6000, 0x6001, 0x6002, 0x6509)


@dataclass
class Model:
    """A position in eighths of a cycle, and what CiA 406 makes of it."""

    cycles_per_revolution: int
    objects: dict[int, int] = field(default_factory=dict)
    saved: dict[int, int] = field(default_factory=dict)
    place: int = 0
    step: int = 0
    sampled: bool = False

    def __post_init__(self) -> None:
        n = self.cycles_per_revolution
        self.resolution = 8192 * n
        self.physical_range = self.resolution * min((2**32 - 1) // self.resolution, 65535)
        most = min(self.physical_range, U32 // self.resolution * self.resolution)
        self.objects = dict(zip(KEPT, (0, self.resolution, most, 0), strict=True))
        self.saved = dict(self.objects)

    @property
    def scaling(self) -> bool:
        return bool(self.objects[0x6000] & 4)

    @property
    def total_range(self) -> int:
        return self.objects[0x6002] if self.scaling else self.physical_range

    def units(self) -> int:
        per_revolution = self.objects[0x6001] if self.scaling else self.resolution
        sign = -1 if self.objects[0x6000] & 1 else 1
        return sign * self.place * per_revolution // (8 * self.cycles_per_revolution)

    def position(self) -> int:
        return (self.units() + self.objects[0x6509]) % self.total_range if self.sampled else 0

    def preset(self, value: int) -> AbortCode | None:
        if value >= self.total_range:
            return AbortCode.INVALID_VALUE
        if not self.sampled or self.step:
            return AbortCode.DEVICE_STATE
        offset = (value - self.units()) % self.total_range
        self.objects[0x6509] = offset if 2 * offset < self.total_range else offset - self.total_range
        return None

    def reset(self) -> None:
        self.objects = dict(self.saved)
        self.place, self.step, self.sampled = self.place % 8, 0, False


class Pair:
    """The module and its model, side by side."""

    def __init__(self, cycles_per_revolution: int) -> None:
        config = ModuleConfig(node_id=32, cycles_per_revolution=cycles_per_revolution, autostart=True)
        self.module, self.now = FeedbackModule(config, MemoryStore()), 0.0
        self.module.start(self.now)
        self.model = Model(cycles_per_revolution)

    def read(self, index: int) -> int:
        return int(self.module.dictionary.entry(index).current())

    def write(self, index: int, value: int, size: int) -> AbortCode | None:
        try:
            self.module.dictionary.entry(index).download(value.to_bytes(size, "little"))
        except SdoAbort as abort:
            return abort.code
        return None

    def sample(self, step: int) -> None:
        """The next sample, ``step`` eighths of a cycle further."""
        self.now += 1e-3
        self.module.receive(Frame(0x80, b""), self.now)
        if self.model.sampled:
            self.model.step = step
            self.model.place += step
        self.model.sampled = True
        counts = struct.pack("<hh", *EIGHTHS[self.model.place % 8])
        self.module.receive(Frame(0x190, counts), self.now)

    def set(self, index: int, value: int, size: int) -> None:
        wanted = AbortCode.VALUE_TOO_LOW if index != 0x6000 and not value else None
        if index == 0x6000 and value & ~5:
            wanted = AbortCode.INVALID_VALUE
        assert self.write(index, value, size) is wanted
        if wanted is None:
            self.model.objects[index] = value

    def preset(self, index: int, value: int, size: int) -> None:
        wanted = self.model.preset(value)
        assert self.write(index, value, size) is wanted
        if wanted is None:
            assert self.read(0x6004) == self.read(0x6008) == value
            assert self.read(0x6003) == self.read(0x6009) == value

    def save(self) -> None:
        self.module.dictionary.entry(0x1010, 3).download(b"save")
        self.model.saved = dict(self.model.objects)

    def reset(self) -> None:
        for _ in range(20):  # it stands: one that moves at a reset is lost
            self.sample(0)
        self.now += 1.0
        self.module.receive(Frame(0, b"\x81\x20"), self.now)
        self.model.reset()

    def far(self, cycles: int) -> None:
        """The machine has gone a long way, and stands."""
        self.module.chain.restart(cycles)
        self.model.place = cycles * 8 + self.model.place % 8
        self.model.sampled = False
        for _ in range(2):
            self.sample(0)

    def check(self) -> None:
        model = self.model
        assert self.read(0x6004) == self.read(0x6008) == model.position()
        assert 0 <= model.position() < model.total_range
        for index, value in model.objects.items():
            assert self.read(index) == value
        assert self.read(0x6500) == model.objects[0x6000]
        raw = model.place * 8192 // 8 % model.physical_range if model.sampled else 0
        assert self.read(0x600C) == raw
        assert self.module.dictionary.entry(0x650A, 3).current() == min(model.total_range - 1, 2**31 - 1)


MOVES = st.tuples(st.just("sample"), st.sampled_from([-1, 0, 0, 0, 1]))
NUMBERS = st.one_of(st.integers(1, 40), st.integers(0, U32), st.sampled_from([1, 2**31, 2**31 + 1, U32]))
STEPS = st.one_of(
    MOVES,
    st.tuples(st.just("set"), st.just(0x6000), st.sampled_from([0, 1, 4, 5, 5, 4, 2, 8, 0x8000]), st.just(2)),
    st.tuples(st.just("set"), st.sampled_from([0x6001, 0x6002]), NUMBERS, st.just(4)),
    st.tuples(st.just("preset"), st.just(0x6003), NUMBERS, st.just(4)),
    st.tuples(st.just("preset"), st.just(0x6009), st.one_of(NUMBERS, st.integers(0, 2**64 - 1)), st.just(8)),
    st.tuples(st.just("save")),
    st.tuples(st.just("reset")),
    st.tuples(st.just("far"), st.integers(-(2**45), 2**45)),
)
HOLD = ("sample", 0)
# A preset half a range away: both signs of the offset are the same place.
HALF = [
    ("set", 0x6001, 2, 4),
    ("set", 0x6002, 12, 4),
    ("set", 0x6000, 4, 2),
    HOLD,
    HOLD,
    ("preset", 0x6003, 6, 4),
]


@examples(150)
@given(st.sampled_from([1, 2, 3, 16, 1000, 2500]), st.lists(STEPS, max_size=40))
@example(16, [HOLD, HOLD, ("preset", 0x6003, 2**31, 4)])  # half of the largest range
@example(1, HALF)
@example(2500, [HOLD, HOLD, ("preset", 0x6009, 1, 8), ("save",), ("reset",), HOLD])
def test_any_sequence_gives_the_position_of_the_model(cycles: int, steps: list[tuple[object, ...]]) -> None:
    pair = Pair(cycles)
    pair.check()
    for name, *arguments in steps:
        getattr(pair, str(name))(*arguments)
        pair.check()


@given(st.integers(1, 2**32), st.integers(-(2**70), 2**70), st.data())
def test_the_offset_is_an_integer32_and_exact_in_any_range(
    total_range: int, units: int, data: st.DataObject
) -> None:
    value = data.draw(st.integers(0, total_range - 1))
    offset = PositionScale(1, 1, total_range, False, 0).offset_for(units, value)
    assert -(2**31) <= offset < 2**31
    assert (units + offset) % total_range == value


@given(st.integers(1, 1048576))
def test_resolution_and_revolutions_fit_32_bits(cycles: int) -> None:
    resolution = single_turn_resolution(cycles)
    revolutions = distinguishable_revolutions(resolution)
    assert resolution % cycles == 0
    assert 1 <= revolutions <= 0xFFFF
    assert resolution <= U32
    assert resolution * revolutions < 2**32
    if revolutions < 0xFFFF:  # else it is the object that is full
        assert resolution * (revolutions + 1) >= 2**32


@given(
    st.integers(-(2**45), 2**45),
    st.floats(0, 1, exclude_max=True),
    st.integers(1, 1048576),
    st.integers(0, 32),
    st.booleans(),
)
def test_the_short_way_gives_the_units_of_the_long_one(
    cycles: int, phase: float, per_revolution: int, bits: int, reverse: bool
) -> None:
    units_per_revolution = per_revolution << bits
    scale = PositionScale(per_revolution, units_per_revolution, U32, reverse, 0)
    assert scale.binary == (0 if reverse else 1 << bits)
    if scale.binary:
        assert cycles * scale.binary + int(phase * scale.binary_factor) == scale.units(cycles, phase)
    assert PositionScale(per_revolution, units_per_revolution * 3, U32, False, 0).binary == 0


FACTORS = st.integers(0, U32)
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
    st.tuples(FACTORS, FACTORS, FACTORS, FACTORS),
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


def test_the_defaults_are_per_minute_and_revolutions_per_square_second() -> None:
    bench = Bench(cycles_per_revolution=100)
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
