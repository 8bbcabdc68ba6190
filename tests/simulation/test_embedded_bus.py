"""The bus inside the process, the producers of its SYNC, and the time of a machine in slow motion."""

import itertools
import math
import statistics
import struct
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, strategies as st

from canfb.cia301.frame import Frame, frame_bits
from canfb.configuration import parse_config
from canfb.interface.encoder_interface import EncoderInterface, SampleClock
from canfb.simulation.embedded_bus import (
    AGAIN_S,
    LONGEST_FRAME_BITS,
    POSITION_PDO,
    BackgroundTraffic,
    Drive,
    EmbeddedBus,
    SyncProducer,
    SyncTiming,
    WatchedSyncProducer,
)
from canfb.simulation.encoder import Encoder, Motion, MotionSource, Ramp, ShaftEncoder
from canfb.simulation.set_up import SlowMotion, simulated_axis, sync_rate
from fake_bus import FakeClock, FakeDevice
from folding import each
from played import Sender


def station(bus: EmbeddedBus, **options: Any) -> FakeDevice:
    clock: Any = bus
    made = FakeDevice(clock, **options)
    bus.attach(made)
    return made


def test_answers_come_after_what_was_already_sent() -> None:
    """A queue, not a recursion: both answers to the first frame go before the answer to an answer."""
    order: list[int] = []
    bus = EmbeddedBus()
    answers = {0x100: [Frame(0x101, b""), Frame(0x102, b"")]}
    first = station(bus, answer=lambda frame: answers.get(frame.can_id, []))
    station(bus, answer=lambda frame: [Frame(0x200, b"")] if frame.can_id == 0x101 else [])
    bus.observers.append(lambda frame, now: order.append(frame.can_id))
    bus.send(Frame(0x100, b""))
    assert order == [0x100, 0x101, 0x102, 0x200]
    assert first.heard_ids() == [0x100, 0x200]


def test_time_goes_from_deadline_to_deadline() -> None:
    sent: list[tuple[float, int]] = []
    bus = EmbeddedBus()
    slow, fast = station(bus, period_s=0.25, tick_id=0x201), station(bus, period_s=0.125, tick_id=0x202)
    bus.observers.append(lambda frame, now: sent.append((now, frame.can_id)))
    bus.run_until(0.6)
    assert bus.now == 0.6
    assert sent == [
        (0.125, 0x202), (0.25, 0x201), (0.25, 0x202), (0.375, 0x202), (0.5, 0x201), (0.5, 0x202)
    ]  # fmt: skip
    assert {*slow.ticked, *fast.ticked} == {0.0}, "neither early nor late"
    bus.run_until(0.5)
    assert bus.now == 0.6, "time does not go back"


def test_bits_and_taps_count_every_frame_once() -> None:
    bus = EmbeddedBus()
    heard: list[tuple[Frame, float]] = []
    bus.observers.append(lambda frame, now: heard.append((frame, now)))
    for _ in range(3):
        station(bus, boot=(Frame(0x700, b"\0"),))
    frames = [Frame(0x181, bytes(n)) for n in range(9)]
    bus.run_until(1.5)
    for frame in frames:
        bus.send(frame)
    assert len(heard) == 3 + 9
    assert bus.bits == 3 * frame_bits(1) + sum(frame_bits(n) for n in range(9))
    assert heard[3:] == [(frame, 1.5) for frame in frames]


def stuffed(bits: list[int]) -> int:
    """Number of bits after stuffing: five alike are followed by their opposite, which counts as well."""
    length, run, last = 0, 0, -1
    for bit in bits:
        run = run + 1 if bit == last else 1
        last = bit
        length += 1
        if run == 5:
            length += 1
            run, last = 1, 1 - bit
    return length


@each("size", range(9))
def test_the_most_stuff_bits_are_counted_and_no_more(size: int) -> None:
    """The worst there can be: five bits alike, then always four of one kind after each stuff bit."""
    assert (frame_bits(0), frame_bits(8)) == (55, 135), "as the books have it"
    worst = [0] * 5
    while len(worst) < 34 + 8 * size:
        worst += [1 - worst[-1]] * 4
    # Start bit to CRC, then CRC delimiter, ACK, end of frame, interframe space (ISO 11898-1).
    assert stuffed(worst[: 34 + 8 * size]) + 1 + 2 + 7 + 3 == frame_bits(size)


class Computer(FakeDevice):
    """A participant that wants something computed when it hears a frame, and tells what came out."""

    job: Callable[[], int] | None = None

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        self.job = lambda: frame.can_id + 1
        return [Frame(0x200, b"")]

    def pending_job(self) -> Callable[[], int] | None:
        return self.job

    def finish_job(self, job: Callable[[], int], result: int, now: float) -> list[Frame]:
        assert job is self.job
        self.job = None
        return [Frame(result, b"")]

    def job_progress(self, job: Callable[[], int], part: float) -> None:
        raise AssertionError("it is computed at once")


def test_what_a_participant_wants_computed_is_computed_after_the_frames_of_this_instant() -> None:
    bus, heard = EmbeddedBus(), list[int]()
    computer = Computer(FakeClock())
    bus.attach(computer)
    bus.observers.append(lambda frame, now: heard.append(frame.can_id))
    bus.send(Frame(0x100, b""))
    assert heard == [0x100, 0x200, 0x101]
    bus.computes = False
    bus.send(Frame(0x110, b""))
    assert heard[3:] == [0x110, 0x200]
    assert computer.job is not None, "it waits until somebody computes it"


BIT_S = 1e-6
SYNC_BITS = frame_bits(0) - 3  # its end: the interframe space comes behind


def heard_on(bit_rate: int, *frames: tuple[float, Frame]) -> list[tuple[int, float]]:
    bus, listener = EmbeddedBus(bit_rate), Sender()
    bus.attach(listener)
    bus.attach(Sender(*frames))
    bus.run_until(1.0)
    return listener.heard


@each("bit_rate", [1_000_000, 125_000])
@each("size", [0, 4, 8])
def test_a_frame_is_received_at_its_end(size: int, bit_rate: int) -> None:
    ((can_id, at),) = heard_on(bit_rate, (0.5, Frame(0x181, bytes(size))))
    assert can_id == 0x181
    assert at == pytest.approx(0.5 + (frame_bits(size) - 3) / bit_rate)


def test_a_sync_waits_for_the_frame_on_the_wire_and_goes_before_all_others() -> None:
    frames = [(0.1, Frame(0x700, bytes(8))), *((0.10001, Frame(0x200 + n, bytes(8))) for n in range(3))]
    heard = heard_on(1_000_000, *frames, (0.1001, Frame(0x80, b"")))
    assert [can_id for can_id, _ in heard] == [0x700, 0x80, 0x200, 0x201, 0x202]
    assert heard[1][1] == pytest.approx(0.1 + (135 + SYNC_BITS) * BIT_S)


def test_a_frame_from_outside_and_its_answer_are_over_at_the_return() -> None:
    bus, heard = EmbeddedBus(1_000_000), list[int]()
    bus.observers.append(lambda frame, now: heard.append(frame.can_id))
    station(bus, answer=lambda frame: [Frame(0x581, bytes(8))] if frame.can_id == 0x601 else [])
    bus.send(Frame(0x601, bytes(8)))
    assert heard == [0x601, 0x581]
    assert bus.now == pytest.approx(267e-6)


@given(st.lists(st.tuples(st.floats(0, 1e-3), st.integers(0x100, 0x103), st.integers(0, 8)), max_size=30))
def test_the_wire_carries_one_frame_at_a_time_and_those_of_one_can_id_in_order(
    frames: list[tuple[float, int, int]],
) -> None:
    bus, listener, order = EmbeddedBus(1_000_000), Sender(), dict[int, list[bytes]]()
    sent = [(at, Frame(can_id, bytes([n] * size))) for n, (at, can_id, size) in enumerate(frames)]
    sender = Sender(*sent)
    bus.attach(listener)
    bus.attach(sender)
    bus.observers.append(lambda frame, now: order.setdefault(frame.can_id, []).append(frame.data))
    bus.run_until(1.0)
    assert sender.heard == []
    assert len(listener.heard) == len(frames)
    for can_id, data in order.items():
        mine = [(at, frame.data) for at, frame in sent if frame.can_id == can_id]
        assert data == [one for _, one in sorted(mine, key=lambda pair: pair[0])]
    times = [at for _, at in listener.heard]
    assert all(
        second - first >= (frame_bits(0) - 1e-3) * BIT_S for first, second in itertools.pairwise(times)
    )
    total = sum(frame_bits(size) for _, _, size in frames) * BIT_S
    assert not times or times[-1] <= 1e-3 + total


@pytest.mark.parametrize("load", [0.1, 0.5, 0.9])
def test_a_sync_is_late_by_a_frame_at_most_and_as_often_as_the_bus_is_busy(load: float) -> None:
    """Of 2000 SYNCs, in bit times, their own length taken off."""
    bit_rate = 1_000_000
    bus, listener = EmbeddedBus(bit_rate), Sender()
    for participant in (listener, BackgroundTraffic(load, bit_rate, seed=3), SyncProducer(1e-3)):
        bus.attach(participant)
    bus.run_until(2.0005)
    syncs = [at for can_id, at in listener.heard if can_id == 0x80]
    delays = [(at - (n + 1) * 1e-3) * bit_rate - SYNC_BITS for n, at in enumerate(syncs)]
    assert -1e-3 < min(delays) < 1e-3
    assert 120 < max(delays) <= LONGEST_FRAME_BITS + 1e-3
    late = sum(delay > 1e-3 for delay in delays) / len(delays)
    assert load - 0.05 < late < load + 0.05


def test_no_traffic_is_none() -> None:
    traffic = BackgroundTraffic(0.0, 1_000_000)
    traffic.start(0.0)
    assert (traffic.deadline(), traffic.tick(5.0)) == (None, [])


SYNC = Frame(0x80, b"")
COB_ID = 0x1A0
PERIOD_S = 1e-3
COUNT = 4000


@given(st.floats(1e-5, 10), st.floats(0, 1e4), st.lists(st.floats(0, 100) | st.none(), max_size=50))
def test_one_sync_at_a_time_in_an_unbroken_rhythm(
    period: float, start: float, waits: list[float | None]
) -> None:
    """The first comes one period after power-on; what is overdue is left out. None: it is served on time."""
    producer = SyncProducer(period)
    assert producer.deadline() is None
    assert producer.tick(start) == producer.start(start) == producer.receive(Frame(0x123, b""), start) == []
    due, now = producer.deadline(), start
    for wait in waits:
        assert due is not None
        assert now < due <= now + period * (1 + 1e-6) + 1e-9
        assert (due - start) / period == pytest.approx(round((due - start) / period), abs=1e-3)
        now = due if wait is None else now + wait * period
        assert producer.tick(now) == ([SYNC] if now >= due else [])
        assert producer.tick(now) == []
        due = producer.deadline()


# least and most (µs), standard deviation, part of the SYNCs that are late
@each(
    "timing, low, high, rms, late",
    [
        (SyncTiming(), (0.0, 0.0), (0.0, 0.0), 0.0, 0.0),
        (SyncTiming(sync_jitter_us=100.0), (-100.0, -99.0), (99.0, 100.0), 100.0 / math.sqrt(3), 0.5),
        (SyncTiming(sync_jitter_rms_us=50.0), (-200.0, -130.0), (130.0, 200.0), 50.0, 0.5),
        (SyncTiming(bus_load=0.3), (0.0, 0.0), (132.0, 135.0), None, 0.3),
        (SyncTiming(bus_load=0.7, bus_bit_rate=250_000), (0.0, 0.0), (441.0, 450.0), None, 0.7),
    ],
)
def test_a_deviation_fills_its_range_and_keeps_to_it(
    timing: SyncTiming, low: tuple[float, float], high: tuple[float, float], rms: float | None, late: float
) -> None:
    producer = SyncProducer(PERIOD_S, timing)
    off = [1e6 * producer.deviation_s() for _ in range(COUNT)]
    assert low[0] - 1e-9 <= min(off) <= low[1]
    assert high[0] <= max(off) <= high[1] + 1e-9
    assert rms is None or statistics.pstdev(off) == pytest.approx(rms, rel=0.05)
    assert sum(one > 0 for one in off) / COUNT == pytest.approx(late, abs=0.03)


@given(st.floats(0, 1e6), st.floats(0, 1e6), st.floats(1e-5, 1.0), st.integers(0, 1000))
def test_syncs_keep_their_order_whatever_the_jitter(
    jitter: float, rms: float, period_s: float, seed: int
) -> None:
    timing = SyncTiming(sync_jitter_us=jitter, sync_jitter_rms_us=rms, bus_load=1.0)
    producer = SyncProducer(period_s, timing, seed)
    times = [n * period_s + producer.deviation_s() for n in range(50)]
    assert times == sorted(times)


def times_of(producer: SyncProducer) -> list[float]:
    times = list[float]()
    while (at := producer.deadline() or 0.0) < 2.0:
        assert producer.tick(at) == [SYNC]
        times.append(at)
    return times


def producer_times(timing: SyncTiming, seed: int = 1) -> list[float]:
    producer = SyncProducer(PERIOD_S, timing, seed)
    producer.start(0.0)
    return times_of(producer)


def drive_times(timing: SyncTiming, seed: int = 1) -> list[float]:
    drive = Drive(PERIOD_S, COB_ID, 1000, timing, seed)
    assert (drive.start(0.0), drive.deadline(), drive.tick(5.0)) == ([], None, []), "not before it is asked"
    drive.start_sync(0.0)
    times = times_of(drive)
    assert drive.syncs == len(times)
    return times


@each("times", [producer_times, drive_times])
def test_jitter_does_not_add_up_and_drift_does(times: Callable[..., list[float]]) -> None:
    assert all(at == round(at / PERIOD_S) * PERIOD_S for at in times(SyncTiming()))
    steady = times(SyncTiming(sync_jitter_us=100.0))
    assert abs(len(steady) - 2000) <= 1
    first = round(steady[0] / PERIOD_S)
    assert all(abs(at - (first + n) * PERIOD_S) <= 100.001e-6 for n, at in enumerate(steady))
    assert steady == times(SyncTiming(sync_jitter_us=100.0)) != times(SyncTiming(sync_jitter_us=100.0), 6)
    fast = times(SyncTiming(sync_drift_ppm=1000.0))
    assert fast[-1] - fast[0] == pytest.approx((len(fast) - 1) * PERIOD_S / 1.001, rel=1e-9)
    assert len(fast) - len(steady) in (1, 2, 3)


def pdo(position: int, status: int = 1, residual: int = 0) -> Frame:
    return Frame(COB_ID, POSITION_PDO.pack(position, status, residual))


def test_a_position_pdo_is_taken_apart_and_no_other_frame() -> None:
    drive = Drive(0.001, COB_ID, 1 << 32)
    drive.start_sync(0.0)
    drive.tick(0.0)
    for frame in (Frame(COB_ID + 1, bytes(8)), Frame(COB_ID, bytes(7)), Frame(COB_ID, b""), SYNC):
        assert drive.receive(frame, 0.0) == []
    assert drive.receive(pdo(123456, 0x0081, 32768), 0.0) == []
    consumed = drive.consumed
    assert (consumed.sync_number, consumed.position_units) == ([1], [123456])
    assert (consumed.status, consumed.residual_cycles) == ([0x0081], [0.5])


@given(st.integers(3, 2**32), st.data())
def test_positions_are_unwrapped_as_long_as_each_step_is_below_half_the_range(
    total_range: int, data: st.DataObject
) -> None:
    largest = (total_range - 1) // 2
    truth = [data.draw(st.integers(0, total_range - 1))]
    for step in data.draw(st.lists(st.integers(-largest, largest), max_size=50)):
        truth.append(truth[-1] + step)
    drive = Drive(0.001, COB_ID, total_range)
    for position in truth:
        drive.receive(pdo(position % total_range), 0.0)
    assert drive.consumed.position_units == truth


class Watched:
    """The producer of ``asked_hz`` in a program that serves it ``held_hz`` times a second."""

    def __init__(self, asked_hz: float) -> None:
        self.lines: list[str] = []
        self.now = 100.0
        self.producer = WatchedSyncProducer(1.0 / asked_hz, self.lines.append)
        assert self.producer.start(self.now) == []

    def run(self, seconds: float, held_hz: float, *others: Frame) -> None:
        end_s = self.now + seconds
        while self.now < end_s:
            self.now = max(self.now + 1.0 / held_hz, self.producer.deadline() or 0.0)
            for frame in others:
                assert self.producer.receive(frame, self.now) == []
            assert self.producer.tick(self.now) == [SYNC]


@each("asked, held, seconds, times", [
    (500.0, 443.0, 40.0, 1),
    (1000.0, 970.0, 40.0, 1),
    (100.0, 50.0, AGAIN_S - 1.0, 1),
    (100.0, 50.0, AGAIN_S + 5.0, 2),
    (500.0, 1000.0, 10.0, 0),
    (100.0, 99.5, 10.0, 0),
    (0.5, 10.0, 500.0, 0),
])  # fmt: skip
def test_a_rate_that_is_not_reached_is_said_once_a_minute(
    asked: float, held: float, seconds: float, times: int
) -> None:
    watched = Watched(asked)
    watched.run(seconds, held)
    assert len(watched.lines) == times
    for line in watched.lines:
        assert line.startswith("SYNC: ")
        assert line.endswith(f" Hz reached, {asked:g} Hz requested: this computer does not keep up"
                             "; set a lower --rate, or --pace sync")  # fmt: skip


@each("foreign", [True, False])
def test_the_sync_of_another_node_is_named_and_not_taken_for_a_slow_computer(foreign: bool) -> None:
    watched = Watched(100.0)
    watched.run(10.0, 1000.0, Frame(0x181, b""), Frame(0x80, b"", rtr=True), *[SYNC] * foreign)
    said = "SYNC: another node sends it too, 100 Hz beside the 100 Hz sent here; end one of the two"
    assert watched.lines == [said] * foreign


def test_while_the_bus_is_gone_nothing_is_said_and_then_a_new_window_begins() -> None:
    watched = Watched(100.0)
    watched.run(1.0, 1000.0)
    assert watched.producer.bus_off(watched.now) == []
    watched.run(20.0, 5.0, SYNC)
    assert watched.producer.bus_back(watched.now) == []
    watched.run(10.0, 1000.0)
    assert watched.lines == []
    watched.run(10.0, 50.0)
    assert len(watched.lines) == 1


NODE, TPDO1 = 16, 0x190
LATE_S = (0.01, 0.0101, 0.5, 0.5001, 3.0, 60.0, 60.01)  # when the SYNCs come


def turning() -> MotionSource:
    return MotionSource(ShaftEncoder(Encoder(noise_lsb=0.0), 100), Motion((Ramp(0.0, 60.0),)), 1e-3)


def slow() -> tuple[EmbeddedBus, EncoderInterface, SlowMotion, list[Frame]]:
    """An interface in slow motion, in OPERATIONAL, and the PDOs that it sends."""
    interface = EncoderInterface(NODE, turning(), autostart=True, times=True, clock=SampleClock())
    hearing = SlowMotion(interface.dictionary, 1e-3)
    interface.time_base = hearing
    bus, sent = EmbeddedBus(), []
    bus.observers.append(lambda frame, now: sent.append(frame) if frame.can_id == TPDO1 else None)
    bus.attach(hearing)
    bus.attach(interface)
    return bus, interface, hearing, sent


def test_in_slow_motion_each_sync_is_one_interval_however_late() -> None:
    bus, _, hearing, sent = slow()
    for at in LATE_S:
        bus.run_until(at)
        bus.send(SYNC)
    times = [struct.unpack("<hhI", frame.data)[2] for frame in sent]
    assert times == pytest.approx([times[0] + 10_000 * n for n in range(7)], abs=1), "in units of 100 ns"
    assert hearing.time_s == pytest.approx(7e-3)


def test_1006h_and_1005h_of_the_interface_count() -> None:
    bus, interface, hearing, _ = slow()
    interface.dictionary.entry(0x1006).value = 2500
    bus.send(SYNC)
    assert hearing.time_s == pytest.approx(2.5e-3)
    bus.send(Frame(0x80, b"", rtr=True))
    bus.send(Frame(0x85, b""))
    assert hearing.time_s == pytest.approx(2.5e-3)
    interface.dictionary.entry(0x1005).value = 0x85
    bus.send(Frame(0x85, b""))
    assert hearing.time_s == pytest.approx(5e-3)


def test_the_fast_recording_goes_on_with_the_syncs() -> None:
    bus, interface, _, _ = slow()
    interface.dictionary.entry(0x2050, 4).value = 50_000
    bus.send(SYNC)
    bus.send(Frame(0x600 + NODE, bytes.fromhex("2F50200101000000")))
    bus.run_until(10.0)
    assert interface.recorder.count == 1
    for _ in range(10):
        bus.send(SYNC)
    bus.send(Frame(0x600 + NODE, bytes.fromhex("4050200200000000")))
    assert interface.recorder.count == 501


def test_the_plant_turns_one_interval_with_each_sync() -> None:
    config = parse_config("modules: [{node_id: 32}]\nsimulation: {drive: {load_torque_nm: -0.1}}\n")
    axis = simulated_axis(config.simulation, config.modules[0], autostart=True)
    assert axis is not None
    drive, source = axis
    interface = EncoderInterface(NODE, source, autostart=True)
    hearing = SlowMotion(interface.dictionary, 0.01)
    interface.time_base = drive.plant.time_base = drive.time_base = hearing
    bus = EmbeddedBus()
    for device in (hearing, drive.plant, interface, drive):
        bus.attach(device)
    for at in LATE_S:
        bus.run_until(at)
        bus.send(SYNC)
    assert drive.plant.motor.time_s == pytest.approx(0.06), "the first SYNC begins"
    assert drive.plant.motor.speed_rad_s > 1.0
    assert drive.interval_s == pytest.approx(0.01)


def test_the_interval_is_that_of_the_rate_or_of_the_configuration() -> None:
    config = parse_config("modules: [{node_id: 32}]\nsimulation: {pace: sync, sync_period_us: 2e4}\n")
    assert config.simulation.pace == "sync"
    assert sync_rate(config.simulation, None) == pytest.approx(50.0)
    assert sync_rate(config.simulation, 200.0) == 200.0
