"""Arrays of tracks from the caller: what they must be, and errors that say what they are instead."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

FEW_SAMPLES = 64  # too few to check mid-scale and full scale
LEAST_NORMALISED = 0.05  # peak of tracks in -1..1; below it may be the noise of dead inputs
LEAST_SPREAD = 0.25  # of counts around a centre that is not zero, against the largest of them


def pair_of_tracks(
    sine: npt.ArrayLike, cosine: npt.ArrayLike, *, may_be_offset: bool = False
) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Both tracks as arrays of one shape (n,), ADC counts with zero at mid-scale; else ValueError.

    Unsigned ones pass where a conditioning takes an offset away (``may_be_offset``).
    """
    kinds = "iuf" if may_be_offset else "if"
    sines, cosines = _numbers("sine", sine, kinds), _numbers("cosine", cosine, kinds)
    if sines.ndim != 1 or sines.shape != cosines.shape:
        raise ValueError(
            "sine and cosine must be arrays of one dimension and of one length, "
            f"not of shape {sines.shape} and {cosines.shape}"
        )
    return sines, cosines


def check_counts(sine: npt.NDArray[Any], cosine: npt.NDArray[Any], *, may_be_offset: bool = False) -> None:
    """ValueError for tracks that can only be something else than counts with zero at mid-scale.

    They are in -1..1, or go round but never below zero. Fewer than 64 samples pass.
    """
    if len(sine) >= FEW_SAMPLES:
        _refuse_normalised(sine, cosine)
        if not may_be_offset and goes_round_off_zero(sine, cosine):
            raise ValueError(
                "sine and cosine must be zero at mid-scale, but no count is below zero: subtract mid-scale, "
                "2048 with 12 bits"
            )


def _numbers(name: str, track: npt.ArrayLike, kinds: str) -> npt.NDArray[Any]:
    try:
        numbers = np.asarray(track)
    except ValueError:
        raise ValueError(f"{name} must be an array of one dimension: its rows differ in length") from None
    if numbers.dtype.kind in kinds:
        return numbers
    if numbers.dtype.kind == "u":
        raise ValueError(
            f"{name} must be signed counts, zero at mid-scale, not {numbers.dtype}: subtract mid-scale, "
            f"{name}.astype(int) - 2048 with 12 bits"
        )
    if numbers.dtype.kind == "O":
        try:
            return numbers.astype(np.float64)
        except (TypeError, ValueError):
            pass
    raise ValueError(f"{name} must be real numbers (ADC counts), not {numbers.dtype}")


def _refuse_normalised(sine: npt.NDArray[Any], cosine: npt.NDArray[Any]) -> None:
    if sine.dtype.kind == "i" or not (_is_small(sine[:FEW_SAMPLES]) and _is_small(cosine[:FEW_SAMPLES])):
        return  # nearly always
    peak = max(np.nanmax(np.abs(track), initial=0.0) for track in (sine, cosine))
    if LEAST_NORMALISED < peak <= 1.0:
        raise ValueError(
            f"sine and cosine must be ADC counts, but none exceeds {peak:.3g}: multiply tracks in -1..1 "
            "by the full scale, 2048 with 12 bits"
        )


def _is_small(track: npt.NDArray[Any]) -> bool:
    return not (np.abs(track) > 1.0).any()


def goes_round_off_zero(sine: npt.NDArray[Any], cosine: npt.NDArray[Any]) -> bool:
    """No count of either is below zero, and yet the tracks go round; a machine that stands may have none."""
    if len(sine) < FEW_SAMPLES or (sine[:FEW_SAMPLES] < 0).any() or (cosine[:FEW_SAMPLES] < 0).any():
        return False  # nearly always
    sides = []
    for track in (sine, cosine):
        low, high = float(track.min()), float(track.max())
        if not 0.0 <= low <= high < float("inf") or high - low < LEAST_SPREAD * high or high == 0.0:
            return False
        sides.append(track > (low + high) / 2.0)
    return len(np.unique(sides[0] * 2 + sides[1])) == 4
