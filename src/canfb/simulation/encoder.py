"""A sine/cosine encoder with the errors that real ones have, and its ADC."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from canfb.checks import integer_in
from canfb.signal.phase import FloatArray
from canfb.simulation.analog_path import IDEAL_PATH, AnalogPath, low_pass


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
    noise_lsb                       rms of Gaussian noise before the ADC, counts, not negative
    path                            between the tracks and the ADC; ideal by default
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
        x = 2.0 * np.pi * np.asarray(np.mod(position_cycles, 1.0), dtype=np.float64)
        if self.path.is_ideal:
            sine, cosine = np.sin(x), np.cos(x - self.phase_error_rad)
            for h in self.harmonics:
                sine = sine + h.sine * np.sin(h.order * x + h.sine_shift_rad)
                cosine = cosine + h.cosine * np.cos(h.order * x + h.cosine_shift_rad)
        else:
            sine, cosine = self._filtered(x, np.asarray(hertz, np.float64))
        return (
            self.amplitude_counts * (self.sine_offset + self.sine_amplitude * sine),
            self.amplitude_counts * (self.cosine_offset + self.cosine_amplitude * cosine),
        )

    def _filtered(self, x: FloatArray, hertz: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Both tracks behind the analog path, relative to their amplitudes, without offset."""
        path = self.path
        sine_x = x - 2.0 * np.pi * hertz * path.delay_s
        cosine_x = sine_x + 2.0 * np.pi * hertz * path.cosine_delay_s
        waves = [
            Harmonic(1, 1.0, 1.0, 0.0, -self.phase_error_rad),
            *self.harmonics,
        ]
        sine, cosine = np.zeros(x.shape), np.zeros(x.shape)
        for h in waves:
            left, late = low_pass(h.order, hertz, path.sine_corner_hz)
            sine = sine + h.sine * left * np.sin(h.order * sine_x + h.sine_shift_rad - late)
            left, late = low_pass(h.order, hertz, path.cosine_corner_hz)
            cosine = cosine + h.cosine * left * np.cos(h.order * cosine_x + h.cosine_shift_rad - late)
        return sine, cosine

    def sample(
        self,
        position_cycles: npt.ArrayLike,
        rng: np.random.Generator | None = None,
        hertz: npt.ArrayLike = 0.0,
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        """ADC counts at these positions (cycles), signed, zero at mid-scale.

        Without ``rng`` there is no noise. ``hertz`` is the speed, which the analog path depends on.
        """
        sine, cosine = self.tracks(position_cycles, hertz)
        if rng is not None and self.noise_lsb > 0.0:
            sine = sine + rng.normal(0.0, self.noise_lsb, np.shape(sine))
            cosine = cosine + rng.normal(0.0, self.noise_lsb, np.shape(cosine))
        return self._convert(sine), self._convert(cosine)

    def coarse(self, revolutions: float, rng: np.random.Generator | None = None) -> tuple[int, int]:
        """ADC counts of the track with one cycle per revolution, with the nominal amplitude and no errors."""
        x, full = 2.0 * math.pi * math.fmod(revolutions, 1.0), 1 << (self.adc_bits - 1)
        noise = (0.0, 0.0)
        if rng is not None and self.noise_lsb > 0.0:
            noise = (rng.normal(0.0, self.noise_lsb), rng.normal(0.0, self.noise_lsb))
        sine, cosine = (
            max(-full, min(full - 1, round(self.amplitude_counts * track + off)))
            for track, off in zip((math.sin(x), math.cos(x)), noise, strict=True)
        )
        return sine, cosine

    def _convert(self, track: FloatArray) -> npt.NDArray[np.int64]:
        full = 1 << (self.adc_bits - 1)
        return np.clip(np.rint(track), -full, full - 1).astype(np.int64)


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
