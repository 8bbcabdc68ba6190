"""The analog path, from the tracks at several speeds: delay of the cosine, corners of both low-passes.

    |sine| = A / sqrt(1 + (f / fs)^2),    |cosine| = B / sqrt(1 + (f / fc)^2),    f in cycles per second
    angle from sine to cosine = angle at standstill + 2 pi f cosine_delay + arctan(f / fs) - arctan(f / fc)

|sine|^-2 is linear in f^2 and, with known corners, the angle linear in f: weighted least squares fit both.
The geometric mean of the amplitudes gives the mean corner, their ratio the difference.

The angle does not show the delay common to both tracks. One pole with gain r delays by arccos(r) / (2 pi)
cycles, two equal poles by more. Uncertainties are one standard deviation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from canfb.calibration.result import Reason
from canfb.errors import CalibrationError
from canfb.signal.front_end import Corners
from canfb.signal.phase import ArrayLike, ComplexArray, FloatArray

# Repeatability from one speed to the next, standard deviations:
AMPLITUDE_REPEATS = 1e-3  # of the amplitude of both tracks, relative
RATIO_REPEATS = 2e-4  # of the ratio of the amplitudes
ANGLE_REPEATS_RAD = 2e-4  # of the angle from sine to cosine
DETECTED_SIGMAS = 3.0  # a low-pass or a delay of more than these is detected
APART_SIGMAS = 2.0  # corners that differ by less are equal
# Rms phase error, cycles per rad, caused by an error d of the angle between the tracks, or by an amplitude
# ratio of exp(d): to first order the arc tangent errs by d/2 cos 2x, or d/2 sin 2x, beside its mean.
ERROR_OF_ANGLE = 1.0 / (4.0 * math.pi * math.sqrt(2.0))
MOST_UNCERTAIN_CYCLES = 1e-4  # largest rms phase error by the uncertain delay, at the highest speed
MOST_OFF_CYCLES = 1e-3  # largest rms phase error by the misfit of the model, at any speed
ROUNDS = 30
MOST_MISFIT = DETECTED_SIGMAS * AMPLITUDE_REPEATS
BEYOND = 3.0  # standard deviations: a low-pass stronger than the fit by these would have been detected


class Fundamental(NamedTuple):
    """The fundamentals of both tracks at one speed.

    hertz           cycles per second, with sign
    sine, cosine    amplitudes, counts
    angle_rad       lead of the cosine over the sine, less a quarter of a cycle
    noise           relative standard deviation of an amplitude by the noise of the samples
    """

    hertz: float
    sine: float
    cosine: float
    angle_rad: float
    noise: float


@dataclass(frozen=True)
class LowPass:
    """A low-pass of one pole, fitted to the amplitudes over the speed.

    per_hz          1 / corner, 0.0: none detected; sigma_per_hz: its uncertainty
    top_hz          the highest speed
    misfit          largest relative difference of an amplitude from the fit
    checked         the speeds suffice to judge by misfit whether it is one pole
    least_corner_hz a lower corner would have been detected
    rises           the amplitude rises with the speed
    two_poles_delay_s   longer delay, at low speed, if it were two equal poles; None: ruled out
    """

    per_hz: float
    sigma_per_hz: float
    top_hz: float
    misfit: float
    checked: bool
    least_corner_hz: float = math.inf
    rises: bool = False
    two_poles_delay_s: float | None = None

    @property
    def is_detected(self) -> bool:
        return self.per_hz > 0.0

    @property
    def corner_hz(self) -> float:
        """Corner frequency; 0.0: none."""
        return 1.0 / self.per_hz if self.per_hz else 0.0

    @property
    def corner_sigma_hz(self) -> float:
        """Uncertainty of the corner; 0.0: none."""
        return self.sigma_per_hz * self.corner_hz**2

    @property
    def left(self) -> float:
        """Gain at the highest speed, 0..1."""
        return 1.0 / math.hypot(1.0, self.top_hz * self.per_hz)

    @property
    def is_one_pole(self) -> bool:
        return self.misfit <= MOST_MISFIT and not self.rises

    @property
    def delay_s(self) -> float:
        return self.per_hz / (2.0 * math.pi)

    @property
    def delay_sigma_s(self) -> float:
        """Uncertainty of `delay_s` for one pole; if none is detected, the longest delay that would not be."""
        if not self.is_detected:
            return 1.0 / (2.0 * math.pi * self.least_corner_hz) if self.least_corner_hz else math.inf
        return self.sigma_per_hz / (2.0 * math.pi)

    def delay_cycles(self, hertz: float) -> float:
        """Delay at a speed: arctan(f / fc) / (2 pi)."""
        return math.atan(hertz * self.per_hz) / (2.0 * math.pi)

    def delay_sigma_cycles(self, hertz: float) -> float:
        ratio = hertz * self.per_hz
        return abs(hertz) * self.delay_sigma_s / (1.0 + ratio * ratio)


@dataclass(frozen=True)
class PathFit:
    """The analog path between an encoder and its counts.

    cosine_delay_s        the cosine is sampled this much after the sine (2002:06), 0.0: none is detected
    corners, low_pass     2001:05 and 2001:06; low-pass of the sine, which delays the position
    """

    cosine_delay_s: float
    cosine_delay_sigma_s: float
    corners: Corners
    low_pass: LowPass

    def turned_rad(self, hertz: FloatArray | float) -> FloatArray:
        return np.asarray(
            2.0 * math.pi * hertz * self.cosine_delay_s
            + np.angle(response(hertz, self.corners.of_cosine_hz))
            - np.angle(response(hertz, self.corners.corner_hz)),
            np.float64,
        )


NO_PATH = PathFit(0.0, 0.0, Corners(), LowPass(0.0, 0.0, 0.0, 0.0, False))


def response(hertz: ArrayLike, corner_hz: float) -> ComplexArray:
    f = np.asarray(hertz, np.float64)
    return np.asarray(1.0 / (1.0 + 1j * f / corner_hz) if corner_hz else np.ones(f.shape), np.complex128)


def fit_path(found: Sequence[Fundamental]) -> PathFit:
    """The path of these fundamentals. CalibrationError ("speed") if the speeds are too close together,
    or if no such path gives these tracks.
    """
    f, sine, cosine, angle, noise = np.array(found).T
    check_apart(f, noise)
    size, gain = np.sqrt(sine * cosine), np.log(cosine / sine)
    sigma = np.hypot(noise, AMPLITUDE_REPEATS)
    both = fit_low_pass(f, size, sigma)
    per_hz, apart_sigma = np.array([both.per_hz, both.per_hz]), 0.0
    for _ in range(ROUNDS if both.is_detected else 0):
        pair, apart_sigma = _corners(f, gain, noise, both.per_hz)
        if abs(pair[1] - pair[0]) < APART_SIGMAS * apart_sigma:
            per_hz[:] = both.per_hz
            break
        moved, per_hz = float(np.abs(pair - per_hz).max()), pair
        if moved < 1e-6 * both.per_hz:
            break
        # The geometric mean of two low-passes differs from one low-pass at the mean corner: correct for it.
        each = np.prod(np.hypot(1.0, np.outer(pair, f)), axis=0)
        both = fit_low_pass(f, size * np.sqrt(each) / np.hypot(1.0, pair.mean() * f), sigma)
    ratio = np.outer(per_hz, f)
    angle = np.unwrap(angle) - np.arctan(ratio[0]) + np.arctan(ratio[1])
    weight = 1.0 / np.hypot(noise, ANGLE_REPEATS_RAD)
    turns = 2.0 * math.pi * f
    (delay_s, at_rest), covariance = np.polyfit(turns, angle, 1, w=weight, cov="unscaled")
    delay_sigma_s = math.sqrt(covariance[0, 0])
    left_angle = angle - at_rest - turns * delay_s
    gain = gain - 0.5 * np.log1p(ratio[0] ** 2) + 0.5 * np.log1p(ratio[1] ** 2)
    off = ERROR_OF_ANGLE * np.hypot(left_angle, gain - np.average(gain, weights=weight))
    worst = int(np.argmax(off))
    if off[worst] > MOST_OFF_CYCLES:
        raise CalibrationError(
            f"no delay and no low-pass give these tracks: at {f[worst]:.6g} cycles/s {off[worst]:.2g} cycle "
            "rms are left. Is each speed right, within half a cycle per sample?",
            Reason.SPEED,
        )
    corner, of_cosine = (1.0 / float(one) if one else 0.0 for one in per_hz)
    return PathFit(
        float(delay_s) if abs(delay_s) > DETECTED_SIGMAS * delay_sigma_s else 0.0,
        math.hypot(delay_sigma_s, apart_sigma / (2.0 * math.pi)),  # different corners look like a delay
        Corners(corner, 0.0 if of_cosine == corner else of_cosine),
        replace(both, per_hz=float(per_hz[0])),
    )


def check_apart(hertz: FloatArray, noise: FloatArray | float = 0.0) -> None:
    """Refuse speeds (cycles/s) too close to determine the delay; the error gives the uncertainty."""
    apart, top = float(np.ptp(hertz)), float(np.abs(hertz).max())
    sigma_rad = math.sqrt(2.0) * math.hypot(ANGLE_REPEATS_RAD, float(np.max(noise)))
    if apart == 0.0:
        raise CalibrationError("the analog path requires at least two different speeds", Reason.SPEED)
    left = ERROR_OF_ANGLE * sigma_rad * top / apart
    if left > MOST_UNCERTAIN_CYCLES:
        raise CalibrationError(
            f"the speeds are too close to tell: from {hertz.min():.6g} to {hertz.max():.6g} cycles/s the "
            f"delay between the tracks is known to ±{sigma_rad / (2.0 * math.pi * apart) * 1e9:.3g} ns, "
            f"{left:.2g} cycle rms at the highest speed. Measure at a third of it or less, too",
            Reason.SPEED,
        )


def fit_low_pass(hertz: FloatArray, amplitude: FloatArray, sigma: FloatArray) -> LowPass:
    """Fit one pole to amplitudes (any unit) at speeds (cycles/s), ``sigma`` relative, all of one length.

    At least one speed must differ from zero.
    """
    top = float(np.abs(hertz).max())
    square = (hertz / top) ** 2
    checked = len(np.unique(np.round(np.sqrt(square), 2))) > 2
    if np.ptp(square) < 1e-3:
        return LowPass(0.0, 0.0, top, 0.0, False, 0.0)
    ratio2, sigma2, misfit = _poles(square, amplitude, sigma, 1)
    rises = ratio2 < -DETECTED_SIGMAS * sigma2
    if ratio2 <= DETECTED_SIGMAS * sigma2:
        least = top / math.sqrt(max(ratio2, 0.0) + BEYOND * sigma2)
        return LowPass(0.0, 0.0, top, misfit, checked, least, rises)
    ratio = math.sqrt(ratio2)
    other2, _, other_misfit = _poles(square, amplitude, sigma, 2)
    other_s = math.sqrt(max(other2, 0.0)) / top / math.pi
    ruled_out = checked and other_misfit > MOST_MISFIT
    return LowPass(
        ratio / top,
        sigma2 / (2.0 * ratio) / top,
        top,
        misfit,
        checked,
        two_poles_delay_s=None if ruled_out else other_s,
    )


def _poles(
    square: FloatArray, amplitude: FloatArray, sigma: FloatArray, count: int
) -> tuple[float, float, float]:
    """(top speed / corner)^2 of this many equal poles, its uncertainty, largest relative difference.

    amplitude^(-2/count) is linear in ``square``, (speed / top speed)^2.
    """
    inverse = (amplitude.max() / amplitude) ** (2.0 / count)
    weight = count / (2.0 * sigma * inverse)
    (rise, at_rest), covariance = np.polyfit(square, inverse, 1, w=weight, cov="unscaled")
    fitted = np.maximum(at_rest + rise * square, 1e-9)
    off = (inverse / fitted) ** (count / 2.0) - 1.0
    # With two speeds the line fits exactly and nothing scatters.
    spread = max(1.0, math.sqrt(float(np.sum((off / sigma) ** 2)) / max(1, len(square) - 2)))
    at_rest = max(float(at_rest), 1e-9)
    return float(rise) / at_rest, spread * math.sqrt(covariance[0, 0]) / at_rest, float(np.abs(off).max())


def _corners(f: FloatArray, gain: FloatArray, noise: FloatArray, per_hz: float) -> tuple[FloatArray, float]:
    """1 / corner of sine and cosine, and the uncertainty of their difference.

    ``per_hz`` is their mean; the ratio of the amplitudes gives the difference.
    """
    weight = 1.0 / np.hypot(RATIO_REPEATS, noise)
    pair = np.array([per_hz, per_hz])
    for _ in range(ROUNDS):
        ratio = np.outer(pair, f)
        model = 0.5 * np.log1p(ratio[0] ** 2) - 0.5 * np.log1p(ratio[1] ** 2)
        # derivative of `gain` with respect to `half`: 1 / corner is mean + half (cosine), mean - half (sine)
        slope = -np.sum(ratio * f / (1.0 + ratio**2), axis=0)
        (half, _), covariance = np.polyfit(slope, gain - model, 1, w=weight, cov="unscaled")
        sigma = 2.0 * math.sqrt(covariance[0, 0])
        half = max(-0.4 * per_hz, min(half, 0.4 * per_hz))
        pair = np.clip(pair + np.array([-half, half]), 0.5 * per_hz, 1.5 * per_hz)
        if abs(half) < 1e-9 * per_hz:
            break
    return pair, sigma
