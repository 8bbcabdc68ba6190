"""Whatever comes from the bus: nothing raises, states are kept, parameters stay consistent."""

from __future__ import annotations

from pathlib import Path

import pytest
from device_kit import ID, Bench
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from canfb.cia301 import cob
from canfb.cia301.frame import Frame
from canfb.cia301.nmt import NmtState
from canfb.device.od.dictionary import Dictionary
from canfb.device.pdo.mapping import COMMUNICATION, LONGEST_BITS, MAPPING, Direction, numbers, resolve
from drawing import examples

SERVER = 0x600 + ID
ERROR_CONTROL = 0x700 + ID
LSS_RESPONSE = 0x7E4
INDICES = [0x1000, 0x1001, 0x1003, 0x1005, 0x1006, 0x1007, 0x1008, 0x1014, 0x1015, 0x1016, 0x1017]
INDICES += [0x1019, 0x1029, 0x1200, 0x1201, 0x1400, 0x1401, 0x1600, 0x1601, 0x1800, 0x1801, 0x1A00]
INDICES += [0x100C, 0x100D, 0x1012, 0x1021, 0x1022, 0x1F80]
INDICES += [0x1A01, 0x2000, 0x2010, 0x2011, 0x2020, 0x2021, 0x6004]
VALUES = [0, 1, 2, 8, 100, 240, 254, 255, 0x80, 0x40000080, 0x190, 0x80000190, 0x400001A0, 0xC00001A0]
VALUES += [0x2A0, 0x800002A0, 0x680, 0x6C0, 0x00470010, 0x20000110, 0x20000210, 0x20100120, 0x20110110]
VALUES += [0x10010008, 0x00050008, 0xFFFFFFFF]

any_data = st.binary(max_size=9)
any_frame = st.builds(Frame, st.integers(0, 0x7FF), any_data, st.booleans())


@st.composite
def sdo_requests(draw: st.DrawFn) -> Frame:
    command = draw(st.sampled_from([0x40, 0x2F, 0x2B, 0x23, 0x22, 0x21, 0x20, 0xA0, 0xA4, 0xC2, 0xC6, 0xC0]))
    index, subindex = draw(st.sampled_from(INDICES)), draw(st.integers(0, 9))
    value = draw(st.sampled_from(VALUES) | st.integers(0, 0xFFFFFFFF))
    data = bytes([command, index & 0xFF, index >> 8, subindex]) + value.to_bytes(4, "little")
    return Frame(SERVER, data)


@st.composite
def sdo_segments(draw: st.DrawFn) -> Frame:
    command = draw(st.sampled_from([0x00, 0x10, 0x0D, 0x1D, 0x60, 0x70, 0x80, 0xA1, 0xA2, 0xA3]))
    command = draw(st.sampled_from([command, 0xC1, 0xD5, 0x01, 0x02, 0x81, 0x82, 0x83]))
    return Frame(SERVER, bytes([command]) + draw(st.binary(min_size=7, max_size=7)))


known = st.sampled_from([0x000, 0x080, 0x100, 0x720, 0x190, 0x200, 0x320, 0x680, 0x747, SERVER])
frames = st.one_of(
    sdo_requests(),
    sdo_requests(),
    sdo_segments(),
    st.builds(
        lambda command, node_id: Frame(0, bytes([command, node_id])),
        st.sampled_from([1, 1, 1, 2, 128, 128, 129, 130, 3]),
        st.sampled_from([0, ID, ID + 1]),
    ),
    st.builds(Frame, known, any_data, st.booleans() | st.just(False)),
    any_frame,
)
steps = st.tuples(frames, st.sampled_from([0.0, 0.0, 0.0001, 0.001, 0.01, 0.3, 2.0]))


def check_pdos(dictionary: Dictionary) -> None:
    """COB-IDs, types and mappings are possible ones."""
    for direction in Direction:
        for number in numbers(dictionary, direction):
            communication = COMMUNICATION[direction] + number - 1
            mapping = MAPPING[direction] + number - 1
            cob_id = dictionary.entry(communication, 1).value
            kind = dictionary.entry(communication, 2).value
            assert kind <= 240 or kind >= 252
            assert not cob_id & 0x3FFFF800
            assert not (cob.is_valid(cob_id) and cob.is_restricted(cob_id & cob.CAN_ID))
            count = dictionary.entry(mapping, 0).value
            mapped = [dictionary.entry(mapping, sub).value for sub in range(1, count + 1)]
            assert sum(resolve(dictionary, value, direction).bits for value in mapped) <= LONGEST_BITS


def check_sent(before: NmtState, after: NmtState, sent: list[Frame]) -> None:
    for frame in sent:
        assert 0 < frame.can_id <= 0x7FF
        assert len(frame.data) <= 8
        assert not frame.rtr
    quiet = {NmtState.INITIALISING, NmtState.STOPPED}
    if before in quiet and after in quiet:
        assert {frame.can_id for frame in sent} <= {ERROR_CONTROL, LSS_RESPONSE}


def play(bench: Bench, script: list[tuple[Frame, float]]) -> None:
    node = bench.node
    outputs = [entry for entry in bench.dictionary if entry.index in (0x2010, 0x2011)]

    def rpdo_received(number: int, now: float) -> None:
        outputs[1].value = 1
        node.trigger_tpdo(1, now)

    bench.application.react(rpdo_received=rpdo_received)
    for frame, pause in script:
        before = node.state
        sent = node.receive(frame, bench.now)
        check_sent(before, node.state, sent)
        bench.now += pause
        before = node.state
        sent = node.tick(bench.now)
        check_sent(before, node.state, sent)
        due = node.deadline()
        assert due is None or due > bench.now
        check_pdos(bench.dictionary)
        for entry in bench.dictionary:
            if entry.on_read is None:
                entry.encode()


@pytest.mark.parametrize("started", [False, True])
@examples(150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(script=st.lists(steps, max_size=40))
def test_the_sample_device(sample_path: Path, started: bool, script: list[tuple[Frame, float]]) -> None:
    bench = Bench(Dictionary.load(sample_path, ID))
    if started:
        bench.start()
    play(bench, script)


@examples(50)
@given(data=st.lists(st.binary(min_size=8, max_size=8), max_size=60))
def test_a_hostile_sdo_client_does_not_spoil_the_next_one(sample_path: Path, data: list[bytes]) -> None:
    bench = Bench(Dictionary.load(sample_path, ID))
    bench.start()
    for request in data:
        bench.send(SERVER, request)
    bench.send(SERVER, "8000000000000000")
    assert bench.read(0x1000) == 0x40191
