"""A reference measurement at several speeds: encoder and analog path together.

From the coefficients S_k, C_k of order k at speed f (:mod:`.methods`) and the path (:mod:`.path_fit`) the
coefficients at standstill are

    S_k / H(k f; fs),    C_k / (H(k f; fc) exp(2 pi i k f cosine_delay)),    H(f; fc) = 1 / (1 + i f / fc)

from the lowest speed. If a speed varies too much, the samples are converted to its mean with the path, and
fitted again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from canfb.calibration.ellipse import angle_cycles, fit_ellipse, with_track_harmonics
from canfb.calibration.joint import Waveform, grid_phases, raw_phase_curve, series_of, table_of
from canfb.calibration.methods import calibrate_from_motion, mean_tracks_of
from canfb.calibration.path_fit import (
    ANGLE_REPEATS_RAD,
    NO_PATH,
    RATIO_REPEATS,
    Fundamental,
    PathFit,
    check_apart,
    fit_path,
    response,
)
from canfb.calibration.recording import NO_TIME, Recording, recorded_tracks, recording
from canfb.calibration.result import (
    MOST_CHANGE_CYCLES,
    SIGNIFICANT,
    TRACK_POINTS,
    Calibration,
    Drift,
    Reason,
    changed,
    drift,
    naming_speed,
)
from canfb.calibration.solver import Progress, no_progress
from canfb.errors import CalibrationError
from canfb.signal.conditioning import Conditioning
from canfb.signal.front_end import Corners
from canfb.signal.phase import FloatArray
from canfb.signal.sample import TICK_S

SMOOTH_SAMPLES = 33  # the speed is averaged over these: between two samples it is mostly noise
MOST_VARIATION = 0.3  # largest range of a speed within one measurement, relative to its mean


@dataclass(frozen=True, eq=False)
class TracksAtSpeed:
    """Samples of both tracks at one speed, which may vary a little.

    sine, cosine   ADC counts, shape (n,), NaN where a sample is missing
    rate_hz        samples per second; time_s: sample times, seconds, rising; None: equidistant
    hertz          mean speed, cycles per second, with sign, error below half a cycle per sample
    """

    sine: FloatArray
    cosine: FloatArray
    rate_hz: float
    hertz: float
    time_s: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class SpeedCalibration:
    """Result of :func:`calibrate_over_speeds`.

    calibration   at standstill: table, conditioning with 2002:06 and the harmonics; quality of the
                  lowest speed
    path          analog path between encoder and counts
    """

    calibration: Calibration
    path: PathFit

    def with_delay(self, delay_s: float) -> SpeedCalibration:
        conditioning = replace(self.calibration.conditioning, delay_s=float(np.float32(delay_s)))
        return replace(self, calibration=replace(self.calibration, conditioning=conditioning))


def calibrate_over_speeds(
    measured: Sequence[TracksAtSpeed],
    *,
    adc_bits: int | None = None,
    entries: int = 1024,
    progress: Progress = no_progress,
) -> SpeedCalibration:
    """Conditioning, table, 2002:06, corners and harmonics from the same encoder at several speeds.

    ``adc_bits`` and ``entries`` as for :func:`.methods.calibrate_from_motion`. CalibrationError, with the
    speed, for a measurement that is refused; ValueError for wrong arguments.
    """
    hertz = np.array([one.hertz for one in measured])
    if not len(measured) or not np.isfinite(hertz).all():
        raise ValueError("speeds must be finite numbers, one for each measurement")
    check_apart(hertz)
    found = []
    for number, one in enumerate(measured):
        found.append(_AtSpeed.of(one, adc_bits, entries))
        progress(0.7 * (number + 1) / len(measured))
    path = fit_path([one.fundamental for one in found])
    found = [one.steadied(path, adc_bits, entries) for one in found]
    path = fit_path([one.fundamental for one in found])
    progress(0.95)
    each = [at_standstill(one.calibration, one.hertz, path, entries) for one in found]
    calibration = _judged(each[int(np.argmin(np.abs(hertz)))], each)
    progress(1.0)
    return SpeedCalibration(calibration, path)


def _judged(calibration: Calibration, each: Sequence[Calibration]) -> Calibration:
    """``calibration``, its uncertainty and change increased by its largest difference to ``each``.

    All are at standstill. CalibrationError if they differ by more than MOST_CHANGE_CYCLES.
    """
    found = Drift()
    for one in each:
        off = drift(one, calibration.table, calibration.conditioning)
        if off.rms > SIGNIFICANT * np.hypot(one.uncertainty_rms, calibration.uncertainty_rms):
            found = max(found, off)
    if found.rms > MOST_CHANGE_CYCLES:
        raise changed(f"the tables of the speeds differ by {found.rms:.1e} cycle rms")
    return replace(
        calibration,
        uncertainty_rms=max(calibration.uncertainty_rms, found.rms),
        uncertainty_peak=max(calibration.uncertainty_peak, found.peak),
        change_rms=max(calibration.change_rms, found.rms),
    )


def measured_at_standstill(
    measured: TracksAtSpeed,
    cosine_delay_s: float,
    corners: Corners,
    *,
    adc_bits: int | None = None,
    entries: int = 1024,
) -> Calibration:
    """A measurement at one speed through a known path, converted to standstill.

    CalibrationError if it is refused.
    """
    path = replace(NO_PATH, cosine_delay_s=cosine_delay_s, corners=corners)
    found = _AtSpeed.of(measured, adc_bits, entries).steadied(path, adc_bits, entries)
    return at_standstill(found.calibration, found.hertz, path, entries)


def at_standstill(found: Calibration, hertz: float, path: PathFit, entries: int) -> Calibration:
    """``found`` at this speed, converted to standstill: mean tracks without the path."""
    waveform = standing_waveform(found.tracks, found.track_orders, hertz, path.cosine_delay_s, path.corners)
    conditioning = fit_ellipse(*waveform.tracks(grid_phases(TRACK_POINTS)[:-1]))
    curve = raw_phase_curve(waveform, conditioning)
    tracks = mean_tracks_of(waveform, curve)
    conditioning = with_track_harmonics(conditioning, tracks)
    conditioning = replace(conditioning, cosine_delay_s=float(np.float32(path.cosine_delay_s)))
    return replace(found, table=table_of(curve, entries), conditioning=conditioning, tracks=tracks)


def standing_waveform(
    tracks: FloatArray, orders: tuple[int, ...], hertz: float, cosine_delay_s: float, corners: Corners
) -> Waveform:
    """Mean tracks at standstill from those at a speed, counts over one cycle, shape (2, n), sine first."""
    spectrum = np.fft.rfft(tracks, axis=1) / tracks.shape[1]
    k = np.array(orders)
    at = spectrum[:, k]
    at[0] /= response(k * hertz, corners.corner_hz)
    at[1] /= response(k * hertz, corners.of_cosine_hz) * np.exp(2j * np.pi * k * hertz * cosine_delay_s)
    return series_of(np.column_stack([spectrum[:, 0], at]), orders)


@dataclass(frozen=True, eq=False)
class _AtSpeed:
    """A measurement at one speed: its fit, and the speed at each sample, cycles per second."""

    samples: TracksAtSpeed
    record: Recording
    speed: FloatArray
    calibration: Calibration

    @classmethod
    def of(cls, samples: TracksAtSpeed, adc_bits: int | None, entries: int) -> _AtSpeed:
        with naming_speed(samples.hertz):
            record = recording(
                samples.sine, samples.cosine, samples.time_s, None, adc_bits, may_be_offset=True
            )
            mean = mean_speed(record, samples.hertz / samples.rate_hz)
            speed = samples.rate_hz * _smooth(speeds(record, mean))
            if np.ptp(speed) > MOST_VARIATION * abs(samples.hertz):
                raise CalibrationError(
                    f"from {speed.min():.6g} to {speed.max():.6g} cycles/s: not one speed", Reason.SPEED
                )
            return cls(samples, record, speed, _fit(samples, samples.sine, samples.cosine, adc_bits, entries))

    @property
    def hertz(self) -> float:
        return float(self.speed[self.record.valid].mean())

    def _varies(self, path: PathFit) -> bool:
        speed = self.speed[self.record.valid]
        gains = [np.abs(response(speed, hz)) for hz in (path.corners.corner_hz, path.corners.of_cosine_hz)]
        # A variation matters if its effect exceeds the repeatability of two measurements.
        return bool(
            np.std(path.turned_rad(speed)) > ANGLE_REPEATS_RAD
            or max(np.std(gain) / np.mean(gain) for gain in gains) > RATIO_REPEATS
        )

    def steadied(self, path: PathFit, adc_bits: int | None, entries: int) -> _AtSpeed:
        """If the speed varies too much: the samples converted to its mean, and fitted again."""
        if not self._varies(path):
            return self
        at, record = self.hertz, self.record
        ellipse = fit_ellipse(record.sine, record.cosine, record.valid)
        cosine = sampled_together(record, path.turned_rad(self.speed) - float(path.turned_rad(at)))
        zeros = (ellipse.sine_offset_counts, ellipse.cosine_offset_counts)
        hz = (path.corners.corner_hz, path.corners.of_cosine_hz)
        sine, cosine = (
            np.where(
                record.valid,
                zero + (track - zero) * np.abs(response(at, corner) / response(self.speed, corner)),
                np.nan,
            )
            for track, zero, corner in zip((record.sine, cosine), zeros, hz, strict=True)
        )
        return replace(self, calibration=_fit(self.samples, sine, cosine, adc_bits, entries))

    @property
    def fundamental(self) -> Fundamental:
        found = self.calibration
        sine, cosine = (complex(one) for one in np.fft.rfft(found.tracks, axis=1)[:, 1] / TRACK_POINTS)
        mean = float(np.sqrt(abs(sine) * abs(cosine))) * 2.0
        return Fundamental(
            self.hertz,
            2.0 * abs(sine),
            2.0 * abs(cosine),
            float(np.angle(cosine / (sine * 1j))),
            found.noise_counts / mean * float(np.sqrt(2.0 / found.samples_used)),
        )


def _fit(
    samples: TracksAtSpeed, sine: FloatArray, cosine: FloatArray, adc_bits: int | None, entries: int
) -> Calibration:
    return calibrate_from_motion(
        sine, cosine, "fit", time_s=samples.time_s, adc_bits=adc_bits, entries=entries
    )


def _smooth(speed: FloatArray) -> FloatArray:
    half = min(SMOOTH_SAMPLES, len(speed)) // 2
    padded = np.pad(speed, half, "mean", stat_length=half + 1)
    return np.convolve(padded, np.full(2 * half + 1, 1.0 / (2 * half + 1)), "valid")


FITS = 3
LARGEST_RAD = 1.0  # limit of the phase error of the ellipse
LONGEST_STEP = 2.0  # longest time between two samples that gives a speed, sampling intervals


def sampled_together(record: Recording, turned_rad: FloatArray) -> FloatArray:
    """The cosine track in counts, as if sampled together with the sine.

    ``turned_rad`` is the phase error d by the path at each sample of the record. Clipped samples are
    unchanged; NaN: no sample. CalibrationError if the samples are on no ellipse.
    """
    sine, cosine, use = record.sine, record.cosine, record.valid
    ellipse = fit_ellipse(sine, cosine, use)
    shown = ellipse.phase_error_rad + float(np.mean(turned_rad[use]))
    used = replace(ellipse, phase_error_rad=max(-LARGEST_RAD, min(shown, LARGEST_RAD)))
    for _ in range(FITS):
        found = _together(sine, cosine, turned_rad, used)
        used = fit_ellipse(sine, found, use)
    inside = np.clip(found, cosine.min(), cosine.max())  # the amplitude does not change
    return np.select([use, record.clipped], [inside, cosine], np.nan)


def tracks_of_job(
    data: bytes, times: bytes | None, turned: bytes | None, adc_bits: int
) -> tuple[FloatArray, FloatArray, FloatArray | None]:
    """Both tracks, as if sampled at once, and their times in seconds, None: equidistant.

    ``data`` as for :func:`.recorded_tracks`; ``times`` in units of 100 ns, INTEGER64, NO_TIME: no sample;
    ``turned`` as for :func:`sampled_together`, REAL32. All have one length and native byte order.
    CalibrationError if the samples are on no ellipse.
    """
    sine, cosine = recorded_tracks(data)
    turned_rad = np.frombuffer(turned, np.float32).astype(np.float64) if turned else np.zeros(len(sine))
    time_s = None
    if times is not None:
        ticks = np.frombuffer(times, np.int64)
        known = ticks != NO_TIME
        sine, cosine, turned_rad = sine[known], cosine[known], turned_rad[known]
        time_s = ticks[known] * TICK_S
    if turned is not None:
        record = recording(sine, cosine, time_s, None, adc_bits, may_be_offset=True)
        cosine = sampled_together(record, turned_rad)
    return sine, cosine, time_s


def mean_speed(record: Recording, near_cycles: float) -> float:
    """Mean speed, cycles per interval. Samples give it modulo 1: the value nearest to ``near_cycles``."""
    step = _steps(record)[1]
    shown = float(np.mean(step)) if len(step) else near_cycles
    return shown + round(near_cycles - shown)


def speeds(record: Recording, mean_cycles: float) -> FloatArray:
    """Speed at each sample, cycles per interval, shape (n,), given its mean.

    Samples alone give the speed modulo 1.
    """
    middle, step = _steps(record)
    if not len(step):
        return np.full(len(record.sine), mean_cycles)
    return np.interp(record.time, middle, step - float(np.mean(step)) + mean_cycles)


def _steps(record: Recording) -> tuple[FloatArray, FloatArray]:
    ellipse, at = fit_ellipse(record.sine, record.cosine, record.valid), np.flatnonzero(record.valid)
    angle = angle_cycles(ellipse, record.sine, record.cosine)
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


MOST_EFFECT_RAD = 0.1  # largest phase shift of the fundamental by the path that leaves harmonics unchanged


def counts_at(hertz: float, cosine_delay_s: float, corners: Corners) -> bool:
    """Whether the path changes the harmonics at this speed, cycles per second.

    If so, the table of this speed contains their error, and a module would correct it twice.
    """
    turned = 2.0 * np.pi * abs(hertz * cosine_delay_s)
    passed = [abs(hertz) / hz for hz in (corners.corner_hz, corners.of_cosine_hz) if hz]
    return turned + max(passed, default=0.0) > MOST_EFFECT_RAD
