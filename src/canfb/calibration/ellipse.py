"""Ellipse through the samples (Heydemann): offset, gain and phase error of the tracks.

With s = s0 + A sin x and c = c0 + B cos(x - d) the samples lie on

    r' Q^-1 r = 1,   r = (s - s0, c - c0),   Q = [ A^2        A B sin d ]
                                                 [ A B sin d  B^2       ]

The conic a s^2 + b s c + e c^2 + f s + g c = 1 is found by least squares; sin d = Q12 / sqrt(Q11 Q22), and
the gains scale both amplitudes to their geometric mean. Squares of a grid with more samples than uniform
motion gives are thinned, and samples beyond five standard deviations are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from canfb.calibration.result import Reason, robust_rms
from canfb.errors import CalibrationError
from canfb.signal.conditioning import HARMONIC_ORDERS, LARGEST_HARMONIC, Conditioning
from canfb.signal.phase import ArrayLike, FloatArray, IntArray

ROUNDS = 8
# Distances from the ellipse, relative to the amplitude: a sample is kept within 5 standard deviations or
# MIN_SCATTER, whichever is more; harmonics of a poor encoder reach 0.15.
MIN_SCATTER = 0.02
REJECT_SIGMAS = 5.0
LARGEST_SCATTER = 0.25
# Largest ratio of the amplitudes of the tracks; beyond it one track is dead.
LARGEST_RATIO = 20.0
STANDSTILL_COUNTS = 8.0
# An ellipse passes through about 90 squares of the grid. Motion locked at 1/8 cycle per sample gives 8
# points, which fall into at most 24 squares if all lie on edges.
SQUARES_OF_ELLIPSE = 90
MIN_PLACES = 25
# The fit starts from the range of each track without this percentage at either end: few, or many faults.
MARGINS = (1.0, 8.0)
NEAR = 0.15


def fit_ellipse(sine: ArrayLike, cosine: ArrayLike, valid: ArrayLike | None = None) -> Conditioning:
    """Conditioning that turns the ellipse of the samples into a circle about the origin, in REAL32
    (2002:01..05).

    ADC counts of one shape, NaN: no sample; ``valid`` False leaves a sample out. ValueError for
    different shapes, CalibrationError ("ellipse") for a dead track, one point, a short arc, or noise.
    """
    s, c = np.ravel(np.asarray(sine, np.float64)), np.ravel(np.asarray(cosine, np.float64))
    if s.shape != c.shape:
        raise ValueError(f"sine and cosine must be of one length: {s.shape} and {c.shape}")
    use = np.isfinite(s) & np.isfinite(c)
    if valid is not None:
        use &= np.ravel(np.asarray(valid, np.bool_))
    s, c = s[use], c[use]
    if len(s) < 16:
        raise CalibrationError(f"{len(s)} usable samples are too few for an ellipse", Reason.SAMPLES)
    keep = _thinned(s, c)
    s, c = s[keep], c[keep]
    best, most = None, 0.5
    for margin in MARGINS:
        start = _Box.of(s, c, margin)
        fit, part = start.fit(s, c)
        if fit is not None and part > most:
            best, most = start.conditioning(fit), part
    if best is None:
        raise CalibrationError(
            "the samples do not lie on an ellipse: a dead track, noise, or too short a distance",
            Reason.ELLIPSE,
        )
    return best


def angle_cycles(conditioning: Conditioning, sine: FloatArray, cosine: FloatArray) -> FloatArray:
    """Arc tangent of the conditioned tracks in cycles, 0 <= angle < 1; NaN stays NaN."""
    s, c = conditioning.apply(sine, cosine)
    return np.asarray(np.arctan2(s, c) / (2.0 * np.pi) % 1.0 % 1.0, np.float64)


def _thinned(s: FloatArray, c: FloatArray) -> IntArray:
    box = _Box.of(s, c, MARGINS[0])
    if box.half.max() < STANDSTILL_COUNTS:
        raise CalibrationError(
            "the tracks hardly change: the machine is at standstill, or moves a whole number of "
            "cycles per sample",
            Reason.COVERAGE,
        )
    if not (box.half.min() > 2.0 and box.half.max() / box.half.min() < LARGEST_RATIO):
        raise CalibrationError(
            f"the tracks span {2 * box.half[0]:.0f} and {2 * box.half[1]:.0f} counts: no ellipse. "
            "Check the wiring of the tracks, and let the machine move",
            Reason.ELLIPSE,
        )
    column, row = (np.clip((one + 1.0) * 16.0, 0, 31).astype(np.int64) for one in box.scaled(s, c))
    place = 32 * row + column
    counts = np.bincount(place)
    if np.sum(counts > max(1, len(s) // 2000)) < MIN_PLACES:
        raise CalibrationError(
            "the samples have only a few different phases: the motion is locked to them. Change the speed",
            Reason.LOCKED,
        )
    order = np.argsort(place, kind="stable")
    first = np.cumsum(counts) - counts
    # Keep every n-th sample of an overfull square, so that the samples kept span the whole recording.
    every = 1 + counts // max(8, len(s) // SQUARES_OF_ELLIPSE * 2)
    rank = np.arange(len(s)) - first[place[order]]
    return np.sort(order[rank % every[place[order]] == 0])


_Ellipse = tuple[FloatArray, FloatArray]  # centre, and Q^-1


@dataclass(frozen=True, eq=False)
class _Box:
    middle: FloatArray
    half: FloatArray

    @classmethod
    def of(cls, s: FloatArray, c: FloatArray, margin: float) -> _Box:
        ends = np.array([np.percentile(track, [margin, 100.0 - margin]) for track in (s, c)])
        # A sine of amplitude A exceeds A cos(pi p) during the fraction p of its cycle.
        return cls(ends.mean(axis=1), (ends[:, 1] - ends[:, 0]) / 2.0 / np.cos(np.pi * margin / 100.0))

    def scaled(self, s: FloatArray, c: FloatArray) -> tuple[FloatArray, FloatArray]:
        return (s - self.middle[0]) / self.half[0], (c - self.middle[1]) / self.half[1]

    def fit(self, s: FloatArray, c: FloatArray) -> tuple[_Ellipse | None, float]:
        x, y = self.scaled(s, c)
        radius = np.hypot(x, y)
        keep = (radius > 0.3) & (radius < 1.7)
        for _ in range(ROUNDS):
            fit = _conic(x[keep], y[keep])
            if fit is None:
                return None, 0.0
            off = _radius(*fit, x, y) - 1.0
            before, keep = keep, np.abs(off) < max(REJECT_SIGMAS * robust_rms(off), MIN_SCATTER)
            if np.array_equal(before, keep):
                break
        if np.mean(keep) < 0.5 or float(np.std(off[keep])) > LARGEST_SCATTER:
            return None, 0.0
        return fit, float(np.mean(np.abs(off) < NEAR))

    def conditioning(self, fit: _Ellipse) -> Conditioning:
        centre, q = fit[0], np.linalg.inv(fit[1])
        amplitude = np.sqrt(np.diag(q)) * self.half
        mean = np.sqrt(amplitude[0] * amplitude[1])
        offset = self.middle + centre * self.half
        try:
            return as_real32(
                Conditioning(
                    sine_offset_counts=float(offset[0]),
                    cosine_offset_counts=float(offset[1]),
                    sine_gain=float(mean / amplitude[0]),
                    cosine_gain=float(mean / amplitude[1]),
                    phase_error_rad=float(np.arcsin(q[0, 1] / np.sqrt(q[0, 0] * q[1, 1]))),
                )
            )
        except ValueError as error:
            raise CalibrationError(
                f"the ellipse of the tracks is too narrow: {error}", Reason.ELLIPSE
            ) from None


def _conic(x: FloatArray, y: FloatArray) -> _Ellipse | None:
    if len(x) < 8:
        return None
    columns = np.column_stack([x * x, x * y, y * y, x, y])
    solution, _, rank, _ = np.linalg.lstsq(columns, np.ones(len(x)), rcond=1e-9)
    a, b, c, d, e = solution.tolist()
    shape = np.array([[a, b / 2.0], [b / 2.0, c]])
    if rank < 5 or np.linalg.eigvalsh(shape).min() <= 0.0:
        return None
    centre = np.linalg.solve(shape, [-d / 2.0, -e / 2.0])
    return centre, shape / (1.0 + float(centre @ shape @ centre))


def _radius(centre: FloatArray, shape: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    dx, dy = x - centre[0], y - centre[1]
    square = shape[0, 0] * dx * dx + 2.0 * shape[0, 1] * dx * dy + shape[1, 1] * dy * dy
    return np.asarray(np.sqrt(square), np.float64)


def as_real32(conditioning: Conditioning) -> Conditioning:
    """The same conditioning with values that objects 2002:01..07 and 2005h (REAL32) hold exactly."""
    return Conditioning(*(float(np.float32(value)) for value in conditioning.values))


def without_harmonics(used: Conditioning) -> Conditioning:
    """``used`` without harmonics, for a table of one speed."""
    return used.with_harmonics([0j] * len(HARMONIC_ORDERS))


def with_track_harmonics(used: Conditioning, tracks: FloatArray) -> Conditioning:
    """``used`` with the harmonics of these mean tracks, ADC counts, shape (2, n), sine first, over one cycle.

    They are the harmonics of cosine + i sine after conditioning, relative to the fundamental and its phase.
    """
    s, c = used.apply(*tracks)
    spectrum = np.fft.fft(c + 1j * s) / np.size(s)
    first = spectrum[1]
    shift = first / abs(first)

    def at(order: int) -> complex:
        value = complex(spectrum[order] / abs(first) * shift ** (-order))
        return value if abs(value) <= LARGEST_HARMONIC else 0j

    return as_real32(used.with_harmonics([at(order) for order in HARMONIC_ORDERS]))
