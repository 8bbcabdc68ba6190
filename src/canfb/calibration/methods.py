"""Reference measurements: from any motion, at any speed, and from a slow recording (section 2 of the paper).

    raw(k) = p(t_k) + e(p(t_k)) + noise   (modulo 1);  p: position in cycles, e: error within a cycle

**Any motion**: a polynomial of time follows p in a block of samples; e repeats with every cycle. One fit
(:mod:`.joint`) separates the two at any speed. Deviations of odd blocks are calculated with the table of the
even blocks, and vice versa. The error of the table is the largest of: scatter of the tables of
independent blocks, covariance of the fit, mean deviation over the phase beyond its noise, orders that
the samples cannot rule out, and change in time.

**Slow, many samples in each cycle**: a cubic through four positive zero crossings of the sine gives the phase
of each sample between the inner two; a crossing comes from the four samples around it. The mean tracks over
that phase, of many cycles and as Fourier series, give the table.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace

import numpy as np

from canfb.calibration.ellipse import angle_cycles, with_track_harmonics
from canfb.calibration.figure import change_of_figure
from canfb.calibration.joint import (
    JointFit,
    Waveform,
    bound_covariance,
    fit_jointly,
    grid_phases,
    origin_of,
    raw_phase_curve,
    series_of,
    table_of,
    table_sensitivity,
    table_variance,
)
from canfb.calibration.recording import Blocks, Recording, prepared
from canfb.calibration.result import (
    FINE,
    PEAK_SIGMAS,
    THIRDS,
    TRACK_POINTS,
    Calibration,
    Drift,
    ErrorCurve,
    ErrorHarmonic,
    Method,
    Reason,
    about_mean,
    coverage,
    error_curve,
    judge,
    largest_change,
    peak,
    root_mean,
    samples_in_bins,
)
from canfb.calibration.solver import ORDER_STEPS, Progress, Solution, Solver, no_progress
from canfb.errors import CalibrationError
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import CorrectionTable
from canfb.signal.phase import ArrayLike, BoolArray, FloatArray, IntArray, raw_phases


def calibrate_from_motion(
    sine: ArrayLike,
    cosine: ArrayLike,
    conditioning: Conditioning | str | None = None,
    *,
    time_s: ArrayLike | None = None,
    valid: ArrayLike | None = None,
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


# The scatter of this many independent tables gives their error within about 15 %, of two within 30 %.
PARTS = 8
SCATTER, SCATTER_OF_TWO = 0.15, 0.3
MIN_BLOCKS_OF_PART = 24
HIGHEST_HARMONIC = 64  # highest order of the error that is reported


def finish(record: Recording, solution: Solution, conditioning: Conditioning, entries: int) -> Calibration:
    fit, loss, undetermined = solution
    blocks, use, position = fit.blocks, fit.blocks.used, fit.position
    cycles = float(np.abs(np.diff(position, axis=1))[use[:, 1:] & use[:, :-1]].sum())
    curve = raw_phase_curve(fit.waveform, conditioning)
    sensitivity = table_sensitivity(fit.waveform, conditioning)
    spread = np.sqrt(table_variance(sensitivity, fit.covariance))
    expected = root_mean(spread)
    each = [_fit_of_part(fit, rows) for rows in independent_parts(len(blocks))]
    parts = [table_of(raw_phase_curve(one.waveform, conditioning), entries).entries for one in each]
    measured = measured_error(parts)
    tables = [CorrectionTable(np.mean(parts[odd::2], axis=0)) for odd in (0, 1)]
    change = max(
        _change(fit, sensitivity, max(1.0, measured / expected)),
        change_of_figure(record, fit.waveform, conditioning),
    )
    bound = float(np.sqrt(table_variance(sensitivity, bound_covariance(fit)).mean()))
    before, after = _deviations(blocks, position, conditioning, tables)
    moving = use & fit.informative[:, None]
    phase = position - origin_of(curve)
    curve_of_errors = error_curve(phase[moving], before[moving], after[moving])
    systematic = _systematic(curve_of_errors, phase[moving], root_mean(after[moving]))
    tracks = mean_tracks_of(fit.waveform, curve)
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
        harmonics=harmonics_of(tracks, conditioning, expected),
        curve=curve_of_errors,
        block_samples=blocks.index.shape[1],
        tracks=tracks,
    )
    return judge(found, loss)


def _systematic(curve: ErrorCurve, position: FloatArray, noise: float) -> float:
    """Rms of the mean deviation over the phase, less its noise: systematic error of the tracks."""
    count = samples_in_bins(position)
    seen = count > 0
    excess = float(np.mean(curve.after[seen] ** 2 - noise**2 / count[seen]))
    return float(np.sqrt(max(0.0, excess)))


def independent_parts(count: int) -> list[IntArray]:
    """Indices of ``count`` blocks or cycles, dealt in turn to the parts."""
    parts = PARTS if count >= PARTS * MIN_BLOCKS_OF_PART else 2
    return [np.arange(first, count, parts) for first in range(parts)]


def mean_tracks_of(waveform: Waveform, curve: FloatArray) -> FloatArray:
    """Tracks at phases n/1024, phase 0 where ``curve`` (:func:`.raw_phase_curve`) is 0."""
    return np.array(waveform.tracks(grid_phases(TRACK_POINTS)[:-1] + origin_of(curve)))


def _change(fit: JointFit, sensitivity: FloatArray, doubt: float) -> Drift:
    """Change of the tracks during the measurement; ``doubt``: actual noise / noise by the covariance."""
    largest = Drift()
    moving = np.flatnonzero(fit.informative)  # standstill gives no information on the table
    for count in (THIRDS, FINE):
        if len(moving) < 4 * count:  # the covariance of a part is credible from four blocks on
            break
        parts = [_fit_of_part(fit, rows) for rows in np.array_split(moving, count)]
        tables = np.array([sensitivity @ p.waveform.coefficients.ravel() for p in parts])
        spreads = [np.sqrt(table_variance(sensitivity, p.covariance)) for p in parts]
        largest = max(largest, largest_change(tables, doubt * np.array([*map(root_mean, spreads)])))
    return largest


def _fit_of_part(fit: JointFit, rows: IntArray) -> JointFit:
    return fit_jointly(fit.blocks.take(rows), fit.waveform, fit.motion[rows], rounds=6, noise=fit.noise)


def measured_error(tables: list[FloatArray]) -> float:
    """Rms error of the mean of these independent tables, from their scatter without the mean of each."""
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
    tracks: FloatArray, conditioning: Conditioning, expected: float
) -> tuple[ErrorHarmonic, ...]:
    """Harmonics of the error of the conditioned arc tangent above 3 x ``expected``, cycles."""
    angle = np.unwrap(angle_cycles(conditioning, *tracks), period=1.0)
    spectrum = np.fft.rfft(angle - grid_phases(TRACK_POINTS)[:-1]) / TRACK_POINTS
    found = [
        ErrorHarmonic(order, 2.0 * float(abs(spectrum[order])), float(np.angle(spectrum[order])))
        for order in range(1, HIGHEST_HARMONIC + 1)
    ]
    shown = (one for one in found if one.amplitude_cycles > 3.0 * expected)
    return tuple(sorted(shown, key=lambda one: -one.amplitude_cycles))


MIN_SAMPLES_PER_CYCLE = 40
MIN_CYCLES = 16
MAX_CYCLES = 4096  # more cycles only cost memory
# Largest step of raw phase between two samples; with 40 % offset it is three times that of the phase.
LARGEST_STEP_CYCLES = 0.125
REJECT_CYCLE = 4.0
ORDERS = tuple(range(1, ORDER_STEPS[-1] + 1))


def calibrate_from_zero_crossings(
    sine: ArrayLike,
    cosine: ArrayLike,
    conditioning: Conditioning | str | None = None,
    *,
    time_s: ArrayLike | None = None,
    valid: ArrayLike | None = None,
    adc_bits: int | None = None,
    entries: int = 1024,
    progress: Progress | None = None,
) -> Calibration:
    """Correction table from a slow recording: at least 40 samples in each cycle used (section 2).

    Arguments and errors are those of :func:`calibrate_from_motion`.
    Speed and direction may vary; only whole cycles without an invalid sample are used, in the
    direction of the longer distance.
    """
    report = progress or no_progress
    record, _, _, chosen = prepared(sine, cosine, conditioning, time_s, valid, adc_bits, entries)
    report(0.2)
    s, c = chosen.apply(record.sine, record.cosine)
    usable = record.valid & ((s != 0.0) | (c != 0.0))
    raw = np.where(usable, raw_phases(s, c), 0.0)
    # An unusable sample gets the phase before it, so that the cycle count continues.
    last = np.maximum.accumulate(np.where(usable, np.arange(len(raw)), 0))
    angle = np.unwrap(raw[last], period=1.0)
    columns = np.array([record.time, s, angle, usable, record.sine, record.cosine, raw])
    turned = np.array([-columns[0], *columns[1:]])[:, ::-1]
    forward, back = (columns, turned) if angle[-1] >= angle[0] else (turned, columns)
    cycles = _Cycles.of(chosen, forward)
    agree = cycles.agreeing()
    if agree.sum() < MIN_CYCLES:
        raise CalibrationError(f"{agree.sum()} cycles agree: at least {MIN_CYCLES} are needed", Reason.CYCLES)
    good = cycles.take(agree)
    measured = measured_error([good.take(rows).table().entries for rows in independent_parts(len(good))])
    parts = [cycles.take(rows) for rows in np.array_split(np.arange(len(cycles)), THIRDS)]
    with contextlib.suppress(CalibrationError):  # too few cycles in the other direction
        # Real tracks have the same shape in both directions. Tracks that were inverted or exchanged
        # during the measurement seem to reverse, and differ.
        parts.append(_Cycles.of(chosen, back))
    parts = [part.take(part.agreeing()) for part in parts]
    noise = measured * np.sqrt([len(good) / len(part) for part in parts])
    change = max(
        largest_change(np.array([part.table().entries for part in parts]), noise),
        change_of_figure(record, good.waveform(), chosen),
    )
    report(0.9)
    samples_left_out = int(record.valid.sum()) - len(good.phase)
    amplitude = root_mean(np.hypot(s[usable], c[usable]))
    found = _finish(good, entries, measured, change, samples_left_out, amplitude)
    report(1.0)
    return found


@dataclass(frozen=True, eq=False)
class _Cycles:
    """The samples of whole cycles: phase by the crossings, cycle number, raw phase, counts."""

    conditioning: Conditioning
    phase: FloatArray
    cycle: IntArray
    raw: FloatArray
    counts: FloatArray

    @classmethod
    def of(cls, conditioning: Conditioning, columns: FloatArray) -> _Cycles:
        time, sine, angle, seen, *counts, raw = columns
        first, last, times = _whole(time, sine, angle, seen > 0.0)
        length = last - first + 1
        cycle = np.repeat(np.arange(len(first)), length)
        at = np.arange(len(cycle)) + np.repeat(first - np.cumsum(length) + length, length)
        phase = _interpolate(times[cycle], np.arange(-1.0, 3.0), time[at]) % 1.0
        return cls(conditioning, phase, cycle, raw[at], np.array(counts)[:, at])

    def __len__(self) -> int:
        return int(self.cycle[-1]) + 1

    def take(self, cycles: IntArray | BoolArray) -> _Cycles:
        chosen = np.zeros(len(self), np.bool_)
        chosen[cycles] = True
        rows = chosen[self.cycle]
        number = np.cumsum(chosen) - 1
        return replace(
            self,
            phase=self.phase[rows],
            cycle=number[self.cycle[rows]],
            raw=self.raw[rows],
            counts=self.counts[:, rows],
        )

    def waveform(self) -> Waveform:
        place = (self.phase * TRACK_POINTS).astype(np.int64) % TRACK_POINTS
        number = np.bincount(place, minlength=TRACK_POINTS)
        seen = number > 0
        phase, sine, cosine = (
            np.bincount(place, one, TRACK_POINTS)[seen] / number[seen] for one in (self.phase, *self.counts)
        )
        grid = np.arange(TRACK_POINTS) / TRACK_POINTS
        tracks = np.array([np.interp(grid, phase, one, period=1.0) for one in (sine, cosine)])
        return series_of(np.fft.rfft(tracks, axis=1)[:, : ORDERS[-1] + 1] / TRACK_POINTS, ORDERS)

    def table(self, entries: int = TRACK_POINTS) -> CorrectionTable:
        return table_of(raw_phase_curve(self.waveform(), self.conditioning), entries)

    def off(self, phase: FloatArray) -> FloatArray:
        return about_mean(phase - self.phase)

    def agreeing(self) -> BoolArray:
        square = np.bincount(self.cycle, self.off(self.table().correct_array(self.raw)) ** 2)
        off = np.sqrt(square / np.bincount(self.cycle))
        return np.asarray(off <= REJECT_CYCLE * np.median(off) + 1e-9, np.bool_)


def _whole(
    time: FloatArray, sine: FloatArray, angle: FloatArray, usable: BoolArray
) -> tuple[IntArray, IntArray, FloatArray]:
    """Cycles between two positive zero crossings, with one more whole cycle on either side.

    Their first and last samples, and the times of four crossings, shape (cycles, 4).
    """
    whole = np.floor(angle)
    # The crossing lies between samples at and at + 1; four samples around it are needed.
    at = np.flatnonzero(np.diff(whole) != 0.0)
    at = at[(at >= 1) & (at + 2 < len(whole))]
    upward = np.diff(whole)[at] == 1.0
    step = np.diff(angle)
    rough = np.cumsum((step <= 0.0) | (step > LARGEST_STEP_CYCLES))
    bad = np.cumsum(~usable)
    start, stop = np.maximum(at[:-3] - 2, 0), at[3:]
    clean = (bad[stop + 2] == bad[start]) & (rough[stop + 1] == rough[start])
    clean &= upward[:-3] & upward[1:-2] & upward[2:-1] & upward[3:]
    rows = np.flatnonzero(clean)
    if len(rows) < MIN_CYCLES:
        is_slow = np.median(np.abs(step)) < 1.0 / MIN_SAMPLES_PER_CYCLE
        raise CalibrationError(
            f"{len(rows)} whole cycles without a fault: at least {MIN_CYCLES} are needed. "
            "Record longer, at a steady slow speed",
            Reason.CYCLES if is_slow else Reason.SPEED,
        )
    samples = np.diff(at)[rows + 1]
    if np.sum(samples >= MIN_SAMPLES_PER_CYCLE) < MIN_CYCLES:
        raise CalibrationError(
            f"{np.median(samples):.0f} samples in a cycle: at least {MIN_SAMPLES_PER_CYCLE} are needed. "
            "Turn slower, sample faster, or calibrate from motion",
            Reason.SPEED,
        )
    rows = rows[samples >= MIN_SAMPLES_PER_CYCLE]
    rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), MAX_CYCLES)).astype(np.int64)]
    around = at[:, None] + np.arange(-1, 3)
    crossing = _interpolate(sine[around], time[around] - time[at][:, None], np.zeros(len(at))) + time[at]
    return at[rows + 1] + 1, at[rows + 2], crossing[rows[:, None] + np.arange(4)]


@np.errstate(divide="ignore", invalid="ignore")  # crossings that are not clean; they are not used
def _interpolate(x: FloatArray, y: FloatArray, at: FloatArray) -> FloatArray:
    """The polynomial through the points of each row, by Neville's algorithm."""
    for step in range(1, x.shape[-1]):
        part = (at[:, None] - x[:, :-step]) / (x[:, step:] - x[:, :-step])
        y = y[..., :-1] + part * np.diff(y)
    return y[:, 0]


def _finish(
    cycles: _Cycles, entries: int, measured: float, change: Drift, left_out: int, amplitude: float
) -> Calibration:
    waveform, odd = cycles.waveform(), cycles.cycle % 2 == 1
    curve = raw_phase_curve(waveform, cycles.conditioning)
    tracks = mean_tracks_of(waveform, curve)
    halves = [cycles.take(np.arange(first, len(cycles), 2)).table(entries) for first in (0, 1)]
    after = cycles.off(np.where(odd, *(half.correct_array(cycles.raw) for half in halves)))
    before = cycles.off(cycles.raw)
    noise, errors = root_mean(after), error_curve(cycles.phase, before, after)
    measured = max(measured, _systematic(errors, cycles.phase, noise))
    return judge(
        Calibration(
            table=table_of(curve, entries),
            conditioning=cycles.conditioning,
            method=Method.ZERO_CROSSINGS,
            coverage=coverage(cycles.phase),
            cycles_used=float(len(cycles)),
            samples_used=len(cycles.phase),
            samples_rejected=left_out,
            residual_rms=noise,
            residual_peak=peak(after),
            before_rms=root_mean(before),
            before_peak=peak(before),
            uncertainty_rms=max(measured, change.rms),
            uncertainty_peak=max(PEAK_SIGMAS * measured, change.peak),
            change_rms=change.rms,
            noise_counts=noise * 2.0 * np.pi * amplitude,
            noise_cycles=noise,
            harmonics=harmonics_of(tracks, cycles.conditioning, measured),
            curve=errors,
            block_samples=round(len(cycles.phase) / len(cycles)),
            tracks=tracks,
        )
    )
