"""The embedded bus with a bit rate: frames take time, wait for each other, and carry their receive time."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.cia301.frame import Frame, frame_bits
from canfb.simulation.embedded_bus import BackgroundTraffic, EmbeddedBus, Wire
from canfb.simulation.sync_producer import LONGEST_FRAME_BITS, SyncProducer
from folding import each

BIT_S = 1e-6
SYNC_BITS = frame_bits(0) - 3  # its end: the interframe space comes behind


class Sender:
    """Sends frames at given times; notes what it hears."""

    def __init__(self, *frames: tuple[float, Frame]) -> None:
        self._frames = sorted(frames, key=lambda pair: pair[0])
        self.heard: list[tuple[int, float]] = []

    def start(self, now: float) -> list[Frame]:
        return []

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        assert frame.timestamp == now
        self.heard.append((frame.can_id, now))
        return []

    def deadline(self) -> float | None:
        return self._frames[0][0] if self._frames else None

    def tick(self, now: float) -> list[Frame]:
        frames = [frame for at, frame in self._frames if at <= now]
        del self._frames[: len(frames)]
        return frames


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


def test_frames_of_one_can_id_keep_their_order_and_own_ones_are_not_heard() -> None:
    bus = EmbeddedBus(500_000)
    sender, listener, seen = Sender(), Sender(), list[bytes]()
    for participant in (sender, listener):
        bus.attach(participant)
    bus.attach(Sender(*((0.0, Frame(0x100, bytes([n]))) for n in range(5))))
    bus.observers.append(lambda frame, now: seen.append(frame.data))
    bus.run_until(0.5)
    assert seen == [bytes([n]) for n in range(5)]
    assert len(sender.heard) == len(listener.heard) == 5


def test_what_is_in_flight_at_the_end_arrives_later() -> None:
    bus, listener = EmbeddedBus(1_000_000), Sender()
    bus.attach(listener)
    bus.attach(Sender((0.0, Frame(0x80, b""))))
    bus.run_until(40e-6)
    assert listener.heard == []
    assert bus.now == 40e-6
    bus.run_until(60e-6)
    assert listener.heard == [(0x80, pytest.approx(52e-6))]


def test_a_frame_from_outside_and_its_answer_are_over_at_the_return() -> None:
    class Answering(Sender):
        def receive(self, frame: Frame, now: float) -> list[Frame]:
            return [Frame(0x581, bytes(8))] if frame.can_id == 0x601 else []

    bus, heard = EmbeddedBus(1_000_000), list[int]()
    bus.observers.append(lambda frame, now: heard.append(frame.can_id))
    bus.attach(Answering())
    bus.send(Frame(0x601, bytes(8)))
    assert heard == [0x601, 0x581]
    assert bus.now == pytest.approx(267e-6)


@given(st.lists(st.tuples(st.floats(0, 0.01), st.integers(0, 0x7FF), st.integers(0, 8)), max_size=30))
def test_the_wire_carries_one_frame_at_a_time_and_loses_none(frames: list[tuple[float, int, int]]) -> None:
    heard = heard_on(1_000_000, *((at, Frame(can_id, bytes(size))) for at, can_id, size in frames))
    assert sorted(can_id for can_id, _ in heard) == sorted(can_id for _, can_id, _ in frames)
    times = [at for _, at in heard]
    assert all(
        second - first >= (frame_bits(0) - 1e-3) * BIT_S for first, second in itertools.pairwise(times)
    )
    total = sum(frame_bits(size) for _, _, size in frames) * BIT_S
    assert not times or times[-1] <= 0.01 + total


def sync_delays(load: float, seed: int, bit_rate: int = 1_000_000) -> list[float]:
    """How late each of 2000 SYNCs is received, in bit times, its own length taken off."""
    bus, listener = EmbeddedBus(bit_rate), Sender()
    bus.attach(listener)
    bus.attach(BackgroundTraffic(load, bit_rate, seed))
    bus.attach(SyncProducer(1e-3))
    bus.run_until(2.0005)
    syncs = [at for can_id, at in listener.heard if can_id == 0x80]
    return [(at - (n + 1) * 1e-3) * bit_rate - SYNC_BITS for n, at in enumerate(syncs)]


@pytest.mark.parametrize("load", [0.1, 0.5, 0.9])
def test_a_sync_is_late_by_a_frame_at_most_and_as_often_as_the_bus_is_busy(load: float) -> None:
    delays = sync_delays(load, 3)
    assert -1e-3 < min(delays) < 1e-3
    assert 120 < max(delays) <= LONGEST_FRAME_BITS + 1e-3
    late = sum(delay > 1e-3 for delay in delays) / len(delays)
    assert load - 0.05 < late < load + 0.05


def test_the_same_seed_gives_the_same_bus_and_another_one_another() -> None:
    assert sync_delays(0.5, 3) == sync_delays(0.5, 3)
    assert sync_delays(0.5, 3) != sync_delays(0.5, 4)


def test_the_load_is_what_was_asked_for() -> None:
    bus = EmbeddedBus(250_000)
    bus.attach(BackgroundTraffic(0.4, 250_000))
    bus.run_until(20.0)
    assert bus.bits / 250_000 / 20.0 == pytest.approx(0.4, rel=0.05)


def test_no_traffic_is_none() -> None:
    traffic = BackgroundTraffic(0.0, 1_000_000)
    traffic.start(0.0)
    assert (traffic.deadline(), traffic.tick(5.0)) == (None, [])


@each(
    "build, name",
    [
        *((partial(Wire, rate), "bit_rate") for rate in (9_999, 1_000_001, 0, -5)),
        *((partial(BackgroundTraffic, load, 1_000_000), "load") for load in (-0.1, 0.96, float("nan"))),
    ],
)
def test_what_no_bus_has_is_refused(build: Callable[[], object], name: str) -> None:
    with pytest.raises(ValueError, match=f"{name} must be"):
        build()
