"""Faults of a sine/cosine encoder, its cable, its converter and its bus, as functions of the samples.

Every model takes :class:`Samples`, one per sampling interval, and gives new ones in which the
fault is present from ``start`` to ``stop``; before and after that nothing is changed. They are
the fault models that functional safety (IEC 61800-5-2) asks of such encoders. The
counts keep the ends of the converter, as real ones do::

    rng = np.random.default_rng(1)
    sine, cosine = encoder.sample(position_cycles, rng)
    bad = OpenTrack(Signal.SINE).inject(Samples.of(sine, cosine, adc_bits=12), 300, 360, rng)
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Protocol, Self

import numpy as np
import numpy.typing as npt

from canfb.checks import integer_in

Counts = npt.NDArray[np.int64]


class Signal(StrEnum):
    """Which of the two tracks a fault is on."""

    SINE = "sine"
    COSINE = "cosine"
    BOTH = "both"

    @property
    def names(self) -> tuple[str, ...]:
        """The fields of :class:`Samples` that it stands for."""
        return ("sine", "cosine") if self is Signal.BOTH else (self.value,)


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

    def converted(self, counts: npt.ArrayLike) -> Counts:
        """What the converter makes of these values: rounded, held at its ends."""
        full = self.full_scale_counts
        return np.clip(np.rint(np.asarray(counts, dtype=np.float64)), -full, full - 1).astype(np.int64)

    def put(self, start: int, sine: npt.ArrayLike, cosine: npt.ArrayLike) -> Samples:
        """With these values, converted, from ``start`` on."""
        s, c = self.sine.copy(), self.cosine.copy()
        new_s, new_c = self.converted(sine), self.converted(cosine)
        s[start : start + len(new_s)], c[start : start + len(new_c)] = new_s, new_c
        return replace(self, sine=s, cosine=c)


class Fault(Protocol):
    """A fault model."""

    def inject(self, samples: Samples, start: int, stop: int, rng: np.random.Generator) -> Samples:
        """``samples`` with the fault in the intervals start..stop, 0 <= start < stop <= len(samples).

        ValueError outside this range. ``rng`` is used where chance plays a part.
        """


def _span(samples: Samples, start: int, stop: int) -> slice:
    if not 0 <= start < stop <= len(samples):
        raise ValueError(f"0 <= start < stop <= {len(samples)} must hold, not {start} and {stop}")
    return slice(start, stop)


@dataclass(frozen=True)
class OpenTrack:
    """A broken wire: the input is pulled to mid-scale, plus what it catches.

    ``noise_lsb`` is the rms of that, in counts.
    """

    signal: Signal
    noise_lsb: float = 0.0

    def inject(self, samples: Samples, start: int, stop: int, rng: np.random.Generator) -> Samples:
        """See :class:`Fault`."""
        return _replaced(samples, self.signal, _span(samples, start, stop), 0.0, self.noise_lsb, rng)


@dataclass(frozen=True)
class ShortedTrack:
    """A track short-circuited to a supply: the converter stands at its upper or lower end."""

    signal: Signal
    high: bool

    def inject(self, samples: Samples, start: int, stop: int, rng: np.random.Generator) -> Samples:
        """See :class:`Fault`."""
        end = samples.full_scale_counts - 1 if self.high else -samples.full_scale_counts
        return _replaced(samples, self.signal, _span(samples, start, stop), end, 0.0, rng)


@dataclass(frozen=True)
class StuckTrack:
    """A track that stays at ``counts``; None: at the value of its last good sample."""

    signal: Signal
    counts: float | None = None

    def inject(self, samples: Samples, start: int, stop: int, rng: np.random.Generator) -> Samples:
        """See :class:`Fault`."""
        span = _span(samples, start, stop)
        if self.counts is not None:
            return _replaced(samples, self.signal, span, self.counts, 0.0, rng)
        last = np.full(stop - start, max(start - 1, 0))
        return samples.put(
            start,
            samples.sine[last if "sine" in self.signal.names else span],
            samples.cosine[last if "cosine" in self.signal.names else span],
        )


def _replaced(
    samples: Samples, signal: Signal, span: slice, counts: float, noise: float, rng: np.random.Generator
) -> Samples:
    sine, cosine = counts + rng.normal(0.0, noise, (2, span.stop - span.start))
    return samples.put(
        span.start,
        sine if "sine" in signal.names else samples.sine[span],
        cosine if "cosine" in signal.names else samples.cosine[span],
    )


@dataclass(frozen=True)
class JoinedTracks:
    """Both tracks short-circuited to each other: both show their mean."""

    def inject(self, samples: Samples, start: int, stop: int, rng: np.random.Generator) -> Samples:
        """See :class:`Fault`."""
        span = _span(samples, start, stop)
        mean = (samples.sine[span] + samples.cosine[span]) / 2.0
        return samples.put(start, mean, mean)


@dataclass(frozen=True)
class SwappedTracks:
    """Sine and cosine exchanged: the machine seems to turn in the other direction."""

    def inject(self, samples: Samples, start: int, stop: int, rng: np.random.Generator) -> Samples:
        """See :class:`Fault`."""
        span = _span(samples, start, stop)
        return samples.put(start, samples.cosine[span], samples.sine[span])


@dataclass(frozen=True)
class InvertedTracks:
    """The wires of a differential track exchanged: its sign is wrong."""

    signal: Signal

    def inject(self, samples: Samples, start: int, stop: int, rng: np.random.Generator) -> Samples:
        """See :class:`Fault`."""
        span = _span(samples, start, stop)
        sine_sign = -1 if "sine" in self.signal.names else 1
        cosine_sign = -1 if "cosine" in self.signal.names else 1
        return samples.put(start, sine_sign * samples.sine[span], cosine_sign * samples.cosine[span])


@dataclass(frozen=True)
class TrackDrift:
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

    def inject(self, samples: Samples, start: int, stop: int, rng: np.random.Generator) -> Samples:
        """See :class:`Fault`."""
        span = _span(samples, start, stop)
        part = np.minimum(np.arange(1, stop - start + 1) / self.ramp_samples, 1.0)
        sine, cosine = samples.sine[span], samples.cosine[span]
        turn = part * self.phase_rad
        cosine_turned = cosine * np.cos(turn) + sine * np.sin(turn)
        return samples.put(
            start,
            sine * (1.0 + part * (self.sine_gain - 1.0)) + part * self.sine_offset,
            cosine_turned * (1.0 + part * (self.cosine_gain - 1.0)) + part * self.cosine_offset,
        )


@dataclass(frozen=True)
class Oscillation:
    """A sine of ``amplitude_counts`` added: an amplifier that oscillates, a hum that couples in.

    ``periods_per_sample`` is its frequency as sampled. On both tracks it is the same.
    """

    signal: Signal
    amplitude_counts: float
    periods_per_sample: float
    shift_rad: float = 0.0

    def inject(self, samples: Samples, start: int, stop: int, rng: np.random.Generator) -> Samples:
        """See :class:`Fault`."""
        _span(samples, start, stop)
        angle = 2.0 * math.pi * self.periods_per_sample * np.arange(stop - start) + self.shift_rad
        return _added(samples, self.signal, start, self.amplitude_counts * np.sin(angle))


@dataclass(frozen=True)
class ExcessNoise:
    """Gaussian noise of ``rms_counts`` added to each track, independent of the other."""

    signal: Signal
    rms_counts: float

    def inject(self, samples: Samples, start: int, stop: int, rng: np.random.Generator) -> Samples:
        """See :class:`Fault`."""
        _span(samples, start, stop)
        for name in self.signal.names:
            noise = rng.normal(0.0, self.rms_counts, stop - start)
            samples = _added(samples, Signal(name), start, noise)
        return samples


def _added(samples: Samples, signal: Signal, start: int, values: npt.NDArray[np.float64]) -> Samples:
    span = slice(start, start + len(values))
    sine, cosine = samples.sine[span], samples.cosine[span]
    return samples.put(
        start,
        sine + values if "sine" in signal.names else sine,
        cosine + values if "cosine" in signal.names else cosine,
    )


@dataclass(frozen=True)
class PhaseGlitch:
    """Samples at a random point of the circle: any phase, good amplitude.

    ``common``: one random phase error for all of them, else one for each.
    """

    amplitude_counts: float
    common: bool = False

    def inject(self, samples: Samples, start: int, stop: int, rng: np.random.Generator) -> Samples:
        """See :class:`Fault`."""
        span = _span(samples, start, stop)
        if self.common:
            angle = np.arctan2(samples.sine[span], samples.cosine[span]) + rng.uniform(0.0, 2.0 * math.pi)
        else:
            angle = rng.uniform(0.0, 2.0 * math.pi, stop - start)
        size = self.amplitude_counts
        return samples.put(start, size * np.sin(angle), size * np.cos(angle))


@dataclass(frozen=True)
class CountGlitch:
    """Samples of random counts anywhere in the range of the converter."""

    def inject(self, samples: Samples, start: int, stop: int, rng: np.random.Generator) -> Samples:
        """See :class:`Fault`."""
        _span(samples, start, stop)
        full = samples.full_scale_counts
        sine, cosine = rng.integers(-full, full, (2, stop - start))
        return samples.put(start, sine, cosine)


@dataclass(frozen=True)
class LostSamples:
    """No sample comes, and the receiver knows it."""

    def inject(self, samples: Samples, start: int, stop: int, rng: np.random.Generator) -> Samples:
        """See :class:`Fault`."""
        delivered = samples.delivered.copy()
        delivered[_span(samples, start, stop)] = False
        return replace(samples, delivered=delivered)


@dataclass(frozen=True)
class FrozenSamples:
    """The last good sample comes again and again."""

    def inject(self, samples: Samples, start: int, stop: int, rng: np.random.Generator) -> Samples:
        """See :class:`Fault`."""
        span = _span(samples, start, stop)
        last = np.full(stop - start, max(start - 1, 0))
        return samples.put(span.start, samples.sine[last], samples.cosine[last])


@dataclass(frozen=True)
class RepeatedSamples:
    """Every sample comes ``times`` times, so the ones between are missing: a converter too slow.

    The first of them repeats the last good sample. ValueError for ``times`` below 2.
    """

    times: int = 2

    def __post_init__(self) -> None:
        if self.times < 2:
            raise ValueError(f"times must be at least 2, not {self.times}")

    def inject(self, samples: Samples, start: int, stop: int, rng: np.random.Generator) -> Samples:
        """See :class:`Fault`."""
        _span(samples, start, stop)
        places = np.arange(start, stop)
        source = np.maximum(places - (places - start + 1) % self.times, 0)
        return samples.put(start, samples.sine[source], samples.cosine[source])


@dataclass(frozen=True)
class LateSamples:
    """Every sample comes ``intervals`` later than it was taken; the receiver does not know it.

    At the beginning the last good sample is repeated, at the end ``intervals`` are left out.
    ValueError for ``intervals`` below 1.
    """

    intervals: int = 1

    def __post_init__(self) -> None:
        if self.intervals < 1:
            raise ValueError(f"intervals must be at least 1, not {self.intervals}")

    def inject(self, samples: Samples, start: int, stop: int, rng: np.random.Generator) -> Samples:
        """See :class:`Fault`."""
        _span(samples, start, stop)
        source = np.maximum(np.arange(start, stop) - self.intervals, max(start - 1, 0))
        return samples.put(start, samples.sine[source], samples.cosine[source])
