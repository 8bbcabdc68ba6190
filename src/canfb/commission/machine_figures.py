"""Figures of a machine from the samples of its duty cycle: motion, signal, noise of both.

**Acceleration and jerk**: the second difference of the positions, averaged by a fitted parabola (positive
weights, Savitzky and Golay), less sqrt(2 ln n) times the noise, for n averages. **Noise of a phase**: the
fourth difference has sqrt(70) times its rms, which the median estimates, insensitive to faults.
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

HALVES = (1, 2, 4, 8, 16, 32, 64)  # half widths of the windows of the parabolas, samples to each side
MOVING_CYCLES = 0.02  # per interval; at lower speed counts of neighbours hardly differ, which hides noise
FOURTH = math.sqrt(70.0)  # noise of the fourth difference / noise of a sample
SMOOTHED = 4  # half width that reduces the noise of second differences to less than a tenth
GROUPS, LEAST_OF_GROUP = 5, 400


@dataclass(frozen=True, eq=False)
class MotionFigures:
    """Motion of a machine; in cycles and sampling intervals.

    slowest, fastest     speed, with sign
    turned, moving       range of the position; part of the samples in motion, 0..1
    acceleration, jerk   largest ones, less noise
    noise                rms noise of a phase, at the speeds with the largest one
    residual             second difference at each sample from the third on; NaN: not known
    fitted_error         largest significant phase error; NaN: too few different phases
    change               rms difference of that error between thirds of the time; 0.0: not significant
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
        """Largest phase error, cycles: residual / 4 (too small at most speeds) or the error of the fit."""
        single = peak(_known(self.residual - smooth_acceleration(self.residual))) / 4.0
        return max(single, self.fitted_error)

    @property
    def residual_noise(self) -> float:
        return math.sqrt(RESIDUAL_WEIGHTS) * self.noise


def motion_figures(samples: SupervisedSamples) -> MotionFigures:
    """Motion of ``samples``: more than the longest window, at least two adjacent ones valid."""
    speed, elapsed = samples.speed, samples.elapsed
    acceleration = np.diff(speed) / ((elapsed[2:] + elapsed[1:-1]) / 2.0)
    moves = np.abs(speed) >= MOVING_CYCLES
    noise = _noise(acceleration, np.where(moves, np.abs(speed), np.nan)[1:])
    slow = _known(np.convolve(speed, _bell(8), "valid"))  # averaged: between two samples it is mostly noise
    slow = slow if len(slow) else _known(speed)
    fitted_error, change = _phase_errors(samples)
    return MotionFigures(
        slowest=float(slow.min()),
        fastest=float(slow.max()),
        turned=float(np.ptp(samples.position[samples.valid])),
        moving=float(np.mean(moves[np.isfinite(speed)])),
        acceleration=_largest(acceleration, noise, np.array([1.0, -2.0, 1.0])),
        jerk=_largest(np.diff(acceleration), noise, np.array([1.0, -3.0, 3.0, -1.0])),
        noise=noise,
        residual=np.diff(speed) * elapsed[2:],  # eq. 9 predicts with the last speed
        fitted_error=fitted_error,
        change=change,
    )


TELLING_CYCLES = 0.2  # per interval; at lower speed acceleration looks like a phase error
ORDERS = np.arange(1, 5)  # orders of the error: offset; gain and phase error; harmonics up to the third
LEAST_TOLD = 0.01  # least rms of the residuals per error: 400 residuals with noise 0.001 show 0.005 cycle


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

    Shapes (parts, BINS), (parts,); noise inf: too few different phases.
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
    """Second differences averaged to a tenth of their noise; NaN: not known."""
    unknown = np.full(SMOOTHED - 1, np.nan)
    return np.concatenate([unknown, np.convolve(residual, _bell(SMOOTHED), "valid"), unknown])


def _noise(acceleration: FloatArray, speed: FloatArray) -> float:
    """Phase noise of a sample, cycles. ``speed``: absolute value, NaN at standstill."""
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
        sigmas = math.sqrt(2.0 * math.log(len(averaged) + 1.0))  # expected maximum of as many noise values
        by_noise = sigmas * noise * float(np.linalg.norm(np.convolve(bell, difference)))
        most = max(most, peak(averaged) - by_noise)
    return most


def _known(values: FloatArray) -> FloatArray:
    return values[np.isfinite(values)]


def _bell(half: int) -> FloatArray:
    """Weights of second differences that give the second derivative of a parabola fitted to 2 half + 1
    samples (Savitzky and Golay): positive, sum 1.
    """
    place = np.arange(-half, half + 1, dtype=np.float64)
    second = 2.0 * np.linalg.pinv(np.vander(place, 3))[0]
    return np.asarray(np.cumsum(np.cumsum(second))[:-2], np.float64)


CLASSES = 12
LEAST_OF_CLASS = 100
LEAST_CLASSES = 3
LOWEST_PART = 0.5  # the lowest speed must be below this part of the top speed


def low_pass_of(followed: SupervisedSamples, interval_s: float, corners: Corners) -> LowPass | None:
    """Low-pass by the amplitude over the speed, before correction for ``corners``; None: too few speeds."""
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


ROUNDING_VARIANCE = 1.0 / 12.0  # of rounding to whole counts, counts^2
HARMONICS = 12  # orders fitted to the amplitude over the phase
FITTED_SAMPLES = 50_000
SURE_PART = 0.8  # part of the measured noise that is assumed; it may be less at another time
TEN_YEARS_S = 10.0 * 365.25 * 86400.0
LEAST_REPEATS, MOST_REPEATS = 16, 255
QUIETEST_COUNTS = 0.15  # less noise cannot be distinguished from none


@dataclass(frozen=True, eq=False)
class TrackFigures:
    """Amplitude and noise of the tracks, ADC counts after conditioning.

    mean, least, most       of the amplitude over all valid samples
    over_phase              lowest, mean and highest in each of 64 bins of the phase, shape (3, 64); NaN: no
                            sample
    noise_counts            of the converter before rounding, rms; 0.0: none detected
    longest_repeat          most successive samples that repeat the previous counts
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
    """Amplitude and noise of these samples, some of which are valid. ``gain`` of the conditioning.

    The noise is the smaller of radial noise, which motion does not increase, and phase noise.
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

    At whole cycles per sample normal noise repeats both counts n times with a probability of at most q^n,
    q = erf(1 / (2 sqrt(2) noise))^2. The result gives less than one false alarm in ten years at this speed,
    ``rate_hz`` samples per second, exceeds ``margin`` x the longest repeat, and is at least 16; 0 beyond 255.
    """
    if noise_counts < QUIETEST_COUNTS:
        return 0
    again = math.erf(0.5 / (SURE_PART * noise_counts * math.sqrt(2.0))) ** 2
    by_chance = math.log(rate_hz * TEN_YEARS_S) / -math.log(again) if again < 1.0 else math.inf
    repeats = max(float(LEAST_REPEATS), by_chance, margin * (longest_repeat + 1))
    return math.ceil(repeats) if repeats <= MOST_REPEATS else 0


def _radial_noise(supervised: SupervisedSamples, valid: BoolArray) -> float:
    """Noise of the amplitude less its mean course over the phase, counts."""
    amplitude = np.where(valid, supervised.amplitude, np.nan)
    used = np.flatnonzero(valid)[:FITTED_SAMPLES]
    phase = np.where(valid, supervised.position % 1.0, 0.0)
    course, *_ = np.linalg.lstsq(_waves(phase[used]), amplitude[used], rcond=None)
    step = 100_000  # samples at a time: bounds the memory
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
    """Samples of a machine, and results of following them; None: not known.

    start_speed          at the first sample, cycles per interval
    followed             results of the chain with the limits of the module and the chosen corner
    interval_s           sampling interval, seconds
    coarse_spread        range of the difference of the coarse track, revolutions; coarse_note: why unknown
    longest_pause        longest time without SYNC or sample, periods
    low_pass             from the amplitude over the speed
    jitter_s             rms of the intervals between SYNCs or sample times
    off_grid_s           largest distance of a SYNC or sample time from the even grid
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
        """Convert cycles per interval^``power`` to rad/s^``power``."""
        return cycles * 2.0 * math.pi / cycles_per_revolution / self.interval_s**power
