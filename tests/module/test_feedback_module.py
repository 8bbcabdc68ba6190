import math
import struct

import pytest
from canopen import SdoAbortedError
from hypothesis import given, strategies as st
from module_bench import Bench

from canfb import FeedbackModule, Frame, ModuleConfig, StatusBit
from canfb.module.cia406.position import PHASE_UNITS, PositionScale
from drawing import examples


def test_after_a_pause_no_position_is_valid_before_a_sample_came(bench: Bench) -> None:
    """A synchronous TPDO would send the old one, for ever where the encoder interface has gone."""
    bench.sdo[0x1800][1].raw = 0x800001A0
    bench.sdo[0x1800][2].raw = 1
    bench.sdo[0x1800][1].raw = 0x400001A0
    bench.sync()
    bench.counts(0, 1500)
    assert bench.position(bench.sync())[1] == StatusBit.VALID
    bench.start("PRE-OPERATIONAL")
    for _ in range(3):
        assert bench.position(bench.sync())[1] == 0
    for _ in range(4):  # it may have begun to move
        bench.counts(0, 1500)
        assert bench.position(bench.sync())[1] == StatusBit.COASTING
    bench.counts(0, 1500)
    assert bench.position(bench.sync())[1] == StatusBit.VALID


@pytest.mark.parametrize(("index", "sub", "value"), [
    (0x2001, 1, 0), (0x2001, 1, 1048577), (0x2001, 2, 0), (0x2001, 3, 2560), (0x2001, 4, 410),
    (0x2001, 5, -1.0), (0x2001, 5, 1e10),
    (0x2002, 1, math.inf), (0x2002, 3, 0.0), (0x2002, 5, 2.0), (0x2002, 6, 0.02), (0x2002, 7, -0.02),
    (0x2002, 8, 2), (0x2002, 9, 251), (0x2002, 10, 501), (0x2002, 11, 251), (0x2002, 12, 10001),
    (0x2010, 1, 0), (0x2010, 1, 32769), (0x2010, 2, -1.0), (0x2010, 2, math.nan), (0x2013, 1, 3),
    (0x2014, 1, 0), (0x2014, 2, 0), (0x2014, 3, 2), (0x2014, 4, -0.1), (0x2014, 4, 0.3), (0x2014, 5, 2),
    (0x2014, 4, math.nan), (0x2030, 1, 0), (0x2030, 1, 6), (0x2030, 1, 255), (0x2030, 10, 199),
    (0x2030, 10, 200_001), (0x2050, 1, 0), (0x2050, 1, 3), (0x2050, 1, 255),
    (0x6000, 0, 0x80), (0x6001, 0, 0), (0x6003, 0, 0xFFFFFFFF),
])  # fmt: skip
def test_bad_values_are_refused_and_change_nothing(bench: Bench, index: int, sub: int, value: float) -> None:
    bench.at(0.0)
    variable = bench.sdo[index][sub] if sub else bench.sdo[index]
    before = variable.raw
    with pytest.raises(SdoAbortedError) as error:
        variable.raw = value
    assert error.value.code in (0x06090030, 0x06090031, 0x06090032)
    assert variable.raw == before
    assert bench.at(0.0)[1] == StatusBit.VALID


@examples(50)
@given(st.data())
def test_no_frame_ever_raises_and_what_is_published_is_well_formed(data: st.DataObject) -> None:
    module = FeedbackModule(ModuleConfig(node_id=32, autostart=True))
    module.start(0.0)
    now = 0.0
    ids = st.one_of(st.sampled_from([0, 0x80, 0x190, 0x620, 0x720]), st.integers(0, 0x7FF))
    for _ in range(30):
        now += data.draw(st.floats(0, 0.1))
        frame = Frame(data.draw(ids), data.draw(st.binary(max_size=9)), data.draw(st.booleans()))
        for out in [*module.receive(frame, now), *module.tick(now)]:
            assert 0 <= out.can_id <= 0x7FF
            assert len(out.data) <= 8


def test_a_sample_in_two_pdos_is_complete_with_the_second(bench: Bench) -> None:
    bench.map_rpdo2(0x20000310, 0x20000410, 0x20000608, 0x20000710)
    for _ in range(30):
        bench.sync()
        assert bench.counts(0, 1500) == []
        bench.sdo[0x1803][2].raw = 254  # another PDO: the part that came is kept
        frames = bench.sent(Frame(0x290, struct.pack("<hhBH", 0, 1500, 0, 0)))
        _, status, _ = bench.position(frames)
    assert status == StatusBit.VALID
    frames = bench.sent(Frame(0x290, struct.pack("<hhBH", 0, 1500, 0, 0)))
    assert frames == []
    bench.sync()
    bench.counts(0, 1500)
    _, status, _ = bench.position(bench.sent(Frame(0x290, struct.pack("<hhBH", 1500, 0, 0, 0))))
    assert status & StatusBit.COARSE
    assert bench.sdo[0x2012][11].raw == 1


def test_they_can_be_mapped_into_a_pdo(bench: Bench) -> None:
    parameters, mapping = bench.sdo[0x1802], bench.sdo[0x1A02]
    parameters[2].raw = 1
    mapping[0].raw = 0
    for place, value in enumerate((0x20110510, 0x20110720, 0x65050010), start=1):
        mapping[place].raw = value
    mapping[0].raw = 3
    parameters[1].raw = 0x3A0
    assert [bench.sdo[0x2011][sub].raw for sub in (5, 7, 8)] == [0, 0.0, 0], "before the first sample"
    bench.follow(0.25, 0, 12, amplitude=440)
    (data,) = [frame.data for frame in bench.sync() if frame.can_id == 0x3A0]
    amplitude, velocity, warnings = struct.unpack("<HfH", data)
    assert (amplitude, warnings) == (440, 2)
    assert velocity == pytest.approx(2 * math.pi * 0.25 / 2500 / bench.interval_s, rel=1e-3)


def test_a_velocity_beyond_real32_is_the_largest_one(bench: Bench) -> None:
    bench.interval_s = 1e-300
    bench.bus.now = 0.0
    bench.follow(0.25, 0, 4)
    assert bench.sdo[0x2011][7].raw == pytest.approx(3.4e38, rel=1e-3)


def test_a_residual_limit_that_follows_the_acceleration_follows_the_encoder_too(bench: Bench) -> None:
    bench.sdo[0x2010][2].raw = 100.0  # 0.04 cycle at 2500 cycles and 1 kHz, 16 cycles at a million
    bench.at(0.0, samples=10)  # until the period is known
    assert bench.at(0.2)[1] & StatusBit.RESIDUAL
    bench.at(0.0, samples=6)
    bench.sdo[0x2001][1].raw = 1_000_000
    assert bench.at(0.2)[1] == StatusBit.VALID


@given(
    st.integers(1, 1048576), st.integers(1, 2**32 - 1), st.booleans(),
    st.integers(-(2**62), 2**62), st.integers(0, PHASE_UNITS - 1),
)  # fmt: skip
def test_the_scaling_is_exact(per_turn: int, units: int, reverse: bool, cycles: int, phase: int) -> None:
    scale = PositionScale(per_turn, units, 2**32, reverse, 0)
    exact = (cycles * PHASE_UNITS + phase) * (-units if reverse else units)
    assert scale.units(cycles, phase / PHASE_UNITS) == exact // (per_turn * PHASE_UNITS)
