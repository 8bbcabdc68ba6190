"""A recording of both tracks, checked; blocks of it; its positions; motion that is locked to its samples.

At p/q cycles per sample only q places of the cycle are sampled. The mean of cosine + i sine, amplitude A, at
a place that moves by d cycles in a window is A |sin(pi d) / (pi d)|; locked is d < 0.36 / q in 256 samples.

Phases leave the speed open by s whole cycles per sample. With even times the position is then off by a line,
as smooth as the motion. With uneven ones all speeds that join the first two samples are followed, and the one
with the least squares of the residuals (eq. 9 over elapsed times, the speed over BASELINE at least) is taken.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from canfb.calibration.ellipse import angle_cycles, as_real32, fit_ellipse
from canfb.calibration.result import Reason, samples_in_bins
from canfb.errors import CalibrationError
from canfb.objects import MISSED_COUNTS
from canfb.signal.conditioning import IDENTITY, Conditioning
from canfb.signal.phase import (
    ArrayLike,
    BoolArray,
    FloatArray,
    IntArray,
    check_counts,
    pair_of_tracks,
    real_array,
)
from canfb.signal.sample_recording import BYTES_PER_SAMPLE
from canfb.signal.tracker import track

MIN_SAMPLES = 200
# Faults may hit the end of the range now and then; a track that is too large hits it in
# every cycle at the same phase.
CLIPPED_PART = 0.05
CLIPPED_PART_OF_BIN = 0.2
BREAK_INTERVALS = 10.0
DEAD = 0.1  # of the amplitude: less is no track, and its angle would be followed as a motion
ADC_BITS = (12, 14, 16)
FAULTY_PART = 0.005  # of the counts, at either end: a track that clips has more of them there
MOST_COUNTS = 1e12  # of no converter: squares of them are finite
UNEVEN = 1e-6
NO_TIME = -1
CUBIC = 4
SPARE = 2  # a block with fewer samples than coefficients and these says nothing about the tracks


@dataclass(frozen=True, eq=False)
class Blocks:
    """Samples in rows, one row a block.

    index   sample numbers, shape (blocks, length), filled up where a block is shorter
    used    False for filling and for samples left out
    terms   Legendre polynomials of time -1..1 over the block, shape (blocks, length, coefficients)
    tracks  counts, shape (2, blocks, length), sine first
    """

    index: IntArray
    used: BoolArray
    terms: FloatArray
    tracks: FloatArray

    def __len__(self) -> int:
        return len(self.index)

    def take(self, rows: IntArray | BoolArray) -> Blocks:
        return Blocks(self.index[rows], self.used[rows], self.terms[rows], self.tracks[:, rows])

    def using(self, used: BoolArray) -> Blocks:
        """The same blocks with other samples left out; blocks with too few samples give none."""
        return replace(self, used=used & (used.sum(axis=1) >= self.coefficients + SPARE)[:, None])

    @property
    def coefficients(self) -> int:
        return int(self.terms.shape[2])

    @property
    def samples(self) -> int:
        return int(self.used.sum())

    @property
    def freedom(self) -> int:
        return self.samples - self.coefficients * int(self.used.any(axis=1).sum())

    @property
    def correct(self) -> float:
        return float(np.sqrt(self.samples / max(1, self.freedom)))

    def informative(self, position: FloatArray) -> BoolArray:
        """Blocks whose samples meet at least four eighths of the cycle.

        ``position`` in cycles, (blocks, length). At standstill, or locked to the samples,
        any table looks good.
        """
        eighth = (position % 1.0 * 8.0).astype(np.int64) % 8
        met = np.zeros((len(self), 8), np.bool_)
        met[np.nonzero(self.used)[0], eighth[self.used]] = True
        return np.asarray(met.sum(axis=1) >= 4, np.bool_)

    def smooth(self, values: FloatArray) -> FloatArray:
        weighted = np.where(self.used[..., None], self.terms, 0.0)
        right = np.einsum("blt,bl->bt", weighted, np.where(self.used, values, 0.0))
        return solve_blocks(np.matmul(weighted.transpose(0, 2, 1), weighted), right[..., None])[..., 0]

    def evaluate(self, coefficients: FloatArray) -> FloatArray:
        return np.asarray(np.matmul(self.terms, coefficients[..., None])[..., 0], np.float64)


def solve_blocks(matrices: FloatArray, right: FloatArray) -> FloatArray:
    """Solutions of many small positive systems; a block without samples gives zero."""
    size = np.trace(matrices, axis1=1, axis2=2)
    # The small ridge only matters where samples are too few or too close together.
    ridge = np.where(size > 0.0, size * 1e-13, 1.0)
    return np.asarray(
        np.linalg.solve(matrices + ridge[:, None, None] * np.eye(matrices.shape[1]), right), np.float64
    )


@dataclass(frozen=True, eq=False)
class Recording:
    """Samples of both tracks, float64, with 0 in place of what is not a number.

    valid, clipped   used; at the ends of the converter's range
    time, uneven     in sampling intervals (median), rising; they differ
    breaks           first samples after gaps over which the position is not followed
    """

    sine: FloatArray
    cosine: FloatArray
    valid: BoolArray
    clipped: BoolArray
    time: FloatArray
    uneven: bool
    breaks: IntArray

    def positions(self, phase: FloatArray) -> FloatArray:
        """:func:`positions` by the phases of valid samples."""
        return positions(np.where(self.valid, phase, np.nan), self.time, self.uneven, self.breaks)

    def cut(self, length: int, terms: int = CUBIC) -> Blocks:
        """Blocks of about ``length`` samples; none reaches across a break.

        In each block the motion is a polynomial of ``terms`` coefficients.
        """
        ends = [
            np.linspace(first, last, 1 + max(1, round((last - first) / length))).round().astype(np.int64)
            for first, last in itertools.pairwise([0, *self.breaks.tolist(), len(self.time)])
            if last - first >= terms + SPARE
        ]
        spans = np.vstack([np.zeros((0, 2), np.int64), *(np.column_stack([at[:-1], at[1:]]) for at in ends)])
        start, stop = spans[:, :1], spans[:, 1:]
        place = start + np.arange(np.max(stop - start, initial=1))
        inside, index = place < stop, np.minimum(place, stop - 1)
        begin, end = self.time[start], self.time[stop - 1]
        x = 2.0 * (self.time[index] - begin) / (end - begin) - 1.0
        legendre = np.asarray(np.polynomial.legendre.legvander(x, terms - 1), np.float64)
        tracks = np.array([self.sine[index], self.cosine[index]])
        blocks = Blocks(index, inside, legendre, tracks).using(inside & self.valid[index])
        return blocks.take(np.flatnonzero(blocks.used.any(axis=1)))


def recording(
    sine: ArrayLike,
    cosine: ArrayLike,
    time_s: ArrayLike | None,
    valid: ArrayLike | None,
    adc_bits: int | None,
    *,
    may_be_offset: bool = False,
) -> Recording:
    """Check the arguments of a reference measurement. ValueError for wrong ones, CalibrationError
    ("samples") for too few usable samples. The mark of a missed sample (2050:03) is not a sample.
    ``may_be_offset``: a conditioning will take the offset away."""
    s, c = np.array(pair_of_tracks(sine, cosine, may_be_offset=may_be_offset), np.float64)
    missed = (s == MISSED_COUNTS) & (c == MISSED_COUNTS) | (np.maximum(np.abs(s), np.abs(c)) > MOST_COUNTS)
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
    return Recording(
        np.nan_to_num(s), np.nan_to_num(c), usable, clipped, time, uneven, breaks.astype(np.int64)
    )


def prepared(
    sine: ArrayLike,
    cosine: ArrayLike,
    conditioning: Conditioning | str | None,
    time_s: ArrayLike | None,
    valid: ArrayLike | None,
    adc_bits: int | None,
    entries: int,
) -> tuple[Recording, Conditioning, FloatArray, Conditioning]:
    """The arguments of a reference measurement, checked: the recording, its ellipse, the angles behind that
    (cycles), and the conditioning that the table is made for, as 2002h holds it.
    """
    if entries not in range(16, 4097):
        raise ValueError(f"entries must be 16..4096, not {entries!r}")
    if not (conditioning is None or conditioning == "fit" or isinstance(conditioning, Conditioning)):
        raise ValueError('conditioning must be None, "fit" or a Conditioning')
    may_be_offset = conditioning not in (None, IDENTITY)
    record = recording(sine, cosine, time_s, valid, adc_bits, may_be_offset=may_be_offset)
    ellipse = fit_ellipse(record.sine, record.cosine, record.valid)
    amplitude = np.hypot(*ellipse.apply(record.sine, record.cosine))
    alive = record.clipped | (record.valid & (amplitude > DEAD * np.median(amplitude[record.valid])))
    record = recording(sine, cosine, time_s, alive, adc_bits, may_be_offset=may_be_offset)
    angle = angle_cycles(ellipse, record.sine, record.cosine)
    check_clipped(record, angle)
    return (
        record,
        ellipse,
        angle,
        as_real32(ellipse if isinstance(conditioning, str) else conditioning or IDENTITY),
    )


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


def _clipped(s: FloatArray, c: FloatArray, usable: BoolArray, adc_bits: int | None) -> BoolArray:
    counts = np.concatenate([s[usable], c[usable], [0.0]])
    low, high = float(counts.min()), float(counts.max())
    if adc_bits is None:  # of the tracks: a fault may lie beyond their converter's range
        low, high = np.quantile(counts, (FAULTY_PART, 1.0 - FAULTY_PART), method="nearest").tolist()
        fitting = [bits for bits in ADC_BITS if -(1 << bits - 1) <= low and high < 1 << bits - 1]
        if not fitting:
            return np.zeros_like(usable)
        adc_bits = fitting[0]
    full = 1 << int(adc_bits) - 1 if adc_bits in range(4, 17) else 0  # 0: nothing fits
    if low < -full or high > full - 1:
        do = "set adc_bits (4 to 16)" if low < 0.0 else "none is below zero: subtract mid-scale"
        raise ValueError(f"samples from {low:g} to {high:g} counts do not fit {adc_bits} bits: {do}")
    return np.asarray((np.minimum(s, c) <= -full) | (np.maximum(s, c) >= full - 1), np.bool_)


def _intervals(time_s: ArrayLike | None, n: int) -> tuple[FloatArray, bool]:
    if time_s is None:
        return np.arange(n, dtype=np.float64), False
    time = real_array("time_s", time_s)
    if time.shape != (n,) or not np.isfinite(time).all():
        raise ValueError("time_s must be finite numbers, one for each sample")
    steps = np.diff(time)
    if steps.min() <= 0.0:
        raise ValueError("time_s must rise from sample to sample")
    interval = float(np.median(steps))
    return (time - time[0]) / interval, bool(np.ptp(steps) > UNEVEN * interval)


def check_clipped(record: Recording, angle: FloatArray) -> None:
    """Refuse tracks that are cut off. ``angle`` of all samples, clipped ones included, in cycles."""
    count = int(record.clipped.sum())
    seen = record.valid | record.clipped
    cut = samples_in_bins(angle[record.clipped])
    worst = float((cut / np.maximum(1, samples_in_bins(angle[seen]))).max())
    if count > CLIPPED_PART * seen.sum() or (worst > CLIPPED_PART_OF_BIN and count > 6):
        raise CalibrationError(
            f"{count} samples are at the ends of the converter's range: reduce the amplitude of the tracks",
            Reason.CLIPPED,
        )


WINDOW = 256  # samples; a reference measurement needs that the phases move within about this many
LARGEST_DENOMINATOR = 16
DRIFT_CYCLES = 0.36  # over the window, times the denominator: less is too close to locked
# Steps in cycles per sample, far from simple fractions; the first that leads away from them is taken. 0.382
# is the golden section, whose multiples stay farthest from whole numbers: 0.034 at 13, more at all others
# up to 16.
STEPS = (0.382, 0.276, 0.171, 0.236, 0.118, 0.073, 0.045)
FAR = 0.03


def find_lock(sine: FloatArray, cosine: FloatArray) -> Fraction | None:
    """Cycles per sample, less whole ones, of locked tracks (ADC counts, NaN for a missed sample); None
    without a lock, below 256 samples, or with all missed.

    Locked at p/q, each q-th sample lies at the same place; here for q up to 16, on windows of 256.
    """
    z = cosine + 1j * sine
    windows = len(z) // WINDOW
    rows = z[: windows * WINDOW].reshape(windows, WINDOW)
    if np.isnan(rows).all():
        return None
    power = np.nanmean(np.abs(rows) ** 2)
    for q in range(1, LARGEST_DENOMINATOR + 1):
        places = rows[:, : WINDOW // q * q].reshape(windows, -1, q)
        mean = np.nansum(places, axis=1) / np.maximum(1, (~np.isnan(places)).sum(axis=1))
        if np.mean(np.abs(mean) ** 2) > power * np.sinc(DRIFT_CYCLES / q) ** 2:
            step = float(np.angle(np.nansum(z[1:] * np.conj(z[:-1])))) / (2.0 * math.pi)
            return Fraction(round(step * q), q) % 1
    return None


def away_from(fraction: float) -> float:
    """What to add to these cycles per sample so that they are no simple fraction."""
    denominators = range(1, LARGEST_DENOMINATOR + 1)
    far = (
        step
        for step in STEPS
        if all(abs(math.remainder(q * (fraction + step), 1.0)) >= FAR for q in denominators)
    )
    return next(far, STEPS[0])


# Cycles per interval: far beyond 3000 rpm of 5000 cycles at 1 kHz.
FASTEST = 512.0
# Intervals; nearly one, so that times with some jitter are followed as by eq. 9.
BASELINE = 0.75
LONGEST_LAG = 64  # samples; this many within BASELINE are a flood, not a sampling
# Speeds are given up, and those that have become one are joined, at this interval of samples.
PRUNE_SAMPLES = 32
# A speed whose sum of squares is worse by this many mean squares is wrong (10 standard deviations) ...
WRONG = 100.0
# ... and one that is worse by no more than this fits as well as the best (3 standard deviations).
ALIKE = 9.0
# Mean squares of residuals, cycle^2, at least: 16 bits leave more; and what a poor encoder that is not
# corrected yet may show at the first phase that it has not met before.
LEAST_SQUARE, POOR_SQUARE = 1e-8, 2e-4
LONG = 1.5  # intervals: over more than these the speed after them counts as well


def positions(phase: FloatArray, time: FloatArray, uneven: bool, breaks: IntArray) -> FloatArray:
    """Positions in cycles; each segment starts near 0, and even ones may be off by a straight line.

    ``phase`` in cycles, NaN: none, interpolated; ``time`` in sampling intervals, rising; ``breaks``: first
    samples of all segments but the first.
    """
    position = np.empty(len(phase))
    speed = 0.0
    for start, stop in itertools.pairwise([0, *(int(b) for b in breaks), len(phase)]):
        part = slice(start, stop)
        if uneven:
            position[part], speed = _follow_uneven(phase[part], time[part], speed)
        else:
            result = track(phase[part], 0.5)
            position[part] = result.cycles + result.phase
    return position


def _follow_uneven(phase: FloatArray, time: FloatArray, likely: float) -> tuple[FloatArray, float]:
    """Positions and the speed at the end, cycles per interval.

    ``likely``: the speed to take among those that fit equally well is the one nearest to it.
    """
    seen = np.flatnonzero(~np.isnan(phase))
    if len(seen) < 2 or time[seen[-1]] - time[seen[0]] < BASELINE:
        return np.zeros(len(phase)) + (phase[seen[0]] if len(seen) else 0.0), likely
    p, t = phase[seen], time[seen]
    first, k = int(np.searchsorted(t, t[0] + BASELINE)), np.arange(len(t))
    base = np.searchsorted(t, t[k - 1] - BASELINE, side="right") - 1
    base = np.where(k > first, np.maximum(base, k - 1 - LONGEST_LAG), 0)
    elapsed = float(t[first] - t[0])
    most = np.ceil(FASTEST * elapsed)
    weights = np.append(0.0, np.diff(t)) / np.maximum(t[k - 1] - t[base], 1e-30)
    turns, square, rows = _run(p, t, first, base, weights, np.arange(-most, most + 1.0))
    alike = turns[square <= square.min() + ALIKE * max(square.min() / len(rows), LEAST_SQUARE)]
    turn = alike[np.argmin(np.abs((alike + p[first] - p[0]) / elapsed - likely))]
    places = np.concatenate(_run(p, t, first, base, weights, np.array([turn]))[2]).tolist()
    columns = (one[first + 1 :].tolist() for one in (p, base, weights))
    for one, begin, weight in zip(*columns, strict=True):  # one motion: floats are faster than arrays of one
        places.append(round(places[-1] + (places[-1] - places[begin]) * weight - one) + one)
    position = _over_gaps(np.array(places), t, first, base)
    at = base[-1] + 1
    return np.interp(time, t, position), float((position[-1] - position[at]) / (t[-1] - t[at]))


def _run(
    phase: FloatArray, time: FloatArray, first: int, base: IntArray, weights: FloatArray, turns: FloatArray
) -> tuple[FloatArray, FloatArray, list[FloatArray]]:
    """Follow the motions that have passed these whole cycles from sample 0 to ``first``, straight.

    The speed before sample k is that from sample ``base[k]`` to k - 1, times ``weights[k]`` a step. Until one
    is left: those open, the sums of the squares of their residuals in those of the phases, their positions.
    """
    part = ((time[: first + 1] - time[0]) / (time[first] - time[0]))[:, None]
    line = phase[0] + part * (turns + (phase[first] - phase[0]))
    start = phase[: first + 1, None]
    rows = list(np.rint(line - start) + start)
    square = np.sum((line - rows) ** 2 / (1.0 + (1.0 - part) ** 2 + part**2), axis=0)
    scales = 1.0 / (1.0 + (1.0 + weights) ** 2 + weights**2)
    for k in range(first + 1, len(phase)):
        if len(turns) == 1:
            break
        ahead = rows[-1] + (rows[-1] - rows[base[k]]) * weights[k]
        rows.append(np.rint(ahead - phase[k]) + phase[k])
        square += (ahead - rows[-1]) ** 2 * scales[k]
        if k % PRUNE_SAMPLES == 0:
            keep = _still_open(np.array(rows[-LONGEST_LAG - 1 :]), square, k)
            turns, square = turns[keep], square[keep]
            rows[-LONGEST_LAG - 2 :] = [row[keep] for row in rows[-LONGEST_LAG - 2 :]]
    return turns, square, rows


def _still_open(latest: FloatArray, square: FloatArray, taken: int) -> IntArray:
    """Motions to go on with: not wrong, and of those with the same latest steps only the best."""
    order = np.argsort(square, kind="stable")
    order = order[square[order] <= square.min() + WRONG * max(square.min() / taken, POOR_SQUARE)]
    steps = latest[:, order] - latest[-1, order]
    _, first = np.unique(np.rint(steps - steps[:, :1]), axis=1, return_index=True)
    return np.sort(order[first])


def _over_gaps(position: FloatArray, time: FloatArray, first: int, base: IntArray) -> FloatArray:
    """The positions with those of long intervals from the speeds on both sides, as for constant acceleration.

    The speed before alone errs by A T (T + 1) / 2: half a cycle after nine intervals of 0.011 cycle each^2.
    """
    end = np.flatnonzero(np.diff(time) > LONG) + 1
    after = np.searchsorted(time, time[end] + BASELINE)
    known = (end > first) & (after < len(time))
    end, after = end[known], after[known]
    begin = end - 1
    before = base[end]
    ahead, gap, behind = time[begin] - time[before], time[end] - time[begin], time[after] - time[end]
    early = (position[begin] - position[before]) / ahead
    late = (position[after] - position[end]) / behind
    middle = early + (late - early) * (ahead + gap) / (ahead + 2.0 * gap + behind)
    shift = np.zeros(len(time))
    shift[end] = np.rint(middle * gap - (position[end] - position[begin]))
    # Two long intervals in a row: the speed over the second cannot judge the first.
    shift[end[after > np.append(end[1:], len(time))]] = 0.0
    return np.asarray(position + np.cumsum(shift), np.float64)
