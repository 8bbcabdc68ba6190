"""What the pictures are drawn from, against a simulated encoder whose errors are known."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import canfb
from canfb import objects as od
from canfb.configuration import Config
from canfb.monitoring.layout import known_layouts
from canfb.monitoring.lines import MachineUnits
from canfb.monitoring.sdo_reading import ModuleReading
from canfb.monitoring.snapshot import ModuleSnapshot
from canfb.scope.live_page import LivePage
from canfb.scope.traces import EVERY_S, LEAST_SAMPLES, LONGEST_S, ModuleTraces
from canfb.signal.correction import NO_CORRECTION, Correction
from monitored_network import NODE, MonitoredNetwork

UNITS = MachineUnits(5.0, "mm")


class Traced:
    """A network whose module is looked at five times a second."""

    def __init__(self) -> None:
        self.network, self.traces = MonitoredNetwork(), ModuleTraces(UNITS)

    def run(self, seconds: float) -> None:
        end = self.network.bus.now + seconds
        while self.network.bus.now < end:
            self.network.run(0.2)
            self.traces.take(self.network.bus.now, self.network.module())


def test_position_velocity_residual_amplitude_and_faults_are_followed() -> None:
    traced = Traced()
    traced.run(3.0)
    points = np.array(traced.traces.points, float)
    assert len(points) == 15
    time_s, position, velocity, residual, limit, amplitude, raw, faults, invalid = points[-5:].T
    assert np.ptp(time_s) == pytest.approx(0.8)
    assert velocity == pytest.approx(63.7 / 60 * 5.0, rel=0.02)
    assert np.diff(position) == pytest.approx(0.2 * 63.7 / 60 * 5.0, rel=0.02)
    assert (residual > 0.0).all()
    assert limit == pytest.approx(1 / 3, abs=1e-4)
    assert np.isnan(amplitude).all(), "2011:05 is not read"
    assert (np.abs(raw - 1500) < 200).all()
    assert not np.concatenate([faults, invalid]).any()
    traced.network.source.lost = True
    traced.run(0.2)
    _, position, velocity, *_, faults, invalid = traced.traces.points[-1]
    assert (position, velocity, invalid) == (None, None, 1)
    assert faults
    assert faults > 0


def test_what_is_remembered_is_bounded_and_a_clock_that_is_set_begins_again() -> None:
    traces, module = ModuleTraces(UNITS), ModuleSnapshot("EDS", age_s=0.0, position_revolutions=1.0)
    for k in range(2000):
        traces.take(0.2 * k, module)
    assert traces.points[-1][0] == pytest.approx(399.8)
    assert LONGEST_S - 0.5 < 399.8 - (traces.points[0][0] or 0.0) <= LONGEST_S
    traces.take(1.0, module)
    assert len(traces.points) == 1


def test_the_deviation_is_that_of_the_encoder_and_nearly_gone_with_its_table() -> None:
    traced = Traced()
    traced.run(4.0)
    traces, now = traced.traces, traced.network.bus.now
    before = traces.deviation(now)
    assert before is not None
    assert traces.deviation(now + 0.9 * EVERY_S) is None
    rms = np.sqrt(np.mean(np.square(before["before"])))
    assert 0.5 < rms < 3.0  # % of a cycle: the encoder of the demo has 1.2
    assert set(before["mean"]) == {None}
    assert before["text"].startswith("no table is active: ")
    _, sine, cosine = np.array(traces._samples).T
    found = canfb.calibrate_from_motion(sine, cosine)
    traces.know(Correction(found.table, found.conditioning))
    traces.take(now, replace(traced.network.module(), table_active=True, table_crc32=found.table.crc32))
    after = traces.deviation(now)
    assert after is not None, "at once"
    assert np.abs(after["mean"]).max() < 0.2 * np.abs(after["before"]).max()
    assert f"with the active table {found.table.crc32:08X}h 0.0" in after["text"]


def test_the_table_has_one_state() -> None:
    """What was read counts only while bit 7 and 2020:04 agree with it."""
    table = canfb.CorrectionTable(np.arange(64) / 64)
    read = Correction(table)
    module = ModuleSnapshot("module", age_s=0.0, status=1)
    active = replace(module, table_active=True, table_crc32=table.crc32)
    for was_read, looks_like, known in (
        (None, module, NO_CORRECTION),
        (None, active, None),
        (read, active, read),
        (read, replace(active, table_crc32=7), None),
        (read, replace(active, table_active=False), NO_CORRECTION),
        (NO_CORRECTION, replace(module, table_crc32=0), NO_CORRECTION),
        (NO_CORRECTION, replace(active, table_crc32=0), None),
        (None, replace(module, status=None), None),
        (read, replace(module, status=None, table_crc32=table.crc32), read),
    ):
        traces = ModuleTraces(UNITS)
        if was_read is not None:
            traces.know(was_read)
        traces.take(1.0, looks_like)
        assert traces.correction == known


def test_there_is_no_deviation_of_few_samples_nor_at_standstill() -> None:
    traces = ModuleTraces(UNITS)
    module = ModuleSnapshot("EDS", full_scale_counts=2048)
    for n, why in enumerate([f"of {LEAST_SAMPLES} samples", *["only while the machine turns"] * 9]):
        for k in range(1 if n == 0 else 6):
            heard = 100 * (10 * n + k + 1)
            tracks = [(1000 + j % 3, 1000 - j % 2) for j in range(100)]
            traces.take(10.0 * n, replace(module, tracks_counts=tracks, tracks_heard=heard))
        curve = traces.deviation(10.0 * n)
        assert curve is not None
        assert why in curve["text"]


def told(events: bytes | None) -> dict[str, Any]:
    """The data of these events, by name."""
    assert events is not None
    found = {}
    for one in events.decode().split("\n\n")[:-1]:
        name, data = one.split("\n")
        found[name.removeprefix("event: ")] = json.loads(data.removeprefix("data: "))
    return found


def test_a_page_gets_the_past_then_each_look_with_what_was_read() -> None:
    network = MonitoredNetwork()
    page = LivePage(0, UNITS)
    with page.server:
        for _ in range(5):
            network.run(0.2)
            page.show(network.model.snapshot(network.bus.now))
        with page.server.viewer() as events:
            begin = told(events.get_nowait())
            assert begin["past"]["units"] == {"position": "mm", "velocity": "mm/s"}
            assert len(begin["past"]["points"][str(NODE)]) == 5
            assert begin["look"]["modules"][0]["point"] == begin["past"]["points"][str(NODE)][-1]
            (layout,) = known_layouts(Config(), [NODE])
            page.know(ModuleReading(NODE, {}, layout, NO_CORRECTION))
            network.model.put(NODE, od.COUNTER_LOST, 4, network.bus.now)
            network.run(0.2)
            page.show(network.model.snapshot(network.bus.now))
            look = told(events.get_nowait())["look"]
    (module,) = look["modules"]
    assert (module["node"], module["tone"]) == (NODE, "good")
    assert module["point"][0] == pytest.approx(1.2)
    assert dict(module["lines"])["status"] == [["valid", "good"]]
    assert ["lost", 4, 0] in module["counters"]
    assert len(module["tracks"]) == 400
    assert look["others"] == "16 OPERATIONAL"
    assert begin["look"]["modules"][0]["deviation"]["text"].startswith("no table is active")
