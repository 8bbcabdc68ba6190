"""What the analog path does to the tracks at speed: a delay between them, attenuation, and harmonics.

A converter with a multiplexer samples the cosine ``cosine_delay_s`` after the sine. At f cycles per second
that turns it by d = 2 pi f cosine_delay: a phase error of ``phase_error - d``, which :class:`Conditioning`
removes exactly. A low-pass with the corner frequency fc leaves A / sqrt(1 + (f / fc)^2); its inverse is used
as a gain, so that the limits of the amplitude hold at any speed. If the corner frequencies of the tracks
differ, so do the gains, and arctan(f / fc of the sine) - arctan(f / fc of the cosine) is added to d.

**Harmonics** cause the phase error that a correction table leaves at speed. The tracks are z(x) = c + i s =
sum z_k e^ikx, z_1 = 1. A table removes the effect of the other z_k at standstill. With the spectra C_k = (z_k
+ z_-k*) / 2 and S_k = (z_k - z_-k*) / 2i of both tracks, their low-passes H and their phase error phi, at f
cycles/s:

    S_k(f) = S_k Hs(k f) / |Hs(f)| e^(i k lag),      lag = -arg Hs(f)
    y_k(f) = (C_k cos phi + S_k sin phi) Hc(k f) / |Hc(f)| e^(i k (lag + d)),      d = 2 pi f cosine_delay
    C_k(f) = (y_k(f) - S_k(f) sin a) / cos a,      a the phase error at f

To first order the phase is then off by D(x, f) = Im sum (z_k(f) - z_k) e^(i (k - 1) x) / (2 pi), tabulated
over phase and speed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from math import atan, sqrt, tan

import numpy as np

from canfb.signal.conditioning import HARMONIC_ORDERS, Coefficients, Conditioning
from canfb.signal.phase import ComplexArray, FloatArray

Row = tuple[tuple[float, float], ...]
PLACES = 64  # per cycle: the highest order of D is 6, and linear interpolation leaves 0.5 % of order 2
SPEEDS = 192  # rows on either side of standstill
MOST_CORNERS = 3.0  # the highest tabulated speed, in corner frequencies
MOST_TURN_RAD = 1.2  # the same, by the angle that the cosine delay turns


@dataclass(frozen=True)
class Corners:
    """Corner frequencies of the low-passes of both tracks, Hz, 0.0: none."""

    corner_hz: float = 0.0
    cosine_corner_hz: float = 0.0

    @property
    def are_there(self) -> bool:
        return bool(self.corner_hz or self.cosine_corner_hz)

    @property
    def of_cosine_hz(self) -> float:
        """Corner frequency of the cosine, Hz: that of the sine unless it is given."""
        return self.cosine_corner_hz or self.corner_hz


NO_LOW_PASS = Corners()


@dataclass(frozen=True)
class HarmonicRows:
    """D over the phase, as (value, step to the next value) in cycles: ``rows[SPEEDS]`` at standstill, the
    others ``step_hz`` apart.
    """

    rows: tuple[Row, ...]
    step_hz: float

    def row(self, hertz: float) -> Row:
        """The row nearest to a speed in cycles per second; beyond the table, its end."""
        place = hertz / self.step_hz
        return self.rows[SPEEDS + round(max(-SPEEDS, min(place, SPEEDS)))]


@lru_cache(maxsize=8)
def harmonic_rows(used: Conditioning, path: Corners) -> HarmonicRows | None:
    """The rows for this encoder and analog path; None if there is nothing to correct."""
    standing = np.array(used.harmonics)
    reaches = [MOST_CORNERS * hz for hz in (path.corner_hz, path.of_cosine_hz) if hz]
    if used.cosine_delay_s:
        reaches.append(MOST_TURN_RAD / (2.0 * math.pi * abs(used.cosine_delay_s)))
    if not reaches or not standing.any():
        return None
    step_hz = min(reaches) / SPEEDS
    hertz = np.asarray(np.arange(-SPEEDS, SPEEDS + 1) * step_hz, np.float64)
    moved = _deviation(standing, used, path, hertz)
    slopes = np.roll(moved, -1, axis=1) - moved
    rows = tuple(
        tuple(zip(values, rises, strict=True))
        for values, rises in zip(moved.tolist(), slopes.tolist(), strict=True)
    )
    return HarmonicRows(rows, step_hz)


def _deviation(standing: ComplexArray, used: Conditioning, path: Corners, hertz: FloatArray) -> FloatArray:
    """D, cycles, shape (speeds, PLACES); ``standing`` are the harmonics at standstill."""
    z = dict(zip(HARMONIC_ORDERS, standing.tolist(), strict=True)) | {1: 1.0 + 0j}
    f = np.asarray(hertz, np.float64)[:, None]
    x = 2.0 * np.pi * np.arange(PLACES) / PLACES
    moved = np.zeros((len(hertz), PLACES), np.complex128)
    for k in sorted({abs(order) for order in z}):
        ahead, behind = z.get(k, 0j), z.get(-k, 0j)
        at_ahead, at_behind = harmonic_at(k, ahead, behind, used, path, f)
        moved += (at_ahead - ahead) * np.exp(1j * (k - 1) * x) + (at_behind - behind) * np.exp(
            -1j * (k + 1) * x
        )
    return np.asarray(moved.imag / (2.0 * np.pi), np.float64)


def harmonic_at(
    k: int,
    ahead: complex,
    behind: complex,
    used: Conditioning,
    path: Corners,
    hertz: FloatArray,
) -> tuple[ComplexArray, ComplexArray]:
    """z_k and z_-k at these speeds, any shape, from ``ahead`` and ``behind``, those at standstill."""
    cosine, sine = (ahead + behind.conjugate()) / 2.0, (ahead - behind.conjugate()) / 2.0j
    phi = used.phase_error_rad
    lag_s, lag_c = (
        np.arctan(hertz / hz) if hz else 0.0 * hertz for hz in (path.corner_hz, path.of_cosine_hz)
    )
    turned = 2.0 * np.pi * hertz * used.cosine_delay_s
    angle = phi - turned - lag_s + lag_c
    s = sine * _left(k, hertz, path.corner_hz) * np.exp(1j * k * lag_s)
    y = (cosine * math.cos(phi) + sine * math.sin(phi)) * _left(k, hertz, path.of_cosine_hz)
    c = (y * np.exp(1j * k * (lag_s + turned)) - s * np.sin(angle)) / np.cos(angle)
    return c + 1j * s, c.conj() + 1j * s.conj()


def _left(k: int, f: FloatArray, corner_hz: float) -> ComplexArray:
    """H(k f) / |H(f)|."""
    if not corner_hz:
        return np.ones(f.shape, np.complex128)
    ratio = f / corner_hz
    return np.asarray(np.sqrt(1.0 + ratio * ratio) / (1.0 + 1j * k * ratio), np.complex128)


def corrected(row: Row, phase: float) -> float:
    """``phase`` - D, where 0 <= phase < 1."""
    place = phase * PLACES
    index = int(place)
    first, slope = row[index]
    phase -= first + (place - index) * slope
    if phase < 0.0:
        phase += 1.0
    if phase >= 1.0:
        phase -= 1.0
    return phase


LARGEST_RAD = 1.47  # |d - phase_error|: beyond it both tracks have the same phase within 6 degrees
AHEAD_INTERVALS = 1.5  # from the middle of the last interval, whose speed is known, to the next sample
SAME_INTERVAL = 2e-4  # relative difference up to which an interval is the same


class FrontEnd:
    """Coefficients of a conditioning at a speed, cycles per sampling interval of ``unit_s`` seconds; 0.0:
    not known, as at standstill.
    """

    __slots__ = (
        "_conditioning",
        "_corner",
        "_corners",
        "_cosine_corner",
        "_delay",
        "_differ",
        "_hertz",
        "_rows",
        "_used",
        "unit_s",
        "varies",
    )

    def __init__(self, conditioning: Conditioning, corners: Corners) -> None:
        self._conditioning, self._corners = conditioning, corners
        self.use_conditioning(conditioning)
        self._differ = corners.of_cosine_hz != corners.corner_hz
        self._rows = harmonic_rows(conditioning, corners)
        self.varies = self._rows is not None or bool(corners.corner_hz and conditioning.delay_s)
        """:meth:`row` or :meth:`lag_intervals` depend on the speed, not only the coefficients."""
        self.use_interval(0.0)

    def use_conditioning(self, conditioning: Conditioning) -> None:
        self._used = tuple(map(float, conditioning.values[:5]))

    def use_interval(self, unit_s: float) -> None:
        self.unit_s = unit_s
        self._hertz = hertz = 1.0 / unit_s if unit_s > 0.0 else 0.0  # cycles per second at 1 per interval
        self._delay = 2.0 * math.pi * hertz * self._conditioning.cosine_delay_s
        corners = self._corners
        self._corner = hertz / corners.corner_hz if corners.corner_hz else 0.0
        self._cosine_corner = hertz / corners.of_cosine_hz if corners.of_cosine_hz else 0.0

    def hertz(self, speed_cycles: float) -> float:
        return speed_cycles * self._hertz

    def turned_rad(self, speed_cycles: float) -> float:
        turned = self._delay * speed_cycles
        if self._differ:
            turned += atan(self._corner * speed_cycles) - atan(self._cosine_corner * speed_cycles)
        return turned

    def row(self, speed_cycles: float) -> Row:
        return () if self._rows is None else self._rows.row(speed_cycles * self._hertz)

    def lag_intervals(self, speed_cycles: float) -> float:
        """2002:07 at this speed: of it, a low-pass delays by 1 / (2 pi fc) arctan(u) / u, u = f / fc."""
        lag = self._conditioning.delay_s * self._hertz
        ratio = self._corner * speed_cycles
        if ratio:
            lag -= (1.0 - atan(ratio) / ratio) * self._hertz / (2.0 * math.pi * self._corners.corner_hz)
        return lag

    def coefficients(self, speed_cycles: float, amplitude_known: bool = True) -> Coefficients:
        """As :meth:`Conditioning.coefficients`, at this speed; all zero if the delay makes both tracks
        the same.

        ``amplitude_known`` False: the attenuation is not corrected.
        """
        offset_s, offset_c, gain_s, gain_c, phase_error = self._used
        angle = phase_error - self.turned_rad(speed_cycles)
        if self._cosine_corner and amplitude_known:
            gain_s *= _rise(self._corner * speed_cycles)
            gain_c *= _rise(self._cosine_corner * speed_cycles)
        if not -LARGEST_RAD < angle < LARGEST_RAD:
            return 0.0, 0.0, 0.0, 0.0, 0.0
        skew = tan(angle)
        return offset_s, gain_s, offset_c, gain_c * sqrt(1.0 + skew * skew), skew


def _rise(ratio: float) -> float:
    return sqrt(1.0 + ratio * ratio)
