"""A sine/cosine encoder with the errors that real ones have, its analog path and ADC, and it on a shaft."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from canfb.checks import integer_in
from canfb.signal.phase import FloatArray
from canfb.signal.sample import Sample

RevolutionsAt = Callable[[float], float]
"""Position of the shaft in revolutions as a function of its time in seconds."""


@dataclass(frozen=True, kw_only=True)
class AnalogPath:
    """Its response at a steady speed.

    sine_corner_hz, cosine_corner_hz   of a low-pass of one pole on that track, 0.0: none
    cosine_delay_s                     the cosine is sampled this much after the sine
    delay_s                            both tracks come this much late, beside their low-pass
    """

    sine_corner_hz: float = 0.0
    cosine_corner_hz: float = 0.0
    cosine_delay_s: float = 0.0
    delay_s: float = 0.0

    def lag_s(self, hertz: float) -> float:
        lag_s = self.delay_s
        if self.sine_corner_hz:
            ratio = hertz / self.sine_corner_hz
            lag_s += (math.atan(ratio) / ratio if ratio else 1.0) / (2.0 * math.pi * self.sine_corner_hz)
        return lag_s


IDEAL_PATH = AnalogPath()


class Harmonic(NamedTuple):
    """One harmonic of a track: size relative to the fundamental, shift in radians."""

    order: int
    sine: float
    cosine: float
    sine_shift_rad: float = 0.0
    cosine_shift_rad: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Encoder:
    """Two tracks as functions of the phase, sampled by an ADC.

    amplitude_counts                nominal amplitude A of the tracks
    sine_offset, cosine_offset      relative to A
    sine_amplitude, cosine_amplitude  relative to A
    phase_error_rad                 the cosine track is A cos(x - phase_error)
    harmonics                       of either track, relative to its amplitude
    adc_bits                        4..16; counts are rounded and held at the ends
    noise_lsb                       rms of Gaussian noise before the ADC, counts
    ValueError for anything else.
    """

    amplitude_counts: float = 1500.0
    sine_offset: float = 0.0
    cosine_offset: float = 0.0
    sine_amplitude: float = 1.0
    cosine_amplitude: float = 1.0
    phase_error_rad: float = 0.0
    harmonics: tuple[Harmonic, ...] = field(default=())
    adc_bits: int = 12
    noise_lsb: float = 0.0
    path: AnalogPath = IDEAL_PATH

    def __post_init__(self) -> None:
        integer_in("adc_bits", self.adc_bits, 4, 16)
        if not 0.0 <= self.noise_lsb < math.inf:
            raise ValueError(f"noise_lsb must not be negative: {self.noise_lsb!r}")

    def tracks(
        self, position_cycles: npt.ArrayLike, hertz: npt.ArrayLike = 0.0
    ) -> tuple[FloatArray, FloatArray]:
        """Analog tracks in counts, before noise and ADC; any shape. ``hertz`` is the speed, cycles/s."""
        path, speed = self.path, 2.0 * np.pi * np.asarray(hertz, np.float64)
        x = 2.0 * np.pi * np.asarray(np.mod(position_cycles, 1.0), np.float64) - speed * path.delay_s
        y = x + speed * path.cosine_delay_s
        waves = (Harmonic(1, 1.0, 1.0, 0.0, -self.phase_error_rad), *self.harmonics)
        sine, cosine = np.zeros(x.shape), np.zeros(x.shape)
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
        sine, cosine = self.tracks(position_cycles, hertz)
        if rng is not None and self.noise_lsb > 0.0:
            sine = sine + rng.normal(0.0, self.noise_lsb, np.shape(sine))
            cosine = cosine + rng.normal(0.0, self.noise_lsb, np.shape(cosine))
        return self._convert(sine), self._convert(cosine)

    def _convert(self, track: FloatArray) -> npt.NDArray[np.int64]:
        full = 1 << (self.adc_bits - 1)
        return np.clip(np.rint(track), -full, full - 1).astype(np.int64)


def _left(
    wave: np.ufunc, order: int, x: FloatArray, shift_rad: float, hertz: npt.ArrayLike, corner_hz: float
) -> FloatArray:
    ratio = order * np.asarray(hertz, np.float64) / corner_hz if corner_hz else np.float64(0.0)
    left: FloatArray = wave(order * x + shift_rad - np.arctan(ratio)) / np.sqrt(1.0 + ratio * ratio)
    return left


def demo_encoder() -> Encoder:
    """The encoder of ``canfb demo``: every error of a mediocre one at once."""
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
SPEED_OVER_S = 1e-5  # of the analog path


class ShaftEncoder:
    """Samples an encoder at a position of its shaft, with a coarse track and a zero pulse at whole
    revolutions.

    ``aperture_jitter_s`` is the rms of the instant of holding, normal, cut off at four times that.
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
        self._others = np.random.default_rng((seed, 0xA9))  # coarse track and aperture: noise of their own
        self._aperture_jitter_s = aperture_jitter_s
        self._last: tuple[float, float] | None = None  # time and revolutions of the sample before
        self.position_cycles = 0.0
        """True position of the last sample, cycles."""

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
        pulse = None
        if last is not None and math.floor(last[1]) != math.floor(revolutions):
            pulse = _pulse_place(*last, held_s, revolutions, revolutions_at)
        coarse_sine, coarse_cosine = self._coarse.sample(revolutions, self._others)
        return Sample(int(sine), int(cosine), 1.0, False, int(coarse_sine), int(coarse_cosine), pulse)

    def _hertz(self, at_s: float, revolutions_at: RevolutionsAt) -> float:
        before_s = max(0.0, at_s - SPEED_OVER_S)
        if before_s == at_s:
            return 0.0
        turned = revolutions_at(at_s) - revolutions_at(before_s)
        return turned / (at_s - before_s) * self._cycles_per_revolution

    def fast_samples(
        self, revolutions: npt.NDArray[np.float64], seed: tuple[int, int]
    ) -> npt.NDArray[np.int16]:
        """Both tracks at these positions, shape (n, 2), ADC counts; ``seed`` is that of the noise."""
        rng = np.random.default_rng((self._seed, *seed))
        tracks = self._encoder.sample(revolutions * self._cycles_per_revolution, rng)
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
