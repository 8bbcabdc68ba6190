"""Reading by SDO against a real module: what no PDO carries, no more often than something changes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from canfb import objects as od
from canfb.configuration import Config
from canfb.errors import CanfbError
from canfb.master.access import NodeAccess
from canfb.master.all_or_nothing import put_in_force
from canfb.monitoring.bus_model import BusModel
from canfb.monitoring.layout import known_layouts
from canfb.monitoring.sdo_reading import (
    CYCLE_S,
    LAYOUT_S,
    QUIET_S,
    REPEATED,
    ModuleReader,
    ModuleReading,
)
from canfb.monitoring.snapshot import NodeSnapshot
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import NO_CORRECTION, Correction, CorrectionTable
from commissioning_kit import MODULE_ID, Bench

ENTRIES = np.arange(64) / 64
TABLE = CorrectionTable(ENTRIES + 0.01 * np.sin(2 * np.pi * ENTRIES))


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
        self.model.learn(reading.layout)
        for place, value in reading.values.items():
            self.model.put(MODULE_ID, place, value, now)
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
    assert (reading.layout.origin, reading.layout.full_scale_counts) == ("module", 8192)
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
    before = Correction(CorrectionTable(ENTRIES)) if active == NO_CORRECTION else NO_CORRECTION
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
