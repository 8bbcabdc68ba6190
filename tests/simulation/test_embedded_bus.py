"""The bus inside the process: order and time; with a bit rate, frames take time and wait for each other."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.cia301.frame import Frame, frame_bits
from canfb.simulation.embedded_bus import BackgroundTraffic, EmbeddedBus
from canfb.simulation.sync_producer import LONGEST_FRAME_BITS, SyncProducer
from fake_bus import FakeClock, FakeDevice
from folding import each
from played import Sender


def station(bus: EmbeddedBus, **options: Any) -> FakeDevice:
    """A device on the bus."""
    clock: Any = bus
    made = FakeDevice(clock, **options)
    bus.attach(made)
    return made


def test_everybody_hears_everything_but_himself_in_the_order_of_sending() -> None:
    bus = EmbeddedBus()
    stations = [station(bus, boot=(Frame(can_id, b""),)) for can_id in (0x701, 0x702, 0x703)]
    # The third is attached last: both others hear its first frame, nobody else was there before.
    assert [one.heard_ids() for one in stations] == [[0x702, 0x703], [0x703], []]
    bus.send(Frame(0x123, b"\x01"))
    assert [one.heard[-1] for one in stations] == [(0.0, Frame(0x123, b"\x01"))] * 3


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


def test_frames_bits_and_taps_count_every_frame_once() -> None:
    bus = EmbeddedBus()
    heard: list[tuple[Frame, float]] = []
    bus.observers.append(lambda frame, now: heard.append((frame, now)))
    for _ in range(3):
        station(bus, boot=(Frame(0x700, b"\0"),))
    frames = [Frame(0x181, bytes(n)) for n in range(9)]
    bus.run_until(1.5)
    for frame in frames:
        bus.send(frame)
    assert bus.frames == len(heard) == 3 + 9
    assert bus.bits == 3 * frame_bits(1) + sum(frame_bits(n) for n in range(9))
    assert heard[3:] == [(frame, 1.5) for frame in frames]


# The length of a frame, bit by bit (ISO 11898-1): header, data, CRC, with stuff bits; then the rest.


def crc15(bits: list[int]) -> list[int]:
    register = 0
    for bit in bits:
        feedback = bit ^ (register >> 14)
        register = register << 1 & 0x7FFF
        if feedback:
            register ^= 0x4599
    return [register >> n & 1 for n in reversed(range(15))]


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


def wire_bits(can_id: int, data: bytes) -> int:
    """Bits of a data frame, start bit to interframe space."""
    header = [0, *(can_id >> n & 1 for n in reversed(range(11))), 0, 0, 0]
    header += [len(data) >> n & 1 for n in reversed(range(4))]
    bits = header + [byte >> n & 1 for byte in data for n in reversed(range(8))]
    return stuffed(bits + crc15(bits)) + 1 + 2 + 7 + 3  # CRC delimiter, ACK, end of frame, interframe space


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_no_frame_is_longer_than_it_is_counted(can_id: int, data: bytes) -> None:
    assert 47 + 8 * len(data) <= wire_bits(can_id, data) <= frame_bits(len(data))


@each("size", range(9))
def test_the_most_stuff_bits_are_counted_and_no_more(size: int) -> None:
    """The worst there can be: five bits alike, then always four of one kind after each stuff bit."""
    assert (frame_bits(0), frame_bits(8)) == (55, 135), "as the books have it"
    worst = [0] * 5
    while len(worst) < 34 + 8 * size:
        worst += [1 - worst[-1]] * 4
    assert stuffed(worst[: 34 + 8 * size]) + 13 == frame_bits(size)
    assert frame_bits(size) >= max(wire_bits(can_id, bytes(size)) for can_id in (0, 0x3C, 0x7FF))


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


def test_a_frame_from_outside_and_its_answer_are_over_at_the_return() -> None:
    bus, heard = EmbeddedBus(1_000_000), list[int]()
    bus.observers.append(lambda frame, now: heard.append(frame.can_id))
    station(bus, answer=lambda frame: [Frame(0x581, bytes(8))] if frame.can_id == 0x601 else [])
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


def test_no_traffic_is_none() -> None:
    traffic = BackgroundTraffic(0.0, 1_000_000)
    traffic.start(0.0)
    assert (traffic.deadline(), traffic.tick(5.0)) == (None, [])
