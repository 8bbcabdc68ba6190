"""The runner on a bus that is not there, or off, or down, in a time that does not pass by itself."""

import errno
import itertools
import math
import struct
from collections.abc import Callable
from typing import Any, cast

import can
import pytest
from can.interfaces.udp_multicast import UdpMulticastBus
from hypothesis import example, given, strategies as st

from canfb import FeedbackModule, Frame, ModuleConfig, objects as od
from canfb.bus.bus_state import ERROR_BUS_OFF, ERROR_RESTARTED, LASTING_S, RETRY_S, SETTLED_S
from canfb.bus.runner import LONGEST_BLIND_DRAIN_S, LONGEST_WAIT_S, DeviceFailure, Runner
from canfb.cia301.codes import NmtState
from canfb.device.node import Device
from canfb.errors import reason
from drawing import examples
from fake_bus import FakeBus, FakeClock, FakeDevice, each_kind_of_bus, frame_bus, message  # noqa: F401
from folding import each

WALL_S = 1.8e9  # the time of day minus the clock of the runner
BROKEN = can.CanOperationError("the cable is off", 5)


class Bench:
    """A runner, its fake bus, and what it reported."""

    def __init__(self, *plan: tuple[float, can.Message | Exception]) -> None:
        self.clock = FakeClock()
        self.bus = FakeBus(self.clock, plan)
        self.reported: list[str] = []

    def device(self, **options: Any) -> FakeDevice:
        return FakeDevice(self.clock, **options)

    def runner(self, devices: list[Device], **options: Any) -> Runner:
        bus: Any = self.bus
        clocks = self.clock, self.clock.sleep, lambda: self.clock.now + WALL_S
        return Runner(frame_bus(bus), devices, self.reported.append, *clocks, **options)

    def run(
        self,
        devices: list[Device],
        duration_s: float,
        ready: Callable[[], None] = lambda: None,
        **options: Any,
    ) -> Runner:
        runner = self.runner(devices, **options)
        self.bus.end_s = duration_s
        runner.run(lambda: self.bus.at >= duration_s, ready)
        return runner


def test_a_frame_reaches_every_device_with_the_time_and_answers_go_out() -> None:
    bench = Bench((0.5, message(0x181, b"\x01\x02", timestamp=WALL_S + 1000.25)))
    quiet = bench.device()
    loud = bench.device(answer=lambda frame: [Frame(0x201, b"\x03"), Frame(0x202, b"", rtr=True)])
    runner = bench.run([quiet, loud], 1.0)
    want = (1000.5, Frame(0x181, b"\x01\x02", False, cast(float, pytest.approx(1000.25, abs=1e-6))))
    assert quiet.heard[0] == loud.heard[0] == want
    first, second = (sent for _, sent in bench.bus.sent)
    assert (first.arbitration_id, first.data, first.is_remote_frame) == (0x201, b"\x03", False)
    assert (second.arbitration_id, second.is_remote_frame) == (0x202, True)
    assert not first.is_extended_id
    assert not first.is_fd
    assert (runner.counters.received, runner.counters.sent) == (1, 2)
    assert bench.reported == []


def test_boot_ups_and_answers_to_answers_come_in_order_and_nobody_hears_himself() -> None:
    bench = Bench((0.0, message(0x100)))
    replies = {0x100: [Frame(0x101, b""), Frame(0x102, b"")], 0x201: []}
    one = bench.device(answer=lambda frame: replies.get(frame.can_id, []), boot=(Frame(0x701, b"\0"),))
    other = bench.device(
        answer=lambda frame: [Frame(0x201, b"")] if frame.can_id == 0x101 else [], boot=(Frame(0x702, b"\0"),)
    )
    bench.bus.refuse = lambda at: bench.clock.sleep(0.003)  # sending wakes others, who go first
    at_ready: list[list[int]] = []
    bench.run([one, other], 0.05, lambda: at_ready.append(bench.bus.sent_ids()))
    assert at_ready == [[0x701, 0x702]], "once, after the boot-ups"
    left_s = {message.arbitration_id: 999.997 + at for at, message in bench.bus.sent}
    assert [at for at, frame in one.heard + other.heard if frame.can_id != 0x100] == pytest.approx(
        [left_s[can_id] for can_id in (0x702, 0x201, 0x701, 0x101, 0x102)]
    )
    assert bench.bus.sent_ids() == [0x701, 0x702, 0x101, 0x102, 0x201]
    assert one.heard_ids() == [0x702, 0x100, 0x201]
    assert other.heard_ids() == [0x701, 0x101, 0x102, 0x100]


def flood(stamp: Callable[[float], float]) -> FakeDevice:
    """A second of a bus where a frame always waits, and each takes 0.1 ms."""
    bench = Bench(*((0.0, message(0x300, timestamp=stamp(n * 1e-4))) for n in range(11_000)))

    def busy(frame: Frame) -> list[Frame]:
        bench.clock.now += 1e-4
        return []

    device = bench.device(period_s=0.01, answer=busy)
    bench.run([device], 0.9999)
    assert len(device.heard) in {9998, 9999}
    return device


def test_a_flood_starves_no_timer() -> None:
    """Frames without receive times may all have come before a deadline, but not for ever."""
    device = flood(lambda at: 0.0)
    assert len(device.ticked) == 99
    assert max(device.ticked) <= LONGEST_BLIND_DRAIN_S + 0.0002
    assert max(device.ticked[12:]) <= 0.0002


@pytest.mark.parametrize("lag_s", [0.0, 0.002, 0.05])
def test_a_timer_waits_for_frames_that_came_before_it(lag_s: float) -> None:
    device = flood(lambda at: WALL_S + 1000.0 + at - lag_s)
    assert len(device.ticked) == 99 - round(lag_s / 0.01)
    assert all(lag_s - 0.0003 <= late_s <= lag_s + 0.0003 for late_s in device.ticked)


@pytest.mark.parametrize("beside", [None, 0.2])
@pytest.mark.parametrize("in_a_call", [True, False])
def test_a_runner_that_was_away_gives_the_frames_first(in_a_call: bool, beside: float | None) -> None:
    """Two seconds, in a call of the device or behind a wait that ended a little early without a frame.

    What came meanwhile takes its time: nothing was late but the runner. A timer of a device ``beside`` it
    goes on.
    """
    bench = Bench(*((0.007 * n, message(0x300, timestamp=WALL_S + 1000.0 + 0.007 * n)) for n in range(400)))
    order: list[str] = []
    receive = bench.bus.recv

    def hears(frame: Frame) -> list[Frame]:
        order.append("frame")
        if in_a_call and len(order) == 20:
            order.append("away")
            bench.clock.now += 2.0
        bench.clock.now += 1e-4
        device.next_s = None if frame.timestamp is None else frame.timestamp + 0.0075
        return []

    def ends_early(timeout: float | None = None) -> can.Message | None:
        assert timeout is not None
        if in_a_call or len(order) != 20:
            return receive(timeout)
        order.append("away")
        bench.clock.now += timeout - 0.0009 + 2.0
        return None

    def ticks(now: float, until: float = 0.0) -> list[Frame]:
        order.append("tick")
        device.next_s = None
        return []

    bench.bus.recv = ends_early  # type: ignore[method-assign]
    device = bench.device(period_s=0.0075, answer=hears)
    device.tick = ticks  # type: ignore[method-assign]
    other = bench.device(period_s=beside)
    bench.run([device, other], 2.79)
    assert bool(other.ticked) is bool(beside)
    assert order.count("away") == 1
    assert "tick" not in order
    assert order.count("frame") > 390


def test_a_module_that_was_away_misses_neither_sync_nor_heartbeat() -> None:
    """One second, with the heartbeats of its own that were due meanwhile."""
    wishes = ["2B17100064000000", "231610012C010500"]  # heartbeat each 100 ms, that of node 5 within 300 ms
    planned = [(0.01, message(0x620, bytes.fromhex(wish))) for wish in wishes]
    for n in range(300):
        frames = [(0x080, b""), (0x190, struct.pack("<hh", 1500, 0)), *[(0x705, b"\5")] * (n % 10 == 0)]
        for late_s, (can_id, data) in enumerate(frames):
            at = 0.02 + 0.01 * n + 2e-4 * late_s
            planned.append((at, message(can_id, data, timestamp=WALL_S + 1000.0 + at)))
    bench = Bench(*planned)
    heard: list[Frame] = []

    def is_away(frame: Frame) -> list[Frame]:
        heard.append(frame)
        bench.clock.now += 1.0 if len(heard) == 300 else 1e-4
        return []

    module = FeedbackModule(ModuleConfig(node_id=32, autostart=True))
    bench.run([module, bench.device(answer=is_away)], 3.0)
    assert set(bench.bus.sent_ids()) == {0x1A0, 0x2A0, 0x5A0, 0x720}, "no EMCY"
    assert 15 < bench.bus.sent_ids().count(0x720) < 25, "missed heartbeats are not made up"
    assert module.state is NmtState.OPERATIONAL
    counters = od.COUNTER_MISSED, od.COUNTER_SYNCS_NOT_HEARD
    assert [module.dictionary.entry(*place).value for place in counters] == [0, 0]


def test_without_deadlines_a_wait_is_short_enough_for_a_signal() -> None:
    bench = Bench()
    bench.run([bench.device()], 5.0)
    assert set(bench.bus.waits) == {LONGEST_WAIT_S}
    assert 0.01 <= LONGEST_WAIT_S <= 0.5


def polling(*plan: tuple[float, can.Message | Exception]) -> Bench:
    """A bus where a look takes 10 µs."""
    bench = Bench(*plan)
    receive = bench.bus.recv

    def takes_time(timeout: float | None = None) -> can.Message | None:
        bench.clock.now += 1e-5
        return receive(timeout)

    bench.bus.recv = takes_time  # type: ignore[method-assign]
    return bench


def test_a_runner_that_polls_never_waits_and_keeps_deadlines_and_frames() -> None:
    stamped = [(n * 0.003, message(0x300, timestamp=WALL_S + 1000.0 + n * 0.003)) for n in range(1, 60)]
    bench = polling(*stamped)
    device = bench.device(period_s=0.01)
    runner = bench.run([device], 0.195, busy_poll=True)
    assert set(bench.bus.waits) == {0.0}
    assert len(device.ticked) == 19
    assert max(device.ticked) <= 2.1e-5, "a look at the bus before a deadline, and one behind it"
    times_s = [now - 1000.0 for now, _ in device.heard]
    assert times_s == pytest.approx([at for at, _ in stamped], abs=2.1e-5)
    assert runner.counters.received == len(stamped)
    assert bench.clock.slept == []


def test_a_runner_that_polls_waits_while_the_bus_fails() -> None:
    bench = polling(*((0.0, BROKEN) for _ in range(5)))
    bench.run([bench.device()], 0.45, busy_poll=True)
    assert bench.clock.slept == [RETRY_S] * 2


KINDS: dict[str, Callable[[], can.Message | Exception]] = {
    "data": lambda: message(0x181, b"\1\2"),
    "remote": lambda: message(0x182, is_remote_frame=True),
    "error frame": lambda: message(0x20000004, is_error_frame=True),
    "29 bits": lambda: can.Message(arbitration_id=0x181, is_extended_id=True),
    "CAN FD": lambda: message(0x181, is_fd=True, data=bytes(64)),
    "failure": lambda: BROKEN,
}
HEARD = {"data": (False, 0x181), "remote": (True, 0x182)}
EVENTS = st.lists(st.tuples(st.floats(0.001, 0.3), st.sampled_from(sorted(KINDS))), max_size=30)
PERIODS_S = st.lists(st.floats(0.01, 0.5), min_size=1, max_size=3)


@given(EVENTS, PERIODS_S, st.floats(0.0, 4.0), st.floats(0.0, 4.0))
@examples(40)
def test_whatever_a_bus_does_frames_come_once_and_deadlines_are_kept(
    events: list[tuple[float, str]], periods_s: list[float], refuses_s: float, takes_s: float
) -> None:
    """Each device hears all frames of CANopen in their order, and those of the others, sent or refused."""
    at_s = list(itertools.accumulate(pause_s for pause_s, _ in events))
    bench = Bench(*((round(at, 6), KINDS[kind]()) for at, (_, kind) in zip(at_s, events, strict=True)))
    bench.bus.refuse = lambda at: BROKEN if refuses_s <= at < takes_s else None
    devices = [bench.device(period_s=period_s, tick_id=0x300 + n) for n, period_s in enumerate(periods_s)]
    runner = bench.run([*devices], 9.5)
    kinds, counters = [kind for _, kind in events], runner.counters
    came = [HEARD[kind] for kind in kinds if kind in HEARD]
    failures = kinds.count("failure")
    for device, period_s in zip(devices, periods_s, strict=True):
        heard = [(frame.rtr, frame.can_id) for _, frame in device.heard]
        assert [one for one in heard if one[1] < 0x300] == came
        others = sum(len(other.ticked) for other in devices if other is not device)
        assert len(heard) == len(came) + others
        # One tick at a time: a deadline that passed before the last one was due from then on.
        ticks_s = [0.0, *(n * period_s + late_s for n, late_s in enumerate(device.ticked, 1))]
        pauses_s = [now - before for before, now in itertools.pairwise(ticks_s)]
        assert max(map(min, device.ticked, pauses_s)) <= (RETRY_S if failures > 1 else 0.0) + 1e-9
        assert abs(len(device.ticked) - 9.5 / period_s) <= 1.001
    assert (counters.received, counters.error_frames) == (len(came), kinds.count("error frame"))
    assert counters.bus_failures == failures
    assert counters.sent == len(bench.bus.sent)
    assert counters.sent + counters.send_failures == sum(len(device.ticked) for device in devices)
    assert len(bench.clock.slept) < max(failures, 1), "a single failure costs no time"
    ends = {"the bus fails: the": "the bus works", "a frame could not": "frames can be sent"}
    for trouble, recovered in ends.items():
        lines = [text for text in bench.reported if text.startswith((trouble, recovered))]
        assert [text.startswith(trouble) for text in lines] == [n % 2 == 0 for n in range(len(lines))]


def test_stop_ends_it_from_within_or_after_the_boot_up() -> None:
    bench = Bench((0.1, message(0x123)), (0.2, message(0x124)))

    def ending(frame: Frame) -> list[Frame]:
        runner.stop()
        return [Frame(0x200, b"")]

    device = bench.device(answer=ending)
    runner = bench.runner([device])
    runner.run()
    assert device.heard_ids() == [0x123]
    assert bench.bus.sent_ids() == [0x200]
    bench = Bench()
    runner = bench.runner([bench.device(boot=(Frame(0x701, b"\0"),))])
    runner.stop()
    runner.run()
    assert bench.bus.sent_ids() == [0x701]
    assert bench.bus.waits == []


class UdpLikeBus(FakeBus, UdpMulticastBus):
    """A sender hears itself, and the channel of a message goes along."""

    def recv(self, timeout: float | None = None) -> can.Message | None:
        return FakeBus.recv(self, timeout)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        FakeBus.send(self, msg)
        self.plan.append((self.at, msg))


class GsUsbBus(FakeBus):
    """As python-can's gs_usb: what was sent comes back, marked."""

    def send(self, msg: can.Message) -> None:
        super().send(msg)
        self.plan.append((self.at, message(msg.arbitration_id, is_rx=False)))


@pytest.mark.parametrize("each_kind_of_bus", ["python-can"], indirect=True)
@pytest.mark.parametrize(
    ("kind", "foreign"),
    [
        (UdpLikeBus, {"channel": "of another process"}),
        (GsUsbBus, {}),
        (FakeBus, {"is_rx": False}),  # SocketCAN sets it for the frames of every process on the computer
    ],
)
def test_own_frames_that_come_back_are_left_out(kind: type[FakeBus], foreign: dict[str, Any]) -> None:
    bench = Bench()
    bench.bus = kind(bench.clock, [(0.25, message(0x181, **foreign))])
    one, other = bench.device(period_s=0.1), bench.device()
    runner = bench.run([one, other], 0.55)
    assert one.heard_ids() == [0x181]
    assert other.heard_ids() == [0x80, 0x80, 0x181, 0x80, 0x80, 0x80], "once each, not twice"
    assert runner.counters.received == 1
    assert len(bench.bus.sent) == 5
    assert (bench.bus.sent[0][1].channel is None) is (kind is not UdpLikeBus)


def breaks(*arguments: object) -> list[Frame]:
    raise ZeroDivisionError("by\nzero")


@pytest.mark.parametrize("method", ["start", "receive", "tick", "bus_off", "bus_back"])
def test_a_device_that_raises_ends_it_for_all(method: str) -> None:
    bus_off, restarted = (message(error, is_error_frame=True) for error in (0x40, 0x100))
    plan = (0.1, message(0x181)), (0.2, bus_off), (0.3, restarted)
    bench = Bench(*(() if method == "receive" else plan))  # then a frame of the other device
    good, bad = bench.device(period_s=0.25), bench.device(period_s=0.25 if method == "tick" else None)
    silent: Any = lambda now: []  # noqa: E731
    vars(bad).update({"bus_off": silent, "bus_back": silent, method: breaks})
    said = r"^program error: ZeroDivisionError: by zero \(test_runner"
    with pytest.raises(DeviceFailure, match=said) as failure:
        bench.run([good, bad], 5.0)
    assert failure.value.device is bad
    assert isinstance(failure.value.__cause__, ZeroDivisionError)
    assert bench.reported in ([], [OFF_LINE], [OFF_LINE, ON_LINE])


BUS_OFF = message(ERROR_BUS_OFF | 0x200, bytes(8), is_error_frame=True)
ASKED = [Frame(0x620, b"\x40\x00\x10\x00\0\0\0\0")]


@each("plan, heard, until_s", [
    ([(0.03, message(0x720, b"\x05")), (0.04, message(0x5A0))], 0x720, 0.03),
    ([(0.05, message(0x5A0, b"\x43"))], 0x5A0, 0.05),
    ([(0.01, message(0x721, b"\x05")), (0.02, message(0x1A0)), (0.15, message(0x720))], None, 0.1),
    ([(0.02, BROKEN), (0.03, message(0x720, b"\x05"))], None, 0.02),
    ([(0.01, BUS_OFF)], None, 0.1),
    ([], None, 0.1),
])  # fmt: skip
def test_other_nodes_are_heard_before_the_devices_start(
    plan: list[tuple[float, can.Message | Exception]], heard: int | None, until_s: float
) -> None:
    bench = Bench(*plan)
    device = bench.device(boot=(Frame(0x720, b"\0"),))
    assert bench.runner([device]).hears({0x5A0, 0x720}, 0.1, ASKED) == heard
    assert (OFF_LINE in bench.reported) is ((0.01, BUS_OFF) in plan)
    assert bench.bus.at == pytest.approx(until_s)
    assert bench.bus.sent_ids() == [0x620]
    assert device.heard == []


INHIBIT_S = 0.010


@given(st.lists(st.floats(0.0, 0.009), min_size=1, max_size=9))
@example([0.0])
@examples(20)
def test_no_two_frames_are_closer_than_the_inhibit_time(delays_s: list[float]) -> None:
    """Also where each leaves later than it is given: a sample each millisecond, an EMCY at every third."""
    module = FeedbackModule(ModuleConfig(node_id=32, autostart=True))
    for index, sub, data in (
        (0x1800, 1, "A00100C0"),  # not valid
        (0x1800, 3, "6400"),  # 100 x 100 us
        (0x1800, 1, "A0010040"),
        (0x1015, 0, "6400"),
    ):
        module.dictionary.lookup(index, sub).download(bytes.fromhex(data))
    plan = []
    for n in range(60):
        amplitude = 1500 if n // 3 % 2 else 20  # too small: EMCY; then its end
        counts = (round(amplitude * f(0.05 * n)) for f in (math.sin, math.cos))
        plan += [(1e-3 * n, one) for one in (message(0x80), message(0x190, struct.pack("<hh", *counts)))]
    bench, delays = Bench(*plan), itertools.cycle(delays_s)
    bench.bus.refuse = lambda at: bench.clock.sleep(next(delays))
    bench.run([module], 0.7)
    for can_id in (0x1A0, 0x0A0):
        times = [at for at, sent in bench.bus.sent if sent.arbitration_id == can_id]
        assert len(times) >= 3
        gaps = [later - earlier for earlier, later in itertools.pairwise(times)]
        assert min(gaps) >= 0.999999 * INHIBIT_S
        assert max(delays_s) > 0.0 or gaps[1] == pytest.approx(INHIBIT_S, abs=1e-6)


RESTARTED = message(ERROR_RESTARTED, bytes(8), is_error_frame=True)
WARNING = message(0x004, bytes(8), is_error_frame=True)
DOWN = can.CanOperationError("Error receiving: Network is down", errno.ENETDOWN)
FULL = can.CanOperationError("Failed to transmit: No buffer space available", errno.ENOBUFS)
OFF_LINE = "the CAN controller is bus-off"
DOWN_LINE = f"the bus fails: {reason(DOWN)}"
ON_LINE = "the CAN controller is on the bus again"
FRAME = message(0x080)


class Watching(FakeDevice):
    """Notes what it is told of the bus, in seconds from the start, and answers each time."""

    def __init__(self, clock: FakeClock, **options: Any) -> None:
        super().__init__(clock, **options)
        self.origin = clock.now
        self.told: list[tuple[str, float]] = []

    def bus_off(self, now: float) -> list[Frame]:
        self.told.append(("off", round(now - self.origin, 6)))
        return []

    def bus_back(self, now: float) -> list[Frame]:
        self.told.append(("back", round(now - self.origin, 6)))
        return [Frame(0x0A0, bytes(8))]


def sending(refuse: Any, *periods_s: float) -> dict[str, Any]:
    """What the bus refuses, by the time; and the periods of devices that send."""
    return {"refuse": refuse, "periods_s": periods_s}


def play(
    plan: Any, duration_s: float, *others: Any, refuse: Any = lambda at: None, periods_s: Any = ()
) -> tuple[Watching, FakeBus, list[str]]:
    """A device that watches the bus, beside others; what was sent, and what was reported."""
    bench = Bench(*plan)
    bench.bus.refuse = refuse
    device = Watching(bench.clock)
    made = [one(bench.clock) for one in others]
    bench.run([device, *made, *(bench.device(period_s=period_s) for period_s in periods_s)], duration_s)
    return device, bench.bus, bench.reported


GONE = can.CanOperationError("the adapter is gone")
UNPACKED = can.CanOperationError("could not unpack")
DOWNS = [DOWN, *(OSError(code, "down") for code in (errno.ENETDOWN, errno.ENODEV, errno.ENXIO))]
SHORT = [(1.0 + 0.1 * n, RESTARTED if n % 2 else BUS_OFF) for n in range(20)]  # a short circuit, restart-ms

# What happens; when the device hears of it: (off), (off, back), ...; and the lines, None: not looked at.
SCENES: dict[str, tuple[list[Any], dict[str, Any], list[float], list[str] | None]] = {
    "an automatic restart":
        ([(1.0, BUS_OFF), (1.1, RESTARTED)], {}, [1.0, 1.1 + SETTLED_S], [OFF_LINE, ON_LINE]),
    "twice":
        ([(1.0, BUS_OFF), (1.1, RESTARTED), (5.0, BUS_OFF), (5.1, RESTARTED)], {},
         [1.0, 1.1 + SETTLED_S, 5.0, 5.1 + SETTLED_S], [OFF_LINE, ON_LINE] * 2),
    "nobody restarts it": ([(1.0, BUS_OFF)], {}, [1.0], [OFF_LINE]),
    "several are one": ([(1.0, BUS_OFF), (1.01, BUS_OFF), (1.02, BUS_OFF)], {}, [1.0], None),
    "error frames are no life": ([(1.0, BUS_OFF), (1.1, WARNING), (1.2, WARNING)], {}, [1.0], None),
    "a driver's queue is none": ([(1.0, BUS_OFF)], sending(lambda at: None, 0.1), [1.0], None),
    "a frame that was received": ([(1.0, BUS_OFF), (3.0, FRAME)], {}, [1.0, 3.0 + SETTLED_S], None),
    "warnings": ([(0.1 * n, WARNING) for n in range(1, 20)], {}, [], []),
    "frames": ([(0.1 * n, FRAME) for n in range(1, 20)], {}, [], []),
    # SocketCAN says it once to the reader; then nothing comes, and sending fails.
    "down":
        ([(1.0, DOWN)], sending(lambda at: DOWN if 1.0 <= at < 4.0 else None, 0.5),
         [1.0, 4.0 + SETTLED_S], [DOWN_LINE, "the bus works again"]),
    "reading fails on and on":
        ([*((1.0, GONE) for _ in range(10)), (5.0, FRAME)], {}, [1.0 + LASTING_S, 5.0 + SETTLED_S], None),
    "bad datagrams": ([(0.1 * n, UNPACKED if n % 2 else FRAME) for n in range(1, 60)], {}, [], None),
    **{f"sending fails: {error!r}":
        ([], sending(lambda at, error=error: error if at < 1.05 else None, 0.5), [0.5, 1.5 + SETTLED_S], None)
       for error in DOWNS},
    "sending fails now and then":
        ([], sending(lambda at: BROKEN if round(at * 10) % 7 == 0 else None, 0.1), [],
         ["a frame could not be sent: the cable is off [Error Code 5]"]),
    # With nobody on the bus who acknowledges the controller is passive, but not off.
    **{f"a full queue: {error}": ([], sending(lambda at, error=error: error, 0.1), [], None)
       for error in (FULL, GONE)},
}  # fmt: skip


@pytest.mark.parametrize("name", SCENES)
def test_who_is_told_what_and_when(name: str) -> None:
    plan, options, told_s, said = SCENES[name]
    device, bus, lines = play(plan, 9.0, **options)
    assert [word for word, _ in device.told] == (["off", "back"] * len(told_s))[: len(told_s)]
    for (_, at), want_s in zip(device.told, told_s, strict=True):
        assert want_s - 1e-6 <= at <= want_s + RETRY_S + 0.11
    assert said is None or lines == said
    assert bus.sent_ids().count(0x0A0) == len(told_s) // 2, "what it says to that goes out"


def test_off_and_on_and_off_is_reported_once_and_each_time_it_is_an_error() -> None:
    """A master may have started the nodes again in between."""
    device, _, lines = play(SHORT, 6.0)
    assert [word for word, _ in device.told] == ["off"] * 10 + ["back"]
    assert lines == [OFF_LINE, ON_LINE]


@pytest.mark.parametrize("error", [DOWN, FULL])
def test_a_boot_up_that_failed_is_sent_before_all_else_when_the_bus_is_there(error: Exception) -> None:
    """Once; its device was not on the bus before, so nothing has been lost for it."""
    starting: list[Watching] = []

    def boots(clock: FakeClock) -> Watching:
        starting.append(Watching(clock, boot=(Frame(0x720, b"\0"), Frame(0x721, b"\x05"))))
        return starting[0]

    device, bus, _ = play([], 8.0, boots, **sending(lambda at: error if at < 3.0 else None, 0.7))
    sent = [(at, one.arbitration_id) for at, one in bus.sent]
    assert sent[0] == (pytest.approx(3.0, abs=RETRY_S + 0.1), 0x720)
    assert [can_id for _, can_id in sent].count(0x720) == 1
    assert 0x721 not in [can_id for _, can_id in sent], "a heartbeat that is late helps nobody"
    assert starting[0].told == []
    assert [word for word, _ in device.told] == (["off", "back"] if error is DOWN else [])
