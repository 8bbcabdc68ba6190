"""Reference measurement of the paper (section 2): a slow recording, many samples in each cycle.

A cubic through four positive zero crossings of the sine gives the phase of each sample between the inner two;
a crossing comes from the four samples around it. The mean tracks over that phase, of many cycles and as
Fourier series, give the table as those of a motion do (:mod:`.from_motion`).
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from canfb.calibration.deviation import THIRDS, Drift, largest_change, lasting
from canfb.calibration.from_motion import harmonics_of, independent_parts, mean_tracks_of, measured_error
from canfb.calibration.joint import Waveform, origin_of, raw_phase_curve, series_of, table_of
from canfb.calibration.motion_blocks import (
    BoolArray,
    IntArray,
    about_mean,
    coverage,
    error_curve,
    peak,
    root_mean,
)
from canfb.calibration.recording import prepared
from canfb.calibration.result import PEAK_SIGMAS, TRACK_POINTS, Calibration, Method, Reason, judge
from canfb.calibration.solver import ORDER_STEPS, Progress, no_progress
from canfb.errors import CalibrationError
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import CorrectionTable
from canfb.signal.phase import FloatArray, raw_phases

MIN_SAMPLES_PER_CYCLE = 40
MIN_CYCLES = 16
MAX_CYCLES = 4096  # more would only cost memory
# Raw phase moves up to three times faster than the phase with 40 % offset.
LARGEST_STEP_CYCLES = 0.125
REJECT_CYCLE = 4.0
ORDERS = tuple(range(1, ORDER_STEPS[-1] + 1))


def calibrate_from_zero_crossings(
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
    """Correction table from a slow recording: at least 40 samples in each cycle used (section 2).

    Arguments and errors are those of :func:`canfb.calibration.from_motion.calibrate_from_motion`.
    Speed and direction may vary; only cycles in the direction with the longer distance are
    used, and only whole ones without an invalid sample.
    """
    report = progress or no_progress
    record, _, _, chosen = prepared(sine, cosine, conditioning, time_s, valid, adc_bits, entries)
    report(0.2)
    s, c = chosen.apply(record.sine, record.cosine)
    usable = record.valid & ((s != 0.0) | (c != 0.0))
    raw = np.where(usable, raw_phases(s, c), 0.0)
    # A sample that is not usable keeps the phase before it, so the count goes on.
    last = np.maximum.accumulate(np.where(usable, np.arange(len(raw)), 0))
    angle = np.unwrap(raw[last], period=1.0)
    seen = usable.astype(np.float64)
    columns: list[FloatArray] = [record.time, s, angle, seen, record.sine, record.cosine, raw]
    turned = [-columns[0][::-1], *(one[::-1] for one in columns[1:])]
    forward, back = (columns, turned) if angle[-1] >= angle[0] else (turned, columns)
    cycles = _Cycles.of(chosen, forward)
    agree = cycles.agreeing()
    if agree.sum() < MIN_CYCLES:
        raise CalibrationError(f"{agree.sum()} cycles agree: at least {MIN_CYCLES} are needed", Reason.CYCLES)
    good = cycles.take(agree)
    measured = measured_error([good.take(rows).table().entries for rows in independent_parts(len(good))])
    parts = [
        cycles.take(rows) for rows in (*np.array_split(np.arange(len(cycles)), THIRDS), *lasting(~agree))
    ]
    with contextlib.suppress(CalibrationError):  # too few
        # Real tracks have the same shape there; inverted or exchanged, the motion seems to turn.
        parts.append(_Cycles.of(chosen, back))
    change = _change([part.take(part.agreeing()) for part in parts], measured * np.sqrt(len(good)))
    report(0.9)
    samples_left_out = int(record.valid.sum()) - len(good.phase)
    amplitude = root_mean(np.hypot(s[usable], c[usable]))
    found = _finish(good, entries, measured, change, samples_left_out, amplitude)
    report(1.0)
    return found


@dataclass(frozen=True, eq=False)
class _Cycles:
    """The samples of whole cycles: phase by the crossings, number of their cycle, raw phase, counts."""

    conditioning: Conditioning
    phase: FloatArray
    cycle: IntArray
    raw: FloatArray
    counts: FloatArray

    @classmethod
    def of(cls, conditioning: Conditioning, columns: list[FloatArray]) -> _Cycles:
        time, sine, angle, seen, *counts, raw = columns
        first, last, times = _whole(time, sine, angle, seen > 0.0)
        length = last - first + 1
        cycle = np.repeat(np.arange(len(first)), length)
        at = np.arange(len(cycle)) + np.repeat(first - np.cumsum(length) + length, length)
        phase = _interpolate(times[cycle], np.arange(-1.0, 3.0), time[at])
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
        place = (self.phase % 1.0 * TRACK_POINTS).astype(np.int64) % TRACK_POINTS
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

    First and last sample inside, and the times of four crossings, shape (cycles, 4).
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
    with np.errstate(divide="ignore", invalid="ignore"):  # events that are not a clean crossing
        after = _interpolate(sine[around], time[around] - time[at][:, None], np.zeros(len(at)))
    crossing = after + time[at]
    return at[rows + 1] + 1, at[rows + 2], crossing[rows[:, None] + np.arange(4)]


def _interpolate(x: FloatArray, y: FloatArray, at: FloatArray) -> FloatArray:
    value = np.zeros_like(at)
    points = range(x.shape[-1])
    for one in points:
        part = y[..., one]
        for other in points:
            if other != one:
                part = part * (at - x[..., other]) / (x[..., one] - x[..., other])
        value += part
    return value


def _change(parts: list[_Cycles], noise_of_cycle: float) -> Drift:
    tables = np.array([part.table().entries for part in parts])
    return largest_change(tables, np.array([noise_of_cycle / np.sqrt(len(part)) for part in parts]))


def _finish(
    cycles: _Cycles, entries: int, measured: float, change: Drift, left_out: int, amplitude: float
) -> Calibration:
    waveform, odd = cycles.waveform(), cycles.cycle % 2 == 1
    curve = raw_phase_curve(waveform, cycles.conditioning)
    halves = [cycles.take(np.arange(first, len(cycles), 2)).table() for first in (0, 1)]
    after = cycles.off(np.where(odd, *(half.correct_array(cycles.raw) for half in halves)))
    before = cycles.off(cycles.raw)
    noise = root_mean(after)
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
            harmonics=harmonics_of(waveform, cycles.conditioning, origin_of(curve), measured),
            curve=error_curve(cycles.phase, before, after),
            block_samples=round(len(cycles.phase) / len(cycles)),
            tracks=mean_tracks_of(waveform, curve),
        )
    )
