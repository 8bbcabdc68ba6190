"""The encoder interface on the bus: its PDOs for each SYNC in OPERATIONAL, none otherwise; what they hold."""

import itertools
import math
import struct
from typing import Any

import pytest
from hypothesis import given, strategies as st

from canfb import Frame, Sample
from canfb.interface.encoder_interface import EncoderInterface, SampleClock
from canfb.simulation.encoder import Encoder, Motion, MotionSource, ShaftEncoder
from canfb.sources.protocol import Source
from drawing import examples
from folding import each
from ideal_tracks import counts_at
from played import Listed, repeated

NODE, TPDO1 = 16, 0x190
SYNC = Frame(0x80, b"")
START, STOP, PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION = 1, 2, 128, 129, 130


def nmt(command: int, node: int = NODE) -> Frame:
    return Frame(0, bytes([command, node]))


def adc(sine: int, cosine: int) -> Frame:
    return Frame(TPDO1, struct.pack("<hh", sine, cosine))


def download(index: int, subindex: int, value: int, size: int = 4) -> Frame:
    head = bytes([0x23 | (4 - size) << 2, index & 0xFF, index >> 8, subindex])
    return Frame(0x600 + NODE, head + value.to_bytes(size, "little").ljust(4, b"\0"))


def operational(source: Source, **words: Any) -> EncoderInterface:
    interface = EncoderInterface(NODE, source, autostart=True, **words)
    interface.start(0.0)
    return interface


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
    assert interface.start(0.0) == [Frame(0x700 + NODE, b"\0")]
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


def test_a_sample_that_is_lost_silences_its_pdo_alone() -> None:
    interface = operational(Listed([None]))
    assert interface.receive(SYNC, 0.0) == []
    (answer,) = interface.receive(Frame(0x600 + NODE, bytes([0x40, 0, 0x10, 0, 0, 0, 0, 0])), 0.0)
    assert answer == Frame(0x580 + NODE, bytes([0x43, 0, 0x10, 0, 0x91, 0x01, 0x04, 0x00]))


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
        assert struct.unpack("<hh", frame.data) == counts_at(cycles, 1000.0)
    several = operational(source, samples_per_sync=2)
    for now in (6.0, 6.001, 6.002, 7.0):  # no samples far apart, nor one of long ago
        several.receive(SYNC, now)
    assert source.position_cycles == pytest.approx(100.0 * (7.0 - 5.0 - 0.001 / 16))


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


def test_a_source_that_fails_is_one_emcy_until_it_has_worked_for_a_second() -> None:
    broken = OSError(5, "Input/output error")
    told: list[str] = []
    interface = operational(Listed([*[broken] * 3, (1, 2), (1, 2), *[broken] * 2]))
    interface.on_source = told.append
    emcy = Frame(0x80 + NODE, struct.pack("<HB5x", 0x5000, 1))
    assert [interface.receive(SYNC, 0.01 * n) for n in range(3)] == [[emcy], [], []]
    assert interface.receive(SYNC, 0.5) == [adc(1, 2)]
    assert interface.receive(SYNC, 1.5) == [Frame(0x80 + NODE, bytes(8)), adc(1, 2)]
    assert told == ["the source fails: [Errno 5] Input/output error", "the source works again"]
    assert (interface.samples, interface.missed) == (2, 3)
    assert interface.receive(SYNC, 1.6) == [emcy]
    interface.receive(nmt(RESET_COMMUNICATION), 1.7)
    assert interface.receive(SYNC, 1.8) == [emcy], "a failure that persists, after a reset"


FULL = Sample(1, -2, coarse_sine=3, coarse_cosine=-4, zero_pulse=0.25)


@each(
    "times, sample, data",
    [
        (False, FULL, struct.pack("<hh", 1, -2)),
        (True, FULL, struct.pack("<hhI", 1, -2, 5_001_000)),
        (True, FULL._replace(time_100ns=2**32 + 77), struct.pack("<hhI", 1, -2, 77)),
    ],
)
def test_tpdo1_is_both_tracks_with_times_the_sample_time_and_nothing_else_goes_out(
    times: bool, sample: Sample, data: bytes
) -> None:
    interface = operational(Listed([sample]), times=times, clock=SampleClock(0.0, 1000))
    assert interface.receive(SYNC, 0.5) == [Frame(0x190, data)]


def test_the_sample_time_is_that_of_the_reception_by_the_clock_of_the_bus() -> None:
    """Whenever the program comes round to the SYNC; a stamp of some other clock is not used."""
    interface = operational(repeated(FULL), times=True)
    stamps = [
        struct.unpack_from("<I", interface.receive(SYNC._replace(timestamp=stamp), now)[0].data, 4)[0]
        for stamp, now in ((1.9995, 2.0), (None, 2.0), (2.1, 2.0), (1.7e9, 2.0), (-20.0, 2.0), (2.5, 20.0))
    ]
    assert stamps == [19_995_000, 20_000_000, 20_000_000, 20_000_000, 20_000_000, 25_000_000]


def test_tpdo2_holds_coarse_track_flags_and_zero_pulse() -> None:
    """It is switched on as a master does it, by its COB-ID alone."""
    samples = FULL, None, Sample(1, -2, invalid=True), FULL._replace(zero_pulse=1.0)
    interface = operational(Listed(samples))
    (answer,) = interface.receive(download(0x1801, 1, 0x40000280 + NODE), 0.0)
    assert answer.data[0] == 0x60
    sent = [interface.receive(SYNC, 0.001 * n) for n in range(4)]
    assert [[frame.can_id for frame in frames] for frames in sent] == [
        [0x190, 0x290],
        [],
        *[[0x190, 0x290]] * 2,
    ]
    fields = [struct.unpack("<hhBH", frames[1].data) for frames in sent if frames]
    assert fields[0] == (3, -4, 1, 16384)
    assert fields[1][2] == 2, "no pulse in this one, and the interface itself calls it bad"
    assert fields[2] == (3, -4, 1, 65535)


WRAP = 1 << 32
drifts = st.floats(-10_000, 10_000)
starts = st.integers(-(1 << 40), 1 << 40)
moments = st.floats(0, 1e7)  # of a monotonic clock: four months
gaps = st.floats(0, 420)  # less than a turn of the clock


@given(drifts, starts, moments, gaps)
def test_ticks_pass_as_time_does_whatever_it_shows(
    drift_ppm: float, start: int, now: float, step_s: float
) -> None:
    clock = SampleClock(drift_ppm, start)
    first, second = clock.ticks(now), clock.ticks(now + step_s)
    assert 0 <= first < WRAP
    passed = (second - first) % WRAP
    # A tick at either end, and what a float of such a time cannot hold.
    assert passed == pytest.approx(step_s * 1e7 * (1 + drift_ppm * 1e-6), abs=1.1 + 4 * math.ulp(now) * 1e7)


@given(starts)
def test_it_wraps_after_429_seconds(start: int) -> None:
    clock = SampleClock(0.0, start)
    turn_s = WRAP * 1e-7
    assert clock.ticks(0.0) == start % WRAP
    assert clock.ticks(turn_s + 1e-9) == start % WRAP
    assert clock.ticks(turn_s - 5e-8) == (start - 1) % WRAP


@each("drift_ppm", [10_001, -10_001, math.nan, math.inf])
def test_a_drift_that_no_clock_has_is_refused(drift_ppm: float) -> None:
    with pytest.raises(ValueError, match="drift_ppm must be a number"):
        SampleClock(drift_ppm)
