"""Reference measurement of the paper (section 2): a slow recording, many samples in each cycle.

A cubic through four positive zero crossings of the sine gives the position between the inner two; the
samples there are resampled to equidistant raw phases and averaged over many cycles. Beyond the paper, a
crossing comes from four samples, and the smooth difference to the arc tangent is resampled, not the phase.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from canfb.calibration.deviation import THIRDS, Drift, largest_change, lasting
from canfb.calibration.joint import grid_phases, table_from_phases
from canfb.calibration.motion_blocks import (
    BoolArray,
    ErrorHarmonic,
    IntArray,
    about_mean,
    coverage,
    error_curve,
    error_harmonics,
    peak,
    root_mean,
)
from canfb.calibration.recording import Recording, prepared
from canfb.calibration.result import PEAK_SIGMAS, TRACK_POINTS, Calibration, Method, Reason, judge
from canfb.calibration.solver import Progress, no_progress
from canfb.errors import CalibrationError
from canfb.signal.conditioning import Conditioning
from canfb.signal.phase import FloatArray, raw_phases

MIN_SAMPLES_PER_CYCLE = 40
MIN_CYCLES = 16
MAX_CYCLES = 4096  # more would only cost memory
# Raw phase moves up to three times faster than the phase with 40 % offset.
LARGEST_STEP_CYCLES = 0.125
REJECT_CYCLE = 4.0
CHUNK_CYCLES = 128


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
    passage = _Passage.of(record, chosen)
    cycles = _find_cycles(passage)
    nodes = _ideal_phase(np.arange(entries) / entries)
    curves = _resample(passage, cycles, nodes)
    change = _change(curves, _backwards(passage, nodes))
    good = _agreeing(curves)
    if good.sum() < MIN_CYCLES:
        raise CalibrationError(f"{good.sum()} cycles agree: at least {MIN_CYCLES} are needed", Reason.CYCLES)
    report(0.9)
    found = _finish(passage, cycles.take(good), nodes, curves[good], chosen, record, change)
    report(1.0)
    return found


@dataclass(frozen=True, eq=False)
class _Passage:
    """The samples in the direction of positive raw phase.

    time  sampling intervals;  sine  conditioned, counts;  counts  both tracks as they came;
    usable  may be used;  raw  raw phase;  angle  ideal phase at that raw phase (the arc
    tangent), continuous, cycles;  amplitude  of the tracks, counts
    """

    time: FloatArray
    sine: FloatArray
    counts: FloatArray
    usable: BoolArray
    angle: FloatArray
    raw: FloatArray
    amplitude: float

    @classmethod
    def of(cls, record: Recording, conditioning: Conditioning) -> _Passage:
        s, c = conditioning.apply(record.sine, record.cosine)
        usable = record.valid & ((s != 0.0) | (c != 0.0))
        raw = np.where(usable, raw_phases(s, c), 0.0)
        # A sample that is not usable keeps the phase before it, so the count goes on.
        last = np.maximum.accumulate(np.where(usable, np.arange(len(raw)), 0))
        angle = np.unwrap(_ideal_phase(raw[last]), period=1.0)
        amplitude = root_mean(np.hypot(s[usable], c[usable]))
        counts = np.array((record.sine, record.cosine))
        forward = cls(record.time, s, counts, usable, angle, raw, amplitude)
        return forward if angle[-1] >= angle[0] else forward.reversed()

    def reversed(self) -> _Passage:
        return _Passage(
            -self.time[::-1],
            self.sine[::-1],
            self.counts[:, ::-1],
            self.usable[::-1],
            self.angle[::-1],
            self.raw[::-1],
            self.amplitude,
        )


@dataclass(frozen=True, eq=False)
class _Cycles:
    """Whole cycles: first and last sample inside, count at the start, times of four crossings."""

    first: IntArray
    last: IntArray
    count: FloatArray
    times: FloatArray

    def __len__(self) -> int:
        return len(self.first)

    def take(self, rows: IntArray | BoolArray) -> _Cycles:
        return _Cycles(self.first[rows], self.last[rows], self.count[rows], self.times[rows])

    def position(self, time: FloatArray) -> FloatArray:
        """Cubic through the crossings, 0..1 between the inner two; time has shape (cycles, ...)."""
        times = self.times.reshape(len(self), *(1,) * (time.ndim - 1), 4)
        return _interpolate(times, np.arange(-1.0, 3.0), time)


def _ideal_phase(raw: FloatArray) -> FloatArray:
    """Phase of ideal tracks at these raw phases: Table 1 inverted."""
    quarter = np.rint(4.0 * raw) / 4.0
    return np.asarray(quarter + np.arctan(8.0 * (raw - quarter)) / (2.0 * np.pi), np.float64)


def _find_cycles(passage: _Passage) -> _Cycles:
    """Whole cycles between two positive zero crossings, with one more whole cycle on either side."""
    whole = np.floor(passage.angle)
    # The crossing lies between samples at and at + 1; four samples around it are needed.
    at = np.flatnonzero(np.diff(whole) != 0.0)
    at = at[(at >= 1) & (at + 2 < len(whole))]
    upward = np.diff(whole)[at] == 1.0
    step = np.diff(passage.angle)
    rough = np.cumsum((step <= 0.0) | (step > LARGEST_STEP_CYCLES))
    bad = np.cumsum(~passage.usable)
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
    crossing = _crossing_times(passage, at)
    times = crossing[rows[:, None] + np.arange(4)]
    return _Cycles(at[rows + 1] + 1, at[rows + 2], whole[at[rows + 1] + 1], times)


def _crossing_times(passage: _Passage, at: IntArray) -> FloatArray:
    """Time of zero sine between samples ``at`` and ``at + 1``: inverse cubic through four samples."""
    around = at[:, None] + np.arange(-1, 3)
    sine, time = passage.sine[around], passage.time[around]
    with np.errstate(divide="ignore", invalid="ignore"):  # events that are not a clean crossing
        after = _interpolate(sine, time - time[:, 1:2], np.zeros(len(at)))
    return after + passage.time[at]


def _resample(passage: _Passage, cycles: _Cycles, nodes: FloatArray) -> FloatArray:
    """Position in the cycle where the angle is ``nodes``, shape (cycles, nodes)."""
    rising = np.maximum.accumulate(passage.angle)
    curves = np.empty((len(cycles), len(nodes)))
    for start in range(0, len(cycles), CHUNK_CYCLES):
        part = np.arange(start, min(start + CHUNK_CYCLES, len(cycles)))
        some = cycles.take(part)
        target = some.count[:, None] + nodes
        before = np.searchsorted(rising, target, side="right") - 1
        around = before[..., None] + np.arange(-2, 4)
        angle = passage.angle[around]
        time = passage.time[around]
        difference = some.position(time) - (angle - some.count[:, None, None])
        curves[part] = nodes + _interpolate(angle, difference, target)
    return curves


def _interpolate(x: FloatArray, y: FloatArray, at: FloatArray) -> FloatArray:
    """Polynomial through the points of the last axis (Lagrange)."""
    value = np.zeros_like(at)
    points = range(x.shape[-1])
    for one in points:
        part = y[..., one]
        for other in points:
            if other != one:
                part = part * (at - x[..., other]) / (x[..., one] - x[..., other])
        value += part
    return value


def _agreeing(curves: FloatArray) -> BoolArray:
    off = np.sqrt(np.mean((curves - np.median(curves, axis=0)) ** 2, axis=1))
    return np.asarray(off <= REJECT_CYCLE * np.median(off) + 1e-9, np.bool_)


def _backwards(passage: _Passage, nodes: FloatArray) -> FloatArray | None:
    """Curves of the cycles in the other direction, None for too few. Real tracks have the same shape there;
    where one is inverted or both are exchanged, the motion seems to turn."""
    turned = passage.reversed()
    try:
        return _resample(turned, _find_cycles(turned), nodes)
    except CalibrationError:
        return None


def _change(curves: FloatArray, backwards: FloatArray | None) -> Drift:
    """Of the curves (cycles, nodes) in the course of the recording."""
    parts = np.array_split(curves, THIRDS) + [curves[rows] for rows in lasting(~_agreeing(curves))]
    parts += [] if backwards is None else [backwards]
    parts = [part[_agreeing(part)] for part in parts]
    tables = np.array([part.mean(axis=0) for part in parts])
    scatter = root_mean(np.array([np.sqrt(np.mean(np.var(part, axis=0, ddof=1))) for part in parts]))
    return largest_change(tables, np.array([scatter / np.sqrt(len(part)) for part in parts]))


def _finish(
    passage: _Passage,
    cycles: _Cycles,
    nodes: FloatArray,
    curves: FloatArray,
    conditioning: Conditioning,
    record: Recording,
    change: Drift,
) -> Calibration:
    mean = curves.mean(axis=0)
    tables = [
        table_from_phases(half - half[0]) for half in (curves[0::2].mean(axis=0), curves[1::2].mean(axis=0))
    ]
    measured = float(np.std(tables[0].entries - tables[1].entries)) / 2.0
    spread = np.std(curves, axis=0) / np.sqrt(len(curves))
    inside, owner = _members(cycles)
    position = cycles.take(owner).position(passage.time[inside])
    raw = passage.raw[inside]
    after = np.where(owner % 2 == 0, tables[1].correct_array(raw), tables[0].correct_array(raw))
    before, after = about_mean(raw - position), about_mean(after - position)
    noise = root_mean(after)
    found = Calibration(
        table=table_from_phases(mean - mean[0]),
        conditioning=conditioning,
        method=Method.ZERO_CROSSINGS,
        coverage=coverage(position),
        cycles_used=float(len(cycles)),
        samples_used=len(inside),
        samples_rejected=int(record.valid.sum()) - len(inside),
        residual_rms=noise,
        residual_peak=peak(after),
        before_rms=root_mean(before),
        before_peak=peak(before),
        uncertainty_rms=max(root_mean(spread), measured, change.rms),
        uncertainty_peak=max(PEAK_SIGMAS * max(float(spread.max()), measured), change.peak),
        change_rms=change.rms,
        noise_counts=noise * 2.0 * np.pi * passage.amplitude,
        noise_cycles=noise,
        harmonics=_harmonics(nodes, mean, max(root_mean(spread), measured)),
        curve=error_curve(position, before, after),
        block_samples=round(len(inside) / len(cycles)),
        tracks=_mean_tracks(passage.counts[:, inside], position - mean[0]),
    )
    return judge(found)


def _members(cycles: _Cycles) -> tuple[IntArray, IntArray]:
    length = cycles.last - cycles.first + 1
    owner = np.repeat(np.arange(len(cycles)), length)
    begin = np.repeat(np.cumsum(length) - length, length)
    return cycles.first[owner] + np.arange(len(owner)) - begin, owner


def _mean_tracks(counts: FloatArray, phase: FloatArray) -> FloatArray:
    """Both tracks at phases n / TRACK_POINTS: the mean around there, straight over what has no sample."""
    place = np.rint(phase % 1.0 * TRACK_POINTS).astype(np.int64) % TRACK_POINTS
    number = np.bincount(place, minlength=TRACK_POINTS)
    seen = np.flatnonzero(number)
    means = [np.bincount(place, track, TRACK_POINTS)[seen] / number[seen] for track in counts]
    return np.array([np.interp(np.arange(TRACK_POINTS), seen, one, period=TRACK_POINTS) for one in means])


def _harmonics(nodes: FloatArray, phase: FloatArray, uncertainty: float) -> tuple[ErrorHarmonic, ...]:
    even = grid_phases(1024)[:-1]
    ahead = np.concatenate([phase - 1.0, phase, phase + 1.0])
    angle = np.interp(even, ahead, np.concatenate([nodes - 1.0, nodes, nodes + 1.0]))
    return error_harmonics(even, angle, 3.0 * uncertainty)
