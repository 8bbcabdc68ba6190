"""A sine/cosine encoder with realistic errors, analog path and ADC, on a shaft; motions of the shaft as
functions of time: ramps with ripple, moves with limited jerk, and a motion that can be stopped."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from canfb.checks import number_in, within
from canfb.signal.phase import FloatArray
from canfb.signal.sample import Sample

# Position of the shaft in revolutions as a function of its time in seconds.
RevolutionsAt = Callable[[float], float]


@dataclass(frozen=True, kw_only=True)
class AnalogPath:
    """The analog path, by its response at a constant speed.

    sine_corner_hz, cosine_corner_hz   corner of a one-pole low-pass of the track, 0.0: none
    cosine_delay_s                     delay of the cosine sample after the sine
    delay_s                            delay of both tracks in addition to their low-pass
    """

    sine_corner_hz: float = 0.0
    cosine_corner_hz: float = 0.0
    cosine_delay_s: float = 0.0
    delay_s: float = 0.0


IDEAL_PATH = AnalogPath()


class Harmonic(NamedTuple):
    """One harmonic of a track: size relative to the fundamental, shift in radians."""

    order: int
    sine: float
    cosine: float
    sine_shift_rad: float = 0.0
    cosine_shift_rad: float = 0.0


@dataclass(frozen=True, kw_only=True)
class TrackErrors:
    """Errors of both tracks, relative to their nominal amplitude A; the cosine is A cos(x - phase_error)."""

    sine_offset: float = 0.0
    cosine_offset: float = 0.0
    sine_amplitude: float = 1.0
    cosine_amplitude: float = 1.0
    phase_error_rad: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Encoder(TrackErrors):
    """Two tracks as functions of the phase, sampled by an ADC.

    amplitude_counts                nominal amplitude A of the tracks
    harmonics                       harmonics of either track, relative to its amplitude
    adc_bits                        4..16; counts are rounded and clipped
    noise_lsb                       rms of Gaussian noise before the ADC, counts, 0..1e6
    ValueError for anything else.
    """

    amplitude_counts: float = 1500.0
    harmonics: tuple[Harmonic, ...] = field(default=())
    adc_bits: int = 12
    noise_lsb: float = 0.0
    path: AnalogPath = IDEAL_PATH

    def __post_init__(self) -> None:
        within(self, adc_bits=(4, 16), noise_lsb=(0.0, 1e6))

    def tracks(
        self, position_cycles: npt.ArrayLike, hertz: npt.ArrayLike = 0.0
    ) -> tuple[FloatArray, FloatArray]:
        """Analog tracks in counts, before noise and ADC; any shape. ``hertz`` is the speed, cycles/s."""
        path, speed = self.path, np.multiply(2.0 * np.pi, hertz)
        x = 2.0 * np.pi * np.mod(position_cycles, 1.0, dtype=np.float64) - speed * path.delay_s
        y = x + speed * path.cosine_delay_s
        waves = (Harmonic(1, 1.0, 1.0, 0.0, -self.phase_error_rad), *self.harmonics)
        sine, cosine = 0.0 * x, 0.0 * y
        for h in waves:
            sine = sine + h.sine * _left(np.sin, h.order, x, h.sine_shift_rad, hertz, path.sine_corner_hz)
            cosine = cosine + h.cosine * _left(
                np.cos, h.order, y, h.cosine_shift_rad, hertz, path.cosine_corner_hz
            )
        return (
            self.amplitude_counts * (self.sine_offset + self.sine_amplitude * sine),
            self.amplitude_counts * (self.cosine_offset + self.cosine_amplitude * cosine),
        )

    def sample(
        self,
        position_cycles: npt.ArrayLike,
        rng: np.random.Generator | None = None,
        hertz: npt.ArrayLike = 0.0,
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        """ADC counts at these positions (cycles), signed, zero at mid-scale; without noise if ``rng`` is
        None.
        """
        full, tracks = 1 << (self.adc_bits - 1), np.array(self.tracks(position_cycles, hertz))
        if rng is not None and self.noise_lsb > 0.0:
            tracks += rng.normal(0.0, self.noise_lsb, tracks.shape)
        # np.clip is ten times slower for a single number.
        sine, cosine = np.minimum(np.maximum(np.rint(tracks), -full), full - 1).astype(np.int64)
        return sine, cosine


def _left(
    wave: np.ufunc, order: int, x: FloatArray, shift_rad: float, hertz: npt.ArrayLike, corner_hz: float
) -> FloatArray:
    angle_rad = order * x + shift_rad
    if corner_hz:
        ratio = np.multiply(order, hertz) / corner_hz
        track: FloatArray = wave(angle_rad - np.arctan(ratio)) / np.sqrt(1.0 + ratio * ratio)
    else:
        track = wave(angle_rad)
    return track


def demo_encoder() -> Encoder:
    """The encoder of ``canfb demo``: mediocre, with every kind of error."""
    return Encoder(
        amplitude_counts=1500.0,
        sine_offset=0.04,
        cosine_offset=-0.03,
        sine_amplitude=1.03,
        cosine_amplitude=0.96,
        phase_error_rad=0.05,
        harmonics=(Harmonic(2, 0.006, 0.005, 0.4, 1.1), Harmonic(3, 0.012, 0.010), Harmonic(5, 0.003, 0.004)),
        noise_lsb=0.5,
    )


BISECTIONS = 40
SPEED_OVER_S = 1e-5  # the analog path gets the mean speed over this time before the sample


class ShaftEncoder:
    """Samples an encoder at a position of its shaft, with a coarse track and a zero pulse at whole
    revolutions.

    ``aperture_jitter_s`` is the rms jitter of the sampling instant, normal, cut off at four times the rms.
    """

    def __init__(
        self,
        encoder: Encoder,
        cycles_per_revolution: int,
        seed: int = 1,
        aperture_jitter_s: float = 0.0,
    ) -> None:
        self._encoder = encoder
        self._coarse = Encoder(
            amplitude_counts=encoder.amplitude_counts, adc_bits=encoder.adc_bits, noise_lsb=encoder.noise_lsb
        )
        self._cycles_per_revolution = cycles_per_revolution
        self._rng = np.random.default_rng(seed)
        self._seed = seed
        self._others = np.random.default_rng((seed, 0xA9))  # separate noise for coarse track and aperture
        self._aperture_jitter_s = aperture_jitter_s
        self._last: tuple[float, float] | None = None  # time and revolutions of the previous sample
        self.position_cycles = 0.0  # True position of the last sample, cycles.

    def sample(self, time_s: float, revolutions_at: RevolutionsAt) -> Sample:
        held_s = time_s
        if self._aperture_jitter_s:
            off = float(self._others.normal())
            held_s = max(0.0, time_s + self._aperture_jitter_s * max(-4.0, min(4.0, off)))
        revolutions = revolutions_at(held_s)
        self.position_cycles = revolutions * self._cycles_per_revolution
        hertz = 0.0 if self._encoder.path == IDEAL_PATH else self._hertz(held_s, revolutions_at)
        sine, cosine = self._encoder.sample(self.position_cycles, self._rng, hertz)
        last, self._last = self._last, (held_s, revolutions)
        pulse = (
            _pulse_place(*last, held_s, revolutions, revolutions_at)
            if last is not None and math.floor(last[1]) != math.floor(revolutions)
            else None
        )
        coarse_sine, coarse_cosine = self._coarse.sample(revolutions, self._others)
        return Sample(int(sine), int(cosine), 1.0, False, int(coarse_sine), int(coarse_cosine), pulse)

    def _hertz(self, at_s: float, revolutions_at: RevolutionsAt) -> float:
        before_s = max(0.0, at_s - SPEED_OVER_S)
        if before_s == at_s:
            return 0.0
        turned = revolutions_at(at_s) - revolutions_at(before_s)
        return turned / (at_s - before_s) * self._cycles_per_revolution

    def fast_samples(
        self, revolutions: FloatArray, revolutions_per_s: FloatArray, seed: tuple[int, int]
    ) -> npt.NDArray[np.int16]:
        """Both tracks at these positions, shape (n, 2), ADC counts; ``seed`` determines the noise."""
        rng, cycles = np.random.default_rng((self._seed, *seed)), self._cycles_per_revolution
        tracks = self._encoder.sample(revolutions * cycles, rng, revolutions_per_s * cycles)
        return np.stack(tracks, axis=-1).astype(np.int16)


def _pulse_place(
    from_s: float, from_revolutions: float, to_s: float, to_revolutions: float, at: RevolutionsAt
) -> float:
    forward = to_revolutions > from_revolutions
    mark = math.floor(to_revolutions) if forward else math.floor(to_revolutions) + 1
    low_s, high_s = from_s, to_s
    for _ in range(BISECTIONS):
        middle_s = (low_s + high_s) / 2.0
        if (at(middle_s) >= mark) == forward:
            high_s = middle_s
        else:
            low_s = middle_s
    return (high_s - from_s) / (to_s - from_s) if to_s > from_s else 1.0


class ShaftMotion(Protocol):
    """Position of a shaft over time, revolutions."""

    def revolutions(self, time_s: float) -> float:
        """Position at ``time_s``."""

    def revolutions_at(self, times_s: FloatArray) -> FloatArray:
        """Positions at these times."""


class PiecewiseCubic:
    """A piecewise function of time, polynomials of degree <= 3; the last one has no end."""

    def __init__(self, speed: float = 0.0) -> None:
        self._starts = [0.0]
        self._pieces = [(0.0, speed, 0.0, 0.0)]

    def state(self, time_s: float) -> tuple[float, float]:
        place = max(0, bisect_right(self._starts, time_s) - 1)
        passed, (value, speed, half, sixth) = time_s - self._starts[place], self._pieces[place]
        return (
            value + passed * (speed + passed * (half + passed * sixth)),
            speed + passed * (2.0 * half + passed * 3.0 * sixth),
        )

    def at(self, times_s: npt.ArrayLike) -> FloatArray:
        times = np.asarray(times_s, dtype=np.float64)
        places = np.maximum(np.searchsorted(self._starts, times, "right") - 1, 0)
        passed = times - np.array(self._starts)[places]
        value, speed, half, sixth = np.moveaxis(np.array(self._pieces)[places], -1, 0)
        return np.asarray(value + passed * (speed + passed * (half + passed * sixth)), np.float64)

    def go_on(
        self, from_s: float, speed: float | None = None, acceleration: float = 0.0, jerk: float = 0.0
    ) -> None:
        """Set the motion from ``from_s`` on, by default at the present speed; drops later pieces."""
        value, before = self.state(from_s)
        kept = bisect_right(self._starts, from_s)
        del self._starts[kept:], self._pieces[kept:]
        self._starts.append(from_s)
        self._pieces.append((value, before if speed is None else speed, acceleration / 2.0, jerk / 6.0))


class Ramp(NamedTuple):
    """Linear change of the speed to ``end_rpm`` within ``duration_s``."""

    duration_s: float
    end_rpm: float


class Ripple(NamedTuple):
    """A sine over time that is added to the speed."""

    size_rpm: float
    frequency_hz: float

    def swing(self, time_s: npt.ArrayLike) -> FloatArray | float:
        """Its effect on the position, revolutions."""
        omega = 2.0 * math.pi * self.frequency_hz
        return self.size_rpm / 60.0 * (1.0 - np.cos(np.multiply(omega, time_s))) / omega


class Motion:
    """Position over time: from ``start_rpm`` through ``ramps``, then at the last speed; with ripple."""

    def __init__(self, ramps: Iterable[Ramp], ripples: Iterable[Ripple] = (), start_rpm: float = 0.0) -> None:
        self.ramps, self.ripples, self.start_rpm = tuple(ramps), tuple(ripples), start_rpm
        self._curve = curve = PiecewiseCubic(start_rpm / 60.0)
        at_s, speed = 0.0, start_rpm / 60.0
        for duration_s, end_rpm in self.ramps:
            end = end_rpm / 60.0
            if duration_s > 0.0:
                curve.go_on(at_s, acceleration=(end - speed) / duration_s)
            at_s, speed = at_s + duration_s, end
            curve.go_on(at_s, speed)

    def revolutions(self, time_s: float) -> float:
        return self._curve.state(time_s)[0] + float(self._swing(time_s))

    def revolutions_at(self, times_s: npt.ArrayLike) -> FloatArray:
        return self._curve.at(times_s) + self._swing(times_s)

    def _swing(self, time_s: npt.ArrayLike) -> FloatArray | float:
        return sum((ripple.swing(time_s) for ripple in self.ripples), 0.0)


class SCurve(Motion):
    """Position over time: at rest until ``start_s``, then to ``speed_rad_s`` at ``end_s`` with limited jerk.

    ValueError unless all are 1e-9..1e12, and the speed suffices to reach the acceleration.
    """

    def __init__(
        self, speed_rad_s: float, acceleration_rad_s2: float, jerk_rad_s3: float, start_s: float = 0.0
    ) -> None:
        move = {
            "speed_rad_s": speed_rad_s,
            "acceleration_rad_s2": acceleration_rad_s2,
            "jerk_rad_s3": jerk_rad_s3,
        }
        for name, value in move.items():
            number_in(name, value, 1e-9, 1e12)
        rise_s = acceleration_rad_s2 / jerk_rad_s3
        level_s = speed_rad_s / acceleration_rad_s2 - rise_s
        if level_s < 0.0:
            raise ValueError(f"speed_rad_s is too low to reach {acceleration_rad_s2:g} rad/s^2")
        speed, acceleration, jerk = (value / (2.0 * math.pi) for value in move.values())
        super().__init__(())
        self.end_s = start_s + 2.0 * rise_s + level_s
        curve = self._curve
        curve.go_on(start_s, jerk=jerk)
        curve.go_on(start_s + rise_s, acceleration=acceleration)
        curve.go_on(start_s + rise_s + level_s, acceleration=acceleration, jerk=-jerk)
        curve.go_on(self.end_s, speed)


class StoppableMotion:
    """A motion that can be stopped and resumed: its own time slows down or speeds up within ``ramp_s``."""

    def __init__(self, motion: ShaftMotion, ramp_s: float) -> None:
        self._motion, self._ramp_s = motion, ramp_s
        self._own_time = PiecewiseCubic(1.0)
        self._changed_s = 0.0
        self.running = True  # The last command: run (or start to run), not stop.

    def run(self, running: bool, time_s: float) -> None:
        """Begin to run, or to stop, at ``time_s`` of the machine."""
        if running == self.running:
            return
        self.running, self._changed_s = running, max(time_s, self._changed_s)
        step = float(running) - self._own_time.state(self._changed_s)[1]
        if self._ramp_s:
            self._own_time.go_on(self._changed_s, acceleration=math.copysign(1.0 / self._ramp_s, step))
        self._own_time.go_on(self._changed_s + self._ramp_s * abs(step), float(running))

    def revolutions(self, time_s: float) -> float:
        return self._motion.revolutions(self._own_time.state(time_s)[0])

    def revolutions_at(self, times_s: FloatArray) -> FloatArray:
        return self._motion.revolutions_at(self._own_time.at(times_s))


class MotionSource:
    """An encoder on a machine whose motion is a function of time, independent of the sampling.

    :meth:`sample_at` samples at a true time, relative to the first call; :meth:`next` after one interval.
    """

    def __init__(self, shaft: ShaftEncoder, motion: ShaftMotion, interval_s: float) -> None:
        self._shaft = shaft
        self.motion = motion
        self._interval_s = interval_s
        self._count = 0
        self._start_s: float | None = None

    @property
    def position_cycles(self) -> float:
        return self._shaft.position_cycles

    def machine_time(self, now: float) -> float:
        if self._start_s is None:
            self._start_s = now
        return max(0.0, now - self._start_s)

    def fast_samples(self, times_s: FloatArray, seed: tuple[int, int]) -> npt.NDArray[np.int16]:
        now, before = (self.motion.revolutions_at(times_s - ago_s) for ago_s in (0.0, SPEED_OVER_S))
        return self._shaft.fast_samples(now, (now - before) / SPEED_OVER_S, seed)

    def sample_at(self, now: float) -> Sample:
        return self._shaft.sample(self.machine_time(now), self.motion.revolutions)

    def next(self) -> Sample:
        time_s = self._count * self._interval_s
        self._count += 1
        sine, cosine, *_ = self._shaft.sample(time_s, self.motion.revolutions)
        return Sample(sine, cosine)
