"""Harmonics of both tracks, as the analog path needs them (2005h)."""

from __future__ import annotations

import math

import numpy as np

from canfb.calibration.ellipse import as_real32
from canfb.signal.conditioning import HARMONIC_ORDERS, LARGEST_HARMONIC, Conditioning
from canfb.signal.phase import FloatArray

MOST_EFFECT_RAD = 0.1  # of the analog path on the fundamental, for harmonics as at standstill


def counts_at(hertz: float, cosine_delay_s: float, corner_hz: float) -> bool:
    """At this speed, cycles per second, the harmonics are not those at standstill.

    A module would correct them twice: their part of the error is in the table of this speed already.
    """
    turned = 2.0 * math.pi * abs(hertz * cosine_delay_s)
    return turned + (abs(hertz) / corner_hz if corner_hz else 0.0) > MOST_EFFECT_RAD


def without_harmonics(used: Conditioning) -> Conditioning:
    """``used`` with none: its table is that of one speed."""
    return used.with_harmonics([0j] * len(HARMONIC_ORDERS))


def with_track_harmonics(used: Conditioning, tracks: FloatArray) -> Conditioning:
    """``used`` with the harmonics of these mean tracks, ADC counts, shape (2, n), sine first, over one cycle.

    Of cosine + i sine behind the conditioning, relative to the fundamental and its phase.
    """
    s, c = used.apply(*tracks)
    spectrum = np.fft.fft(c + 1j * s) / np.size(s)
    first = spectrum[1]
    shift = first / abs(first)

    def at(order: int) -> complex:
        value = complex(spectrum[order] / abs(first) * shift ** (-order))
        return value if abs(value) <= LARGEST_HARMONIC else 0j

    return as_real32(used.with_harmonics([at(order) for order in HARMONIC_ORDERS]))
