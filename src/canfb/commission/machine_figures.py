"""Figures of a machine from the samples of its duty: its motion, its signal, the noise of both.

**Acceleration and jerk**: the second difference of the positions, averaged by a fitted parabola (positive
weights, Savitzky and Golay), less sqrt(2 ln n) times the noise of n averages. **Noise of a phase**: sqrt(70)
times it is the rms of the fourth difference; the median ignores faults.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from canfb.calibrate.measurement import SupervisedSamples
from canfb.calibration.path_fit import AMPLITUDE_REPEATS, LowPass, fit_low_pass, response
from canfb.calibration.result import (
    BINS,
    THIRDS,
    bins_of,
    largest_change,
    mean_in_bins,
    peak,
    robust_rms,
    root_mean,
    runs,
)
from canfb.master.samples import TrackSamples
from canfb.signal.correction import Correction
from canfb.signal.front_end import Corners
from canfb.signal.phase import BoolArray, FloatArray, IntArray
from canfb.signal.residual_noise import RESIDUAL_WEIGHTS

HALVES = (1, 2, 4, 8, 16, 32, 64)  # of the windows of the parabolas, samples to each side
MOVING_CYCLES = 0.02  # per interval: slower, the counts of neighbours hardly differ and noise hides
FOURTH = math.sqrt(70.0)  # times the noise of a sample: that of the fourth difference
SMOOTHED = 4  # of them: the noise of second differences is less than a tenth after this parabola
GROUPS, LEAST_OF_GROUP = 5, 400


@dataclass(frozen=True, eq=False)
class MotionFigures:
    """What a machine did; cycles and sampling intervals.

    slowest, fastest     speed, with sign
    turned, moving       range of the position; part of the samples at which it moved, 0..1
    acceleration, jerk   the largest, noise taken off
    noise                rms of the phase of a sample at the speeds at which it is largest
    residual             second difference at each sample from the third on; NaN where not known
    fitted_error         of the phase, significant; NaN: the same few phases came
    change               rms by which that of thirds of the time differs; 0.0: noise
    """

    slowest: float
    fastest: float
    turned: float
    moving: float
    acceleration: float
    jerk: float
    noise: float
    residual: FloatArray
    fitted_error: float
    change: float

    @property
    def top_speed(self) -> float:
        return max(abs(self.slowest), abs(self.fastest))

    @property
    def residual_peak(self) -> float:
        return peak(_known(self.residual))

    @property
    def residual_rms(self) -> float:
        return root_mean(_known(self.residual))

    @property
    def phase_error(self) -> float:
        """The largest of a phase, cycles: at most speeds the residual shows less than four times of it."""
        single = peak(_known(self.residual - smooth_acceleration(self.residual))) / 4.0
        return max(single, self.fitted_error)

    @property
    def residual_noise(self) -> float:
        return math.sqrt(RESIDUAL_WEIGHTS) * self.noise


def motion_figures(samples: SupervisedSamples) -> MotionFigures:
    """The motion of these samples: more than the longest window, and at least one step between two valid
    ones.
    """
    speed, elapsed = samples.speed, samples.elapsed
    acceleration = np.diff(speed) / ((elapsed[2:] + elapsed[1:-1]) / 2.0)
    position = samples.position[samples.valid]
    moves = np.abs(speed) >= MOVING_CYCLES
    noise = _noise(acceleration, np.where(moves, np.abs(speed), np.nan)[1:])
    slow = _known(np.convolve(speed, _bell(8), "valid"))  # a speed between two samples is mostly noise
    slow = slow if len(slow) else _known(speed)
    fitted_error, change = _phase_errors(samples)
    return MotionFigures(
        slowest=float(slow.min()),
        fastest=float(slow.max()),
        turned=float(np.ptp(position)),
        moving=float(np.mean(moves[np.isfinite(speed)])),
        acceleration=_largest(acceleration, noise, np.array([1.0, -2.0, 1.0])),
        jerk=_largest(np.diff(acceleration), noise, np.array([1.0, -3.0, 3.0, -1.0])),
        noise=noise,
        residual=np.diff(speed) * elapsed[2:],  # eq. 9 carries the last speed on
        fitted_error=fitted_error,
        change=change,
    )


TELLING_CYCLES = 0.2  # per interval: slower, an acceleration looks like an error of the phase
ORDERS = np.arange(1, 5)  # of the error: offset; gain and phase error; harmonics up to the third
LEAST_TOLD = 0.01  # of an error, rms, must show in the residuals: 400 with a noise of 0.001 tell 0.005 cycle


def _phase_errors(samples: SupervisedSamples) -> tuple[float, float]:
    """``fitted_error`` and ``change`` of :class:`MotionFigures`."""
    elapsed, speed = samples.elapsed[1:, None], samples.speed[:, None]
    columns = np.diff(np.diff(_errors(samples.position), axis=0) / elapsed, axis=0) * elapsed[1:]
    residual = (np.diff(speed, axis=0) * elapsed[1:])[:, 0]
    telling = np.flatnonzero(np.isfinite(residual) & (np.abs(speed[1:, 0]) >= TELLING_CYCLES))
    parts = [
        np.array_split(telling, count) if len(telling) >= count * LEAST_OF_GROUP else []
        for count in (1, THIRDS)
    ]
    (whole, noise), thirds = (_fitted(columns, residual, one) for one in parts)
    largest = largest_change(np.append(whole, np.zeros((1, BINS)), axis=0), np.append(noise, 0.0)).peak
    return math.nan if np.isinf(noise).any() else largest, largest_change(*thirds).rms


def _fitted(
    columns: FloatArray, residual: FloatArray, parts: Sequence[IntArray]
) -> tuple[FloatArray, FloatArray]:
    """Errors over the phase by least squares from parts of the residuals, and their noise, cycles.

    Shapes (parts, BINS), (parts,); noise inf: the same few phases came.
    """
    tables, noise = np.zeros((len(parts), BINS)), np.zeros(len(parts))
    for number, part in enumerate(parts):
        found, _, _, sizes = np.linalg.lstsq(columns[part], residual[part], rcond=None)
        if sizes[-1] < LEAST_TOLD * math.sqrt(len(part)):
            noise[number] = math.inf
        else:
            left = float(np.std(residual[part] - columns[part] @ found))
            tables[number] = _errors(np.arange(BINS) / BINS) @ found
            noise[number] = left * float(np.linalg.norm(1.0 / sizes)) / math.sqrt(2.0)
    return tables, noise


def _errors(position: FloatArray) -> FloatArray:
    angle = 2.0 * np.pi * (position % 1.0)[:, None] * ORDERS
    return np.hstack([np.sin(angle), np.cos(angle)])


def smooth_acceleration(residual: FloatArray) -> FloatArray:
    """Second differences averaged until their noise is a tenth; NaN where not known."""
    unknown = np.full(SMOOTHED - 1, np.nan)
    return np.concatenate([unknown, np.convolve(residual, _bell(SMOOTHED), "valid"), unknown])


def _noise(acceleration: FloatArray, speed: FloatArray) -> float:
    """Of one sample, cycles. ``speed`` is its size, NaN at standstill."""
    fourth = np.abs(np.diff(acceleration, 2))
    known = np.isfinite(fourth) & np.isfinite(speed[1:-1])
    fourth = fourth[known][np.argsort(speed[1:-1][known])]
    groups = np.array_split(fourth, max(1, min(GROUPS, len(fourth) // LEAST_OF_GROUP)))
    return max(robust_rms(one) / FOURTH for one in groups)


def _largest(values: FloatArray, noise: float, difference: FloatArray) -> float:
    most = 0.0
    for half in HALVES:
        bell = _bell(half)
        averaged = _known(np.convolve(values, bell, "valid"))
        if len(averaged) < len(bell):
            break
        sigmas = math.sqrt(2.0 * math.log(len(averaged) + 1.0))  # the largest of this many
        by_noise = sigmas * noise * float(np.linalg.norm(np.convolve(bell, difference)))
        most = max(most, peak(averaged) - by_noise)
    return most


def _known(values: FloatArray) -> FloatArray:
    return values[np.isfinite(values)]


def _bell(half: int) -> FloatArray:
    """Weights, all positive, sum 1, with which the second derivative of a fitted parabola weighs the second
    differences in its window of 2 half + 1 samples (Savitzky and Golay).
    """
    place = np.arange(-half, half + 1, dtype=np.float64)
    second = 2.0 * np.linalg.pinv(np.vander(place, 3))[0]
    return np.asarray(np.cumsum(np.cumsum(second))[:-2], np.float64)


CLASSES = 12
LEAST_OF_CLASS = 100
LEAST_CLASSES = 3
LOWEST_PART = 0.5  # of the top speed: there must be one that is lower


def low_pass_of(followed: SupervisedSamples, interval_s: float, corners: Corners) -> LowPass | None:
    """What these samples show, the known ``corners`` undone; None where there are too few speeds."""
    hertz = np.abs(followed.speed) / interval_s
    amplitude = followed.amplitude[1:]
    known = np.isfinite(hertz) & np.isfinite(amplitude)
    hertz, amplitude = hertz[known], amplitude[known]
    amplitude *= np.mean(
        [np.abs(response(hertz, hz)) for hz in (corners.corner_hz, corners.of_cosine_hz)], axis=0
    )
    if not len(hertz) or not hertz.max() > 0.0:
        return None
    number = np.minimum((hertz / hertz.max() * CLASSES).astype(np.int64), CLASSES - 1)
    classes = [number == one for one in range(CLASSES) if np.sum(number == one) >= LEAST_OF_CLASS]
    speeds = np.array([np.sqrt(np.mean(hertz[one] ** 2)) for one in classes])
    if len(speeds) < LEAST_CLASSES or speeds.min() > LOWEST_PART * speeds.max():
        return None
    sizes = np.array([amplitude[one].mean() for one in classes])
    spread = np.array([amplitude[one].std() / np.sqrt(np.sum(one)) for one in classes])
    return fit_low_pass(speeds, sizes, np.hypot(AMPLITUDE_REPEATS, spread / sizes))


ROUNDING_VARIANCE = 1.0 / 12.0  # of a count, of a converter that rounds
HARMONICS = 12  # of the amplitude over the phase
FITTED_SAMPLES = 50_000
SURE_PART = 0.8  # of the noise that was measured; it may be less at another time
TEN_YEARS_S = 10.0 * 365.25 * 86400.0
LEAST_REPEATS, MOST_REPEATS = 16, 255
QUIETEST_COUNTS = 0.15  # less cannot be distinguished from a converter without noise


@dataclass(frozen=True, eq=False)
class TrackFigures:
    """Amplitude and noise of the tracks, ADC counts after conditioning.

    mean, least, most       of the amplitude over all valid samples
    over_phase              lowest, mean and highest in each of 64 bins of the phase, shape (3, 64); NaN: no
                            sample
    noise_counts            of the converter before it rounds, rms; 0.0: none detected
    longest_repeat          successive samples that repeat the counts of the one before
    """

    mean: float
    least: float
    most: float
    over_phase: FloatArray
    noise_counts: float
    longest_repeat: int

    @property
    def spread(self) -> float:
        return max(self.mean - self.least, self.most - self.mean) / self.mean


def track_figures(
    samples: TrackSamples, supervised: SupervisedSamples, gain: float, phase_noise_cycles: float
) -> TrackFigures:
    """Amplitude and noise of these samples, some of which are valid. ``gain`` is that of the conditioning.

    The noise is the smaller one of that along the radius, which no motion adds to, and of that of the phase.
    """
    valid = supervised.valid & np.isfinite(supervised.amplitude)
    amplitude, phase = supervised.amplitude[valid], supervised.position[valid] % 1.0
    mean = float(amplitude.mean())
    along = _radial_noise(supervised, valid)
    across = 2.0 * math.pi * mean * phase_noise_cycles
    counts = min(along, across) / gain
    same = (np.diff(samples.sine) == 0.0) & (np.diff(samples.cosine) == 0.0)
    return TrackFigures(
        mean=mean,
        least=float(amplitude.min()),
        most=float(amplitude.max()),
        over_phase=_over_phase(amplitude, phase),
        noise_counts=math.sqrt(max(0.0, counts * counts - ROUNDING_VARIANCE)),
        longest_repeat=int(np.max(np.diff(runs(same)), initial=0)),
    )


def repeats_of_frozen_input(noise_counts: float, rate_hz: float, margin: float, longest_repeat: int) -> int:
    """Repeats of both counts that distinguish a frozen converter from a working one (2010:04); 0: none do.

    At whole cycles per sample normal noise repeats both counts n times with at most the probability q^n, q =
    erf(1 / (2 sqrt(2) noise))^2. Less than one false alarm in ten years of that, at ``rate_hz`` samples per
    second, more than ``margin`` times the longest repeat, at least 16; 0 beyond 255.
    """
    if noise_counts < QUIETEST_COUNTS:
        return 0
    again = math.erf(0.5 / (SURE_PART * noise_counts * math.sqrt(2.0))) ** 2
    by_chance = math.log(rate_hz * TEN_YEARS_S) / -math.log(again) if again < 1.0 else math.inf
    repeats = max(float(LEAST_REPEATS), by_chance, margin * (longest_repeat + 1))
    return math.ceil(repeats) if repeats <= MOST_REPEATS else 0


def _radial_noise(supervised: SupervisedSamples, valid: BoolArray) -> float:
    """Noise of the amplitude, counts, its course over the phase taken off."""
    amplitude = np.where(valid, supervised.amplitude, np.nan)
    used = np.flatnonzero(valid)[:FITTED_SAMPLES]
    phase = np.where(valid, supervised.position % 1.0, 0.0)
    course, *_ = np.linalg.lstsq(_waves(phase[used]), amplitude[used], rcond=None)
    step = 100_000  # bounded memory
    rest = np.concatenate(
        [amplitude[k : k + step] - _waves(phase[k : k + step]) @ course for k in range(0, len(phase), step)]
    )
    fourth = np.diff(rest, 4)
    moves = np.abs(supervised.speed[1:-2]) >= MOVING_CYCLES
    return robust_rms(fourth[np.isfinite(fourth) & moves]) / FOURTH


def _waves(phase: FloatArray) -> FloatArray:
    angle = 2.0 * np.pi * phase[:, None] * np.arange(1, HARMONICS + 1)
    return np.hstack([np.ones((len(phase), 1)), np.sin(angle), np.cos(angle)])


def _over_phase(amplitude: FloatArray, phase: FloatArray) -> FloatArray:
    bins = bins_of(phase)
    lowest, highest = np.full(BINS, np.inf), np.full(BINS, -np.inf)
    np.minimum.at(lowest, bins, amplitude)
    np.maximum.at(highest, bins, amplitude)
    mean = mean_in_bins(phase, amplitude)
    return np.asarray(np.where(np.isnan(mean), np.nan, np.array([lowest, mean, highest])), np.float64)


@dataclass(frozen=True, eq=False)
class Observation:
    """Samples of a machine, followed from their start on, and what was seen; None: not known.

    start_speed          at the first sample, cycles per interval
    followed             the chain's account, with the limits that the module has, and the corner that is
                         chosen
    interval_s           sampling interval, seconds
    coarse_spread        range of the difference of the coarse track, revolutions; coarse_note: why it is not
                         known
    longest_pause        the longest time without SYNC or sample, periods
    low_pass             by the amplitude over the speed
    jitter_s             rms of the time from SYNC to SYNC, or by sample times
    off_grid_s           largest distance of a SYNC, or of a sample time, from the even grid
    """

    samples: TrackSamples
    used: Correction
    start_speed: float
    followed: SupervisedSamples
    motion: MotionFigures
    tracks: TrackFigures
    interval_s: float
    coarse_spread: float | None
    coarse_note: str
    longest_pause: float | None
    jitter_s: float | None
    off_grid_s: float | None
    low_pass: LowPass | None

    def rad(self, cycles: float, power: int, cycles_per_revolution: int) -> float:
        """Cycles per interval to this power, as rad per second to this power."""
        return cycles * 2.0 * math.pi / cycles_per_revolution / self.interval_s**power
