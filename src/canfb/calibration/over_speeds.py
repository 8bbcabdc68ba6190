"""A reference measurement at several speeds: encoder and analog path together.

A table of one speed has in it what low-passes and a delay between the tracks do at that speed. The module
takes these out at any speed (:mod:`canfb.signal.front_end`), and needs the tracks as they are at
standstill. At each speed a fit (:mod:`.from_motion`) gives the mean tracks, as Fourier series of the phase;
their fundamentals over the speed give the path (:mod:`.path_fit`). Order k of a track passes the path at k
f, so with S_k and C_k the coefficients at speed f, those at standstill are

    S_k / H(k f; fs),    C_k / (H(k f; fc) exp(2 pi i k f cosine_delay)),    H(f; fc) = 1 / (1 + i f / fc)

and from these, taken at the lowest speed, where the least is taken out, follow conditioning, table and
harmonics (:mod:`canfb.signal.harmonics`). No speed need be near standstill.

Each speed may vary a little, as real machines do. Where that counts, which is where the path at the samples
differs from that at the mean speed by more than repeated measurements do, the samples are moved to the mean
speed by a first estimate of the path, and fitted again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from canfb.calibration.changes import SIGNIFICANT, Change
from canfb.calibration.deviation import drift
from canfb.calibration.ellipse import fit_ellipse
from canfb.calibration.from_motion import calibrate_from_motion
from canfb.calibration.path_correction import mean_speed, sampled_together, speeds, with_track_harmonics
from canfb.calibration.path_fit import (
    ANGLE_REPEATS_RAD,
    MOST_OFF_CYCLES,
    NO_PATH,
    RATIO_REPEATS,
    Fundamental,
    PathFit,
    check_apart,
    fit_path,
    response,
)
from canfb.calibration.recording import Recording, recording
from canfb.calibration.result import TRACK_POINTS, Calibration, Reason, changed, naming_speed
from canfb.calibration.solver import Progress, no_progress
from canfb.calibration.waveform import Waveform, grid_phases, origin_of, raw_phase_curve, table_of
from canfb.errors import CalibrationError
from canfb.signal.correction import Correction
from canfb.signal.harmonics import Corners
from canfb.signal.phase import FloatArray

# What of a change within one speed does not count: no more than two measurements differ by anyway.
STEADY_RAD = ANGLE_REPEATS_RAD  # of the angle between the tracks, rms
STEADY_PART = RATIO_REPEATS  # of the amplitudes
SMOOTH_SAMPLES = 33  # a speed between two samples is mostly noise
MOST_VARIATION = 0.3  # of a speed, from its lowest to its highest: more is no one speed


@dataclass(frozen=True, eq=False)
class TracksAtSpeed:
    """Samples of both tracks at one speed, which may vary a little.

    sine, cosine   ADC counts, shape (n,), NaN where a sample is missing
    rate_hz        samples per second
    hertz          mean speed, cycles per second, with sign; right to less than half a cycle per sample
    time_s         sample times, seconds, rising; None: equidistant
    """

    sine: FloatArray
    cosine: FloatArray
    rate_hz: float
    hertz: float
    time_s: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class SpeedCalibration:
    """What several speeds gave.

    calibration   at standstill: table, conditioning with 2002:06 and the harmonics; its quality is that
                  of the lowest speed
    path          what lies between encoder and counts
    each          the fundamentals at the speeds, in the order of the measurements
    """

    calibration: Calibration
    path: PathFit
    each: tuple[Fundamental, ...]

    @property
    def correction(self) -> Correction:
        """Table and conditioning, to be activated together, and with the corners."""
        return self.calibration.correction

    def with_delay(self, delay_s: float) -> SpeedCalibration:
        """With 2002:07."""
        conditioning = replace(self.calibration.conditioning, delay_s=float(np.float32(delay_s)))
        return replace(self, calibration=replace(self.calibration, conditioning=conditioning))


def calibrate_over_speeds(
    measured: Sequence[TracksAtSpeed],
    *,
    adc_bits: int | None = None,
    entries: int = 1024,
    progress: Progress | None = None,
) -> SpeedCalibration:
    """Conditioning, table, 2002:06, corners and harmonics from the same encoder at several speeds.

    ``adc_bits`` and ``entries`` as for :func:`.from_motion.calibrate_from_motion`. CalibrationError for
    measurements that are refused, with the speed; ValueError for wrong arguments.
    """
    report = progress or no_progress
    hertz = np.array([one.hertz for one in measured])
    if not len(measured) or not np.isfinite(hertz).all():
        raise ValueError("speeds must be finite numbers, one for each measurement")
    check_apart(hertz)
    found = []
    for number, one in enumerate(measured):
        found.append(_AtSpeed.of(one, adc_bits, entries))
        report(0.7 * (number + 1) / len(measured))
    path = fit_path([one.fundamental for one in found])
    found = [one.again(path, adc_bits, entries) if one.varies(path) else one for one in found]
    path = fit_path([one.fundamental for one in found])
    report(0.95)
    lowest = found[int(np.argmin(np.abs(hertz)))]
    calibration = at_standstill(lowest.calibration, lowest.hertz, path, entries)
    calibration = _judged(calibration, [at_standstill(o.calibration, o.hertz, path, entries) for o in found])
    report(1.0)
    return SpeedCalibration(calibration, path, tuple(one.fundamental for one in found))


def _judged(calibration: Calibration, each: Sequence[Calibration]) -> Calibration:
    """The calibration with what those of the speeds, all as at standstill, differ from it by.

    CalibrationError where that is more than the path may leave unexplained: the tracks have changed.
    """
    found = Change()
    for one in each:
        off = Change(*drift(one, calibration.table, calibration.conditioning))
        if off.rms > SIGNIFICANT * np.hypot(one.uncertainty_rms, calibration.uncertainty_rms):
            found = max(found, off)
    if found.rms > MOST_OFF_CYCLES:
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
    """A measurement at one speed behind a path that is known, as it is at standstill.

    CalibrationError where it is refused.
    """
    path = replace(NO_PATH, cosine_delay_s=cosine_delay_s, corners=corners)
    found = _AtSpeed.of(measured, adc_bits, entries)
    if found.varies(path):
        found = found.again(path, adc_bits, entries)
    return at_standstill(found.calibration, found.hertz, path, entries)


def at_standstill(found: Calibration, hertz: float, path: PathFit, entries: int) -> Calibration:
    """``found`` at this speed, as it is at standstill: the path taken out of the mean tracks."""
    assert found.tracks is not None
    waveform = standing_waveform(found.tracks, found.track_orders, hertz, path.cosine_delay_s, path.corners)
    phases = grid_phases(TRACK_POINTS)[:-1]
    conditioning = fit_ellipse(*waveform.tracks(phases))
    curve = raw_phase_curve(waveform, conditioning)
    tracks = np.array(waveform.tracks(phases + origin_of(curve)))
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
    parts = np.empty((2, 1 + 2 * len(k)))
    parts[:, 0] = spectrum[:, 0].real
    parts[:, 1::2], parts[:, 2::2] = 2.0 * at.real, -2.0 * at.imag
    return Waveform(orders, parts[0], parts[1])


@dataclass(frozen=True, eq=False)
class _AtSpeed:
    """A measurement at one speed: its fit, and the speed at each sample, cycles per second."""

    samples: TracksAtSpeed
    record: Recording
    speed: FloatArray
    calibration: Calibration

    @classmethod
    def of(cls, samples: TracksAtSpeed, adc_bits: int | None, entries: int) -> _AtSpeed:
        """CalibrationError, with the speed, if it is refused."""
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
        """The mean speed over its valid samples."""
        return float(self.speed[self.record.valid].mean())

    def varies(self, path: PathFit) -> bool:
        """Whether the speed varies so much that the path shows in it."""
        speed = self.speed[self.record.valid]
        gains = [np.abs(response(speed, hz)) for hz in (path.corners.corner_hz, path.corners.of_cosine_hz)]
        return bool(
            np.std(path.turned_rad(speed)) > STEADY_RAD
            or max(np.std(gain) / np.mean(gain) for gain in gains) > STEADY_PART
        )

    def again(self, path: PathFit, adc_bits: int | None, entries: int) -> _AtSpeed:
        """The same with the samples moved to the mean speed along this path."""
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
        """Of both mean tracks."""
        found = self.calibration
        assert found.tracks is not None
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
    found = calibrate_from_motion(
        sine, cosine, "fit", time_s=samples.time_s, adc_bits=adc_bits, entries=entries
    )
    if not found.accepted:
        raise CalibrationError(found.reason.text, found.reason, found)
    return found


def _smooth(speed: FloatArray) -> FloatArray:
    """Mean over some samples; each end goes on with its own."""
    half = min(SMOOTH_SAMPLES, len(speed)) // 2
    ends = float(speed[: half + 1].mean()), float(speed[-half - 1 :].mean())
    padded = np.concatenate([np.full(half, ends[0]), speed, np.full(half, ends[1])])
    return np.convolve(padded, np.full(2 * half + 1, 1.0 / (2 * half + 1)), "valid")
