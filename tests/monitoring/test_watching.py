"""The monitor at a bus and at a log: snapshots in time, and nothing sent unless asked."""

from __future__ import annotations

import errno
import struct
from dataclasses import replace
from pathlib import Path

import can
import pytest

import canfb
from canfb import objects as od
from canfb.configuration import Config
from canfb.errors import BusError, CanfbError
from canfb.monitoring.bus_model import BusModel
from canfb.monitoring.layout import Origin, known_layouts
from canfb.monitoring.sdo_reading import ModuleReading
from canfb.monitoring.snapshot import BusSnapshot
from canfb.monitoring.watching import MessageReader, Watching
from fake_bus import FakeBus, FakeClock, message

NODE = 0x20
FORMATS = ("blf", "log")


def position(k: int) -> bytes:
    return struct.pack("<IHH", k * 1000, 1, 100)


def watched(
    plan: list[tuple[float, can.Message | Exception]], seconds: float, rate_hz: float = 5.0
) -> tuple[list[BusSnapshot], FakeBus]:
    clock = FakeClock()
    bus = FakeBus(clock, plan)
    shown: list[BusSnapshot] = []
    model = BusModel(known_layouts(Config(), [NODE]))
    reader = MessageReader(seconds, clock, clock, clock.sleep)
    Watching(model, shown.append, rate_hz, reader).opened(bus)  # type: ignore[arg-type]
    return shown, bus


def test_snapshots_come_at_their_rate_and_nothing_is_sent() -> None:
    plan: list[tuple[float, can.Message | Exception]] = []
    for k in range(2000):
        at = k * 1e-3
        plan.append((at, message(0x080, timestamp=1000.0 + at)))
        plan.append((at + 5e-4, message(0x1A0, position(k), timestamp=1000.0 + at + 5e-4)))
    shown, bus = watched(plan, 2.0)
    assert [one.time_s for one in shown] == pytest.approx([0.2 * n for n in range(1, 11)], abs=2e-3)
    assert bus.sent == []
    last = shown[-1]
    assert last.sync.rate_hz == pytest.approx(1000.0, rel=1e-6)
    ((_, module),) = last.modules
    assert module.position_units == pytest.approx(1_999_000, abs=2000)


def test_error_frames_and_long_identifiers_are_counted_only() -> None:
    extended = can.Message(arbitration_id=0x180 + NODE, data=position(9), is_extended_id=True)
    plan: list[tuple[float, can.Message | Exception]] = [
        (0.05, can.Message(is_error_frame=True)),
        (0.06, extended),
    ]
    shown, _ = watched(plan, 0.5)
    assert shown[-1].error_frames == 1
    assert shown[-1].load.frames_per_s > 0.0
    assert shown[-1].modules[0][1].age_s is None


def test_an_interface_that_is_down_is_waited_for() -> None:
    """It says so once, and when it is back; nothing spins meanwhile."""
    clock, said = FakeClock(), list[str]()
    down = can.CanOperationError("Error receiving: Network is down", errno.ENETDOWN)
    plan: list[tuple[float, can.Message | Exception]] = [(0.1, down), (0.2, OSError(errno.ENETDOWN, "down"))]
    plan += [(1.0 + n * 0.1, message(0x1A0, position(n), timestamp=1001.0 + n * 0.1)) for n in range(20)]
    shown: list[BusSnapshot] = []
    model = BusModel(known_layouts(Config(), [NODE]))
    reader = MessageReader(3.3, clock, clock, clock.sleep, said.append)
    Watching(model, shown.append, 5.0, reader).opened(FakeBus(clock, plan))  # type: ignore[arg-type]
    assert said == [f"the bus fails: {down}", "the bus works again"]
    assert clock.slept == [pytest.approx(0.2)]
    assert shown[-1].modules[0][1].position_units == 19_000


@pytest.mark.parametrize("error", [can.CanOperationError("gone"), OSError(errno.ENODEV, "gone")])
def test_a_bus_that_fails_is_one_line(error: Exception) -> None:
    with pytest.raises(BusError, match="the bus fails: gone"):
        watched([(0.1, error)], 1.0)


def test_what_was_read_by_sdo_counts_from_the_next_snapshot_on() -> None:
    module = canfb.ModuleConfig(node_id=NODE, cycles_per_revolution=512)
    (layout,) = known_layouts(Config(modules=[module]))
    shown: list[BusSnapshot] = []
    clock = FakeClock()
    reader = MessageReader(1.0, clock, clock, clock.sleep)
    watching = Watching(BusModel(known_layouts(Config(), [NODE])), shown.append, 5.0, reader)
    watching.put(ModuleReading(NODE, {od.COUNTER_MISSED: 3}, replace(layout, origin=Origin.MODULE)))
    watching.opened(FakeBus(clock))  # type: ignore[arg-type]
    ((_, first),) = shown[0].modules
    assert (first.layout, first.counters) == ("module", {"missed": 3})
    assert len(shown) == 5, "of a silent bus"


@pytest.mark.parametrize("ending", FORMATS)
def test_a_log_of_any_format_in_its_own_time(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"drive.{ending}"
    with can.Logger(path) as writer:
        for k in range(300):
            at = 1_700_000_000.0 + k * 0.01
            writer(message(0x080, timestamp=at))
            writer(message(0x1A0, position(k), timestamp=at + 0.002))
    shown: list[BusSnapshot] = []
    clock = FakeClock()
    model = BusModel(known_layouts(Config(), [NODE]))
    Watching(model, shown.append, 5.0, MessageReader(None, clock, clock, clock.sleep)).log(path)
    assert clock.slept == [], "as fast as it can be read"
    assert [one.time_s for one in shown[:-1]] == pytest.approx([0.2 * n for n in range(1, 15)])
    assert shown[-1].time_s == pytest.approx(2.992, abs=2e-3)
    assert shown[-1].sync.rate_hz == pytest.approx(100.0, rel=1e-3)
    assert shown[-1].modules[0][1].position_units == 299_000


def test_a_log_can_be_played_at_a_speed_and_pauses_are_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    with can.Logger(path) as writer:
        for at in (100.0, 100.5, 101.0, 90_000.0, 90_000.5):
            writer(message(0x1A0, position(1), timestamp=at))
    clock = FakeClock()
    shown: list[BusSnapshot] = []
    Watching(BusModel(), shown.append, 5.0, MessageReader(None, clock, clock, clock.sleep)).log(
        path, speed=2.0
    )
    assert len(shown) < 12
    assert set(clock.slept) == {0.1}


@pytest.mark.parametrize(
    ("name", "content", "text"),
    [
        ("drive.log", b"", "no frame in it"),
        ("drive.asc", b"\0\1\2nothing\n", "drive.asc: "),
        ("drive.odt", b"nothing", "unknown suffix"),
        ("none.log", None, "none.log: cannot be read: No such file"),
    ],
)
def test_what_is_no_log_is_one_line(name: str, content: bytes | None, text: str, tmp_path: Path) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(CanfbError, match=text) as raised:
        Watching(BusModel(), lambda snapshot: None, 5.0).log(path)
    assert "\n" not in str(raised.value)
