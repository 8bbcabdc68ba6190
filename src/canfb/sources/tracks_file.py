"""Both tracks out of an NPZ file, as canfb writes it."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np
import numpy.typing as npt

from canfb.errors import CanfbError
from canfb.objects import MISSED_COUNTS
from canfb.signal.phase import FloatArray

LARGEST_UNPACKED = 1 << 28
"""Bytes, of all arrays: a few kB of ZIP can hold any number of zeros. Six hours at 1 kHz, with times."""
LONGEST_MESSAGE = 200


class Tracks(NamedTuple):
    """Sine and cosine in ADC counts, NaN where a sample was missed; and, or None where they are not known:

    rate_hz        samples per second
    time_s         of each sample
    cycles_per_s   the speed
    """

    sine: FloatArray
    cosine: FloatArray
    rate_hz: float | None
    time_s: FloatArray | None
    cycles_per_s: float | None


def with_gaps(sine: npt.ArrayLike, cosine: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Counts as floats, pairs of -32768 as NaN. ValueError for arrays of different length."""
    s, c = np.array(sine, np.float64), np.array(cosine, np.float64)
    if s.ndim != 1 or s.shape != c.shape:
        raise ValueError(f"sine and cosine must have one dimension and one length: {s.shape}, {c.shape}")
    missed = (s == MISSED_COUNTS) & (c == MISSED_COUNTS) | np.isnan(s) | np.isnan(c)
    s[missed] = c[missed] = np.nan
    return s, c


def read_tracks(path: Path) -> Tracks:
    """An NPZ file with arrays sine and cosine, and rate_hz, time_s, cycles_per_s if known. CanfbError, one
    line.
    """
    try:
        with path.open("rb") as file:
            _check_size(file)
            return _tracks(file)
    except OSError as error:
        raise CanfbError(f"{path}: cannot be read: {error.strerror or error}") from None
    except Exception as error:
        said = " ".join(str(error).split())[:LONGEST_MESSAGE]
        raise CanfbError(f"{path}: this is not a file of samples: {said or type(error).__name__}") from None


def _check_size(file: IO[bytes]) -> None:
    with zipfile.ZipFile(file) as packed:
        size = sum(one.file_size for one in packed.infolist())
    if size > LARGEST_UNPACKED:
        raise ValueError(f"its arrays have {size} bytes; at most {LARGEST_UNPACKED} are read")
    file.seek(0)


def _tracks(file: IO[bytes]) -> Tracks:
    with np.load(file, allow_pickle=False) as content:
        missing = [name for name in ("sine", "cosine") if name not in content]
        if missing:
            there = ", ".join(content.files) or "nothing"
            raise ValueError(f"there is no array '{missing[0]}', only {there}")
        numbers = {name: float(content[name]) for name in ("rate_hz", "cycles_per_s") if name in content}
        sine, cosine = with_gaps(content["sine"], content["cosine"])
        time_s = np.asarray(content["time_s"], np.float64) if "time_s" in content else None
        return Tracks(sine, cosine, numbers.get("rate_hz") or None, time_s, numbers.get("cycles_per_s"))
