"""The source of a module, opened as the configuration has it; what is said where libiio is not there."""

from __future__ import annotations

import contextlib
import re
import sys
import types
from pathlib import Path

import numpy as np
import pytest

from canfb.cia301.frame import Frame
from canfb.cli.printing import printed_log
from canfb.configuration import parse_config
from canfb.errors import BusError
from canfb.hosting.hosting import make_module, open_source
from canfb.master.samples import TrackSamples, write_npz
from canfb.signal.sample import Sample
from canfb.signal.supervision import VALID
from canfb.sources.iio_source import ChannelScaling, IioCapture, IioSourceConfig
from canfb.sources.protocol import Source, SourceEnded
from processes import python


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


CONFIG = IioSourceConfig(device="ads7950")


@pytest.fixture
def on_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder whose modules come before those that are installed; iio is not loaded yet."""
    monkeypatch.delitem(sys.modules, "iio", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def test_without_the_binding(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "iio", None)
    with pytest.raises(BusError, match=re.escape("pip install 'canfb[iio]'")):
        IioCapture(CONFIG)


@pytest.mark.parametrize("failure", ["AttributeError('undefined symbol: iio_x')", "OSError('libiio.so.0')"])
def test_without_the_library(failure: str, on_path: Path) -> None:
    (on_path / "iio.py").write_text(f"raise {failure}\n")
    with pytest.raises(BusError, match="apt-get install libiio0"):
        IioCapture(CONFIG)


def test_a_library_of_another_generation_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    newer = types.ModuleType("iio")
    newer.__dict__["version"] = (1, 0, "v1.0")
    monkeypatch.setitem(sys.modules, "iio", newer)
    with pytest.raises(BusError, match=re.escape("needs libiio 0.x and pylibiio below 1, not v1.0")):
        IioCapture(CONFIG)


def test_nothing_loads_the_binding_before_it_is_used() -> None:
    assert python("-c", "import sys, canfb.cli.run; print('iio' in sys.modules)").stdout == "False\n"


@pytest.mark.parametrize("bits", [4, 8, 12, 16, 18, 24, 32])
@pytest.mark.parametrize("signed", [True, False])
def test_both_ends_of_the_range_and_its_middle(bits: int, signed: bool) -> None:
    scaling = ChannelScaling(bits, signed, None)
    full_scale = 1 << min(bits, 16) - 1
    lowest = -(1 << bits - 1) if signed else 0
    readings = lowest, lowest + (1 << bits - 1), lowest + (1 << bits) - 1
    assert [scaling.counts(reading) for reading in readings] == [-full_scale, 0, full_scale - 1]


@pytest.mark.parametrize("mid_scale", [-1e9, 0.0, 100.5, 4095.0, 1e9])
def test_wherever_mid_scale_is_counts_stay_within_their_bits(mid_scale: float) -> None:
    scaling = ChannelScaling(12, False, mid_scale)
    counts = [scaling.counts(reading) for reading in range(4096)]
    assert counts == sorted(counts)
    assert (counts[0], counts[-1]) == (-2048, 2047)
