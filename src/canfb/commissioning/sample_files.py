"""Samples as NPZ or CSV files: what numpy reads, and what `canfb calibrate --samples` takes again."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np

from canfb.commissioning.samples import TrackSamples
from canfb.objects import MISSED_COUNTS
from canfb.sources.tracks_file import read_tracks


def write_npz(path: Path, samples: TrackSamples, hertz: float | None = None) -> None:
    """Tracks as INTEGER16, -32768 in both for a missed sample, the rate in Hz, 0 if not known, and time_s.

    ``hertz`` is the speed, cycles per second, where it is known: cycles_per_s.
    """
    sine, cosine = (
        np.nan_to_num(track, nan=MISSED_COUNTS).astype(np.int16) for track in (samples.sine, samples.cosine)
    )
    known: dict[str, Any] = {} if samples.time_s is None else {"time_s": samples.time_s}
    if hertz is not None:
        known["cycles_per_s"] = hertz
    np.savez_compressed(
        path,
        sine=sine,
        cosine=cosine,
        rate_hz=samples.rate_hz or 0.0,
        origin=np.array(samples.origin),
        **known,
    )


def write_csv(path: Path, samples: TrackSamples) -> None:
    """Columns sine and cosine in counts, before them t_s in seconds where the rate is known.

    A missed sample has no row; its time is left out.
    """
    names = ["t_s", "sine", "cosine"] if samples.rate_hz else ["sine", "cosine"]
    with path.open("w", newline="", encoding="ascii") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(names)
        for number, pair in enumerate(zip(samples.sine.tolist(), samples.cosine.tolist(), strict=True)):
            if not math.isnan(pair[0]):
                time = [f"{number / samples.rate_hz:.9g}"] if samples.rate_hz else []
                rows.writerow([*time, *map(int, pair)])


def read_speed(path: Path) -> float | None:
    """cycles_per_s of an NPZ file that :func:`read_npz` can read; None where it has none."""
    with np.load(path, allow_pickle=False) as content:
        return float(content["cycles_per_s"]) if "cycles_per_s" in content else None


def read_npz(path: Path) -> TrackSamples:
    """An NPZ file with arrays sine and cosine, and rate_hz and time_s if they are known.

    CanfbError, in one line, for anything else.
    """
    tracks = read_tracks(path)
    return TrackSamples(tracks.sine, tracks.cosine, tracks.rate_hz, f"file {path.name}", tracks.time_s)
