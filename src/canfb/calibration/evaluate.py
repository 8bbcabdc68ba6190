"""How good a reference measurement is, measured on data that was not used for it; and the verdict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from canfb.calibration import result as reasons
from canfb.calibration.blocks import Blocks, BoolArray
from canfb.calibration.joint import JointFit, bound_covariance, fit_jointly
from canfb.calibration.recording import BINS, Recording, coverage
from canfb.calibration.result import Calibration, ErrorCurve, Harmonic, error_harmonics
from canfb.calibration.waveform import (
    Waveform,
    grid_phases,
    raw_phase_curve,
    table_of,
    table_sensitivity,
)
from canfb.errors import CalibrationError
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import CorrectionTable
from canfb.signal.phase import FloatArray, raw_phases

MIN_CYCLES = 10.0
MAX_UNCERTAINTY_CYCLES = 5e-4
# With phases well mixed in every block the motion costs little information; this much more
# uncertainty than that says that the motion, not the noise, is to blame.
LOCKED_LOSS = 3.0
SAME_PHASE = 0.9
PEAK_SIGMAS = 3.0


def finish(
    record: Recording, blocks: Blocks, fit: JointFit, conditioning: Conditioning, entries: int
) -> Calibration:
    """Table, figures and verdict. CalibrationError if the measurement cannot be used."""
    use = blocks.used
    position = blocks.evaluate(fit.motion)
    cycles = float(np.abs(np.diff(position, axis=1))[use[:, 1:] & use[:, :-1]].sum())
    curve = raw_phase_curve(fit.waveform, conditioning)
    sensitivity = table_sensitivity(fit.waveform, conditioning)
    spread = np.sqrt(_variance(sensitivity, fit.covariance))
    expected = root_mean(spread)
    tables = [table_of(raw_phase_curve(half, conditioning), entries) for half in _halves(record, blocks, fit)]
    measured = float(np.std(tables[0].entries - tables[1].entries)) / 2.0
    covariance = bound_covariance(blocks, record.sine, record.cosine, fit, fit.noise.across)
    bound = float(np.sqrt(_variance(sensitivity, covariance).mean()))
    before, after = _deviations(record, blocks, position, conditioning, tables)
    moving = use & _mixed(position, use)[:, None]
    correct = float(np.sqrt(blocks.samples / max(1, blocks.freedom)))
    found = Calibration(
        table=table_of(curve, entries),
        conditioning=conditioning,
        method="motion",
        reason=reasons.ACCEPTED,
        coverage=coverage(position[use]),
        cycles_used=cycles,
        samples_used=blocks.samples,
        samples_rejected=int(record.valid.sum()) - blocks.samples,
        residual_rms=root_mean(after[moving]) * correct,
        residual_peak=peak(after[moving]),
        before_rms=root_mean(before[moving]) * correct,
        before_peak=peak(before[moving]),
        uncertainty_rms=max(expected, measured),
        uncertainty_peak=PEAK_SIGMAS * max(float(spread.max()), measured),
        noise_counts=fit.noise.across,
        noise_cycles=fit.noise_cycles,
        bound_rms=bound,
        cramer_rao_ratio=measured / bound,
        harmonics=_harmonics(fit.waveform, conditioning, expected),
        curve=error_curve(position[moving], before[moving], after[moving]),
        block_samples=blocks.index.shape[1],
    )
    known = root_mean(np.sqrt(_variance(sensitivity, fit.known_motion)))
    return judge(found, expected / known)


def judge(found: Calibration, loss: float = 1.0) -> Calibration:
    """The calibration if it can be used, else CalibrationError with it and the reason.

    ``loss``: how many times the uncertainty grew because the motion had to be found as well.
    """
    reason, text = reasons.ACCEPTED, ""
    if found.coverage < 1.0:
        reason = reasons.COVERAGE
        text = (
            f"only {100 * found.coverage:.0f} % of the cycle was sampled: "
            "let the machine go through many cycles, at a speed that is not a whole "
            "number of cycles per sample"
        )
    elif found.cycles_used < MIN_CYCLES:
        reason = reasons.CYCLES
        text = f"{found.cycles_used:.1f} cycles are too few: at least {MIN_CYCLES:.0f} are needed"
    elif found.uncertainty_rms > MAX_UNCERTAINTY_CYCLES:
        reason = reasons.LOCKED if loss > LOCKED_LOSS else reasons.NOISE
        text = f"{reasons.REASONS[reason]}: {found.uncertainty_rms:.1e} cycle rms. " + (
            "Change the speed" if loss > LOCKED_LOSS else "Record longer, or a smoother motion"
        )
    if reason == reasons.ACCEPTED:
        return found
    raise CalibrationError(text, reason, replace(found, reason=reason))


def _variance(sensitivity: FloatArray, covariance: FloatArray) -> FloatArray:
    variance: FloatArray = np.einsum("pi,pi->p", sensitivity @ covariance, sensitivity)
    return np.maximum(variance, 0.0)


def root_mean(values: FloatArray) -> float:
    """Root mean square, 0 of nothing."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def peak(values: FloatArray) -> float:
    """Largest size, 0 of nothing."""
    return float(np.abs(values).max()) if len(values) else 0.0


def _halves(record: Recording, blocks: Blocks, fit: JointFit) -> list[Waveform]:
    """The same fit to the even and to the odd blocks alone."""
    rows = np.arange(len(blocks))
    halves = []
    for odd in (0, 1):
        part = rows[rows % 2 == odd]
        half = fit_jointly(
            blocks.take(part),
            record.sine,
            record.cosine,
            fit.waveform,
            fit.motion[part],
            rounds=6,
            noise=fit.noise,
        )
        halves.append(half.waveform)
    return halves


def _mixed(position: FloatArray, use: BoolArray) -> BoolArray:
    """Blocks whose samples lie at different phases; at standstill any table looks good."""
    turn = np.where(use, np.exp(2j * np.pi * position), 0.0)
    size = np.abs(turn.sum(axis=1)) / np.maximum(1, use.sum(axis=1))
    mixed: BoolArray = size < SAME_PHASE
    return mixed


def _deviations(
    record: Recording,
    blocks: Blocks,
    position: FloatArray,
    conditioning: Conditioning,
    tables: list[CorrectionTable],
) -> tuple[FloatArray, FloatArray]:
    """Deviation from smooth motion with the identity, and with the table of the other half's blocks."""
    raw = raw_phases(*conditioning.apply(record.sine, record.cosine))[blocks.index]
    raw = np.where(blocks.used, raw, 0.0)
    after = np.empty_like(raw)
    for odd in (0, 1):
        after[odd::2] = tables[1 - odd].correct_array(raw[odd::2])
    return _from_smooth(blocks, raw, position), _from_smooth(blocks, after, position)


def _from_smooth(blocks: Blocks, phase: FloatArray, position: FloatArray) -> FloatArray:
    """Deviation of phases from the polynomial of least squares through them in each block."""
    off = (phase - position) % 1.0
    middle = np.angle(np.mean(np.exp(2j * np.pi * off[blocks.used]))) / (2.0 * np.pi)
    off = (off - middle + 0.5) % 1.0 - 0.5
    return np.asarray(off - blocks.evaluate(blocks.smooth(off)), np.float64)


def error_curve(position: FloatArray, before: FloatArray, after: FloatArray) -> ErrorCurve:
    """Mean of both deviations in bins of the phase."""
    bins = (position % 1.0 * BINS).astype(np.int64) % BINS
    count = np.bincount(bins, minlength=BINS)
    with np.errstate(invalid="ignore"):
        mean_before = np.bincount(bins, before, BINS) / np.where(count, count, np.nan)
        mean_after = np.bincount(bins, after, BINS) / np.where(count, count, np.nan)
    return ErrorCurve((np.arange(BINS) + 0.5) / BINS, mean_before, mean_after)


def _harmonics(waveform: Waveform, conditioning: Conditioning, expected: float) -> tuple[Harmonic, ...]:
    phase = grid_phases(1024)[:-1]
    s, c = conditioning.apply(*waveform.tracks(phase))
    angle = np.unwrap(np.arctan2(s, c) / (2.0 * np.pi), period=1.0)
    return error_harmonics(phase, angle, 3.0 * expected)
