"""Ellipse through the samples (Heydemann): offset, gain and phase error of the tracks."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from canfb.errors import CalibrationError
from canfb.signal.conditioning import Conditioning
from canfb.signal.phase import FloatArray

ROUNDS = 8
# A sample this far off the ellipse is a fault; harmonics of a poor encoder reach 0.15.
MIN_SCATTER = 0.02
REJECT_SIGMAS = 5.0
LARGEST_SCATTER = 0.25
# The object dictionary holds the gains as REAL32; more of a difference than this is a dead track.
LARGEST_RATIO = 20.0
STANDSTILL_COUNTS = 8.0
# A whole ellipse passes through some 90 squares of the grid, a motion that is locked at a
# eighth of a cycle per sample meets 8 places, on edges up to 24.
MIN_PLACES = 25


def fit_ellipse(
    sine: npt.ArrayLike, cosine: npt.ArrayLike, valid: npt.ArrayLike | None = None
) -> Conditioning:
    """Conditioning that turns the ellipse of the samples into a circle about the origin.

    ``sine`` and ``cosine`` are ADC counts of one shape, NaN where there is no sample;
    ``valid`` marks with False the samples to leave out. Least squares, repeated without the
    samples that lie far off. Values are rounded to REAL32, as objects 2002:01..05 hold them,
    and the gains keep the geometric mean of both amplitudes.

    Raises ValueError for shapes that differ, CalibrationError ("ellipse") if the samples
    lie on no ellipse: a dead track, one point, a short arc, or noise.
    """
    s, c = np.ravel(np.asarray(sine, np.float64)), np.ravel(np.asarray(cosine, np.float64))
    if s.shape != c.shape:
        raise ValueError(f"sine and cosine must be of one length: {s.shape} and {c.shape}")
    use = np.isfinite(s) & np.isfinite(c)
    if valid is not None:
        use &= np.ravel(np.asarray(valid, np.bool_))
    s, c = s[use], c[use]
    if len(s) < 16:
        raise CalibrationError(f"{len(s)} usable samples are too few for an ellipse", "samples")
    return _robust_fit(s, c)


def angle_cycles(conditioning: Conditioning, sine: FloatArray, cosine: FloatArray) -> FloatArray:
    """Arc tangent of the conditioned tracks in cycles, 0 <= angle < 1; NaN stays NaN."""
    s, c = conditioning.apply(sine, cosine)
    angle: FloatArray = np.arctan2(s, c) / (2.0 * np.pi) % 1.0 % 1.0
    return angle


def _robust_fit(s: FloatArray, c: FloatArray) -> Conditioning:
    # Start from the middle of what the tracks cover, faults at the ends left out.
    low_s, high_s = np.percentile(s, [1.0, 99.0])
    low_c, high_c = np.percentile(c, [1.0, 99.0])
    half = np.array([high_s - low_s, high_c - low_c]) / 2.0
    if half.max() < STANDSTILL_COUNTS:
        raise CalibrationError(
            "the tracks hardly change: the machine stands still, or goes through a whole number of "
            "cycles per sample",
            "coverage",
        )
    if not (half.min() > 2.0 and half.max() / half.min() < LARGEST_RATIO):
        raise CalibrationError(
            f"the tracks span {2 * half[0]:.0f} and {2 * half[1]:.0f} counts: no ellipse. "
            "Check the wiring of the tracks, and let the machine move",
            "ellipse",
        )
    x = (s - (low_s + high_s) / 2.0) / half[0]
    y = (c - (low_c + high_c) / 2.0) / half[1]
    if _places(x, y) < MIN_PLACES:
        raise CalibrationError(
            "the samples lie in a few places only: the motion is locked to them. Change the speed", "locked"
        )
    radius = np.hypot(x, y)
    keep = (radius > 0.3) & (radius < 1.7)
    fit = None
    for _ in range(ROUNDS):
        fit = _conic(x[keep], y[keep])
        if fit is None:
            break
        off = np.abs(_radius(fit, x, y) - 1.0)
        limit = max(REJECT_SIGMAS * 1.4826 * float(np.median(off)), MIN_SCATTER)
        before, keep = keep, off < limit
        if np.array_equal(before, keep):
            break
    if fit is None or np.mean(keep) < 0.5 or float(np.std(_radius(fit, x, y)[keep])) > LARGEST_SCATTER:
        raise CalibrationError(
            "the samples lie on no ellipse: a dead track, noise, or too short a way", "ellipse"
        )
    return _conditioning(fit, half, np.array([(low_s + high_s) / 2.0, (low_c + high_c) / 2.0]))


def _places(x: FloatArray, y: FloatArray) -> int:
    """Squares of a 32 x 32 grid over the tracks that hold more than a stray sample."""
    column = np.clip((x + 1.0) * 16.0, 0, 31).astype(np.int64)
    row = np.clip((y + 1.0) * 16.0, 0, 31).astype(np.int64)
    return int(np.sum(np.bincount(32 * row + column) > max(1, len(x) // 2000)))


def _conic(x: FloatArray, y: FloatArray) -> FloatArray | None:
    """Centre and inverse shape (x0, y0, q00, q01, q11) of the conic of least squares, None if no ellipse."""
    if len(x) < 8:
        return None
    columns = np.column_stack([x * x, x * y, y * y, x, y])
    solution, _, rank, _ = np.linalg.lstsq(columns, np.ones(len(x)), rcond=1e-9)
    a, b, c, d, e = solution.tolist()
    shape = np.array([[a, b / 2.0], [b / 2.0, c]])
    if rank < 5 or np.linalg.eigvalsh(shape).min() <= 0.0:
        return None
    centre = np.linalg.solve(shape, [-d / 2.0, -e / 2.0])
    size = 1.0 + float(centre @ shape @ centre)
    inverse = np.linalg.inv(shape) * size
    return np.array([centre[0], centre[1], inverse[0, 0], inverse[0, 1], inverse[1, 1]])


def _radius(fit: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    shape = np.linalg.inv(np.array([[fit[2], fit[3]], [fit[3], fit[4]]]))
    dx, dy = x - fit[0], y - fit[1]
    radius: FloatArray = np.sqrt(shape[0, 0] * dx * dx + 2.0 * shape[0, 1] * dx * dy + shape[1, 1] * dy * dy)
    return radius


def _conditioning(fit: FloatArray, half: FloatArray, middle: FloatArray) -> Conditioning:
    amplitude_s, amplitude_c = np.sqrt(fit[2]) * half[0], np.sqrt(fit[4]) * half[1]
    mean = np.sqrt(amplitude_s * amplitude_c)
    try:
        return as_real32(
            Conditioning(
                sine_offset_counts=middle[0] + fit[0] * half[0],
                cosine_offset_counts=middle[1] + fit[1] * half[1],
                sine_gain=mean / amplitude_s,
                cosine_gain=mean / amplitude_c,
                phase_error_rad=float(np.arcsin(fit[3] / np.sqrt(fit[2] * fit[4]))),
            )
        )
    except ValueError as error:
        raise CalibrationError(f"the ellipse of the tracks is too narrow: {error}", "ellipse") from None


def as_real32(conditioning: Conditioning) -> Conditioning:
    """The same conditioning with values that objects 2002:01..05 (REAL32) hold exactly."""
    return Conditioning(
        *(
            float(np.float32(value))
            for value in (
                conditioning.sine_offset_counts,
                conditioning.cosine_offset_counts,
                conditioning.sine_gain,
                conditioning.cosine_gain,
                conditioning.phase_error_rad,
            )
        )
    )
