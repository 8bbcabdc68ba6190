"""6000h to 600Ch, 6030h, 6040h and 6509h, cams and the work area: against models in plain integers."""

import struct
from dataclasses import dataclass, field
from fractions import Fraction

import pytest
from canopen import SdoAbortedError
from hypothesis import example, given, strategies as st
from module_bench import Bench

from canfb import FeedbackModule, Frame, ModuleConfig, eds_path
from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.device.od.dictionary import Dictionary
from canfb.device.storage.storage import MemoryStore
from canfb.module.cia406.cams import OUT_OF_RANGE, OVERFLOW, UNDERFLOW, Cam, limit_position, work_area_state
from canfb.module.cia406.position import (
    STILL,
    PositionScale,
    distinguishable_revolutions,
    saturated,
    show_motion,
    single_turn_resolution,
)
from canfb.module.interval import SamplingInterval
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
        self.module.receive(Frame(0x190, struct.pack("<hh", *EIGHTHS[self.model.place % 8])), self.now)

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
        assert self.read(0x6501) == model.resolution
        assert self.read(0x6502) * model.resolution == model.physical_range
        raw = model.place * 8192 // 8 % model.physical_range if model.sampled else 0
        assert self.read(0x600C) == raw
        assert self.module.dictionary.entry(0x650A, 3).current() == min(model.total_range - 1, 2**31 - 1)


NUMBERS = st.one_of(st.integers(1, 40), st.integers(0, U32), st.sampled_from([1, 2**31, 2**31 + 1, U32]))
STEPS = st.one_of(
    st.tuples(st.just("sample"), st.sampled_from([-1, 0, 0, 0, 1])),
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
    offset = PositionScale(1, 1, total_range, False, 0).offset_for(units, 0.0, value)
    assert -(2**31) <= offset < 2**31
    assert (units + offset) % total_range == value


@given(st.integers(1, 1048576))
def test_resolution_and_revolutions_fit_32_bits(cycles: int) -> None:
    resolution = single_turn_resolution(cycles)
    revolutions = distinguishable_revolutions(resolution)
    assert resolution == cycles << next(bits for bits in range(13, 0, -1) if cycles << bits <= U32)
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
        nearest = max(-0x8000, min(round(exact), 0x7FFF))
        assert abs(given_value - nearest) <= 1, index  # a float may round the other way
        if abs(exact) > 32768:
            assert given_value == (0x7FFF if exact > 0 else -0x8000)


@pytest.mark.parametrize(("value", "object_value"), [
    (32767.4, 32767), (32767.6, 32767), (1e300, 32767), (float("inf"), 32767), (-32768.4, -32768),
    (-1e300, -32768), (float("-inf"), -32768), (float("nan"), 0), (-0.4, 0), (1.6, 2),
    (1.4, 1), (-1.6, -2), (40000.0, 32767), (-1e99, -32768),
])  # fmt: skip
def test_saturation(value: float, object_value: int) -> None:
    assert saturated(value) == object_value


def test_the_defaults_are_per_minute_and_revolutions_per_square_second() -> None:
    bench = Bench(cycles_per_revolution=100)
    bench.start()
    bench.sdo[0x1006].raw = 1100  # the measured interval takes precedence
    bench.follow(0.25, 0, 40)
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
    with pytest.raises(SdoAbortedError, match="0x06070012"):
        bench.remote.sdo.download(0x6200, 0, b"\1\0\0\0")


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
    """1000 units per cycle, range 10 cycles; at half a cycle."""
    bench.sdo[0x6001].raw, bench.sdo[0x6002].raw = 2_500_000, 10_000
    bench.sdo[0x6000].raw = 4
    bench.place = 0.5
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
