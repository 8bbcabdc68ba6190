"""A recording of both tracks: checks, blocks, positions, and a test for motion locked to the samples.

At p/q cycles per sample only q phases of the cycle are sampled. The mean of cosine + i sine, amplitude A, of
every q-th sample is A |sin(pi d) / (pi d)| if the phase drifts by d cycles in a window. The motion is locked
if d < 0.36 / q in 256 samples.

Phases determine the speed modulo one cycle per sample. With even times a wrong speed adds a straight line to
the position, which stays smooth. With uneven times all speeds between the first two samples are followed;
the one with the least squared residuals (eq. 9 over elapsed times, speed over at least BASELINE) is kept.
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
# Faults reach the end of the range occasionally; a track that is too large does so in every cycle, at the
# same phase.
CLIPPED_PART = 0.05
CLIPPED_PART_OF_BIN = 0.2
BREAK_INTERVALS = 10.0
DEAD = 0.1  # of the amplitude: below it there is no track, and its angle would look like motion
ADC_BITS = (12, 14, 16)
# Part of the counts, at either end, that is ignored when the bits of the converter are found: a track that
# clips has more counts there.
FAULTY_PART = 0.005
MOST_COUNTS = 1e12  # beyond any converter; squares of these are still finite
UNEVEN = 1e-6
NO_TIME = -1
CUBIC = 4
SPARE = 2  # a block needs this many samples more than coefficients to tell something about the tracks


@dataclass(frozen=True, eq=False)
class Blocks:
    """Samples in rows, one row a block.

    index   sample numbers, shape (blocks, length), shorter blocks padded
    used    False for padding and for samples left out
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
        """These blocks with only the samples ``used``; a block with too few of them uses none."""
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
        """Blocks with samples in at least four eighths of the cycle.

        ``position`` in cycles, (blocks, length). At standstill, or with motion locked to the samples, any
        table fits.
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
    """Solutions of many small positive definite systems; zero for a block without samples."""
    size = np.trace(matrices, axis1=1, axis2=2)
    # The small ridge only matters if samples are too few or too close together.
    ridge = np.where(size > 0.0, size * 1e-13, 1.0)
    return np.asarray(
        np.linalg.solve(matrices + ridge[:, None, None] * np.eye(matrices.shape[1]), right), np.float64
    )


@dataclass(frozen=True, eq=False)
class Recording:
    """Samples of both tracks, float64; 0 replaces NaN.

    valid, clipped   samples used; samples at the ends of the converter's range
    time, uneven     in units of the median interval, rising; whether intervals differ
    breaks           first samples after gaps across which the position is not followed
    """

    sine: FloatArray
    cosine: FloatArray
    valid: BoolArray
    clipped: BoolArray
    time: FloatArray
    uneven: bool
    breaks: IntArray

    def positions(self, phase: FloatArray) -> FloatArray:
        """:func:`positions` from the phases of valid samples."""
        return positions(np.where(self.valid, phase, np.nan), self.time, self.uneven, self.breaks)

    def cut(self, length: int, terms: int = CUBIC) -> Blocks:
        """Blocks of about ``length`` samples; none contains a break.

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
    ("samples") for too few usable samples. Samples marked as missed (2050:03) are not used.
    ``may_be_offset``: a conditioning will remove the offset."""
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
    """The checked arguments of a reference measurement: the recording, its ellipse, the angles after that
    (cycles), and the conditioning that the table is made for, rounded as in 2002h.
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
    if adc_bits is None:  # find it without outliers: a fault may exceed the range of the converter
        low, high = np.quantile(counts, (FAULTY_PART, 1.0 - FAULTY_PART), method="nearest").tolist()
        fitting = [bits for bits in ADC_BITS if -(1 << bits - 1) <= low and high < 1 << bits - 1]
        if not fitting:
            return np.zeros_like(usable)
        adc_bits = fitting[0]
    full = 1 << int(adc_bits) - 1 if adc_bits in range(4, 17) else 0  # 0: refuse any sample
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
    """Refuse clipped tracks. ``angle`` of all samples, also clipped ones, in cycles."""
    count = int(record.clipped.sum())
    seen = record.valid | record.clipped
    cut = samples_in_bins(angle[record.clipped])
    worst = float((cut / np.maximum(1, samples_in_bins(angle[seen]))).max())
    if count > CLIPPED_PART * seen.sum() or (worst > CLIPPED_PART_OF_BIN and count > 6):
        raise CalibrationError(
            f"{count} samples are at the ends of the converter's range: reduce the amplitude of the tracks",
            Reason.CLIPPED,
        )


WINDOW = 256  # samples; a reference measurement requires the phases to move within about this many
LARGEST_DENOMINATOR = 16
DRIFT_CYCLES = 0.36  # drift in the window times q; below it the motion is too close to locked
# Changes of the speed, cycles per sample; `away_from` takes the first that leads to no simple fraction. The
# multiples of 0.382, the golden section, stay farthest from whole numbers: 13 x 0.382 is 0.034 away, all
# others up to 16 are further.
STEPS = (0.382, 0.276, 0.171, 0.236, 0.118, 0.073, 0.045)
FAR = 0.03


def find_lock(sine: FloatArray, cosine: FloatArray) -> Fraction | None:
    """Cycles per sample, modulo 1, of locked tracks (ADC counts, NaN: missed sample); None without a lock,
    below 256 samples, or if all are missed.

    Locked at p/q, every q-th sample has the same phase; tested for q up to 16, in windows of 256.
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
    """The change of ``fraction``, cycles per sample, that leads away from simple fractions."""
    denominators = range(1, LARGEST_DENOMINATOR + 1)
    far = (
        step
        for step in STEPS
        if all(abs(math.remainder(q * (fraction + step), 1.0)) >= FAR for q in denominators)
    )
    return next(far, STEPS[0])


# Highest speed followed, cycles per interval; 3000 rpm with 5000 cycles at 1 kHz is 250.
FASTEST = 512.0
# Shortest time over which a speed is taken, intervals; nearly one, so that jittering times follow eq. 9.
BASELINE = 0.75
LONGEST_LAG = 64  # samples over which a speed is taken at most, however close they are
# After each n samples, wrong speeds are dropped, and all but one of the speeds that have converged.
PRUNE_SAMPLES = 32
# A speed is wrong if its sum of squares exceeds the least by this many mean squares (10 sigma).
WRONG = 100.0
# A speed fits as well as the best one if its sum exceeds the least by at most this (3 sigma).
ALIKE = 9.0
# Lower limits of the mean square of the residuals, cycle^2: less than 16-bit samples have; and that of a
# poor, uncorrected encoder at a phase that no sample has had before.
LEAST_SQUARE, POOR_SQUARE = 1e-8, 2e-4
LONG = 1.5  # intervals; across longer ones the speed after them counts as well


def positions(phase: FloatArray, time: FloatArray, uneven: bool, breaks: IntArray) -> FloatArray:
    """Positions in cycles; each segment starts near 0. With even times a straight line may be added.

    ``phase`` in cycles, NaN: interpolated; ``time`` in sampling intervals, rising; ``breaks``: first
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

    Of speeds that fit equally well the one nearest to ``likely`` is taken.
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
    for one, begin, weight in zip(*columns, strict=True):  # one motion left: floats are faster than arrays
        places.append(round(places[-1] + (places[-1] - places[begin]) * weight - one) + one)
    position = _over_gaps(np.array(places), t, first, base)
    at = base[-1] + 1
    return np.interp(time, t, position), float((position[-1] - position[at]) / (t[-1] - t[at]))


def _run(
    phase: FloatArray, time: FloatArray, first: int, base: IntArray, weights: FloatArray, turns: FloatArray
) -> tuple[FloatArray, FloatArray, list[FloatArray]]:
    """Follow the motions that pass ``turns`` whole cycles, at constant speed, from sample 0 to ``first``.

    The step to sample k is predicted as the step from ``base[k]`` to k - 1, times ``weights[k]``. Ends when
    one motion is left. Returns the ``turns`` left, their sums of squared residuals, each relative to its
    variance for unit variance of the phase, and their positions.
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
    """Motions to continue: not wrong, and the best of those with the same latest steps."""
    order = np.argsort(square, kind="stable")
    order = order[square[order] <= square.min() + WRONG * max(square.min() / taken, POOR_SQUARE)]
    steps = latest[:, order] - latest[-1, order]
    _, first = np.unique(np.rint(steps - steps[:, :1]), axis=1, return_index=True)
    return np.sort(order[first])


def _over_gaps(position: FloatArray, time: FloatArray, first: int, base: IntArray) -> FloatArray:
    """The positions, with steps over long intervals from the speeds on both sides (constant acceleration).

    The speed before a gap T alone errs by A T (T + 1) / 2: 0.5 cycle for T = 9 and A = 0.011 cycle per
    interval^2.
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
    # Two long intervals in a row: the speed over the second may be wrong itself.
    shift[end[after > np.append(end[1:], len(time))]] = 0.0
    return np.asarray(position + np.cumsum(shift), np.float64)
