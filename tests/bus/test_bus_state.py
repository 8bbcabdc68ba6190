"""Bus-off and an interface that is down, and the way back: who is told what, and when."""

from __future__ import annotations

import errno
from typing import Any

import can
import pytest

from canfb.bus.bus_state import ERROR_BUS_OFF, ERROR_RESTARTED, LASTING_S, RETRY_S, SETTLED_S
from canfb.bus.runner import Runner
from canfb.cia301.frame import Frame
from canfb.cia301.nmt import NmtState
from canfb.errors import reason
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from fake_bus import FakeBus, FakeClock, FakeDevice, each_kind_of_bus, frame_bus, message  # noqa: F401

BUS_OFF = message(ERROR_BUS_OFF | 0x200, bytes(8), is_error_frame=True)
RESTARTED = message(ERROR_RESTARTED, bytes(8), is_error_frame=True)
WARNING = message(0x004, bytes(8), is_error_frame=True)
DOWN = can.CanOperationError("Error receiving: Network is down", errno.ENETDOWN)
FULL = can.CanOperationError("Failed to transmit: No buffer space available", errno.ENOBUFS)
OFF_LINE = "the CAN controller is bus-off"
DOWN_LINE = f"the bus fails: {reason(DOWN)}"
ON_LINE = "the CAN controller is on the bus again"


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


class Scene:
    def __init__(self, *plan: tuple[float, can.Message | Exception]) -> None:
        self.clock = FakeClock()
        self.bus = FakeBus(self.clock, plan)
        self.lines: list[str] = []
        self.device = Watching(self.clock)
        self.others: list[Any] = []

    def run(self, duration_s: float) -> Scene:
        bus: Any = self.bus
        runner = Runner(
            frame_bus(bus), [self.device, *self.others], self.lines.append, self.clock, self.clock.sleep
        )
        self.bus.end_s = duration_s
        runner.run(finished=lambda: self.bus.at >= duration_s)
        return self

    @property
    def words(self) -> list[str]:
        return [word for word, _ in self.device.told]


def test_bus_off_and_an_automatic_restart() -> None:
    scene = Scene((1.0, BUS_OFF), (1.1, RESTARTED)).run(5.0)
    (off, off_s), (back, back_s) = scene.device.told
    assert (off, back) == ("off", "back")
    assert off_s == 1.0
    assert 1.1 + SETTLED_S <= back_s <= 1.1 + SETTLED_S + 0.11
    assert scene.bus.sent_ids() == [0x0A0], "what it says to that goes out"
    assert scene.lines == [OFF_LINE, ON_LINE]


def test_the_second_time_is_like_the_first() -> None:
    scene = Scene((1.0, BUS_OFF), (1.1, RESTARTED), (5.0, BUS_OFF), (5.1, RESTARTED)).run(9.0)
    assert scene.words == ["off", "back"] * 2
    assert scene.lines == [OFF_LINE, ON_LINE] * 2


@pytest.mark.parametrize(
    ("plan", "told"),
    [
        ([(1.0, BUS_OFF)], ["off"]),
        ([(1.0, BUS_OFF), (1.01, BUS_OFF), (1.02, BUS_OFF)], ["off"]),
        ([(1.0, BUS_OFF), (1.1, WARNING), (1.2, WARNING)], ["off"]),
        ([(1.0, BUS_OFF), (3.0, message(0x080))], ["off", "back"]),
    ],
)
def test_what_is_a_sign_of_life(plan: list[tuple[float, can.Message]], told: list[str]) -> None:
    assert Scene(*plan).run(9.0).words == told


def test_a_frame_that_was_sent_proves_nothing_while_the_controller_is_off() -> None:
    """Its driver takes some frames into a queue."""
    scene = Scene((1.0, BUS_OFF))
    scene.others = [FakeDevice(scene.clock, period_s=0.1)]
    assert scene.run(10.0).words == ["off"]


@pytest.mark.parametrize("frame", [WARNING, message(0x181)])
def test_other_error_frames_and_frames_tell_nobody(frame: can.Message) -> None:
    scene = Scene(*((0.1 * n, frame) for n in range(1, 20))).run(5.0)
    assert (scene.device.told, scene.lines) == ([], [])


def test_off_and_on_and_off_is_reported_once_and_each_time_it_is_an_error() -> None:
    """A short circuit with restart-ms: a master may have started the nodes again in between."""
    plan = [(1.0 + 0.1 * n, RESTARTED if n % 2 else BUS_OFF) for n in range(20)]
    scene = Scene(*plan).run(6.0)
    assert scene.words == ["off"] * 10 + ["back"]
    assert scene.lines == [OFF_LINE, ON_LINE]


def test_an_interface_that_is_down_fails_but_once_to_the_reader() -> None:
    """So it is with SocketCAN; then nothing comes, and sending fails."""
    scene = Scene((1.0, DOWN))
    scene.bus.refuse = lambda at: DOWN if 1.0 <= at < 4.0 else None
    scene.others = [FakeDevice(scene.clock, period_s=0.5)]
    scene.run(8.0)
    (_, off_s), (_, back_s) = scene.device.told
    assert off_s == 1.0
    assert 4.0 + SETTLED_S <= back_s <= 4.5 + SETTLED_S + 0.11
    assert scene.lines == [DOWN_LINE, "the bus works again"], "an outage is one line"


@pytest.mark.parametrize("code", [errno.ENETDOWN, errno.ENODEV, errno.ENXIO])
@pytest.mark.parametrize("kind", ["can", "system"])
def test_sending_tells_that_the_interface_is_down(code: int, kind: str) -> None:
    scene = Scene()
    error = OSError(code, "down") if kind == "system" else can.CanOperationError("down", code)
    scene.bus.refuse = lambda at: error if at < 1.05 else None
    scene.others = [FakeDevice(scene.clock, period_s=0.5)]
    assert scene.run(5.0).words == ["off", "back"]


@pytest.mark.parametrize("error", [FULL, can.CanOperationError("Transmit buffer full")])
def test_a_full_queue_is_no_bus_off(error: Exception) -> None:
    """As it is with nobody on the bus who acknowledges: the controller is passive, but not off."""
    scene = Scene()
    scene.bus.refuse = lambda at: error
    scene.others = [FakeDevice(scene.clock, period_s=0.1)]
    assert scene.run(5.0).device.told == []


def test_reading_that_fails_on_and_on_is_a_bus_that_is_gone() -> None:
    broken = can.CanOperationError("the adapter is gone")
    scene = Scene(*((1.0, broken) for _ in range(10)), (5.0, message(0x080))).run(9.0)
    (_, off_s), (_, back_s) = scene.device.told
    assert 1.0 + LASTING_S <= off_s <= 1.0 + LASTING_S + RETRY_S
    assert 5.0 + SETTLED_S <= back_s <= 5.0 + SETTLED_S + 0.11


def test_single_bad_datagrams_are_not() -> None:
    bad = can.CanOperationError("could not unpack")
    plan = [(0.1 * n, bad if n % 2 else message(0x181)) for n in range(1, 60)]
    assert Scene(*plan).run(8.0).device.told == []


def test_two_devices_and_one_that_does_not_want_to_know() -> None:
    scene = Scene((1.0, BUS_OFF), (1.1, RESTARTED))
    other, deaf = Watching(scene.clock), FakeDevice(scene.clock)
    scene.others = [deaf, other]
    scene.run(5.0)
    assert [word for word, _ in other.told] == ["off", "back"]
    assert deaf.heard_ids() == [0x0A0, 0x0A0]
    assert other.heard_ids() == [0x0A0], "each hears what the others say, not itself"


def test_the_module_stops_and_says_that_the_bus_is_back() -> None:
    scene = Scene((1.0, BUS_OFF), (1.5, RESTARTED))
    module = FeedbackModule(ModuleConfig(node_id=32, autostart=True))
    states: list[object] = []
    module.events.on_event = lambda event: states.append(event.values.get("state"))
    scene.others = [module]
    scene.run(5.0)
    assert states == ["PRE-OPERATIONAL", "OPERATIONAL", "PRE-OPERATIONAL"]
    sent = [(sent.arbitration_id, bytes(sent.data).hex()) for _, sent in scene.bus.sent]
    assert (0x0A0, "4081110000000000") in sent
    assert (0x0A0, "0000000000000000") in sent


BOOT_UP = Frame(0x720, b"\0")


@pytest.mark.parametrize("error", [DOWN, FULL])
def test_a_boot_up_that_failed_is_sent_before_all_else_when_the_bus_is_there(error: Exception) -> None:
    """Once; its device was not on the bus before, so nothing has been lost for it."""
    scene = Scene()
    scene.bus.refuse = lambda at: error if at < 3.0 else None
    starting = Watching(scene.clock, boot=(BOOT_UP, Frame(0x721, b"\x05")))
    scene.others = [starting, FakeDevice(scene.clock, period_s=0.7)]
    scene.run(8.0)
    sent = [(at, one.arbitration_id) for at, one in scene.bus.sent]
    assert sent[0] == (pytest.approx(3.0, abs=RETRY_S + 0.1), 0x720)
    assert [can_id for _, can_id in sent].count(0x720) == 1
    assert 0x721 not in [can_id for _, can_id in sent], "a heartbeat that is late helps nobody"
    assert starting.told == []
    assert scene.words == (["off", "back"] if error is DOWN else [])


def test_a_module_that_starts_without_a_bus_starts_as_usual_when_it_is_there() -> None:
    """Nobody would start a module with autostart again."""
    scene = Scene()
    scene.bus.refuse = lambda at: DOWN if at < 3.0 else None
    module = FeedbackModule(ModuleConfig(node_id=32, autostart=True))
    scene.others = [module]
    scene.run(8.0)
    assert scene.bus.sent_ids()[0] == 0x720
    assert module.state is NmtState.OPERATIONAL
    assert scene.lines == [DOWN_LINE, "the bus works again"]
