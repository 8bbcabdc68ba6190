"""The SocketCAN of our own on a pair of sockets: queues, filters, and receive times on the runner's clock."""

import errno
import math
import os
import random
import socket
import struct
import time
from collections.abc import Iterator

import pytest
from hypothesis import given, strategies as st

from canfb.bus.clocks import LARGEST_STEP_S, LEARNED_FRAMES, LONGEST_DELAY_S, OtherClock, ReceiveTimes
from canfb.bus.dispatch import LONGEST_DELAY_S as LONGEST_WAIT_S, LONGEST_QUEUE
from canfb.bus.frame_bus import ERROR, EXTENDED, REMOTE
from canfb.bus.raw_can_bus import LONGEST_LATENCY_S, MOST_FILTERS, FrameReader, RawCanBus
from canfb.bus.runner import Runner
from canfb.cia301.frame import Frame
from fake_bus import CAN_FRAME, FakeClock, FakeDevice
from folding import each

PATIENCE_S = 60.0


class Wire:
    """A bus of our own, and its far end."""

    def __init__(self) -> None:
        ours, self.far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.far.setblocking(False)
        self.bus = RawCanBus(ours)

    def put(self, can_id: int, data: bytes = b"") -> None:
        self.far.send(CAN_FRAME.pack(can_id, len(data), data))

    def sent(self) -> list[tuple[int, bytes]]:
        """What has come to the far end."""
        frames: list[tuple[int, bytes]] = []
        while True:
            try:
                can_id, length, data = CAN_FRAME.unpack(self.far.recv(CAN_FRAME.size))
            except BlockingIOError:
                return frames
            frames.append((can_id, data[:length]))

    def fill(self) -> int:
        """Send until the bus takes no more; how many it took."""
        count = 0
        while self.bus.send(0x700, bytes([count % 256]), False):
            count += 1
        return count


@pytest.fixture
def wire() -> Iterator[Wire]:
    made = Wire()
    with made.bus, made.far:
        yield made


def test_frames_come_in_their_order_with_flags_and_times(wire: Wire) -> None:
    flagged = [0x081 | ERROR, 0x1FFF_FFFF | EXTENDED, 0x7FF | REMOTE, 0x7FF, 0]
    sent = [(can_id, bytes(range(length))) for length, can_id in enumerate([0x190, 0x1A0, 0x1A1, *flagged])]
    before_s = time.time()
    for can_id, data in sent:
        wire.put(can_id, data)
    frames = [frame for _ in sent if (frame := wire.bus.receive(PATIENCE_S)) is not None]
    assert [frame[:2] for frame in frames] == sent
    stamps = [before_s - 1e-3, *(frame[2] for frame in frames), time.time() + 1e-3]
    assert stamps == sorted(stamps)
    assert wire.bus.receive(0.0) is None


@pytest.mark.parametrize("wait_s", [0.0, 0.0004, 0.0042])
def test_it_waits_no_longer_than_it_was_told(wire: Wire, wait_s: float) -> None:
    """It may come back earlier, by a part of a millisecond; the runner asks again."""
    start = time.perf_counter()
    assert wire.bus.receive(wait_s) is None
    assert time.perf_counter() - start >= min(wait_s, int(wait_s * 1000) / 1000 or wait_s) - 1e-5


def test_a_full_queue_is_no_wait_and_no_error(wire: Wire) -> None:
    count = wire.fill()
    assert count >= 1
    assert not wire.bus.send(0x1A0, b"", False)
    wire.put(0x080)
    assert wire.bus.receive(0.0) is not None, "it hears meanwhile"
    assert len(wire.sent()) == count
    assert wire.bus.send(0x1A0, b"", False)


def test_room_in_the_queue_ends_a_wait(wire: Wire) -> None:
    wire.fill()
    wire.sent()
    start = time.perf_counter()
    assert wire.bus.receive(PATIENCE_S) is None
    assert time.perf_counter() - start < PATIENCE_S / 2


@pytest.mark.parametrize("code", [errno.ENOBUFS, errno.ENETDOWN, errno.ENODEV, errno.ENXIO, errno.EPERM])
def test_an_interface_that_is_full_takes_it_later_and_one_that_is_down_is_an_error(
    wire: Wire, code: int
) -> None:
    def refused(data: bytes) -> int:
        raise OSError(code, os.strerror(code))

    takes, wire.bus._send = wire.bus._send, refused  # type: ignore[assignment]
    if code == errno.ENOBUFS:
        assert not wire.bus.send(0x1A0, b"", False)
    else:
        with pytest.raises(OSError, match=os.strerror(code)) as caught:
            wire.bus.send(0x1A0, b"", False)
        assert caught.value.errno == code
    wire.bus._send = takes
    assert wire.bus.send(0x1A0, b"", False)


class Line:
    """A runner on a wire, in a time of its own."""

    def __init__(self, wire: Wire) -> None:
        self.wire, self.clock = wire, FakeClock()
        self.lines: list[str] = []
        self.device = FakeDevice(self.clock, answer=lambda frame: [Frame(0x100 + n, b"") for n in range(5)])
        self.runner = Runner(wire.bus, [self.device], self.lines.append, self.clock, self.clock.sleep)
        self.rounds = 0

    def go(self, rounds: int, step_s: float = 0.001) -> None:
        self.rounds = rounds

        def finished() -> bool:
            self.clock.now += step_s
            self.rounds -= 1
            return self.rounds < 0

        self.runner.run(finished)


def test_the_order_is_kept_over_a_full_queue(wire: Wire) -> None:
    filled = wire.fill()
    line = Line(wire)
    wire.put(0x200)
    line.go(3)
    assert line.runner.counters.sent == 0
    assert len(wire.sent()) == filled
    line.go(10)
    assert [can_id for can_id, _ in wire.sent()] == [0x100, 0x101, 0x102, 0x103, 0x104]
    assert line.runner.counters.sent == 5
    assert line.lines == []


def test_frames_that_grow_old_are_given_up_and_reported_once(wire: Wire) -> None:
    filled = wire.fill()
    line = Line(wire)
    for _ in range(3):
        wire.put(0x200)
    line.go(14, step_s=LONGEST_WAIT_S / 8)
    assert len(wire.sent()) == filled, "nothing of what is old goes out"
    assert line.runner.counters.send_failures == 15
    assert line.lines == ["a frame could not be sent: No buffer space available"]


def test_the_queue_has_an_end(wire: Wire) -> None:
    wire.fill()
    line = Line(wire)
    line.device.answer = lambda frame: [Frame(0x100, b"")] * (LONGEST_QUEUE + 7)
    wire.put(0x200)
    line.go(2, step_s=1e-6)
    assert line.runner.counters.send_failures == 7
    assert len(line.lines) == 1


def test_the_time_of_the_hardware_is_taken_where_it_is(wire: Wire) -> None:
    """As the kernel writes it: SCM_TIMESTAMPNS, then SCM_TIMESTAMPING with the third of its times.

    Once the two clocks are known, the frame has the least delay; a frame without such a time has the other.
    """
    reader = FrameReader(wire.bus._socket)

    def late_s(true_s: float, delay_s: float, hardware: bool = True) -> float:
        kernel = struct.pack("@2l", *divmod(round((true_s + delay_s) * 1e9), 10**9))
        times = struct.pack("@6l", 0, 0, 0, 0, *divmod(round((true_s - 95.0) * 1e9), 10**9))
        controls = [(socket.SOL_SOCKET, 35, kernel)] + [(socket.SOL_SOCKET, 37, times)] * hardware
        reader._receive = lambda *arguments: (CAN_FRAME.pack(0x080, 0, b""), controls, 0, None)
        received = reader.read()
        assert received is not None
        return received[2] - true_s

    delays_s = [late_s(100.0 + 0.01 * n, 250e-6 if n % 3 else 40e-6) for n in range(3 * LEARNED_FRAMES)]
    assert delays_s[1] == pytest.approx(250e-6, abs=1e-6)
    assert delays_s[LEARNED_FRAMES + 1 :] == pytest.approx([40e-6] * (2 * LEARNED_FRAMES - 1), abs=5e-6)
    assert late_s(103.0, 90e-6, hardware=False) == pytest.approx(90e-6, abs=1e-6)


class Filters:
    """A CAN socket, as far as filters go."""

    def __init__(self) -> None:
        self.set: list[bytes] = []
        self.gone = False

    def setsockopt(self, level: int, option: int, value: bytes) -> None:
        if self.gone:
            raise OSError(errno.ENODEV, "No such device")
        self.set.append(value)


@pytest.mark.skipif(not hasattr(socket, "CAN_RAW_FILTER"), reason="python was built without SocketCAN")
def test_filters_are_exact_and_set_when_they_change(wire: Wire) -> None:
    kernel = Filters()
    wire.bus._is_can = True
    keeps, wire.bus._socket = wire.bus._socket, kernel  # type: ignore[assignment]
    wire.bus.accept({0x080, 0x190}, {0x1A0})
    wire.bus.accept({0x190, 0x080}, {0x1A0})
    mask = 0xC000_07FF
    assert kernel.set == [struct.pack("=6I", 0x080, mask, 0x190, mask, 0x1A0 | REMOTE, mask)]
    wire.bus.accept(None, ())
    assert kernel.set[1:] == [struct.pack("=II", 0, EXTENDED)], "all but 29-bit identifiers"
    wire.bus.accept(range(MOST_FILTERS), {0x1A0})
    assert len(kernel.set) == 2, "more than the kernel takes: all again"
    kernel.gone = True
    wire.bus.accept({0x080}, ())
    kernel.gone = False
    wire.bus.accept({0x080}, ())
    assert kernel.set[2:] == [struct.pack("=2I", 0x080, mask)], "an interface that is gone is told by reading"
    wire.bus._socket = keeps


RESOLUTION_S = 1e-6  # of a float that holds a time of day
UNSEEN_S = 1e-5 + RESOLUTION_S  # an absence so short may make a frame seem earlier
STEPS = [-3600.0, -1.0, -0.01, -0.001, 0.001, 0.01, 1.0, 3600.0]


class Clocks:
    """A monotonic clock, and a time of day that is set now and then."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.ahead_s = 1.8e9
        self.away_s: list[float] = []  # how long the processor is away before each look at the time of day
        self.times = ReceiveTimes(lambda: self.now, self.wall)

    def wall(self) -> float:
        if self.away_s:
            self.now += self.away_s.pop(0)
        return self.now + self.ahead_s

    def stamp(self, ago_s: float = 0.0) -> float:
        """Of a frame that came so long ago, by the time of day as it is."""
        return self.now - ago_s + self.ahead_s


PAUSES_S = st.floats(0.0, 2.0) | st.sampled_from([0.0, 8e-6, 1.6e-5, 2e-5, 6e-5, 3e-4, 0.001])


@given(st.lists(st.tuples(st.floats(0.0, 10.0), st.floats(0.0, 59.9), PAUSES_S), min_size=1, max_size=30))
def test_it_is_when_the_frame_came(frames: list[tuple[float, float, float]]) -> None:
    """Also when the processor is away between two looks: that makes no step, and no frame seem earlier.

    60 us are enough to take an ADC PDO for one of another SYNC. 10 us are not seen.
    """
    clocks = Clocks()
    for passed_s, ago_s, away_s in frames:
        clocks.now += passed_s
        now, stamp_s, clocks.away_s = clocks.now, clocks.stamp(ago_s), [away_s]
        got = clocks.times.received(stamp_s, now)
        assert got is not None
        unseen_s = RESOLUTION_S + away_s * (away_s <= UNSEEN_S)
        assert now - ago_s - unseen_s <= got <= min(now, now - ago_s + RESOLUTION_S)


@given(st.lists(st.floats(-4e-5, 4e-5), min_size=1, max_size=200))
def test_a_time_of_day_that_is_slewed_is_followed(drifts_s: list[float]) -> None:
    """NTP slews by 500 ppm at most: 50 us in 0.1 s; that is no step."""
    clocks = Clocks()
    for drift_s in drifts_s:
        clocks.now += 0.1
        clocks.ahead_s += drift_s
        got = clocks.times.received(clocks.stamp(0.002), clocks.now)
        assert got == pytest.approx(clocks.now - 0.002, abs=RESOLUTION_S)


@pytest.mark.parametrize("step_s", STEPS)
def test_frames_that_wait_over_a_step_have_no_time(step_s: float) -> None:
    """Before and after the step alike: nobody knows which clock stamped them."""
    clocks = Clocks()
    before = clocks.stamp(0.003)
    clocks.ahead_s += step_s
    after = clocks.stamp(0.001)
    assert clocks.times.received(before, clocks.now) is None
    assert clocks.times.received(after, clocks.now) is None
    clocks.now += 0.5
    assert clocks.times.received(clocks.stamp(), clocks.now) is None, "the queue was not empty yet"
    clocks.times.emptied()
    clocks.now += 0.5
    assert clocks.times.received(clocks.stamp(0.004), clocks.now) == pytest.approx(
        clocks.now - 0.004, abs=RESOLUTION_S
    )


@given(st.sampled_from(STEPS), st.sampled_from(STEPS), st.floats(0.0, 0.5))
def test_no_frame_gets_a_time_of_the_wrong_clock(first_s: float, second_s: float, ago_s: float) -> None:
    clocks = Clocks()
    came = [(clocks.now - ago_s, clocks.stamp(ago_s))]
    for step_s in (first_s, second_s):
        clocks.ahead_s += step_s
        came.append((clocks.now - ago_s, clocks.stamp(ago_s)))
        for true_s, stamp_s in came:
            got = clocks.times.received(stamp_s, clocks.now)
            assert got is None or got == pytest.approx(true_s, abs=2 * LARGEST_STEP_S)


@pytest.mark.parametrize(
    "stamp_s", [0.0, 77.0, 1.7e9, 1.9e9, -1.0, float("nan"), float("inf"), float("-inf")]
)
def test_stamps_of_another_clock_that_stands_still_are_not_used(stamp_s: float) -> None:
    clocks = Clocks()
    for _ in range(5 * LEARNED_FRAMES):
        assert clocks.times.received(stamp_s, clocks.now) is None
        clocks.now += 1e-3
    assert clocks.times.received(clocks.stamp(), clocks.now) is not None, "and cost nothing"


@each("ago_s, used", [
    (LONGEST_DELAY_S - 0.01, True), (LONGEST_DELAY_S + 0.01, False), (-4e-4, True), (-6e-4, False),
])  # fmt: skip
def test_how_far_a_stamp_may_be_off(ago_s: float, used: bool) -> None:
    clocks = Clocks()
    got = clocks.times.received(clocks.stamp(ago_s), clocks.now)
    assert (got is not None) is used
    assert got is None or got <= clocks.now, "nothing comes later than now"


class Adapter:
    """Frames of a USB adapter, or of a controller, that stamps them by a clock of its own, which drifts."""

    def __init__(self, is_controller: bool, drift: float = 1e-4) -> None:
        self.clocks, self.rng = Clocks(), random.Random(1)
        one: ReceiveTimes | OtherClock = self.clocks.times
        if is_controller:
            one = OtherClock(LONGEST_LATENCY_S)
        self.received = one.received
        self.starts_s, self.rate, self.came_s = 77.0, 1.0 + drift, self.clocks.now

    def frame(self, late_s: float = 0.0) -> float | None:
        """One frame, taken so late beyond a delay of 0.1 to 0.2 ms; by how much its time is off."""
        self.came_s += 1e-3
        taken_s = self.came_s + 1e-4 + self.rng.uniform(0.0, 1e-4) + late_s
        self.clocks.now = max(self.clocks.now, taken_s)
        got = self.received(self.starts_s + (self.came_s - 1000.0) * self.rate, self.clocks.now)
        assert got is None or got <= self.clocks.now
        return None if got is None else got - self.came_s

    def frames(self, count: int) -> list[float | None]:
        return [self.frame() for _ in range(count)]


LONGEST_STALLS_S = {False: 0.5, True: LONGEST_LATENCY_S - 0.001}


@given(st.booleans(), st.floats(-1e-4, 1e-4), st.lists(st.floats(0.0, 1.0), max_size=3))
def test_the_clock_of_an_adapter_is_mapped_also_by_a_host_that_stalls(
    is_controller: bool, drift: float, stalls: list[float]
) -> None:
    """Its stamps have no jitter; what is left is the drift between two frames that were taken soonest."""
    adapter = Adapter(is_controller, drift)
    first = adapter.frames(5 * LEARNED_FRAMES)
    assert first[:LEARNED_FRAMES] == [None] * LEARNED_FRAMES
    for part in stalls:
        for left in range(20, 0, -1):
            first.append(adapter.frame(LONGEST_STALLS_S[is_controller] * part * left / 20))
    errors_s = [error_s for error_s in first[LEARNED_FRAMES:] if error_s is not None]
    assert len(errors_s) == len(first) - LEARNED_FRAMES
    assert min(errors_s) > 0.9e-4  # the least delay stays in
    assert max(errors_s) < 1.4e-4 + 2e-4 * (LONGEST_STALLS_S[is_controller] if stalls else 0.0)


@each(
    "is_controller, step_s",
    [(False, step_s) for step_s in (-1e4, -5.0, -0.01, 0.002, 0.01, 5.0, 1e4)]
    + [(True, step_s) for step_s in (-3600.0, -0.02, 0.02, 1.0, 3600.0)],
)
def test_a_clock_that_was_set_is_learned_again(is_controller: bool, step_s: float) -> None:
    """No frame has a time that is wrong by the step, but those that a stalled host would give as well.

    Nothing is later than the latency of a controller.
    """
    adapter = Adapter(is_controller)
    adapter.frames(3 * LEARNED_FRAMES)
    adapter.starts_s += step_s
    got = adapter.frames(3 * LEARNED_FRAMES)
    wrong = [one for one in got if one is not None and abs(one - 1.2e-4) > LARGEST_STEP_S]
    assert not wrong or (step_s < 0.0 and not is_controller and len(wrong) <= 2 * LEARNED_FRAMES)
    assert not is_controller or got[:LEARNED_FRAMES] == [None] * LEARNED_FRAMES
    last = got[-1]
    assert last is not None
    assert abs(last - 1.2e-4) < 5e-5


@given(st.lists(st.floats(-1e6, 1e10) | st.sampled_from([0.0, math.nan, math.inf, -math.inf]), max_size=300))
def test_any_stamps_give_no_time_after_now(stamps: list[float]) -> None:
    clocks = Clocks()
    for stamp in stamps:
        clocks.now += 1e-3
        got = clocks.times.received(stamp, clocks.now)
        assert got is None or got <= clocks.now
