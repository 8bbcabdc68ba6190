"""The source of a module, opened as the configuration has it."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pytest

from canfb.cia301.frame import Frame
from canfb.cli.printing import printed_log
from canfb.configuration import parse_config
from canfb.errors import CanfbError
from canfb.hosting.hosting import make_module, open_source
from canfb.master.samples import TrackSamples, write_npz
from canfb.signal.sample import Sample
from canfb.signal.supervision import VALID
from canfb.sources.protocol import Source, SourceEnded


def opened(source: str, more: str = "") -> Source:
    config = parse_config(f"modules: [{{node_id: 32, source: {source}}}]\n{more}")
    (module,) = config.modules
    assert module.source is not None
    with contextlib.ExitStack() as resources:
        return open_source(module, module.source, config, resources)[1]


def played(source: Source) -> list[Sample | None]:
    samples: list[Sample | None] = []
    with contextlib.suppress(SourceEnded):
        while len(samples) < 100:
            samples.append(source.next())
    return samples


def test_without_one_the_samples_come_from_the_pdo() -> None:
    (module,) = parse_config("modules: [{node_id: 32, source: null}]").modules
    assert module.source is None


def test_the_motion_is_that_of_the_simulation() -> None:
    simulation = (
        "simulation: {encoder: {amplitude: 0.5, noise_lsb: 0}, motion: {standstill_s: 0, ramp_s: 0, rpm: 6}}"
    )
    samples = played(opened("{kind: motion, rate_hz: 500}", simulation))
    # 6 rpm of 2500 cycles at 500 Hz: half a cycle for each sample.
    assert samples[:3] == [Sample(0, 1024), Sample(0, -1024), Sample(0, 1024)]


@pytest.fixture
def tracks(tmp_path: Path) -> Path:
    path = tmp_path / "tracks.csv"
    path.write_text("t,a,b\n0,2048,2049\n0.001,2050,2051\n5,2052,2053\n6.5e2,2054,2055\n")
    return path


def test_a_recording_in_columns(tracks: Path) -> None:
    source = f"{{kind: recording, file: {tracks}, columns: [a, 2], mid_scale: 2048}}"
    assert played(opened(source)) == [Sample(2 * n, 2 * n + 1) for n in range(4)]


def test_a_recording_with_gaps_and_times(tracks: Path) -> None:
    layout = "columns: [a, b], mid_scale: 2048, time_column: t, gap_samples: 2"
    source = f"{{kind: recording, file: {tracks}, {layout}}}"
    assert played(opened(source)) == [Sample(0, 1), None, None, None, None, Sample(6, 7)]
    timed = source.replace("}", ", gap_s: 1000, time_stamps: true}")
    times = [sample and sample.time_100ns for sample in played(opened(timed))]
    assert times == [0, 10_000, 50_000_000, 6_500_000_000 % 2**32]


def test_a_recording_of_the_tools(tmp_path: Path) -> None:
    path = tmp_path / "samples.npz"
    write_npz(path, TrackSamples.of([1.0, np.nan, 3.0], [4.0, np.nan, -6.0], 1000.0, "test"))
    assert played(opened(f"{{kind: recording, file: {path}}}")) == [Sample(1, 4), None, Sample(3, -6)]


@pytest.mark.parametrize("name", ["nothing.csv", "nothing.npz"])
def test_a_file_that_is_not_there_is_told(name: str, tmp_path: Path) -> None:
    with pytest.raises(CanfbError, match=f"{name}: cannot be read"):
        opened(f"{{kind: recording, file: {tmp_path / name}}}")


def test_a_module_of_the_command_runs_on_its_source(capsys: pytest.CaptureFixture[str], tracks: Path) -> None:
    text = f"{{kind: recording, file: {tracks}, columns: [a, b], mid_scale: 1000}}"
    config = parse_config(f"modules: [{{node_id: 32, autostart: true, source: {text}}}]")
    with contextlib.ExitStack() as resources, printed_log():
        module = make_module(config.modules[0], resources, {}, config)
        module.start(0.0)
        for n in range(4):
            module.receive(Frame(0x80, b""), n * 1e-3)
            assert module.feedback is not None
            assert module.feedback.status & VALID
        for n in range(4, 10):
            module.receive(Frame(0x80, b""), n * 1e-3)
    assert capsys.readouterr().err == "canfb: node 32: the source has ended: no more samples\n"
