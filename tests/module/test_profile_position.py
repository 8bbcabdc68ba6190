"""Objects 6000h to 600Ch and 6509h against a model in plain integers, whatever happens in which order."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

from hypothesis import example, given
from hypothesis import strategies as st

from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.cia301.frame import Frame
from canfb.device.storage.storage import MemoryStore
from canfb.module.cia406.position import PositionScale, distinguishable_revolutions, single_turn_resolution
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
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
STILL = ("sample", 0)
# A preset half a range away: both signs of the offset are the same place.
HALF = [
    ("set", 0x6001, 2, 4),
    ("set", 0x6002, 12, 4),
    ("set", 0x6000, 4, 2),
    STILL,
    STILL,
    ("preset", 0x6003, 6, 4),
]


@examples(150)
@given(st.sampled_from([1, 2, 3, 16, 1000, 2500]), st.lists(STEPS, max_size=40))
@example(16, [STILL, STILL, ("preset", 0x6003, 2**31, 4)])  # half of the largest range
@example(1, HALF)
@example(2500, [STILL, STILL, ("preset", 0x6009, 1, 8), ("save",), ("reset",), STILL])
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
