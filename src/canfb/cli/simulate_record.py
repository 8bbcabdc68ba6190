"""``canfb simulate --record``: what the encoder interface sampled, as a file to play and to calibrate."""

from __future__ import annotations

import os
from pathlib import Path

from canfb.errors import CanfbError, ConfigError
from canfb.master.samples import TrackSamples, write_csv, write_npz
from canfb.simulation.sample_recorder import SampleRecorder

WRITERS = {".csv": write_csv, ".npz": write_npz}


def check_record(name: str) -> Path:
    """The file of ``--record``. ConfigError where it cannot be, before anything is recorded."""
    path = Path(name)
    if path.suffix not in WRITERS:
        raise ConfigError(f"--record {name}: the name must end with {' or '.join(WRITERS)}")
    if not path.parent.is_dir():
        raise ConfigError(f"--record {name}: there is no folder {path.parent}")
    if path.is_dir() or not os.access(path if path.exists() else path.parent, os.W_OK):
        raise ConfigError(f"--record {name}: cannot be written")
    return path


def write_record(path: Path, recorder: SampleRecorder, rate_hz: float) -> None:
    """Write what was recorded, at ``rate_hz`` samples per second. CanfbError if the file fails."""
    samples = TrackSamples.of(*recorder.tracks(), rate_hz, "canfb simulate --record")
    try:
        WRITERS[path.suffix](path, samples)
    except OSError as error:
        raise CanfbError(f"--record {path}: {error.strerror or error}") from error
