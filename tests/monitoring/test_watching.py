"""The monitor at a bus and at a log: snapshots in time, nothing sent unless asked, and then what changes."""

import struct
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import can
import pytest

import canfb
from canfb import CanfbError, Conditioning, Config, objects as od
from canfb.master.access import NodeAccess
from canfb.master.all_or_nothing import put_in_force
from canfb.monitoring.bus_model import BusModel
from canfb.monitoring.layout import Origin, known_layouts
from canfb.monitoring.sdo_reading import CYCLE_S, LAYOUT_S, QUIET_S, REPEATED, ModuleReader, ModuleReading
from canfb.monitoring.snapshot import BusSnapshot, NodeSnapshot
from canfb.monitoring.watching import MessageReader, Watching
from canfb.signal.correction import NO_CORRECTION, Correction, CorrectionTable
from commissioning_kit import MODULE_ID, Bench
from fake_bus import FakeBus, FakeClock, message
from ideal_tracks import wavy_table

NODE = 0x20


def position(k: int) -> bytes:
    return struct.pack("<IHH", k * 1000, 1, 100)


class Monitor:
    """The monitor at a fake bus or at a log, in a time of its own; what it showed."""

    def __init__(self, seconds: float | None = None, model: BusModel | None = None) -> None:
        self.clock, self.shown = FakeClock(), list[BusSnapshot]()
        reader = MessageReader(seconds, self.clock, self.clock, self.clock.sleep)
        model = model or BusModel(known_layouts(Config(), [NODE]))
        self.watching = Watching(model, self.shown.append, 5.0, reader)

    def opened(self, *plan: tuple[float, can.Message | Exception]) -> FakeBus:
        bus = FakeBus(self.clock, plan)
        self.watching.opened(cast(Any, bus))
        return bus


def test_snapshots_come_at_their_rate_and_nothing_is_sent() -> None:
    plan: list[tuple[float, can.Message | Exception]] = []
    for k in range(2000):
        at = k * 1e-3
        plan.append((at, message(0x080, timestamp=1000.0 + at)))
        plan.append((at + 5e-4, message(0x1A0, position(k), timestamp=1000.0 + at + 5e-4)))
    monitor = Monitor(2.0)
    bus = monitor.opened(*plan)
    assert [one.time_s for one in monitor.shown] == pytest.approx([0.2 * n for n in range(1, 11)], abs=2e-3)
    assert bus.sent == []
    last = monitor.shown[-1]
    assert last.sync.rate_hz == pytest.approx(1000.0, rel=1e-6)
    ((_, module),) = last.modules
    assert module.position_units == pytest.approx(1_999_000, abs=2000)


def test_error_frames_and_long_identifiers_are_counted_only() -> None:
    extended = can.Message(arbitration_id=0x180 + NODE, data=position(9), is_extended_id=True)
    monitor = Monitor(0.5)
    monitor.opened((0.05, can.Message(is_error_frame=True)), (0.06, extended))
    last = monitor.shown[-1]
    assert last.error_frames == 1
    assert last.load.frames_per_s > 0.0
    assert last.modules[0][1].age_s is None


def test_what_was_read_by_sdo_counts_from_the_next_snapshot_on() -> None:
    (layout,) = known_layouts(Config(modules=[canfb.ModuleConfig(node_id=NODE, cycles_per_revolution=512)]))
    monitor, cause = Monitor(1.0), od.LossCause.COASTED
    read = {od.COUNTER_MISSED: 3, od.FEEDBACK_STATUS: od.StatusBit.LOST, od.COUNTER_LOSS_CAUSE: cause}
    monitor.watching.put(ModuleReading(read, replace(layout, origin=Origin.MODULE)))
    monitor.opened()
    ((_, first),) = monitor.shown[0].modules
    assert (first.layout, first.counters, first.lost_by) == ("module", {"missed": 3}, cause.text)
    assert len(monitor.shown) == 5, "of a silent bus"


@pytest.mark.parametrize("ending", ["blf", "log"])
def test_a_log_of_any_format_in_its_own_time(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"drive.{ending}"
    with can.Logger(path) as writer:
        for k in range(300):
            at = 1_700_000_000.0 + k * 0.01
            writer(message(0x080, timestamp=at))
            writer(message(0x1A0, position(k), timestamp=at + 0.002))
    monitor = Monitor()
    monitor.watching.log(path)
    shown = monitor.shown
    assert monitor.clock.slept == [], "as fast as it can be read"
    assert [one.time_s for one in shown[:-1]] == pytest.approx([0.2 * n for n in range(1, 15)])
    assert shown[-1].time_s == pytest.approx(2.992, abs=2e-3)
    assert shown[-1].sync.rate_hz == pytest.approx(100.0, rel=1e-3)
    assert shown[-1].modules[0][1].position_units == 299_000


def test_a_log_can_be_played_at_a_speed_and_pauses_are_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    with can.Logger(path) as writer:
        for at in (100.0, 100.5, 101.0, 90_000.0, 90_000.5):
            writer(message(0x1A0, position(1), timestamp=at))
    monitor = Monitor(model=BusModel())
    monitor.watching.log(path, speed=1.0)
    assert len(monitor.shown) < 12
    assert monitor.clock.slept == [0.1, 0.1] * (len(monitor.shown) - 1), "a signal is noticed between"


def test_a_time_that_is_no_number_is_that_of_the_frame_before(tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    times_s = ("5.0", "1e400", "5.2", "1e999", "5.4", "1e17")
    path.write_text("".join(f"({time_s}) can0 1A0#{position(1).hex()}\n" for time_s in times_s))
    monitor = Monitor()
    monitor.watching.log(path)
    assert monitor.shown[-1].time_s == pytest.approx(0.4)
    assert [at for at, _ in MessageReader().log(path)] == pytest.approx([0.0, 0.0, 0.2, 0.2, 0.4, 0.4])


@pytest.mark.parametrize(("name", "text"), [("drive.log", "no frame in it"), ("drive.asc", "; 1 damaged")])
def test_what_is_no_log_is_one_line(name: str, text: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(b"" if name == "drive.log" else b"\0\1\2nothing\n")
    with pytest.raises(CanfbError, match=text) as raised:
        Watching(BusModel(), lambda snapshot: None, 5.0).log(path)
    assert "\n" not in str(raised.value)


TABLE = wavy_table()


class Watched:
    """A module on a bench whose frames a model takes, and a reader beside it."""

    def __init__(self, **config: Any) -> None:
        self.bench = Bench(config=config)
        self.model = BusModel(known_layouts(Config(modules=[self.bench.module.config])))
        self.bench.bus.observers.append(self.model.receive)
        self.reader = ModuleReader(MODULE_ID, with_table=True)
        self.passed_s = 0.0

    @property
    def node(self) -> NodeSnapshot:
        ((node, _),) = self.model.snapshot(self.bench.bus.now).modules
        return node

    def read(self) -> ModuleReading | None:
        """If it is due; the model takes it."""
        now, node = self.bench.bus.now + self.passed_s, self.node
        self.bench.master.sent.clear()
        if not self.reader.due(now, node):
            return None
        reading = self.reader.read(self.bench.access, now, node)
        module = self.model.learn(reading.layout)
        for place, value in reading.values.items():
            module.put(place, value, now)
        return reading

    def asked(self) -> list[tuple[int, int]]:
        """Objects that the last reading asked for."""
        starts = [frame.data for frame in self.bench.master.sent if frame.data[0] >> 5 in (2, 5)]
        return [(int.from_bytes(data[1:3], "little"), data[3]) for data in starts if data[1:3] != b"\0\0"]

    def run(self, seconds: float) -> None:
        self.bench.bus.run_until(self.bench.bus.now + seconds)


def test_mapping_counters_and_table_are_those_of_the_module() -> None:
    watched = Watched(adc_bits=14)
    watched.bench.module.dictionary.entry(*od.COUNTER_MISSED).value = 7
    reading = watched.read()
    assert reading is not None
    assert (reading.layout.origin, reading.layout.supervision.sample.full_scale_counts) == ("module", 8192)
    assert reading.layout.assumed == frozenset()
    assert reading.values[od.COUNTER_MISSED] == 7
    assert reading.correction == NO_CORRECTION
    assert set(reading.values) == set(REPEATED), "no PDO has come yet"
    assert {frame.can_id for frame in watched.bench.master.sent} == {0x600 + MODULE_ID}


def test_without_a_change_little_is_read_and_seldom() -> None:
    watched = Watched()
    watched.run(0.05)
    assert watched.read()
    first = len(watched.asked())
    watched.passed_s += 0.9 * CYCLE_S
    assert watched.read() is None
    watched.passed_s += 0.2 * CYCLE_S
    assert watched.read()
    again = watched.asked()
    assert len(again) == len(REPEATED), "the conditioning in place of the status word; no mapping"
    assert len(again) < 0.5 * first
    watched.passed_s += LAYOUT_S
    assert watched.read()
    assert len(watched.asked()) > 0.5 * first, "limits may have been changed"


@pytest.mark.parametrize("active", [Correction(TABLE), Correction(TABLE, Conditioning(3.0)), NO_CORRECTION])
def test_a_table_that_others_activate_is_read_at_once(active: Correction) -> None:
    """By bit 7 of the status word; from table to table by the CRC, within CYCLE_S."""
    watched = Watched()
    before = Correction(CorrectionTable.identity(64)) if active == NO_CORRECTION else NO_CORRECTION
    put_in_force(watched.bench.access, before)
    watched.run(0.05)
    assert watched.read()
    put_in_force(watched.bench.access, active)
    watched.run(0.05)
    reading = watched.read()
    assert reading is not None
    assert reading.correction == active
    put_in_force(watched.bench.access, Correction(TABLE, Conditioning(0.0, 5.0)))
    watched.passed_s += 1.1 * CYCLE_S
    reading = watched.read()
    assert reading is not None
    assert reading.correction == Correction(TABLE, Conditioning(0.0, 5.0))


def test_a_node_that_does_not_answer_is_left_alone_and_asked_again() -> None:
    watched = Watched()
    access, watched.bench.access = watched.bench.access, NodeAccess(watched.bench.master, 99, "module")
    with pytest.raises(CanfbError, match="no answer"):
        watched.read()
    watched.bench.access = access
    watched.passed_s += 0.9 * QUIET_S
    assert watched.read() is None
    watched.passed_s += 0.2 * QUIET_S
    assert watched.read()
