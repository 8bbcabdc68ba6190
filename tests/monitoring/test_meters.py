"""Rate, jitter and load against what was put in."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.cia301.frame import Frame, frame_bits
from canfb.monitoring.bus_model import BusModel
from canfb.monitoring.module_model import Bins, SyncMeter
from monitored_network import BIT_RATE, MonitoredNetwork


def test_the_load_is_that_of_the_frames_that_were_there() -> None:
    network = MonitoredNetwork()
    network.run(2.05)
    load = network.model.snapshot(network.bus.now).load
    of_it = [frame for frame, now in network.frames if 1.0 <= now < 2.0]
    assert load.frames_per_s == pytest.approx(len(of_it), abs=1)
    assert load.bits_per_s == pytest.approx(sum(frame_bits(len(frame.data)) for frame in of_it), abs=140)
    assert load.load == pytest.approx(load.bits_per_s / BIT_RATE)


def test_a_full_bus_is_a_load_of_one() -> None:
    model = BusModel(bit_rate=125_000)
    now = 0.0
    while now < 3.0:
        model.receive(Frame(0x123, bytes(8)), now)
        now += frame_bits(8) / 125_000
    assert model.snapshot(now).load.load == pytest.approx(1.0, abs=0.01)
    assert model.snapshot(now + 2.0).load.load == 0.0
    assert BusModel().snapshot().load.load is None, "no bit rate"


@pytest.mark.parametrize("jitter_us", [0.0, 5.0, 50.0])
@pytest.mark.parametrize("period_s", [1e-3, 2.5e-3, 10e-3])
def test_jitter_that_is_known_is_measured(jitter_us: float, period_s: float) -> None:
    draw, meter = random.Random(7), SyncMeter()
    errors = []
    for k in range(600):
        errors.append(draw.uniform(-jitter_us, jitter_us) * 1e-6)
        if k % 97 != 5:  # not all are heard
            meter.sync(1e9 * 0.0 + k * period_s + errors[-1])
    seen = meter.snapshot(600 * period_s)
    assert seen.rate_hz == pytest.approx(1.0 / period_s, rel=1e-4)
    assert seen.jitter_rms_s == pytest.approx(jitter_us * 1e-6 / math.sqrt(3.0), rel=0.08, abs=1e-9)
    assert seen.jitter_peak_s == pytest.approx(jitter_us * 1e-6, rel=0.06, abs=1e-9)


@pytest.mark.parametrize("period_s", [0.15, 0.5, 1.0])
def test_a_slow_sync_and_one_that_changes_its_rate_have_one(period_s: float) -> None:
    meter, now = SyncMeter(), 0.0
    for rate in (1.0, 0.4, 2.0):
        for _ in range(20):
            now += period_s * rate
            meter.sync(now)
        seen = meter.snapshot(now)
        assert seen.rate_hz == pytest.approx(1.0 / (period_s * rate), rel=1e-4)
        assert seen.jitter_peak_s == pytest.approx(0.0, abs=1e-9)


def test_duplicates_and_silence() -> None:
    meter = SyncMeter()
    assert meter.snapshot(1.0).silent_s is None
    for k in range(100):
        meter.sync(k * 1e-3)
        if k % 10 == 0:
            meter.sync(k * 1e-3 + 1e-5)
    assert meter.snapshot(0.1).rate_hz == pytest.approx(1000.0, rel=1e-3)
    silent = meter.snapshot(5.0)
    assert silent.rate_hz is None
    assert silent.silent_s == pytest.approx(4.901)


@given(st.lists(st.floats(-1e6, 1e6), max_size=50), st.floats(-1e6, 1e6))
def test_whatever_times_syncs_have(times: list[float], now: float) -> None:
    meter = SyncMeter()
    for time_s in times:
        meter.sync(time_s)
    seen = meter.snapshot(now)
    assert seen.rate_hz is None or seen.rate_hz > 0.0


@given(st.lists(st.tuples(st.floats(0.0, 3.0), st.floats(0.0, 0.5)), min_size=1, max_size=100))
def test_the_history_has_the_peak_of_each_interval(steps: list[tuple[float, float]]) -> None:
    history, now, truth = Bins(0.5, 20, max), 0.0, dict[int, float]()
    for step, value in steps:
        now += step
        history.add(value, now)
        number = math.floor(now / 0.5)
        truth[number] = max(truth.get(number, 0.0), value)
    values = history.values(now)
    last = math.floor(now / 0.5)
    assert len(values) <= 20
    assert values == [truth.get(number) for number in range(last - len(values) + 1, last + 1)]
    assert values[-1] is not None
