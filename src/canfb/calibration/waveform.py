"""Both tracks as Fourier series of the phase, and the correction table that follows from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from canfb.calibration.result import Reason
from canfb.errors import CalibrationError
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import MAX_DEVIATION_CYCLES, CorrectionTable
from canfb.signal.phase import FloatArray, raw_phases

GRID = 16384
# Room for the rounding of the entries to REAL32.
LARGEST_DEVIATION = MAX_DEVIATION_CYCLES - 1e-3


def basis(position: FloatArray, orders: tuple[int, ...]) -> FloatArray:
    """Columns 1, cos 2 pi h x, sin 2 pi h x for each order h.

    ``position`` in cycles, any shape; the columns are the last axis.
    """
    angle = 2.0 * np.pi * (position - np.floor(position)).ravel()
    turn = np.cos(angle) + 1j * np.sin(angle)
    rows = np.empty((1 + 2 * len(orders), position.size))
    rows[0] = 1.0
    power, reached = np.ones_like(turn), 0
    for place, order in enumerate(orders):
        for _ in range(order - reached):
            power = power * turn
        reached = order
        rows[1 + 2 * place], rows[2 + 2 * place] = power.real, power.imag
    return np.ascontiguousarray(rows.T).reshape(*position.shape, len(rows))


@dataclass(frozen=True, eq=False)
class Waveform:
    """Mean tracks in ADC counts over the phase.

    orders      harmonics kept, ascending, 1 first
    sine        coefficients of the sine track: mean, then cosine and sine part of each order
    cosine      the same of the cosine track
    """

    orders: tuple[int, ...]
    sine: FloatArray
    cosine: FloatArray

    def tracks(self, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Sine and cosine track at these positions (cycles)."""
        columns = basis(position, self.orders)
        return columns @ self.sine, columns @ self.cosine

    def slope(self) -> Waveform:
        """Change of both tracks per cycle, counts per cycle."""
        parts = []
        for track in (self.sine, self.cosine):
            turned = np.zeros_like(track)
            for place, order in enumerate(self.orders):
                turned[1 + 2 * place] = 2.0 * np.pi * order * track[2 + 2 * place]
                turned[2 + 2 * place] = -2.0 * np.pi * order * track[1 + 2 * place]
            parts.append(turned)
        return Waveform(self.orders, parts[0], parts[1])

    def with_orders(self, orders: tuple[int, ...]) -> Waveform:
        """The same tracks with these orders; new ones are zero."""
        parts = []
        for track in (self.sine, self.cosine):
            moved = np.zeros(1 + 2 * len(orders))
            moved[0] = track[0]
            for place, order in enumerate(orders):
                if order in self.orders:
                    old = self.orders.index(order)
                    moved[1 + 2 * place : 3 + 2 * place] = track[1 + 2 * old : 3 + 2 * old]
            parts.append(moved)
        return Waveform(orders, parts[0], parts[1])


def grid_phases(points: int = GRID) -> FloatArray:
    """Phases 0..1, both ends included."""
    return np.arange(points + 1) / points


def raw_phase_curve(waveform: Waveform, conditioning: Conditioning) -> FloatArray:
    """Raw phase of the waveform at :func:`grid_phases`, continuous, strictly increasing, one cycle long.

    Raises CalibrationError ("monotonic") where raw phase does not determine the phase.
    """
    s, c = conditioning.apply(*waveform.tracks(grid_phases()))
    raw = np.unwrap(raw_phases(s, c), period=1.0)
    if np.isnan(raw).any() or abs(raw[-1] - raw[0] - 1.0) > 1e-6 or np.diff(raw).min() <= 0.0:
        raise CalibrationError(
            "raw phase does not rise through the cycle: the tracks do not circle the origin once. "
            'Fit the ellipse first (conditioning="fit"), and check the tracks',
            Reason.MONOTONIC,
        )
    return raw


def phase_at_raw(raw_curve: FloatArray, raw: FloatArray) -> FloatArray:
    """Phase on a curve of :func:`raw_phase_curve` at raw phases 0..1, continuous."""
    phases = grid_phases(len(raw_curve) - 1)
    # Two cycles of the curve, so that 0..1 lies inside wherever the curve starts.
    start = np.floor(raw_curve[0])
    curve = np.concatenate([raw_curve - start - 1.0, raw_curve[1:] - start, raw_curve[1:] - start + 1.0])
    phase = np.concatenate([phases - 1.0, phases[1:], phases[1:] + 1.0])
    return np.asarray(np.interp(raw, curve, phase), np.float64)


def origin_of(raw_curve: FloatArray) -> float:
    """Phase on a curve of :func:`raw_phase_curve` at raw phase 0, the positive zero crossing of the sine."""
    return float(phase_at_raw(raw_curve, np.zeros(1))[0])


def table_of(raw_curve: FloatArray, entries: int) -> CorrectionTable:
    """Correction table of a curve of :func:`raw_phase_curve`: phase 0 at raw phase 0."""
    raw = np.arange(entries) / entries
    return table_from_phases(phase_at_raw(raw_curve, raw) - origin_of(raw_curve))


def table_from_phases(phase: FloatArray) -> CorrectionTable:
    """Table with these entries, phase 0 at raw phase 0.

    Only if an entry would then be further than 0.25 cycle from its raw phase are all of them
    shifted, by as little as it takes. CalibrationError ("monotonic") if that cannot be.
    """
    deviation = phase - np.arange(len(phase)) / len(phase)
    low, high = float(deviation.min()), float(deviation.max())
    if high - low > 2.0 * LARGEST_DEVIATION:
        raise CalibrationError(
            "raw phase and phase differ by more than 0.25 cycle: too much for a table. "
            'Fit the ellipse first (conditioning="fit")',
            Reason.MONOTONIC,
        )
    shift = min(0.0, LARGEST_DEVIATION - high) + max(0.0, -LARGEST_DEVIATION - low)
    try:
        return CorrectionTable(phase + shift)
    except ValueError as error:
        raise CalibrationError(f"the measurement gives no usable table: {error}", Reason.MONOTONIC) from None


def table_sensitivity(waveform: Waveform, conditioning: Conditioning, points: int = 256) -> FloatArray:
    """Change of the table per change of each coefficient, shape (points, coefficients), mean removed.

    At a given raw phase only the part of a track error across the ray from the origin counts:
    it moves the place where the curve crosses that ray.
    """
    position = np.arange(points) / points
    columns, slope = basis(position, waveform.orders), waveform.slope()
    s, c = conditioning.apply(columns @ waveform.sine, columns @ waveform.cosine)
    _, gain_s, _, factor_c, skew = conditioning.coefficients()
    slope_s = gain_s * (columns @ slope.sine)
    slope_c = factor_c * (columns @ slope.cosine) - skew * slope_s
    across = slope_s * c - slope_c * s
    by_sine = gain_s * (c + skew * s) / across
    by_cosine = -factor_c * s / across
    sensitivity = -np.concatenate([by_sine[:, None] * columns, by_cosine[:, None] * columns], axis=1)
    return np.asarray(sensitivity - sensitivity.mean(axis=0), np.float64)
