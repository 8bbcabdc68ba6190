"""Speed, acceleration, jerk and noise of a machine, from the positions of its samples.

The second difference of the positions is the acceleration, in cycles per interval squared, and noise that
is much larger than most accelerations. It is averaged with bells of several lengths: a short one follows a
vibration, a long one sees a slow ramp through the noise. An average never exceeds the largest
acceleration, so what each bell shows beyond its own noise is at most that, and the largest counts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from canfb.calibrate.supervised_samples import SupervisedSamples
from canfb.calibration.figures import peak, root_mean
from canfb.signal.phase import FloatArray
from canfb.signal.residual_noise import RESIDUAL_WEIGHTS
from canfb.signal.third_order import SECOND as SECOND_ORDER

HALVES = (1, 2, 4, 8, 16, 32, 64)  # of the windows of the parabolas, samples to each side
MOVING_CYCLES = 0.02  # per interval: slower, the counts of neighbours hardly differ and noise hides
SIGMA_OF_MEDIAN = 1.4826
FOURTH = math.sqrt(70.0)  # times the noise of a sample: that of the fourth difference
SECOND = math.sqrt(6.0)
GROUPS, LEAST_OF_GROUP = 5, 400


@dataclass(frozen=True, eq=False)
class MotionSeen:
    """What a machine did; cycles and sampling intervals.

    slowest, fastest   speed, cycles per interval, with sign
    turned             from the lowest to the highest position, cycles
    moving             part of the samples at which it moved, 0..1
    acceleration       the largest, cycles per interval squared, noise taken off
    jerk               the largest change of that in an interval, noise taken off
    noise              rms of the phase of one sample, cycles, at the speeds at which it is largest
    residual           of the prediction, cycles; NaN where not known: the second difference at each sample
                       from the third on, the third difference from the fourth on
    bend               second difference at each sample from the third on, cycles; NaN where not known
    order              of the prediction
    """

    slowest: float
    fastest: float
    turned: float
    moving: float
    acceleration: float
    jerk: float
    noise: float
    residual: FloatArray
    bend: FloatArray
    order: int = SECOND_ORDER

    @property
    def top_speed(self) -> float:
        """The largest size of the speed."""
        return max(abs(self.slowest), abs(self.fastest))

    @property
    def residual_peak(self) -> float:
        """The largest residual of eq. 12, cycles."""
        return peak(self.residual[np.isfinite(self.residual)])

    @property
    def residual_rms(self) -> float:
        """Rms of the residual, cycles."""
        return root_mean(self.residual[np.isfinite(self.residual)])

    @property
    def phase_error(self) -> float:
        """The largest error of one phase that the second differences show beyond the motion, cycles.

        They weigh three phases with 1, 2, 1; at most all are off at the same time.
        """
        off = self.bend - smooth_acceleration(self.bend, self.noise)
        off = off[np.isfinite(off)]
        return peak(off) / 4.0 if len(off) else 0.0

    @property
    def residual_noise(self) -> float:
        """Rms of the residual that the noise of three or four samples makes."""
        return math.sqrt(RESIDUAL_WEIGHTS[self.order]) * self.noise


def motion_seen(samples: SupervisedSamples, order: int = SECOND_ORDER) -> MotionSeen:
    """The motion of these samples, as a prediction of ``order`` has it; at least one step between two valid
    ones.
    """
    speed, elapsed = samples.speed, samples.elapsed
    known = speed[np.isfinite(speed)]
    between = (elapsed[2:] + elapsed[1:-1]) / 2.0
    acceleration = np.diff(speed) / between
    bend = residual = np.diff(speed) * elapsed[2:]  # eq. 9 carries the last speed on
    if order != SECOND_ORDER:  # the parabola through three samples: Newton's form
        residual = np.diff(acceleration) / 2.0 * elapsed[3:] * (elapsed[3:] + elapsed[2:-1])
    position = samples.position[samples.valid]
    moves = np.abs(speed) >= MOVING_CYCLES
    noise = _noise(acceleration, np.where(moves, np.abs(speed), np.nan)[1:])
    slow = _averaged(speed, _bell(8))  # a speed between two samples is mostly noise
    slow = slow[np.isfinite(slow)] if np.isfinite(slow).any() else known
    return MotionSeen(
        slowest=float(slow.min()),
        fastest=float(slow.max()),
        turned=float(np.ptp(position)),
        moving=float(np.mean(moves[np.isfinite(speed)])),
        acceleration=_largest(acceleration, noise, np.array([1.0, -2.0, 1.0])),
        jerk=_largest(np.diff(acceleration), noise, np.array([1.0, -3.0, 3.0, -1.0])),
        noise=noise,
        residual=residual,
        bend=bend,
        order=order,
    )


def smooth_acceleration(residual: FloatArray, noise: float) -> FloatArray:
    """Second differences averaged until their noise is a tenth, for a picture; NaN where not known."""
    for half in HALVES:
        bell = _bell(half)
        if np.linalg.norm(np.convolve(bell, [1.0, -2.0, 1.0])) * noise <= 0.1 * SECOND * noise:
            break
    pad = len(bell) // 2
    return np.concatenate([np.full(pad, np.nan), _averaged(residual, bell), np.full(pad, np.nan)])


def _noise(acceleration: FloatArray, speed: FloatArray) -> float:
    """Of one sample, cycles, at the speeds at which it is largest: jitter grows with the speed.

    The fourth difference has next to nothing of a motion. ``speed`` is its size, NaN at standstill.
    """
    fourth = np.abs(np.diff(acceleration, 2))
    known = np.isfinite(fourth) & np.isfinite(speed[1:-1])
    fourth = fourth[known][np.argsort(speed[1:-1][known])]
    groups = np.array_split(fourth, max(1, min(GROUPS, len(fourth) // LEAST_OF_GROUP)))
    return max(SIGMA_OF_MEDIAN * float(np.median(one)) / FOURTH if len(one) else 0.0 for one in groups)


def _largest(values: FloatArray, noise: float, difference: FloatArray) -> float:
    """The largest size of the values, beyond what noise of the positions alone makes of them."""
    most = 0.0
    for half in HALVES:
        bell = _bell(half)
        averaged = _averaged(values, bell)
        averaged = averaged[np.isfinite(averaged)]
        if len(averaged) < len(bell):
            break
        sigmas = math.sqrt(2.0 * math.log(len(averaged) + 1.0))  # the largest of so many
        by_noise = sigmas * noise * float(np.linalg.norm(np.convolve(bell, difference)))
        most = max(most, peak(averaged) - by_noise)
    return most


def _averaged(values: FloatArray, bell: FloatArray) -> FloatArray:
    if len(values) < len(bell):
        return np.zeros(0)
    averaged: FloatArray = np.convolve(values, bell, "valid")
    return averaged


def _bell(half: int) -> FloatArray:
    """Weights, all positive, sum 1, with which the second derivative of a fitted parabola weighs the second
    differences in its window of 2 half + 1 samples (Savitzky and Golay).
    """
    place = np.arange(-half, half + 1, dtype=np.float64)
    second = 2.0 * np.linalg.pinv(np.vander(place, 3))[0]
    bell: FloatArray = np.cumsum(np.cumsum(second))[:-2]
    return bell
