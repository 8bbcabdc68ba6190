"""The encoder interface on the bus: one TPDO1 for each SYNC in OPERATIONAL, and none otherwise."""

from __future__ import annotations

import itertools
import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.cia301.frame import Frame
from canfb.interface.encoder_interface import EncoderInterface
from canfb.signal.sample import Sample
from canfb.simulation.encoder import Encoder, ShaftEncoder
from canfb.simulation.motion import Motion, MotionSource
from drawing import examples
from folding import each
from played import Listed

NODE, TPDO1 = 16, 0x190
SYNC = Frame(0x80, b"")
START, STOP, PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION = 1, 2, 128, 129, 130


Counts = tuple[int, int]


def nmt(command: int, node: int = NODE) -> Frame:
    return Frame(0, bytes([command, node]))


def adc(sine: int, cosine: int) -> Frame:
    return Frame(TPDO1, struct.pack("<hh", sine, cosine))


def download(index: int, subindex: int, value: int, size: int = 4) -> Frame:
    head = bytes([0x23 | (4 - size) << 2, index & 0xFF, index >> 8, subindex])
    return Frame(0x600 + NODE, head + value.to_bytes(size, "little").ljust(4, b"\0"))


def operational(source: Listed | MotionSource) -> EncoderInterface:
    interface = EncoderInterface(NODE, source)
    interface.start(0.0)
    interface.receive(nmt(START), 0.0)
    return interface


def test_it_boots_up_and_waits_for_a_master() -> None:
    source = Listed((n, -n) for n in itertools.count(1))
    interface = EncoderInterface(NODE, source)
    assert interface.start(0.0) == [Frame(0x700 + NODE, b"\0")]
    assert interface.receive(SYNC, 0.0) == []
    assert source.taken == 0


@each("counts", [(5, -6), (0, 0), (2047, -2048), (-32768, 32767)])
def test_with_autostart_it_samples_at_once_and_the_pdo_holds_sine_and_cosine(counts: Counts) -> None:
    interface = EncoderInterface(NODE, Listed([counts]), autostart=True)
    interface.start(0.0)
    assert interface.receive(SYNC, 0.0) == [adc(*counts)]


# NMT commands and what they lead to; every other frame leaves the state alone.
STATES = {START: True, STOP: False, PRE_OPERATIONAL: False, RESET_NODE: False, RESET_COMMUNICATION: False}
steps = st.one_of(
    st.just(SYNC),
    st.sampled_from(list(STATES)).map(nmt),
    st.sampled_from(list(STATES)).map(lambda command: nmt(command, 0)),
    st.sampled_from(list(STATES)).map(lambda command: nmt(command, NODE + 1)),
    st.builds(Frame, st.integers(0x81, 0x5FF), st.binary(max_size=8)),
)


@examples(60)
@given(st.lists(steps, max_size=40))
def test_exactly_one_pdo_for_each_sync_in_operational_and_none_otherwise(frames: list[Frame]) -> None:
    source = Listed((n, -n) for n in itertools.count(1))
    interface = EncoderInterface(NODE, source)
    interface.start(0.0)
    running = False
    for frame in frames:
        taken = source.taken
        sent = [one for one in interface.receive(frame, 0.0) if one.can_id == TPDO1]
        if frame == SYNC and running:
            assert sent == [adc(taken + 1, -taken - 1)]
        else:
            assert sent == []
            assert source.taken == taken
        if frame.can_id == 0 and frame.data[1] in (NODE, 0):
            running = STATES[frame.data[0]]
    assert interface.samples == source.taken


def test_a_sample_that_is_lost_sends_nothing_and_the_next_one_is_whole() -> None:
    interface = operational(Listed([(1, 2), None, None, (3, 4)]))
    sent = [interface.receive(SYNC, 0.0) for _ in range(4)]
    assert sent == [[adc(1, 2)], [], [], [adc(3, 4)]]
    assert interface.samples == 2
    interface = operational(Listed([None]))
    assert interface.receive(SYNC, 0.0) == []
    (answer,) = interface.receive(Frame(0x600 + NODE, bytes([0x40, 0, 0x10, 0, 0, 0, 0, 0])), 0.0)
    assert answer == Frame(0x580 + NODE, bytes([0x43, 0, 0x10, 0, 0x91, 0x01, 0x04, 0x00])), (
        "no other silence"
    )


def test_the_end_of_a_recording_is_told_by_the_sync_after_it_and_is_silent() -> None:
    source = Listed([(1, 2)])
    interface = operational(source)
    interface.receive(SYNC, 0.0)
    assert not interface.ended
    assert [interface.receive(SYNC, 0.0) for _ in range(3)] == [[], [], []]
    assert interface.ended
    assert interface.samples == 1
    assert source.taken == 2, "a source that has ended is left alone"


def test_as_its_own_sync_producer_it_is_silent_where_a_sample_is_lost() -> None:
    interface = operational(Listed([(1, 2), None, (3, 4)]))
    interface.receive(download(0x1006, 0, 10_000), 0.0)
    interface.receive(download(0x1005, 0, 0x40000080), 0.0)
    sent = []
    for _ in range(3):
        now = interface.deadline()
        assert now is not None
        sent.append(interface.tick(now))
    assert sent == [[SYNC, adc(1, 2)], [SYNC], [SYNC, adc(3, 4)]]


def test_the_machine_is_sampled_at_the_true_time_of_each_sync() -> None:
    """Also after a pause: it has gone on turning."""
    source = MotionSource(
        ShaftEncoder(Encoder(amplitude_counts=1000.0), 100), Motion((), start_rpm=60.0), 0.001
    )
    interface = operational(source)
    for now, cycles in ((5.0, 0.0), (5.0009, 0.09), (5.0021, 0.21), (5.5, 50.0), (5.5011, 50.11)):
        (frame,) = interface.receive(SYNC._replace(timestamp=now), now + 0.0003)
        assert source.position_cycles == pytest.approx(cycles)
        angle = 2 * math.pi * cycles
        assert struct.unpack("<hh", frame.data) == (
            round(1000 * math.sin(angle)),
            round(1000 * math.cos(angle)),
        )


def test_each_sample_is_an_event_for_a_pdo_of_type_0() -> None:
    interface = operational(Listed([(1, 2), None, (3, 4)]))
    interface.receive(download(0x1800, 2, 0, size=1), 0.0)
    sent = [interface.receive(SYNC, 0.0) for _ in range(4)]
    assert sent == [[adc(1, 2)], [], [adc(3, 4)], []]


def test_an_event_driven_pdo_keeps_to_its_timer() -> None:
    interface = operational(Listed((n, -n) for n in itertools.count(1)))
    for frame in (download(0x1800, 2, 0xFE, size=1), download(0x1800, 5, 100, size=2)):
        (answer,) = interface.receive(frame, 0.0)
        assert answer.data[0] == 0x60
    assert [interface.receive(SYNC, 0.01 * n) for n in range(3)] == [[], [], []]
    assert interface.tick(0.1) == [adc(3, -3)]


def test_no_answer_to_a_remote_frame_unless_the_master_allows_it() -> None:
    """A module would take the answer for a new sample."""
    interface = operational(Listed([(5, -6), (7, 8)]))
    remote = Frame(TPDO1, b"", rtr=True)
    assert interface.receive(SYNC, 0.0) == [adc(5, -6)]
    assert interface.receive(remote, 0.0) == []
    assert interface.receive(SYNC, 0.0) == [adc(7, 8)], "the next sample is not used up"
    for cob_id in (0x80000000 | TPDO1, TPDO1):
        interface.receive(download(0x1800, 1, cob_id), 0.0)
    assert interface.receive(remote, 0.0) == [adc(7, 8)]


class Failing:
    """A source that fails as long as it is told to."""

    def __init__(self) -> None:
        self.fails = True

    def next(self) -> Sample:
        if self.fails:
            raise OSError(5, "Input/output error")
        return Sample(1, 2)


def test_a_source_that_fails_is_one_emcy_until_it_has_worked_for_a_second() -> None:
    source = Failing()
    told: list[str] = []
    interface = EncoderInterface(NODE, source, autostart=True)
    interface.on_source = told.append
    interface.start(0.0)
    emcy = Frame(0x80 + NODE, struct.pack("<HB5x", 0x5000, 1))
    assert [interface.receive(SYNC, 0.01 * n) for n in range(3)] == [[emcy], [], []]
    source.fails = False
    assert interface.receive(SYNC, 0.5) == [adc(1, 2)]
    assert interface.receive(SYNC, 1.5) == [Frame(0x80 + NODE, bytes(8)), adc(1, 2)]
    assert told == ["the source fails: [Errno 5] Input/output error", "the source works again"]
    assert (interface.samples, interface.missed) == (2, 3)


def test_a_failure_that_persists_is_reported_again_after_a_reset() -> None:
    interface = EncoderInterface(NODE, Failing(), autostart=True)
    interface.start(0.0)
    (first,) = interface.receive(SYNC, 0.0)
    interface.receive(nmt(RESET_COMMUNICATION), 0.1)
    assert interface.receive(SYNC, 0.2) == [first]


@each("counts", [(32768, 0), (0, -32769), (math.nan, 0)])
def test_counts_that_do_not_fit_are_no_sample(counts: tuple[float, float]) -> None:
    class Wrong:
        def next(self) -> Sample:
            return Sample(*counts)

    interface = EncoderInterface(NODE, Wrong(), autostart=True)
    interface.start(0.0)
    assert [frame.can_id for frame in interface.receive(SYNC, 0.0)] == [0x80 + NODE]
