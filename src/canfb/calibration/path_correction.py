"""Samples behind an analog path: the cosine at the instant of the sine, and harmonics as at standstill.

**The cosine as if it had been sampled with the sine,** where the converter takes it later (2002:06). A
reference measurement fits tracks that are functions of one phase. With the delay d(t) = 2 pi f cosine_delay
(:mod:`canfb.signal.front_end`) the cosine is A cos(x + d - phase_error), and from it and the sine follows

    A cos x = (cosine + s sin(d - phase_error)) / cos(d - phase_error),
    cosine' = A cos(x - phase_error) = A cos x cos(phase_error) + s sin(phase_error),

s and cosine after offset and gain. Offset and gain are those of the samples themselves, and so is the phase
error: a fit shows it less the mean of d, and another fit of what follows shows it better.

**Harmonics** (2005h) are those of cosine + i sine at standstill, relative to the fundamental. The module
takes out what the path does to each of them. A table measured at a speed has their effect at that speed in
it already: with them the module would correct it twice, so they are left out where the path counts.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from canfb.calibration.ellipse import angle_cycles, as_real32, fit_ellipse
from canfb.calibration.recording import Recording, recording, with_time
from canfb.signal.conditioning import HARMONIC_ORDERS, LARGEST_HARMONIC, Conditioning
from canfb.signal.harmonics import Corners
from canfb.signal.phase import FloatArray

FITS = 3
LARGEST_RAD = 1.0  # of a phase error
LONGEST_STEP = 2.0  # intervals between two samples that show a speed


def sampled_together(record: Recording, turned_rad: FloatArray) -> FloatArray:
    """The cosine track in counts; ``turned_rad`` is d at each sample. Both of the length of the record.

    Samples at the ends of the converter stay as they are. CalibrationError if the samples are on no ellipse.
    """
    sine, cosine, use = record.sine, record.cosine, record.valid
    ellipse = fit_ellipse(sine, cosine, use)
    shown = ellipse.phase_error_rad + float(np.mean(turned_rad[use]))
    used = replace(ellipse, phase_error_rad=max(-LARGEST_RAD, min(shown, LARGEST_RAD)))
    for _ in range(FITS):
        found = _together(sine, cosine, turned_rad, used)
        used = fit_ellipse(sine, found, use)
    inside = np.clip(found, cosine.min(), cosine.max())  # the amplitude is the same
    return np.where(record.clipped, cosine, inside)


def recorded_together(
    sine: FloatArray,
    cosine: FloatArray,
    time_s: FloatArray | None,
    adc_bits: int,
    turned: bytes,
    times: bytes | None,
) -> FloatArray:
    """:func:`sampled_together` for :func:`recorded_tracks`, or with ``times`` for :func:`timed_tracks`.

    ``turned`` is d of each sample, REAL32 of this machine.
    """
    turned_rad = np.frombuffer(turned, np.float32).astype(np.float64)
    if times is not None:
        turned_rad = turned_rad[with_time(times)]
    record = recording(sine, cosine, time_s, None, adc_bits, may_be_offset=True)
    return np.where(np.isnan(cosine), np.nan, sampled_together(record, turned_rad))


def mean_speed(record: Recording, near_cycles: float) -> float:
    """Cycles per interval, the one that is nearest to ``near_cycles``: samples leave whole cycles open."""
    step = _steps(record)[1]
    shown = float(np.mean(step)) if len(step) else near_cycles
    return shown + round(near_cycles - shown)


def speeds(record: Recording, mean_cycles: float) -> FloatArray:
    """Speed at each sample, cycles per interval, shape (n,), of a mean that is known from elsewhere.

    Samples alone leave whole cycles per interval open.
    """
    middle, step = _steps(record)
    if not len(step):
        return np.full(len(record.sine), mean_cycles)
    return np.interp(record.time, middle, step - float(np.mean(step)) + mean_cycles)


def _steps(record: Recording) -> tuple[FloatArray, FloatArray]:
    """From sample to sample: the time in the middle, intervals, and the speed, cycles per interval."""
    ellipse = fit_ellipse(record.sine, record.cosine, record.valid)
    angle = np.where(record.valid, angle_cycles(ellipse, record.sine, record.cosine), np.nan)
    at = np.flatnonzero(record.valid)
    place, time = record.positions(angle)[at], record.time[at]
    passed = np.diff(time)
    step = np.diff(place) / passed
    known = (passed <= LONGEST_STEP) & np.isfinite(step) & ~np.isin(at[1:], record.breaks)
    return ((time[1:] + time[:-1]) / 2.0)[known], step[known]


def _together(sine: FloatArray, cosine: FloatArray, turned_rad: FloatArray, used: Conditioning) -> FloatArray:
    s = (sine - used.sine_offset_counts) * used.sine_gain
    c = (cosine - used.cosine_offset_counts) * used.cosine_gain
    phase_error = used.phase_error_rad
    angle = phase_error - turned_rad
    straight = (c - s * np.sin(angle)) / np.cos(angle)
    moved = straight * np.cos(phase_error) + s * np.sin(phase_error)
    return np.asarray(used.cosine_offset_counts + moved / used.cosine_gain, np.float64)


MOST_EFFECT_RAD = 0.1  # of the analog path on the fundamental, for harmonics as at standstill


def counts_at(hertz: float, cosine_delay_s: float, corners: Corners) -> bool:
    """At this speed, cycles per second, the harmonics are not those at standstill.

    A module would correct them twice: their part of the error is in the table of this speed already.
    """
    turned = 2.0 * math.pi * abs(hertz * cosine_delay_s)
    passed = [abs(hertz) / hz for hz in (corners.corner_hz, corners.of_cosine_hz) if hz]
    return turned + max(passed, default=0.0) > MOST_EFFECT_RAD


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
