"""Producers of the SYNC: steady or with jitter, never in bursts; one watches its rate."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.cia301.frame import Frame
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


@each(
    "build, name",
    [
        *(
            (lambda period=period: SyncProducer(period), "period_s")
            for period in (0.0, -1.0, math.nan, math.inf)
        ),
        (lambda: SyncTiming(sync_jitter_us=-1.0), "sync_jitter_us"),
        (lambda: SyncTiming(sync_jitter_rms_us=math.nan), "sync_jitter_rms_us"),
        (lambda: SyncTiming(sync_drift_ppm=10_001), "sync_drift_ppm"),
        (lambda: SyncTiming(bus_load=1.1), "bus_load"),
        (lambda: SyncTiming(bus_bit_rate=9_999), "bus_bit_rate"),
    ],
)
def test_what_cannot_be_is_refused_by_its_name(build: Callable[[], object], name: str) -> None:
    with pytest.raises(ValueError, match=name):
        build()


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
