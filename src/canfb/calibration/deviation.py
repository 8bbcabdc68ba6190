"""Deviation of positions from smooth motion, with a table made from other samples.

A cubic is fitted to the corrected positions in each block of samples; the deviation is noise plus errors
that the table leaves. Blocks with few phases are left out (:meth:`.Blocks.informative`); shorter blocks are
tried, too. For N samples and n coefficients the rms of the deviations is multiplied by sqrt(N / (N - n)).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from canfb.calibration.recording import Blocks, Recording, check_clipped
from canfb.calibration.result import (
    BINS,
    Reason,
    about_mean,
    coverage,
    mean_in_bins,
    peak,
    robust_rms,
    root_mean,
    samples_in_bins,
)
from canfb.errors import CalibrationError
from canfb.signal.correction import Correction
from canfb.signal.phase import BoolArray, FloatArray, raw_phases

# Samples beyond FAULTY_SIGMAS are left out as faulty, if they are at most FAULTY_PART of all samples.
FAULTY_SIGMAS = 8.0
FAULTY_PART = 0.01
# So are blocks whose rms is FAULTY_BLOCK times the median: a missed SYNC shifts all samples of its block,
# whereas a bad table shows in every block.
FAULTY_BLOCK = 4.0
FAULTY_BLOCKS_PART = 0.1
MIN_BLOCKS = 8
# A phase bin is a spike if its count exceeds SPIKE times the mean and SPIKE_SIGMAS of a random count.
SPIKE = 2.0
SPIKE_SIGMAS = 5.0
MIN_COVERAGE = 0.9
LEAST_BLOCK, LONGEST_BLOCK = 12, 4096
CYCLES_OF_BLOCK = 2.0  # fewest cycles in a block: over less, a cubic follows the errors of the encoder


@dataclass(frozen=True, eq=False)
class Deviation:
    """Deviation of samples from smooth motion, cycles; arrays with one entry for each sample used.

    rms, peak      with the table, noise of the samples included; before_rms, before_peak: with the
                   previous correction
    phase, error   with the table, phase 0..1; before: error with the previous correction, about its mean
    faulty         number of samples left out as faulty
    """

    rms: float
    peak: float
    before_rms: float
    before_peak: float
    phase: FloatArray
    error: FloatArray
    before: FloatArray
    faulty: int

    @property
    def spike(self) -> tuple[float, float] | None:
        """The fullest bin, if it is a spike: its count / mean count, and its phase, cycles."""
        count = samples_in_bins(self.phase)
        mean, place = float(count.mean()), int(count.argmax())
        if count[place] <= max(SPIKE * mean, mean + SPIKE_SIGMAS * math.sqrt(mean)):
            return None
        return float(count[place]) / mean, (place + 0.5) / BINS

    def mean_over_phase(self, before: bool = False) -> FloatArray:
        """Mean error in each of 64 bins of the phase; NaN where there is no sample."""
        return mean_in_bins(self.phase, self.before if before else self.error)


def best_deviation(record: Recording, used: Correction, before: Correction, block_samples: int) -> Deviation:
    """:func:`deviation_of_phases` of the samples with these corrections, for the best of three block
    lengths: the motion may be less smooth than during calibration."""
    return best_of_phases(
        record,
        phases_with(used, record.sine, record.cosine),
        phases_with(before, record.sine, record.cosine),
        block_samples,
    )


def best_of_phases(
    record: Recording, phase: FloatArray, phase_before: FloatArray, block_samples: int
) -> Deviation:
    """:func:`best_deviation` of phases; arguments as for :func:`deviation_of_phases`."""
    lengths = sorted(
        {block_samples, max(LEAST_BLOCK, block_samples // 2), max(LEAST_BLOCK, block_samples // 4)}
    )
    return min(
        (deviation_of_phases(record, phase, phase_before, n) for n in lengths), key=lambda found: found.rms
    )


def deviation_of_phases(
    record: Recording, phase: FloatArray, phase_before: FloatArray, block_samples: int
) -> Deviation:
    """Deviation of the samples of ``record`` from a cubic in each block of ``block_samples``.

    ``phase``, cycles, gives the positions (NaN: no sample); ``phase_before`` is compared on the same
    samples. CalibrationError if too few blocks are informative.
    """
    check_clipped(record, np.where(np.isnan(phase), 0.0, phase))
    position = record.positions(phase)
    valid = record.valid & np.isfinite(position)
    speed = float(np.nanmedian(np.abs(np.diff(position))))
    slow = CYCLES_OF_BLOCK / max(speed, CYCLES_OF_BLOCK / LONGEST_BLOCK)
    length = min(max(block_samples, LEAST_BLOCK, math.ceil(slow)), LONGEST_BLOCK)
    blocks = replace(record, valid=valid).cut(length)
    blocks = blocks.take(blocks.informative(position[blocks.index])) if len(blocks) else blocks
    if len(blocks) < MIN_BLOCKS or coverage(position[blocks.index][blocks.used]) < MIN_COVERAGE:
        raise CalibrationError(
            "the machine is at standstill, or its motion is locked to the samples: the table cannot be "
            "judged. Let it turn at another speed, or measure for longer",
            Reason.LOCKED,
        )
    followed = position[blocks.index]
    smooth = blocks.evaluate(blocks.smooth(followed))
    faulty = _faulty(blocks, followed - smooth)
    if faulty.any():
        blocks = blocks.using(blocks.used & ~faulty)
        smooth = blocks.evaluate(blocks.smooth(followed))
    left_out = int(faulty.sum())
    sound = _sound_blocks(blocks, followed - smooth)
    left_out += int(blocks.used[~sound].sum())
    blocks, followed, smooth = blocks.take(sound), followed[sound], smooth[sound]
    error, use = followed - smooth, blocks.used
    old = np.where(use, phase_before[blocks.index], 0.0) - smooth
    old = about_mean(old, of=old[use])
    old = old - blocks.evaluate(blocks.smooth(old))
    return Deviation(
        rms=root_mean(error[use]) * blocks.correct,
        peak=peak(error[use]),
        before_rms=root_mean(old[use]) * blocks.correct,
        before_peak=peak(old[use]),
        phase=np.asarray(phase[blocks.index][use], np.float64),
        error=error[use],
        before=old[use],
        faulty=left_out,
    )


def phases_with(used: Correction, sine: FloatArray, cosine: FloatArray) -> FloatArray:
    raw = raw_phases(*used.conditioning.apply(sine, cosine))
    return raw if used.table is None else used.table.correct_array(raw)


def _faulty(blocks: Blocks, error: FloatArray) -> BoolArray:
    far = blocks.used & (np.abs(error) > FAULTY_SIGMAS * robust_rms(error[blocks.used]))
    return far if far.sum() <= FAULTY_PART * blocks.samples else np.zeros_like(far)


def _sound_blocks(blocks: Blocks, error: FloatArray) -> BoolArray:
    """False for a few blocks that are far worse than the others."""
    count = np.maximum(1, blocks.used.sum(axis=1))
    size = np.sqrt(np.sum(np.where(blocks.used, error, 0.0) ** 2, axis=1) / count)
    bad = size > FAULTY_BLOCK * float(np.median(size))
    few = bad.sum() <= max(1.0, FAULTY_BLOCKS_PART * len(blocks))
    return np.asarray(~bad if few else np.ones_like(bad), np.bool_)
