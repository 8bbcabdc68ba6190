"""A recording of both tracks, checked: what may be used, where it breaks, and its positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from canfb.calibration.following import positions
from canfb.calibration.motion_blocks import BoolArray, IntArray
from canfb.calibration.result import Reason
from canfb.errors import CalibrationError
from canfb.objects import MISSED_COUNTS
from canfb.signal.phase import FloatArray
from canfb.signal.sample_recording import BYTES_PER_SAMPLE
from canfb.signal.tracks import check_counts, pair_of_tracks

MIN_SAMPLES = 200
BINS = 64
MIN_PER_BIN = 2
# Faults may hit the end of the range now and then; a track that is too large hits it in
# every cycle at the same phase.
CLIPPED_PART = 0.05
CLIPPED_PART_OF_BIN = 0.2
BREAK_INTERVALS = 10.0
ADC_BITS = (12, 14, 16)
UNEVEN = 1e-6
SECONDS_PER_TICK = 1e-7  # sample times, 2000:05
NO_TIME = -1


@dataclass(frozen=True, eq=False)
class Recording:
    """Samples of both tracks, float64, with 0 in place of what is not a number.

    valid    False: left out;  clipped: at the ends of the converter's range
    time     in sampling intervals (median), rising
    uneven   the intervals differ
    breaks   first samples after gaps over which the position is not followed
    """

    sine: FloatArray
    cosine: FloatArray
    valid: BoolArray
    clipped: BoolArray
    time: FloatArray
    uneven: bool
    breaks: IntArray

    def positions(self, phase: FloatArray) -> FloatArray:
        """Positions in cycles at these phases (cycles, NaN where there is none), see :mod:`.following`."""
        return positions(phase, self.time, self.uneven, self.breaks)


def recording(
    sine: npt.ArrayLike,
    cosine: npt.ArrayLike,
    time_s: npt.ArrayLike | None,
    valid: npt.ArrayLike | None,
    adc_bits: int | None,
    *,
    may_be_offset: bool = False,
) -> Recording:
    """Check the arguments of a reference measurement. ValueError for wrong ones, CalibrationError
    ("samples") for too few usable samples. The mark of a missed sample (2050:03) is not a sample.
    ``may_be_offset``: a conditioning will take the offset away."""
    tracks = pair_of_tracks(sine, cosine, may_be_offset=may_be_offset)
    s, c = (np.array(track, np.float64) for track in tracks)
    missed = (s == MISSED_COUNTS) & (c == MISSED_COUNTS)
    s[missed] = c[missed] = np.nan
    usable = np.isfinite(s) & np.isfinite(c)
    if valid is not None:
        mask = np.asarray(valid)
        if mask.shape != s.shape or mask.dtype != np.bool_:
            raise ValueError("valid must be booleans, one for each sample")
        usable &= mask
    check_counts(s[usable], c[usable], may_be_offset=may_be_offset)
    clipped = usable & _clipped(s, c, usable, adc_bits)
    usable &= ~clipped
    if usable.sum() < MIN_SAMPLES:
        if clipped.sum() > usable.sum():
            raise CalibrationError("most samples are at the ends of the converter's range", Reason.CLIPPED)
        raise CalibrationError(
            f"{usable.sum()} usable samples: at least {MIN_SAMPLES} are needed", Reason.SAMPLES
        )
    time, uneven = _intervals(time_s, len(s))
    at = np.flatnonzero(usable)
    breaks = at[1:][np.diff(time[at]) > BREAK_INTERVALS]
    s, c = np.nan_to_num(s, posinf=0.0, neginf=0.0), np.nan_to_num(c, posinf=0.0, neginf=0.0)
    return Recording(s, c, usable, clipped, time, uneven, breaks.astype(np.int64))


def recorded_tracks(data: bytes) -> tuple[FloatArray, FloatArray]:
    """Sine and cosine, counts, of an uploaded recording (2050:03); NaN where a sample is missing.

    ValueError unless ``data`` is whole samples.
    """
    if len(data) % BYTES_PER_SAMPLE:
        raise ValueError(
            f"a recording has {BYTES_PER_SAMPLE} bytes per sample: {len(data)} is not a multiple"
        )
    counts = np.frombuffer(data, "<i2").astype(np.float64).reshape(-1, 2)
    counts[(counts == MISSED_COUNTS).all(axis=1)] = np.nan
    return counts[:, 0].copy(), counts[:, 1].copy()


def timed_tracks(data: bytes, times: bytes) -> tuple[FloatArray, FloatArray, FloatArray]:
    """:func:`recorded_tracks` with sample times in seconds, those samples alone that have one.

    ``times`` in units of 100 ns, INTEGER64 of this machine, NO_TIME for none. ValueError unless
    there is one for each sample.
    """
    ticks = np.frombuffer(times, np.int64)
    known = with_time(times)
    sine, cosine = recorded_tracks(data)
    if len(ticks) != len(sine):
        raise ValueError(f"{len(sine)} samples have {len(ticks)} times")
    return sine[known], cosine[known], np.asarray(ticks[known] * SECONDS_PER_TICK, np.float64)


def with_time(times: bytes) -> BoolArray:
    """Which samples have a time, ``times`` as for :func:`timed_tracks`."""
    return np.asarray(np.frombuffer(times, np.int64) != NO_TIME, np.bool_)


def _clipped(s: FloatArray, c: FloatArray, usable: BoolArray, adc_bits: int | None) -> BoolArray:
    if not usable.any():
        return usable
    low = min(float(s[usable].min()), float(c[usable].min()))
    high = max(float(s[usable].max()), float(c[usable].max()))
    if adc_bits is None:
        fitting = [bits for bits in ADC_BITS if -(1 << bits - 1) <= low and high < 1 << bits - 1]
        if not fitting:
            return np.zeros_like(usable)
        adc_bits = fitting[0]
    full = 1 << (adc_bits - 1)
    if low < -full or high > full - 1:
        raise ValueError(f"samples from {low:g} to {high:g} counts do not fit {adc_bits} bits: set adc_bits")
    with np.errstate(invalid="ignore"):
        return np.asarray((np.minimum(s, c) <= -full) | (np.maximum(s, c) >= full - 1), np.bool_)


def _intervals(time_s: npt.ArrayLike | None, n: int) -> tuple[FloatArray, bool]:
    if time_s is None:
        return np.arange(n, dtype=np.float64), False
    time = np.array(time_s, np.float64)
    if time.shape != (n,) or not np.isfinite(time).all():
        raise ValueError("time_s must be finite numbers, one for each sample")
    steps = np.diff(time)
    if n < 2 or steps.min() <= 0.0:
        raise ValueError("time_s must rise from sample to sample")
    interval = float(np.median(steps))
    return (time - time[0]) / interval, bool(np.ptp(steps) > UNEVEN * interval)


def check_clipped(record: Recording, angle: FloatArray) -> None:
    """Refuse tracks that are cut off. ``angle`` of all samples, clipped ones included, in cycles."""
    count = int(record.clipped.sum())
    seen = record.valid | record.clipped
    bins = (angle * BINS).astype(np.int64) % BINS
    cut = np.bincount(bins[record.clipped], minlength=BINS)
    every = np.maximum(1, np.bincount(bins[seen], minlength=BINS))
    worst = float((cut / every).max())
    if count > CLIPPED_PART * seen.sum() or (worst > CLIPPED_PART_OF_BIN and count > 6):
        raise CalibrationError(
            f"{count} samples are at the ends of the converter's range: reduce the amplitude of the tracks",
            Reason.CLIPPED,
        )


def coverage(phase: FloatArray) -> float:
    """Part of the cycle that is sampled: bins of 1/64 with two of these phases (cycles) in or beside them."""
    return covered(np.bincount((phase % 1.0 * BINS).astype(np.int64) % BINS, minlength=BINS))


def covered(counts: Sequence[int] | IntArray) -> float:
    """:func:`coverage` for this many samples in each of the bins."""
    here = np.asarray(counts)
    return float(np.mean(np.roll(here, 1) + here + np.roll(here, -1) >= MIN_PER_BIN))
