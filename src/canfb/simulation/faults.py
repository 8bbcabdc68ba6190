"""Faults of a sine/cosine encoder, its cable, its converter and its bus, as functions of the samples.

Every model takes :class:`Samples` and gives new ones in which the fault is present from ``start`` to
``stop``. They are the fault models that functional safety (IEC 61800-5-2) asks of such encoders::

    rng = np.random.default_rng(1)
    sine, cosine = encoder.sample(position_cycles, rng)
    bad = OpenTrack(Signal.SINE).inject(Samples.of(sine, cosine, adc_bits=12), 300, 360, rng)
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum
from typing import Self

import numpy as np
import numpy.typing as npt

from canfb.checks import integer_in

Counts = npt.NDArray[np.int64]
Tracks = npt.NDArray[np.float64]
"""Sine and cosine while the fault is present, before the converter, shape (2, n)."""
Rng = np.random.Generator


class Signal(Enum):
    """Which of the two tracks a fault is on: a mask of shape (2, 1)."""

    SINE = ((True,), (False,))
    COSINE = ((False,), (True,))
    BOTH = ((True,), (True,))

    def chosen(self, faulty: npt.ArrayLike, tracks: Tracks) -> Tracks:
        """``tracks`` with those that the fault is on replaced."""
        return np.where(self.value, faulty, tracks)


@dataclass(frozen=True)
class Samples:
    """Samples as the receiver gets them, one place per sampling interval.

    sine, cosine        ADC counts, int64, zero at mid-scale, shape (n,)
    delivered           False where no sample came; the counts are then without meaning
    full_scale_counts   2**(adc_bits - 1): counts lie in -full_scale..full_scale - 1
    """

    sine: Counts
    cosine: Counts
    delivered: npt.NDArray[np.bool_]
    full_scale_counts: int

    @classmethod
    def of(cls, sine: npt.ArrayLike, cosine: npt.ArrayLike, adc_bits: int = 12) -> Self:
        """Samples that were all delivered. ValueError for two shapes, or ``adc_bits`` not 4..16."""
        integer_in("adc_bits", adc_bits, 4, 16)
        s, c = np.asarray(sine, dtype=np.int64), np.asarray(cosine, dtype=np.int64)
        if s.ndim != 1 or s.shape != c.shape:
            raise ValueError(f"sine and cosine must be of one length: {s.shape} and {c.shape}")
        return cls(s, c, np.ones(s.shape, dtype=np.bool_), 1 << (adc_bits - 1))

    def __len__(self) -> int:
        return len(self.sine)

    def tracks(self, places: slice | Counts) -> Tracks:
        """Both tracks at these places, shape (2, n)."""
        return np.stack([self.sine[places], self.cosine[places]]).astype(np.float64)

    def put(self, span: slice, tracks: Tracks) -> Samples:
        """With these tracks within ``span`` as the converter makes them: rounded, held at its ends."""
        full = self.full_scale_counts
        counts = np.clip(np.rint(tracks), -full, full - 1).astype(np.int64)
        s, c = self.sine.copy(), self.cosine.copy()
        s[span], c[span] = counts
        return replace(self, sine=s, cosine=c)


class Fault:
    """A fault model: a subclass says what the tracks are while the fault is present."""

    def inject(self, samples: Samples, start: int, stop: int, rng: Rng) -> Samples:
        """``samples`` with the fault in the intervals start..stop, 0 <= start < stop <= len(samples).

        ValueError outside this range. ``rng`` is used where chance plays a part.
        """
        if not 0 <= start < stop <= len(samples):
            raise ValueError(f"0 <= start < stop <= {len(samples)} must hold, not {start} and {stop}")
        return self._faulty(samples, slice(start, stop), rng)

    def _faulty(self, samples: Samples, span: slice, rng: Rng) -> Samples:
        return samples.put(span, self._tracks(samples.tracks(span), samples.full_scale_counts, rng))

    def _tracks(self, tracks: Tracks, full: int, rng: Rng) -> Tracks:
        """The faulty tracks; the converter reaches from -``full`` to ``full`` - 1."""
        raise NotImplementedError


@dataclass(frozen=True)
class OpenTrack(Fault):
    """A broken wire: the input is pulled to mid-scale, plus what it catches, ``noise_lsb`` counts rms."""

    signal: Signal
    noise_lsb: float = 0.0

    def _tracks(self, tracks: Tracks, full: int, rng: Rng) -> Tracks:
        return self.signal.chosen(rng.normal(0.0, self.noise_lsb, tracks.shape), tracks)


@dataclass(frozen=True)
class ShortedTrack(Fault):
    """A track short-circuited to a supply: the converter stands at its upper or lower end."""

    signal: Signal
    high: bool

    def _tracks(self, tracks: Tracks, full: int, rng: Rng) -> Tracks:
        return self.signal.chosen(full - 1 if self.high else -full, tracks)


@dataclass(frozen=True)
class StuckTrack(Fault):
    """A track that stays at ``counts``; None: at the value of its last good sample."""

    signal: Signal
    counts: float | None = None

    def _faulty(self, samples: Samples, span: slice, rng: Rng) -> Samples:
        stuck = samples.tracks(_last_good(span)) if self.counts is None else self.counts
        return samples.put(span, self.signal.chosen(stuck, samples.tracks(span)))


@dataclass(frozen=True)
class JoinedTracks(Fault):
    """Both tracks short-circuited to each other: both show their mean."""

    def _tracks(self, tracks: Tracks, full: int, rng: Rng) -> Tracks:
        return np.broadcast_to(tracks.mean(axis=0), tracks.shape)


@dataclass(frozen=True)
class SwappedTracks(Fault):
    """Sine and cosine exchanged: the machine seems to turn in the other direction."""

    def _tracks(self, tracks: Tracks, full: int, rng: Rng) -> Tracks:
        return tracks[::-1]


@dataclass(frozen=True)
class InvertedTracks(Fault):
    """The wires of a differential track exchanged: its sign is wrong."""

    signal: Signal

    def _tracks(self, tracks: Tracks, full: int, rng: Rng) -> Tracks:
        return self.signal.chosen(-tracks, tracks)


@dataclass(frozen=True)
class TrackDrift(Fault):
    """Offset, gain and phase of the tracks drift: a slow ramp that ends at these values.

    sine_offset, cosine_offset   counts, added
    sine_gain, cosine_gain       the tracks are multiplied by them; 1 changes nothing
    phase_rad                    the cosine track becomes A cos(x - phase_rad)
    ramp_samples                 intervals until the end values, from then on constant, at least 1
    ValueError for a ``ramp_samples`` below 1.
    """

    sine_offset: float = 0.0
    cosine_offset: float = 0.0
    sine_gain: float = 1.0
    cosine_gain: float = 1.0
    phase_rad: float = 0.0
    ramp_samples: int = 100

    def __post_init__(self) -> None:
        if self.ramp_samples < 1:
            raise ValueError(f"ramp_samples must be at least 1, not {self.ramp_samples}")

    def _tracks(self, tracks: Tracks, full: int, rng: Rng) -> Tracks:
        sine, cosine = tracks
        part = np.minimum(np.arange(1, len(sine) + 1) / self.ramp_samples, 1.0)
        turned = np.stack(
            [sine, cosine * np.cos(part * self.phase_rad) + sine * np.sin(part * self.phase_rad)]
        )
        gain = np.array([[self.sine_gain], [self.cosine_gain]])
        offset = np.array([[self.sine_offset], [self.cosine_offset]])
        drifted: Tracks = turned * (1.0 + part * (gain - 1.0)) + part * offset
        return drifted


@dataclass(frozen=True)
class Oscillation(Fault):
    """A sine of ``amplitude_counts`` added: an amplifier that oscillates, a hum that couples in.

    ``periods_per_sample`` is its frequency as sampled. On both tracks it is the same.
    """

    signal: Signal
    amplitude_counts: float
    periods_per_sample: float
    shift_rad: float = 0.0

    def _tracks(self, tracks: Tracks, full: int, rng: Rng) -> Tracks:
        angle = 2.0 * math.pi * self.periods_per_sample * np.arange(tracks.shape[1]) + self.shift_rad
        return self.signal.chosen(tracks + self.amplitude_counts * np.sin(angle), tracks)


@dataclass(frozen=True)
class ExcessNoise(Fault):
    """Gaussian noise of ``rms_counts`` added to each track, independent of the other."""

    signal: Signal
    rms_counts: float

    def _tracks(self, tracks: Tracks, full: int, rng: Rng) -> Tracks:
        return self.signal.chosen(tracks + rng.normal(0.0, self.rms_counts, tracks.shape), tracks)


@dataclass(frozen=True)
class PhaseGlitch(Fault):
    """Samples at a random point of the circle: any phase, good amplitude.

    ``common``: one random phase error for all of them, else one for each.
    """

    amplitude_counts: float
    common: bool = False

    def _tracks(self, tracks: Tracks, full: int, rng: Rng) -> Tracks:
        angle = rng.uniform(0.0, 2.0 * math.pi, 1 if self.common else tracks.shape[1])
        if self.common:
            angle = angle + np.arctan2(*tracks)
        return self.amplitude_counts * np.stack([np.sin(angle), np.cos(angle)]).astype(np.float64)


@dataclass(frozen=True)
class CountGlitch(Fault):
    """Samples of random counts anywhere in the range of the converter."""

    def _tracks(self, tracks: Tracks, full: int, rng: Rng) -> Tracks:
        return rng.integers(-full, full, tracks.shape).astype(np.float64)


@dataclass(frozen=True)
class LostSamples(Fault):
    """No sample comes, and the receiver knows it."""

    def _faulty(self, samples: Samples, span: slice, rng: Rng) -> Samples:
        delivered = samples.delivered.copy()
        delivered[span] = False
        return replace(samples, delivered=delivered)


class _OtherSamples(Fault):
    """Other samples come in place of those that were taken: a subclass says which."""

    def _faulty(self, samples: Samples, span: slice, rng: Rng) -> Samples:
        return samples.put(span, samples.tracks(self._places(span)))

    def _places(self, span: slice) -> Counts:
        raise NotImplementedError


@dataclass(frozen=True)
class FrozenSamples(_OtherSamples):
    """The last good sample comes again and again."""

    def _places(self, span: slice) -> Counts:
        return _last_good(span)


@dataclass(frozen=True)
class RepeatedSamples(_OtherSamples):
    """Every sample comes ``times`` times, so the ones between are missing: a converter too slow.

    The first of them repeats the last good sample. ValueError for ``times`` below 2.
    """

    times: int = 2

    def __post_init__(self) -> None:
        if self.times < 2:
            raise ValueError(f"times must be at least 2, not {self.times}")

    def _places(self, span: slice) -> Counts:
        places = np.arange(span.start, span.stop)
        source: Counts = np.maximum(places - (places - span.start + 1) % self.times, 0)
        return source


@dataclass(frozen=True)
class LateSamples(_OtherSamples):
    """Every sample comes ``intervals`` later than it was taken; the receiver does not know it.

    At the beginning the last good sample is repeated, at the end ``intervals`` are left out.
    ValueError for ``intervals`` below 1.
    """

    intervals: int = 1

    def __post_init__(self) -> None:
        if self.intervals < 1:
            raise ValueError(f"intervals must be at least 1, not {self.intervals}")

    def _places(self, span: slice) -> Counts:
        source: Counts = np.maximum(np.arange(span.start, span.stop) - self.intervals, _last_good(span))
        return source


def _last_good(span: slice) -> Counts:
    """The place of the sample before ``span``, for each place within."""
    return np.full(span.stop - span.start, max(span.start - 1, 0))
