"""Reference measurement from any motion, at any speed, also many cycles per sample.

    raw(k) = p(t_k) + e(p(t_k)) + noise   (modulo 1);  p: position in cycles, e: error within a cycle

A polynomial of time follows p in a block of samples; e repeats with every cycle. One fit (:mod:`.joint`)
separates the two at any speed.

Deviations of samples are those of odd blocks with the table of the even ones, and the other way round. The
error of the table is the largest of the scatter of tables of independent blocks, the covariance of the fit,
the mean deviation over the phase beyond its noise, what the samples cannot rule out, and the change in time.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from canfb.calibration.deviation import FINE, THIRDS, Drift, largest_change, lasting
from canfb.calibration.ellipse import with_track_harmonics
from canfb.calibration.joint import (
    JointFit,
    Waveform,
    bound_covariance,
    fit_jointly,
    grid_phases,
    origin_of,
    raw_phase_curve,
    table_of,
    table_sensitivity,
)
from canfb.calibration.motion_blocks import (
    Blocks,
    ErrorCurve,
    ErrorHarmonic,
    IntArray,
    about_mean,
    coverage,
    error_curve,
    peak,
    root_mean,
    samples_in_bins,
)
from canfb.calibration.recording import Recording, prepared
from canfb.calibration.result import PEAK_SIGMAS, TRACK_POINTS, Calibration, Method, judge
from canfb.calibration.solver import MIN_BLOCKS, Progress, Solution, Solver, no_progress, reject
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import CorrectionTable
from canfb.signal.phase import FloatArray, raw_phases


def calibrate_from_motion(
    sine: npt.ArrayLike,
    cosine: npt.ArrayLike,
    conditioning: Conditioning | str | None = None,
    *,
    time_s: npt.ArrayLike | None = None,
    valid: npt.ArrayLike | None = None,
    adc_bits: int | None = None,
    entries: int = 1024,
    progress: Progress | None = None,
) -> Calibration:
    """Correction table from samples of any motion, taken at any rate (also below Nyquist).

    sine, cosine    ADC counts, zero at mid-scale but for an offset that ``conditioning`` removes, shape
                    (n,); NaN or -32768 in both (2050:03): a missing sample
    conditioning    None: the table corrects all errors, "fit" fits the ellipse of the tracks first, or
                    a :class:`canfb.signal.conditioning.Conditioning` to use
    time_s          sample times in seconds, rising; None: equidistant, no gaps
    valid           False for samples to omit (missed, faulty)
    adc_bits        4..16, to find clipped samples; None: 12, 14 or 16, the first that fits
    entries         length of the table, 16..4096; 1024 leave an interpolation error below 0.001 % of a cycle
    progress        called with 0..1 during the computation

    Raises ValueError for wrong arguments, :class:`canfb.errors.CalibrationError` for a measurement that is
    refused, with reason and remedy.
    """
    report = progress or no_progress
    record, ellipse, angle, chosen = prepared(sine, cosine, conditioning, time_s, valid, adc_bits, entries)
    report(0.05)
    amplitude = root_mean(np.hypot(*ellipse.apply(record.sine, record.cosine))[record.valid])
    solution = Solver(record, ellipse, amplitude, report).solve(angle)
    report(0.8)
    result = finish(record, solution, chosen, entries)
    if conditioning == "fit":
        result = replace(result, conditioning=with_track_harmonics(result.conditioning, result.tracks))
    report(1.0)
    return result


# The scatter of this many independent tables gives their error to some 15 %, that of two to some 30 %.
PARTS = 8
SCATTER, SCATTER_OF_TWO = 0.15, 0.3
MIN_BLOCKS_OF_PART = 24
HIGHEST_HARMONIC = 64  # of the error


def finish(record: Recording, solution: Solution, conditioning: Conditioning, entries: int) -> Calibration:
    fit, whole, loss, undetermined = solution
    blocks, use, position = fit.blocks, fit.blocks.used, fit.position
    cycles = float(np.abs(np.diff(position, axis=1))[use[:, 1:] & use[:, :-1]].sum())
    curve = raw_phase_curve(fit.waveform, conditioning)
    sensitivity = table_sensitivity(fit.waveform, conditioning)
    spread = np.sqrt(_variance(sensitivity, fit.covariance))
    expected = root_mean(spread)
    each = [_fit_of_part(blocks, fit, rows) for rows in independent_parts(len(blocks))]
    parts = [table_of(raw_phase_curve(one.waveform, conditioning), entries).entries for one in each]
    measured = measured_error(parts)
    tables = [CorrectionTable(np.mean(parts[odd::2], axis=0)) for odd in (0, 1)]
    change = _change(whole, fit, sensitivity, max(1.0, measured / expected))
    bound = float(np.sqrt(_variance(sensitivity, bound_covariance(fit)).mean()))
    before, after = _deviations(blocks, position, conditioning, tables)
    moving = use & fit.informative[:, None]
    phase = position - origin_of(curve)
    curve_of_errors = error_curve(phase[moving], before[moving], after[moving])
    systematic = _systematic(curve_of_errors, phase[moving], root_mean(after[moving]))
    found = Calibration(
        table=table_of(curve, entries),
        conditioning=conditioning,
        method=Method.MOTION,
        coverage=coverage(position[use]),
        cycles_used=cycles,
        samples_used=blocks.samples,
        samples_rejected=int(record.valid.sum()) - blocks.samples,
        residual_rms=root_mean(after[moving]) * blocks.correct,
        residual_peak=peak(after[moving]),
        before_rms=root_mean(before[moving]) * blocks.correct,
        before_peak=peak(before[moving]),
        uncertainty_rms=max(expected, measured, systematic, undetermined, change.rms),
        uncertainty_peak=max(
            PEAK_SIGMAS * max(float(spread.max()), measured, systematic, undetermined), change.peak
        ),
        change_rms=change.rms,
        noise_counts=fit.noise_counts,
        noise_cycles=fit.noise_cycles,
        bound_rms=bound,
        cramer_rao_ratio=max(measured, change.rms) / bound,
        cramer_rao_scatter=SCATTER if len(parts) == PARTS else SCATTER_OF_TWO,
        track_orders=fit.waveform.orders,
        harmonics=harmonics_of(fit.waveform, conditioning, origin_of(curve), expected),
        curve=curve_of_errors,
        block_samples=blocks.index.shape[1],
        tracks=mean_tracks_of(fit.waveform, curve),
    )
    return judge(found, loss)


def _variance(sensitivity: FloatArray, covariance: FloatArray) -> FloatArray:
    variance: FloatArray = np.einsum("pi,pi->p", sensitivity @ covariance, sensitivity)
    return np.maximum(variance, 0.0)


def _systematic(curve: ErrorCurve, position: FloatArray, noise: float) -> float:
    """Rms of the mean deviation over the phase, less what noise leaves of it: tracks that do not fit."""
    count = samples_in_bins(position)
    seen = count > 0
    if not seen.any():
        return 0.0
    excess = float(np.mean(curve.after[seen] ** 2 - noise**2 / count[seen]))
    return float(np.sqrt(max(0.0, excess)))


def independent_parts(count: int) -> list[IntArray]:
    """This many blocks, or cycles, dealt to parts."""
    parts = PARTS if count >= PARTS * MIN_BLOCKS_OF_PART else 2
    return [np.arange(first, count, parts) for first in range(parts)]


def mean_tracks_of(waveform: Waveform, curve: FloatArray) -> FloatArray:
    """At phases n/1024, phase 0 where ``curve``, that of :func:`.raw_phase_curve`, is 0."""
    return np.array(waveform.tracks(grid_phases(TRACK_POINTS)[:-1] + origin_of(curve)))


def _change(whole: Blocks, fit: JointFit, sensitivity: FloatArray, doubt: float) -> Drift:
    """Of the tracks in the course of the measurement; ``doubt``: noise over what the covariance expects."""
    largest = Drift()
    left_out = lasting(2 * fit.blocks.used.sum(axis=1) < whole.used.sum(axis=1))
    moving = np.flatnonzero(fit.informative)  # at standstill nobody sees a table
    for count in (THIRDS, FINE):
        if len(moving) < count * MIN_BLOCKS:
            break
        divided = np.array_split(moving, count) + left_out
        parts = [_fit_of_part(whole, fit, rows) for rows in divided]
        tables = np.array([sensitivity @ p.waveform.coefficients.ravel() for p in parts])
        noise = np.array([doubt * root_mean(np.sqrt(_variance(sensitivity, p.covariance))) for p in parts])
        largest = max(largest, largest_change(tables, noise))
    return largest


def _fit_of_part(whole: Blocks, fit: JointFit, rows: IntArray) -> JointFit:
    """The fit to these blocks alone. Where most samples had been left out, it is they that count here."""
    kept, whole, noise, motion = fit.blocks.take(rows), whole.take(rows), fit.noise, fit.motion[rows]
    if 2 * kept.samples < whole.samples:
        coarse = fit_jointly(whole, fit.waveform, motion, noise=noise)
        kept, noise, motion = reject(whole, coarse), coarse.noise, coarse.motion
    return fit_jointly(kept, fit.waveform, motion, rounds=6, noise=noise)


def measured_error(tables: list[FloatArray]) -> float:
    """Rms error of the mean of these independent tables, from how they scatter; mean of each taken off."""
    centred = np.array([table - table.mean() for table in tables])
    return float(np.sqrt(np.mean(np.var(centred, axis=0, ddof=1)) / len(tables)))


def _deviations(
    blocks: Blocks,
    position: FloatArray,
    conditioning: Conditioning,
    tables: list[CorrectionTable],
) -> tuple[FloatArray, FloatArray]:
    raw = np.where(blocks.used, raw_phases(*conditioning.apply(*blocks.tracks)), 0.0)
    after = np.empty_like(raw)
    for odd in (0, 1):
        after[odd::2] = tables[1 - odd].correct_array(raw[odd::2])
    return _from_smooth(blocks, raw, position), _from_smooth(blocks, after, position)


def _from_smooth(blocks: Blocks, phase: FloatArray, position: FloatArray) -> FloatArray:
    off = (phase - position) % 1.0
    off = about_mean(off, of=off[blocks.used])
    return np.asarray(off - blocks.evaluate(blocks.smooth(off)), np.float64)


def harmonics_of(
    waveform: Waveform, conditioning: Conditioning, origin: float, expected: float
) -> tuple[ErrorHarmonic, ...]:
    """Of the error of the conditioned arc tangent, beyond three times the ``expected`` one, cycles."""
    phase = grid_phases(TRACK_POINTS)[:-1]
    s, c = conditioning.apply(*waveform.tracks(phase + origin))
    angle = np.unwrap(np.arctan2(s, c) / (2.0 * np.pi), period=1.0)
    spectrum = np.fft.rfft(angle - phase) / TRACK_POINTS
    found = [
        ErrorHarmonic(order, 2.0 * float(abs(spectrum[order])), float(np.angle(spectrum[order])))
        for order in range(1, HIGHEST_HARMONIC + 1)
    ]
    shown = (one for one in found if one.amplitude_cycles > 3.0 * expected)
    return tuple(sorted(shown, key=lambda one: -one.amplitude_cycles))
