"""What the pictures are drawn from, against a simulated encoder whose errors are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import canfb
from canfb.monitoring.snapshot import (
    BusSnapshot,
    LoadSnapshot,
    ModuleSnapshot,
    NodeSnapshot,
    SyncSnapshot,
)
from canfb.scope.traces import LEAST_SAMPLES, LONGEST_S, SAMPLES, BusTraces
from canfb.signal.correction import Correction
from monitored_network import NODE, MonitoredNetwork


def watched(seconds: float, network: MonitoredNetwork | None = None) -> tuple[MonitoredNetwork, BusTraces]:
    network, traces = network or MonitoredNetwork(), BusTraces()
    end = network.bus.now + seconds
    while network.bus.now < end:
        network.run(0.2)
        traces.take(network.model.snapshot(network.bus.now))
    return network, traces


def test_position_and_velocity_are_followed() -> None:
    network, traces = watched(3.0)
    moments = np.array(traces.of(NODE).points)
    assert len(moments) == 15
    assert np.isfinite(moments[-5:]).all()
    turning = moments[-5:, 2]
    assert turning == pytest.approx(63.7 / 60 * 2 * np.pi, rel=0.02)
    assert moments[-1, 0] - moments[0, 0] < LONGEST_S
    assert network.module().tracks_heard >= 2000


def test_the_deviation_is_that_of_the_encoder_and_nearly_gone_with_its_table() -> None:
    network, traces = watched(6.0)
    module = traces.of(NODE)
    before = module.deviation(network.bus.now)
    assert before.note == ""
    assert not before.with_table
    assert 0.5 < before.before_rms < 3.0  # % of a cycle: the encoder of the demo has 1.2
    _, sine, cosine = np.array(module._samples).T
    found = canfb.calibrate_from_motion(sine, cosine)
    module.know(Correction(found.table, found.conditioning))
    after = module.deviation(network.bus.now)
    assert after.with_table
    assert 0.002 < after.rms < 0.1 * before.before_rms
    assert after.before_rms == pytest.approx(before.before_rms, rel=0.2)
    assert np.nanmax(np.abs(after.mean)) < 0.2 * np.nanmax(np.abs(after.before))


def test_there_is_none_of_few_samples() -> None:
    network, traces = watched(0.2)
    assert f"of {LEAST_SAMPLES} samples" in traces.of(NODE).deviation(network.bus.now).note


def test_there_is_none_at_standstill() -> None:
    traces = BusTraces()
    module = ModuleSnapshot("EDS", full_scale_counts=2048)
    for n in range(10):
        heard = 100 * (n + 1)
        tracks = [(1000 + k % 3, 1000 - k % 2) for k in range(100)]
        still = replace(module, tracks_counts=tracks, tracks_heard=heard)
        look = BusSnapshot(float(n), SyncSnapshot(), LoadSnapshot(), [NodeSnapshot(NODE, module=still)])
        traces.take(look)
    assert "only while the machine turns" in traces.of(NODE).deviation(10.0).note


def test_samples_that_were_not_seen_leave_a_gap() -> None:
    network, traces = watched(1.0)
    network.run(1.5)  # a thousand more than are remembered
    traces.take(network.model.snapshot(network.bus.now))
    places = np.array(traces.of(NODE)._samples)[:, 0]
    assert (np.diff(places) > 10).sum() == 1
    assert len(places) <= SAMPLES
