"""Both tracks out of an NPZ file, as canfb writes it."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from canfb.errors import CanfbError
from canfb.objects import MISSED_COUNTS
from canfb.signal.phase import FloatArray


class Tracks(NamedTuple):
    """Sine and cosine in ADC counts, NaN where a sample was missed; the rate in Hz, times in s, or None."""

    sine: FloatArray
    cosine: FloatArray
    rate_hz: float | None
    time_s: FloatArray | None


def with_gaps(sine: npt.ArrayLike, cosine: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Counts as floats, pairs of -32768 as NaN. ValueError for arrays of different length."""
    s, c = np.array(sine, np.float64), np.array(cosine, np.float64)
    if s.ndim != 1 or s.shape != c.shape:
        raise ValueError(f"sine and cosine must have one dimension and one length: {s.shape}, {c.shape}")
    missed = (s == MISSED_COUNTS) & (c == MISSED_COUNTS) | np.isnan(s) | np.isnan(c)
    s[missed] = c[missed] = np.nan
    return s, c


def read_tracks(path: Path) -> Tracks:
    """An NPZ file with arrays sine and cosine, and rate_hz and time_s if they are known.

    CanfbError, in one line, for anything else.
    """
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as content:
            missing = [name for name in ("sine", "cosine") if name not in content]
            if missing:
                raise CanfbError(
                    f"{path}: there is no array '{missing[0]}', only {', '.join(content.files) or 'nothing'}"
                )
            rate_hz = float(content["rate_hz"]) if "rate_hz" in content else 0.0
            sine, cosine = with_gaps(content["sine"], content["cosine"])
            time_s = np.asarray(content["time_s"], np.float64) if "time_s" in content else None
            return Tracks(sine, cosine, rate_hz or None, time_s)
    except OSError as error:
        raise CanfbError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (ValueError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise CanfbError(f"{path}: this is not a file of samples: {error}") from None
