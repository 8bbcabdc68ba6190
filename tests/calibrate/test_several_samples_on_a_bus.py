"""`canfb calibrate` takes every sample of an interface that sends several for each SYNC."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from test_example_is_calibrated import calibrated

from canfb.cli.config_file import EXAMPLE
from canfb.master.listening import listen
from canfb.master.session import agreed_layout
from canfb.simulation.sync_producer import SyncTiming
from canfb.view.pdo_map import PdoLayout
from commissioning_kit import CYCLES, MODULE_ID, RATE_HZ, Bench
from folding import each

TIMING = SyncTiming(sync_jitter_us=20.0)


def bench(per_sync: int, *, times: bool = True) -> Bench:
    return Bench(config={"samples_per_sync": per_sync}, timing=TIMING if times else SyncTiming())


@pytest.mark.parametrize(
    ("per_sync", "expected"),
    [
        (2, PdoLayout(0x190, earlier=(PdoLayout(0x190, 4, 6),), timed_by=PdoLayout(0x290, time_byte=0))),
        (
            4,
            PdoLayout(
                0x190,
                earlier=(PdoLayout(0x190, 4, 6), PdoLayout(0x290), PdoLayout(0x290, 4, 6)),
                timed_by=PdoLayout(0x390, time_byte=0),
            ),
        ),
    ],
)
def test_the_layout_names_all_pdos(per_sync: int, expected: PdoLayout) -> None:
    network = bench(per_sync)
    assert agreed_layout(network.access, network.interface_access) == expected


@each("per_sync", [2, 3, 4])
def test_every_sample_is_heard_in_its_order(per_sync: int) -> None:
    network = bench(per_sync)
    layout = agreed_layout(network.access, network.interface_access)
    network.master.send(0x000, bytes((2, MODULE_ID)))  # stop it: the interface alone is heard
    samples = listen(network.master, layout, 1.0)
    assert samples.rate_hz == pytest.approx(RATE_HZ * per_sync, rel=1e-3)
    assert len(samples) % per_sync == 0
    assert samples.time_s is not None
    phase = np.arctan2(samples.sine, samples.cosine) / (2.0 * np.pi)
    there = np.isfinite(phase)
    apart = np.diff(samples.time_s)[there[1:] & there[:-1]]
    steps = np.diff(phase)[there[1:] & there[:-1]]
    speed = 10.0 * CYCLES  # 600 rpm, give or take 3 %
    away = (steps - speed * apart + 0.5) % 1.0 - 0.5
    locked = away[len(away) // 2 :]  # to SYNC, whose jitter of 20 us is half a cycle
    assert np.abs(locked).max() < 0.05 * speed / (RATE_HZ * per_sync) + 0.1
    assert samples.missed <= 2 * per_sync  # the first SYNC has none


def test_a_calibration_by_two_samples_for_each_sync(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = EXAMPLE.replace("    times: true", "    samples_per_sync: 2\n    times: true", 1)
    assert text != EXAMPLE
    module, _, took_s = calibrated(text, tmp_path)
    figures = json.loads(capsys.readouterr().out)
    assert figures["accepted"]
    assert figures["fresh_rms_cycles"] < 2e-4
    assert took_s < 110.0
    assert module.limits.samples_per_sync == 2
