"""What samples show of the signal: amplitude over the speed, over the phase, and the noise of the converter.

By the amplitude over the speed of a machine in its duty: the corner of a low-pass before the converter. The
limits of the amplitude (2001:03, 2001:04) hold at standstill where the module knows the corner (2001:05).
What is fitted is the amplitude without what is corrected already, in classes of the speed.

By the amplitude over the phase and the noise: how a frozen input is recognised.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from canfb.calibrate.supervised_samples import SupervisedSamples
from canfb.calibration.figures import BINS, bins_of, mean_in_bins
from canfb.calibration.path_fit import AMPLITUDE_REPEATS, LowPass, fit_low_pass
from canfb.commission.motion_seen import FOURTH, MOVING_CYCLES, SIGMA_OF_MEDIAN
from canfb.master.samples import TrackSamples
from canfb.signal.harmonics import Corners
from canfb.signal.phase import FloatArray

CLASSES = 12
LEAST_OF_CLASS = 100
LEAST_CLASSES = 3
LOWEST_PART = 0.5  # of the top speed: there must be one that is lower


def low_pass_seen(followed: SupervisedSamples, interval_s: float, corners: Corners) -> LowPass | None:
    """What these samples show, the known ``corners`` undone; None where there are too few speeds."""
    hertz = np.abs(followed.speed) / interval_s
    amplitude = followed.amplitude[1:]
    known = np.isfinite(hertz) & np.isfinite(amplitude)
    hertz, amplitude = hertz[known], amplitude[known] * _left(hertz[known], corners)
    if not len(hertz) or not hertz.max() > 0.0:
        return None
    number = np.minimum((hertz / hertz.max() * CLASSES).astype(np.int64), CLASSES - 1)
    classes = [number == one for one in range(CLASSES) if np.sum(number == one) >= LEAST_OF_CLASS]
    if len(classes) < LEAST_CLASSES:
        return None
    speeds = np.array([np.sqrt(np.mean(hertz[one] ** 2)) for one in classes])
    if speeds.min() > LOWEST_PART * speeds.max():
        return None
    sizes = np.array([amplitude[one].mean() for one in classes])
    spread = np.array([amplitude[one].std() / np.sqrt(np.sum(one)) for one in classes])
    return fit_low_pass(speeds, sizes, np.hypot(AMPLITUDE_REPEATS, spread / sizes))


def _left(hertz: FloatArray, corners: Corners) -> FloatArray:
    """Of the amplitude that the known low-passes leave: the mean of both tracks."""
    both = [hz for hz in (corners.corner_hz, corners.of_cosine_hz) if hz]
    left = [1.0 / np.hypot(1.0, hertz / hz) for hz in both]
    return np.asarray(np.mean(left, axis=0) if left else np.ones(len(hertz)), np.float64)


ROUNDING_VARIANCE = 1.0 / 12.0  # of a count, of a converter that rounds
HARMONICS = 12  # of the amplitude over the phase
FITTED_SAMPLES = 50_000
SURE_PART = 0.8  # of the noise that was measured; it may be less at another time
TEN_YEARS_S = 10.0 * 365.25 * 86400.0
LEAST_REPEATS, MOST_REPEATS = 16, 255
QUIETEST_COUNTS = 0.15  # less cannot be distinguished from a converter without noise


@dataclass(frozen=True, eq=False)
class TracksSeen:
    """Amplitude and noise of the tracks, ADC counts after conditioning.

    mean, least, most       of the amplitude over all valid samples
    over_phase              lowest, mean and highest amplitude in each of 64 bins of the phase, shape (3, 64);
                            NaN where there is no sample
    noise_counts            of the converter before it rounds, rms; 0.0: none seen
    longest_repeat          the most successive samples that repeat the counts of the one before
    """

    mean: float
    least: float
    most: float
    over_phase: FloatArray
    noise_counts: float
    longest_repeat: int

    @property
    def spread(self) -> float:
        """How far the amplitude is from its mean, as a part of it."""
        return max(self.mean - self.least, self.most - self.mean) / self.mean


def tracks_seen(
    samples: TrackSamples, supervised: SupervisedSamples, gain: float, phase_noise_cycles: float
) -> TracksSeen:
    """Amplitude and noise of these samples, some of which are valid. ``gain`` is that of the conditioning.

    The noise is the smaller one of that along the radius, which no motion adds to, and of that of the phase.
    """
    valid = supervised.valid & np.isfinite(supervised.amplitude)
    amplitude, phase = supervised.amplitude[valid], supervised.position[valid] % 1.0
    mean = float(amplitude.mean())
    along = _radial_noise(supervised, valid)
    across = 2.0 * math.pi * mean * phase_noise_cycles
    counts = min(along, across) / gain
    return TracksSeen(
        mean=mean,
        least=float(amplitude.min()),
        most=float(amplitude.max()),
        over_phase=_over_phase(amplitude, phase),
        noise_counts=math.sqrt(max(0.0, counts * counts - ROUNDING_VARIANCE)),
        longest_repeat=_longest_repeat(samples),
    )


def repeats_of_frozen_input(noise_counts: float, rate_hz: float, margin: float, longest_repeat: int) -> int:
    """Repeats of both counts that tell a frozen converter from a working one (2010:04); 0: nothing does.

    A machine that moves whole cycles per sample shows one phase only, in the worst case with both
    tracks in the middle of a count. With normal noise of ``noise_counts`` (rms) both counts are then the
    same again with the probability q = erf(1 / (2 sqrt(2) noise))^2, and n times with q^n. The result is
    large enough for less than one false alarm in ten years of that, at ``rate_hz`` samples per second,
    and more than ``margin`` times what was seen; at least 16, 0 if it were more than 255.
    """
    if noise_counts < QUIETEST_COUNTS:
        return 0
    again = math.erf(0.5 / (SURE_PART * noise_counts * math.sqrt(2.0))) ** 2
    by_chance = math.log(rate_hz * TEN_YEARS_S) / -math.log(again) if again < 1.0 else math.inf
    repeats = max(float(LEAST_REPEATS), by_chance, margin * (longest_repeat + 1))
    return math.ceil(repeats) if repeats <= MOST_REPEATS else 0


def _radial_noise(
    supervised: SupervisedSamples, valid: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
) -> float:
    """Noise of the amplitude, counts, its course over the phase taken off."""
    amplitude = np.where(valid, supervised.amplitude, np.nan)
    used = np.flatnonzero(valid)[:FITTED_SAMPLES]
    phase = np.where(valid, supervised.position % 1.0, 0.0)
    course, *_ = np.linalg.lstsq(_waves(phase[used]), amplitude[used], rcond=None)
    fourth = np.full(len(amplitude), np.nan)
    step = 100_000  # bounded memory
    rest = np.concatenate(
        [amplitude[k : k + step] - _waves(phase[k : k + step]) @ course for k in range(0, len(phase), step)]
    )
    fourth = np.diff(rest, 4)
    moves = np.abs(supervised.speed[1:-2]) >= MOVING_CYCLES
    fourth = fourth[np.isfinite(fourth) & moves]
    return SIGMA_OF_MEDIAN * float(np.median(np.abs(fourth))) / FOURTH if len(fourth) else 0.0


def _waves(phase: FloatArray) -> FloatArray:
    angle = 2.0 * np.pi * phase[:, None] * np.arange(1, HARMONICS + 1)
    return np.hstack([np.ones((len(phase), 1)), np.sin(angle), np.cos(angle)])


def _over_phase(amplitude: FloatArray, phase: FloatArray) -> FloatArray:
    bins = bins_of(phase)
    lowest, highest = np.full(BINS, np.inf), np.full(BINS, -np.inf)
    np.minimum.at(lowest, bins, amplitude)
    np.maximum.at(highest, bins, amplitude)
    mean = mean_in_bins(phase, amplitude)
    found: FloatArray = np.where(np.isnan(mean), np.nan, np.array([lowest, mean, highest]))
    return found


def _longest_repeat(samples: TrackSamples) -> int:
    same = (np.diff(samples.sine) == 0.0) & (np.diff(samples.cosine) == 0.0)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same.astype(np.int8), [0]])))
    return int(np.max(edges[1::2] - edges[::2])) if len(edges) else 0
