"""Samples as NPZ or CSV files: what numpy reads, and what `canfb calibrate --samples` takes again."""

from __future__ import annotations

import csv
import math
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from canfb.commissioning.access import CommissioningError
from canfb.commissioning.samples import Samples
from canfb.objects import MISSED_COUNTS


def write_npz(path: Path, samples: Samples) -> None:
    """Tracks as INTEGER16, -32768 in both for a missed sample, the rate in Hz, 0 if not known, and time_s."""
    sine, cosine = (
        np.nan_to_num(track, nan=MISSED_COUNTS).astype(np.int16) for track in (samples.sine, samples.cosine)
    )
    times: dict[str, Any] = {} if samples.time_s is None else {"time_s": samples.time_s}
    np.savez_compressed(
        path,
        sine=sine,
        cosine=cosine,
        rate_hz=samples.rate_hz or 0.0,
        origin=np.array(samples.origin),
        **times,
    )


def write_csv(path: Path, samples: Samples) -> None:
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


def read_npz(path: Path) -> Samples:
    """An NPZ file with arrays sine and cosine, and rate_hz and time_s if they are known.

    CommissioningError, in one line, for anything else.
    """
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as content:
            missing = [name for name in ("sine", "cosine") if name not in content]
            if missing:
                raise CommissioningError(
                    f"{path}: there is no array '{missing[0]}', only {', '.join(content.files) or 'nothing'}"
                )
            rate_hz = float(content["rate_hz"]) if "rate_hz" in content else 0.0
            samples = Samples.of(content["sine"], content["cosine"], rate_hz or None, f"file {path.name}")
            if "time_s" in content:
                samples = replace(samples, time_s=np.asarray(content["time_s"], np.float64))
            return samples
    except OSError as error:
        raise CommissioningError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (ValueError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise CommissioningError(f"{path}: this is no file of samples: {error}") from None
