"""The monitor at a bus and at a log: snapshots in time, and nothing sent unless asked."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import can
import pytest

import canfb
from canfb import objects as od
from canfb.configuration import Config
from canfb.errors import CanfbError
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


class Watched:
    """The monitor at a fake bus or at a log, in a time of its own; what it showed."""

    def __init__(self, seconds: float | None = None, model: BusModel | None = None) -> None:
        self.clock, self.shown = FakeClock(), list[BusSnapshot]()
        reader = MessageReader(seconds, self.clock, self.clock, self.clock.sleep)
        model = model or BusModel(known_layouts(Config(), [NODE]))
        self.watching = Watching(model, self.shown.append, 5.0, reader)

    def opened(self, *plan: tuple[float, can.Message | Exception]) -> FakeBus:
        bus: Any = FakeBus(self.clock, plan)
        self.watching.opened(bus)
        fake: FakeBus = bus
        return fake


def test_snapshots_come_at_their_rate_and_nothing_is_sent() -> None:
    plan: list[tuple[float, can.Message | Exception]] = []
    for k in range(2000):
        at = k * 1e-3
        plan.append((at, message(0x080, timestamp=1000.0 + at)))
        plan.append((at + 5e-4, message(0x1A0, position(k), timestamp=1000.0 + at + 5e-4)))
    watched = Watched(2.0)
    bus = watched.opened(*plan)
    assert [one.time_s for one in watched.shown] == pytest.approx([0.2 * n for n in range(1, 11)], abs=2e-3)
    assert bus.sent == []
    last = watched.shown[-1]
    assert last.sync.rate_hz == pytest.approx(1000.0, rel=1e-6)
    ((_, module),) = last.modules
    assert module.position_units == pytest.approx(1_999_000, abs=2000)


def test_error_frames_and_long_identifiers_are_counted_only() -> None:
    extended = can.Message(arbitration_id=0x180 + NODE, data=position(9), is_extended_id=True)
    watched = Watched(0.5)
    watched.opened((0.05, can.Message(is_error_frame=True)), (0.06, extended))
    last = watched.shown[-1]
    assert last.error_frames == 1
    assert last.load.frames_per_s > 0.0
    assert last.modules[0][1].age_s is None


def test_what_was_read_by_sdo_counts_from_the_next_snapshot_on() -> None:
    module = canfb.ModuleConfig(node_id=NODE, cycles_per_revolution=512)
    (layout,) = known_layouts(Config(modules=[module]))
    watched = Watched(1.0)
    watched.watching.put(ModuleReading(NODE, {od.COUNTER_MISSED: 3}, replace(layout, origin=Origin.MODULE)))
    watched.opened()
    ((_, first),) = watched.shown[0].modules
    assert (first.layout, first.counters) == ("module", {"missed": 3})
    assert len(watched.shown) == 5, "of a silent bus"


@pytest.mark.parametrize("ending", FORMATS)
def test_a_log_of_any_format_in_its_own_time(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"drive.{ending}"
    with can.Logger(path) as writer:
        for k in range(300):
            at = 1_700_000_000.0 + k * 0.01
            writer(message(0x080, timestamp=at))
            writer(message(0x1A0, position(k), timestamp=at + 0.002))
    watched = Watched()
    watched.watching.log(path)
    shown = watched.shown
    assert watched.clock.slept == [], "as fast as it can be read"
    assert [one.time_s for one in shown[:-1]] == pytest.approx([0.2 * n for n in range(1, 15)])
    assert shown[-1].time_s == pytest.approx(2.992, abs=2e-3)
    assert shown[-1].sync.rate_hz == pytest.approx(100.0, rel=1e-3)
    assert shown[-1].modules[0][1].position_units == 299_000


def test_a_log_can_be_played_at_a_speed_and_pauses_are_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    with can.Logger(path) as writer:
        for at in (100.0, 100.5, 101.0, 90_000.0, 90_000.5):
            writer(message(0x1A0, position(1), timestamp=at))
    watched = Watched(model=BusModel())
    watched.watching.log(path, speed=2.0)
    assert len(watched.shown) < 12
    assert set(watched.clock.slept) == {0.1}


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
