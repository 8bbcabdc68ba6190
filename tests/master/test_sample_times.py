"""Samples with their times: from the ADC PDO of a bus whose SYNC jitters, into file and calibration."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.cli.calibrate import over_bus
from canfb.cli.main import build_parser
from canfb.cli.printing import Progress
from canfb.configuration import Config
from canfb.master.all_or_nothing import Guard
from canfb.master.samples import PdoRecorder, TrackSamples, listen, read_npz, write_npz
from canfb.master.session import agreed_layout
from canfb.simulation.sync_producer import SyncTiming
from canfb.view.module_view import PdoLayout
from commissioning_kit import Bench, random_encoder

JITTER = SyncTiming(sync_jitter_us=100.0, sync_drift_ppm=-50.0)
TIMED = PdoLayout(0x190, 0, 2, 0x80, 4)


def pdo(ticks: int) -> bytes:
    return struct.pack("<hhI", 1, 2, ticks % (1 << 32))


def test_the_times_of_the_interface_are_heard_and_unwrapped() -> None:
    bench = Bench(timing=JITTER)
    layout = agreed_layout(bench.access, bench.interface_access)
    assert layout == TIMED
    samples = listen(bench.master, layout, 0.5)
    assert samples.time_s is not None
    steps = np.diff(samples.time_s)
    assert len(samples.time_s) == len(samples) > 400
    assert 0.8e-3 < steps.min() < 0.85e-3
    assert 1.15e-3 < steps.max() < 1.21e-3
    assert steps.mean() == pytest.approx(1.00015e-3, abs=1e-6)


@given(
    st.integers(0, (1 << 32) - 1),
    st.lists(st.integers(9_000, 11_000), min_size=2, max_size=40),
    st.sets(st.integers(0, 40), max_size=20),
)
def test_a_missed_sample_has_a_time_between_its_neighbours(
    start: int, steps: list[int], lost: set[int]
) -> None:
    recorder, at = PdoRecorder(TIMED), [start]
    for step in steps:
        at.append(at[-1] + step)
    for n, ticks in enumerate(at):
        recorder.on_sync(0x80, b"", ticks * 1e-7)
        if n not in lost:
            recorder.on_pdo(0x190, pdo(ticks), ticks * 1e-7)
    recorder.on_sync(0x80, b"", (at[-1] + 10_000) * 1e-7)
    samples = recorder.result("here")
    came = [n for n in range(len(at)) if n not in lost]
    if len(came) < 2:
        assert samples.time_s is None
        return
    assert samples.time_s is not None
    assert (np.diff(samples.time_s) > 0.0).all()
    assert samples.time_s[came] == pytest.approx([(at[n] - at[came[0]]) * 1e-7 for n in came], abs=1e-9)


def test_a_pdo_without_its_time_has_none() -> None:
    assert TIMED.sample_time(pdo(77)) == 77
    assert TIMED.sample_time(b"\0" * 7) is None
    assert PdoLayout(0x190).sample_time(pdo(77)) is None


def test_the_times_are_kept_in_the_file(tmp_path: Path) -> None:
    plain = TrackSamples.of([1.0, 2.0, 3.0], [4.0, 5.0, 6.0], 1000.0, "here")
    write_npz(tmp_path / "plain.npz", plain)
    assert read_npz(tmp_path / "plain.npz").time_s is None
    write_npz(tmp_path / "timed.npz", plain.timed([0xFFFFFFF0, None, 19_990]))
    read = read_npz(tmp_path / "timed.npz").time_s
    assert read is not None
    assert read == pytest.approx([0.0, 1.0003e-3, 2.0006e-3], abs=1e-9)


@pytest.mark.parametrize("rpm", [40.0, 600.0])
def test_calibrating_on_a_bus_that_jitters(rpm: float, capsys: pytest.CaptureFixture[str]) -> None:
    """Equidistant they would be refused: 100 us are 2.5 cycles at 600 rpm."""
    bench = Bench(random_encoder(3), rpm=rpm, timing=JITTER)
    bench.access.write(0x1006, 0, "I", 1000)
    bench.bus.run_until(0.2)
    options = build_parser().parse_args(["calibrate", "--seconds", "5", "--json"])
    assert over_bus(bench.master, options, Config(), Progress(quiet=True), Guard(), "2026-03-01") == 0
    figures = json.loads(capsys.readouterr().out)
    noise = bench.encoder.noise_lsb / (2 * np.pi * bench.encoder.amplitude_counts)
    stamps = rpm / 60 * 2500 * 100e-9 / 12**0.5
    assert figures["residual_rms_cycles"] < 2.0 * np.hypot(noise, stamps) + 5e-5
