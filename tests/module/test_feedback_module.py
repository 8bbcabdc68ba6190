from __future__ import annotations

import math
import struct

import pytest
from canopen import SdoAbortedError
from hypothesis import given
from hypothesis import strategies as st
from module_bench import Bench

from canfb.cia301.frame import Frame
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.objects import StatusBit
from canfb.signal.speeds import STILL_SAMPLES
from drawing import examples


def test_the_counts_are_in_the_dictionary_and_every_stage_of_them(bench: Bench) -> None:
    for n in range(9):
        bench.at(n * 0.25)
    sdo = bench.sdo
    assert (sdo[0x2000][1].raw, sdo[0x2000][2].raw) == (0, 1500)
    assert sdo[0x2011][4].raw == 2
    assert sdo[0x2011][3].raw == 0
    assert sdo[0x2011][5].raw == 1500
    assert sdo[0x2011][6].raw == 0
    assert sdo[0x2011][8].raw == 9
    assert sdo[0x2011][7].raw == pytest.approx(0.25 * 2 * 3.14159265 / 2500 * 1000, rel=1e-3)
    assert sdo[0x6004].raw == 2 * 8192
    assert sdo[0x6008].raw == 2 * 8192
    assert bench.module.feedback is not None
    assert bench.module.feedback.valid


def test_an_interface_that_falls_silent_loses_the_position_once(bench: Bench) -> None:
    for n in range(3):
        bench.at(n * 0.1)
    bench.sync()
    statuses = []
    for _ in range(10):
        statuses += [struct.unpack("<IHH", frame.data)[1] for frame in bench.sync() if frame.can_id == 0x1A0]
    assert [bool(status & StatusBit.LOST) for status in statuses] == [False, False, False, True]
    assert bench.emergencies() == [0x7300, 0x7300], "not valid, then lost"
    assert bench.sdo[0x2012][5].raw == 1
    assert bench.sdo[0x6503].raw == 1
    assert bench.sdo[0x1001].raw == 0x21
    bench.at(0.3)
    assert not bench.at(0.3)[1] & StatusBit.VALID
    bench.remote.nmt.state = "PRE-OPERATIONAL"
    bench.start()
    assert {bench.at(0.3)[1] for _ in range(2 * STILL_SAMPLES)} == {StatusBit.LOST}, "it turned"
    bench.remote.nmt.state = "RESET"
    bench.start()
    assert bench.at(0.3)[1] == StatusBit.VALID
    assert bench.emergencies() == [0x7300, 0x7300]
    assert bench.sdo[0x6503].raw == 0


def test_after_a_pause_no_position_is_valid_before_a_sample_came(bench: Bench) -> None:
    """A synchronous TPDO would send the old one, for ever where the encoder interface has gone."""
    bench.sdo[0x1800][1].raw = 0x800001A0
    bench.sdo[0x1800][2].raw = 1
    bench.sdo[0x1800][1].raw = 0x400001A0
    bench.sync()
    bench.counts(0, 1500)
    assert bench.position(bench.sync())[1] == StatusBit.VALID
    bench.remote.nmt.state = "PRE-OPERATIONAL"
    bench.start()
    for _ in range(3):
        assert bench.position(bench.sync())[1] == 0
    for _ in range(4):  # it may have begun to move
        bench.counts(0, 1500)
        assert bench.position(bench.sync())[1] == StatusBit.COASTING
    bench.counts(0, 1500)
    assert bench.position(bench.sync())[1] == StatusBit.VALID


@pytest.mark.parametrize(("index", "sub", "value"), [
    (0x2001, 1, 0), (0x2001, 1, 1048577), (0x2001, 2, 0), (0x2001, 3, 60000), (0x2001, 4, 0),
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


@examples(300)
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


def test_the_sample_may_come_in_any_rpdo(bench: Bench) -> None:
    sdo = bench.sdo
    sdo[0x1400][1].raw = 0x80000190
    bench.map_rpdo2(0x20000210, 0x20000110)
    bench.sync()
    assert bench.counts(0, 1500) == []
    sample = Frame(0x290, struct.pack("<hh", 0, 1500))
    assert bench.position(bench.sent(sample))[:2] == (2048, StatusBit.VALID)


def test_an_rpdo_without_both_tracks_is_no_sample(bench: Bench) -> None:
    sdo = bench.sdo
    sdo[0x1400][1].raw = 0x80000190
    sdo[0x1600][0].raw = 0
    sdo[0x1600][0].raw = 1
    sdo[0x1400][1].raw = 0x190
    bench.sync()
    too_long = bytes([0x20, 0x82, 0x11, 1, 4, 2, 0, 0])
    assert bench.counts(0, 1500) == [Frame(0xA0, too_long)]
    assert sdo[0x2011][8].raw == 0


def test_a_sample_in_two_pdos_is_complete_with_the_second(bench: Bench) -> None:
    bench.map_rpdo2(0x20000310, 0x20000410, 0x20000608, 0x20000710)
    for _ in range(30):
        bench.sync()
        assert bench.counts(0, 1500) == []
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
