"""Producers of the SYNC, steady or with jitter; and the time of the machine, true or one interval a SYNC."""

from __future__ import annotations

import itertools
import math
import statistics
import struct
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.cia301.frame import Frame
from canfb.configuration import parse_config
from canfb.hosting.simulating import fed_module
from canfb.interface.encoder_interface import EncoderInterface
from canfb.interface.sample_instants import SampleClock
from canfb.simulation.embedded_bus import EmbeddedBus
from canfb.simulation.encoder import Encoder, ShaftEncoder
from canfb.simulation.motion import Motion, MotionSource, Ramp
from canfb.simulation.set_up import SlowMotion, simulated_axis, sync_rate
from canfb.simulation.sync_producer import (
    AGAIN_S,
    POSITION_PDO,
    Drive,
    SyncDeviation,
    SyncProducer,
    SyncTiming,
    WatchedSyncProducer,
)
from folding import each

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
    deviation = SyncDeviation(timing, PERIOD_S)
    off = [1e6 * deviation.next_s() for _ in range(COUNT)]
    assert low[0] - 1e-9 <= min(off) <= low[1]
    assert high[0] <= max(off) <= high[1] + 1e-9
    assert rms is None or statistics.pstdev(off) == pytest.approx(rms, rel=0.05)
    assert sum(one > 0 for one in off) / COUNT == pytest.approx(late, abs=0.03)


@given(st.floats(0, 1e6), st.floats(0, 1e6), st.floats(1e-5, 1.0), st.integers(0, 1000))
def test_syncs_keep_their_order_whatever_the_jitter(
    jitter: float, rms: float, period_s: float, seed: int
) -> None:
    timing = SyncTiming(sync_jitter_us=jitter, sync_jitter_rms_us=rms, bus_load=1.0)
    deviation = SyncDeviation(timing, period_s, seed)
    times = [n * period_s + deviation.next_s() for n in range(50)]
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


@pytest.mark.parametrize(
    ("asked", "held", "seconds", "times"),
    [
        (500.0, 443.0, 40.0, 1),
        (1000.0, 970.0, 40.0, 1),
        (100.0, 50.0, AGAIN_S - 1.0, 1),
        (100.0, 50.0, AGAIN_S + 5.0, 2),
        (500.0, 1000.0, 10.0, 0),
        (100.0, 99.5, 10.0, 0),
        (0.5, 10.0, 500.0, 0),
    ],
)
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


def slow(interval_s: float = 1e-3) -> tuple[EmbeddedBus, EncoderInterface, SlowMotion, list[Frame]]:
    """An interface in slow motion, in OPERATIONAL, and the PDOs that it sends."""
    interface = EncoderInterface(NODE, turning(), autostart=True, times=True, clock=SampleClock())
    hearing = SlowMotion(interface.dictionary, interval_s)
    interface.time_base = hearing
    bus, sent = EmbeddedBus(), []
    bus.observers.append(lambda frame, now: sent.append(frame) if frame.can_id == TPDO1 else None)
    bus.attach(hearing)
    bus.attach(interface)
    return bus, interface, hearing, sent


def steps(sent: list[Frame]) -> tuple[list[float], list[int]]:
    """From sample to sample: cycles, and units of 100 ns."""
    samples = [struct.unpack("<hhI", frame.data) for frame in sent]
    phases = [math.atan2(sine, cosine) / math.tau for sine, cosine, _ in samples]
    pairs = list(itertools.pairwise(phases))
    times = [time for *_, time in samples]
    return [(b - a) % 1.0 for a, b in pairs], [b - a for a, b in itertools.pairwise(times)]


def test_in_slow_motion_each_sync_is_one_interval_however_late() -> None:
    bus, _, hearing, sent = slow()
    for at in LATE_S:
        bus.run_until(at)
        bus.send(SYNC)
    cycles, ticks = steps(sent)
    assert cycles == pytest.approx([0.1] * 6, abs=2e-3)
    assert ticks == pytest.approx([10_000] * 6, abs=1)
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
    axis = simulated_axis(config.simulation, fed_module(config.modules[0]), autostart=True)
    assert axis is not None
    interface = EncoderInterface(NODE, axis.source, autostart=True)
    hearing = SlowMotion(interface.dictionary, 0.01)
    interface.time_base = axis.plant.time_base = axis.drive.time_base = hearing
    bus = EmbeddedBus()
    for device in (hearing, axis.plant, interface, axis.drive):
        bus.attach(device)
    for at in LATE_S:
        bus.run_until(at)
        bus.send(SYNC)
    assert axis.plant.motor.time_s == pytest.approx(0.06), "the first SYNC begins"
    assert axis.plant.motor.speed_rad_s > 1.0
    assert axis.drive.interval_s == pytest.approx(0.01)


def test_the_interval_is_that_of_the_rate_or_of_the_configuration() -> None:
    config = parse_config("modules: [{node_id: 32}]\nsimulation: {pace: sync, sync_period_us: 2e4}\n")
    assert config.simulation.pace == "sync"
    assert sync_rate(config.simulation, None) == pytest.approx(50.0)
    assert sync_rate(config.simulation, 200.0) == 200.0
