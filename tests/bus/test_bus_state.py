"""Bus-off and an interface that is down, and the way back: who is told what, and when."""

from __future__ import annotations

import errno
from typing import Any

import can
import pytest

from canfb.bus.bus_state import ERROR_BUS_OFF, ERROR_RESTARTED, LASTING_S, RETRY_S, SETTLED_S
from canfb.bus.runner import Runner
from canfb.cia301.frame import Frame
from canfb.errors import reason
from fake_bus import FakeBus, FakeClock, FakeDevice, each_kind_of_bus, frame_bus, message  # noqa: F401

BUS_OFF = message(ERROR_BUS_OFF | 0x200, bytes(8), is_error_frame=True)
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
    clock = FakeClock()
    bus = FakeBus(clock, plan)
    bus.refuse, bus.end_s = refuse, duration_s
    lines: list[str] = []
    device = Watching(clock)
    made = [one(clock) if callable(one) else one for one in others]
    devices = [device, *made, *(FakeDevice(clock, period_s=period_s) for period_s in periods_s)]
    fake: Any = bus
    runner = Runner(frame_bus(fake), devices, lines.append, clock, clock.sleep)
    runner.run(finished=lambda: bus.at >= duration_s)
    return device, bus, lines


GONE = can.CanOperationError("the adapter is gone")
UNPACKED = can.CanOperationError("could not unpack")
DOWNS = [DOWN, *(OSError(code, "down") for code in (errno.ENETDOWN, errno.ENODEV, errno.ENXIO))]
SHORT = [(1.0 + 0.1 * n, RESTARTED if n % 2 else BUS_OFF) for n in range(20)]  # a short circuit, restart-ms

# What happens; when the device hears of it: (off), (off, back), ...; and the lines, None: not looked at.
SCENES: dict[str, tuple[list[Any], dict[str, Any], list[float], list[str] | None]] = {
    "an automatic restart": (
        [(1.0, BUS_OFF), (1.1, RESTARTED)],
        {},
        [1.0, 1.1 + SETTLED_S],
        [OFF_LINE, ON_LINE],
    ),
    "twice": (
        [(1.0, BUS_OFF), (1.1, RESTARTED), (5.0, BUS_OFF), (5.1, RESTARTED)],
        {},
        [1.0, 1.1 + SETTLED_S, 5.0, 5.1 + SETTLED_S],
        [OFF_LINE, ON_LINE] * 2,
    ),
    "nobody restarts it": ([(1.0, BUS_OFF)], {}, [1.0], [OFF_LINE]),
    "several are one": ([(1.0, BUS_OFF), (1.01, BUS_OFF), (1.02, BUS_OFF)], {}, [1.0], None),
    "error frames are no life": ([(1.0, BUS_OFF), (1.1, WARNING), (1.2, WARNING)], {}, [1.0], None),
    "a driver's queue is none": ([(1.0, BUS_OFF)], sending(lambda at: None, 0.1), [1.0], None),
    "a frame that was received": ([(1.0, BUS_OFF), (3.0, FRAME)], {}, [1.0, 3.0 + SETTLED_S], None),
    "warnings": ([(0.1 * n, WARNING) for n in range(1, 20)], {}, [], []),
    "frames": ([(0.1 * n, FRAME) for n in range(1, 20)], {}, [], []),
    # SocketCAN says it once to the reader; then nothing comes, and sending fails.
    "down": (
        [(1.0, DOWN)],
        sending(lambda at: DOWN if 1.0 <= at < 4.0 else None, 0.5),
        [1.0, 4.0 + SETTLED_S],
        [DOWN_LINE, "the bus works again"],
    ),
    "reading fails on and on": (
        [*((1.0, GONE) for _ in range(10)), (5.0, FRAME)],
        {},
        [1.0 + LASTING_S, 5.0 + SETTLED_S],
        None,
    ),
    "bad datagrams": ([(0.1 * n, UNPACKED if n % 2 else FRAME) for n in range(1, 60)], {}, [], None),
    **{
        f"sending fails: {error!r}": (
            [],
            sending(lambda at, error=error: error if at < 1.05 else None, 0.5),
            [0.5, 1.5 + SETTLED_S],
            None,
        )
        for error in DOWNS
    },
    # With nobody on the bus who acknowledges the controller is passive, but not off.
    **{
        f"a full queue: {error}": ([], sending(lambda at, error=error: error, 0.1), [], None)
        for error in (FULL, GONE)
    },
}


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
