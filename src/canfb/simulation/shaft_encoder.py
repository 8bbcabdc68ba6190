"""The encoder on a shaft that turns in true time: both tracks, the coarse track, the zero pulse."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from canfb.signal.sample import Sample
from canfb.simulation.encoder import Encoder
from canfb.sources.motion_source import RevolutionsAt

BISECTIONS = 40
SPEED_OVER_S = 1e-5  # of the analog path


class ShaftEncoder:
    """Samples an encoder at a position of its shaft, with noise and, optionally, aperture jitter.

    The coarse track has one cycle per revolution and the amplitude of the others. The zero pulse is where
    the position is a whole number of revolutions. ``aperture_jitter_s`` is the rms of the instant at which
    the tracks are held, normal, cut off at four times that; the clock of the interface knows nothing of it.
    """

    def __init__(
        self,
        encoder: Encoder,
        cycles_per_revolution: int,
        seed: int = 1,
        aperture_jitter_s: float = 0.0,
    ) -> None:
        self._encoder = encoder
        self._cycles_per_revolution = cycles_per_revolution
        self._rng = np.random.default_rng(seed)
        self._seed = seed
        self._others = np.random.default_rng((seed, 0xA9))  # coarse track and aperture: noise of their own
        self._aperture_jitter_s = aperture_jitter_s
        self._last: tuple[float, float] | None = None  # time and revolutions of the sample before
        self.position_cycles = 0.0
        """True position of the last sample, cycles."""

    def sample(self, time_s: float, revolutions_at: RevolutionsAt) -> Sample:
        """The sample at ``time_s`` of the machine."""
        held_s = time_s
        if self._aperture_jitter_s:
            off = float(self._others.normal())
            held_s = max(0.0, time_s + self._aperture_jitter_s * max(-4.0, min(4.0, off)))
        revolutions = revolutions_at(held_s)
        self.position_cycles = revolutions * self._cycles_per_revolution
        hertz = 0.0 if self._encoder.path.is_ideal else self._hertz(held_s, revolutions_at)
        sine, cosine = self._encoder.sample(self.position_cycles, self._rng, hertz)
        last, self._last = self._last, (held_s, revolutions)
        pulse = None
        if last is not None and math.floor(last[1]) != math.floor(revolutions):
            pulse = _pulse_place(*last, held_s, revolutions, revolutions_at)
        coarse = self._encoder.coarse(revolutions, self._others)
        return Sample(int(sine), int(cosine), 1.0, False, *coarse, pulse)

    def _hertz(self, at_s: float, revolutions_at: RevolutionsAt) -> float:
        """The speed there, cycles per second."""
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
    """When the last whole revolution was passed, as a part 0..1 of the time between two samples."""
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
