"""What a user reads when libiio or its Python binding is not there, or too new."""

from __future__ import annotations

import re
import subprocess
import sys
import types
from pathlib import Path

import pytest

from canfb.errors import BusError
from canfb.sources.iio_source import ChannelScaling, IioCapture, IioSourceConfig

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
    done = subprocess.run(
        [sys.executable, "-c", "import sys, canfb.cli.run; print('iio' in sys.modules)"],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    assert done.stdout == "False\n"


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
