"""The bus inside the process: order, time and what goes over it."""

from __future__ import annotations

from collections.abc import Callable

from hypothesis import given
from hypothesis import strategies as st

from canfb.cia301.frame import Frame, frame_bits
from canfb.simulation.embedded_bus import EmbeddedBus
from folding import each


class Station:
    """Notes what it hears; answers and ticks as it is told."""

    def __init__(
        self,
        name: str,
        journal: list[tuple[float, str, int]],
        period_s: float | None = None,
        answer: Callable[[Frame], list[Frame]] = lambda frame: [],
        first_id: int = 0x700,
    ) -> None:
        self.name, self.journal, self.period_s, self.answer = name, journal, period_s, answer
        self.next_s: float | None = None
        self.first_id = first_id

    def start(self, now: float) -> list[Frame]:
        self.next_s = None if self.period_s is None else now + self.period_s
        return [Frame(self.first_id, self.name.encode())]

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        self.journal.append((now, self.name, frame.can_id))
        return self.answer(frame)

    def tick(self, now: float) -> list[Frame]:
        assert self.next_s is not None
        assert now == self.next_s, "neither early nor late"
        assert self.period_s is not None
        self.next_s += self.period_s
        return [Frame(0x80, b"")]

    def deadline(self) -> float | None:
        return self.next_s


Journal = list[tuple[float, str, int]]


def test_everybody_hears_everything_but_himself_in_the_order_of_sending() -> None:
    journal: Journal = []
    bus = EmbeddedBus()
    for name in "abc":
        bus.attach(Station(name, journal, first_id=0x700 + ord(name)))
    # c is attached last: a and b hear its first frame, nobody else was there before.
    assert journal == [
        (0.0, "a", 0x700 + ord("b")),
        (0.0, "a", 0x700 + ord("c")),
        (0.0, "b", 0x700 + ord("c")),
    ]
    journal.clear()
    bus.send(Frame(0x123, b"\x01"))
    assert journal == [(0.0, name, 0x123) for name in "abc"]


def test_answers_come_after_what_was_already_sent() -> None:
    """A queue, not a recursion: both answers to the first frame go before the answer to an answer."""
    journal: Journal = []
    order: list[int] = []
    bus = EmbeddedBus()
    answers = {0x100: [Frame(0x101, b""), Frame(0x102, b"")], 0x101: [], 0x102: []}
    bus.attach(Station("a", journal, answer=lambda frame: answers.get(frame.can_id, [])))
    bus.attach(
        Station("b", journal, answer=lambda frame: [Frame(0x200, b"")] if frame.can_id == 0x101 else [])
    )
    bus.observers.append(lambda frame, now: order.append(frame.can_id))
    bus.send(Frame(0x100, b""))
    assert order == [0x100, 0x101, 0x102, 0x200]
    assert [can_id for _, name, can_id in journal if name == "a"][-2:] == [0x100, 0x200]


def test_time_goes_from_deadline_to_deadline() -> None:
    journal: Journal = []
    bus = EmbeddedBus()
    bus.attach(Station("slow", journal, period_s=0.25))
    bus.attach(Station("fast", journal, period_s=0.125))
    journal.clear()
    bus.run_until(0.6)
    assert bus.now == 0.6
    assert [(time, name) for time, name, _ in journal] == [
        (0.125, "slow"),
        (0.25, "fast"),
        (0.25, "slow"),
        (0.375, "slow"),
        (0.5, "fast"),
        (0.5, "slow"),
    ]
    bus.run_until(0.5)
    assert bus.now == 0.6, "time does not go back"


def test_a_deadline_at_the_end_is_met_and_one_after_it_is_not() -> None:
    journal: Journal = []
    bus = EmbeddedBus()
    bus.attach(Station("a", journal, period_s=0.5))
    bus.attach(Station("b", journal))
    journal.clear()
    for end in (0.5, 0.999):
        bus.run_until(end)
        assert journal == [(0.5, "b", 0x80)]


def test_frames_bits_and_taps_count_every_frame_once() -> None:
    bus = EmbeddedBus()
    heard: list[tuple[Frame, float]] = []
    bus.observers.append(lambda frame, now: heard.append((frame, now)))
    for name in "abc":
        bus.attach(Station(name, [], first_id=0x700))
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


def test_the_oracle_itself() -> None:
    header = [0, *(0x14 >> n & 1 for n in reversed(range(11))), 0, 0, 0, 0, 0, 0, 1]
    bits = [*header, 0, 0, 0, 0, 0, 0, 0, 1]
    assert crc15([*bits, *crc15(bits)]) == [0] * 15, "a frame with its CRC leaves no rest"
    assert stuffed([0, 0, 0, 0, 0, 1, 1, 1, 1, 1]) == 12
    assert stuffed([0, 1] * 10) == 20


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


class Computer:
    """A participant that wants something computed when it hears a frame, and tells what came out."""

    def __init__(self) -> None:
        self.job: Callable[[], int] | None = None

    def start(self, now: float) -> list[Frame]:
        return []

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        self.job = lambda: frame.can_id + 1
        return [Frame(0x200, b"")]

    def tick(self, now: float) -> list[Frame]:
        return []

    def deadline(self) -> float | None:
        return None

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
    computer = Computer()
    bus.attach(computer)
    bus.observers.append(lambda frame, now: heard.append(frame.can_id))
    bus.send(Frame(0x100, b""))
    assert heard == [0x100, 0x200, 0x101]
    bus.computes = False
    bus.send(Frame(0x110, b""))
    assert heard[3:] == [0x110, 0x200]
    assert computer.job is not None, "it waits until somebody computes it"
