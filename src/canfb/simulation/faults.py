"""Faults of a sine/cosine encoder, its cable, its converter and its bus, as functions of the samples.

They are the fault models that functional safety (IEC 61800-5-2) requires for such encoders::

    bad = open_track(Signal.SINE).inject(Samples.of(sine, cosine, adc_bits=12), 300, 360, rng)
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from typing import Self

import numpy as np

from canfb.checks import integer_in
from canfb.signal.phase import ArrayLike, BoolArray, FloatArray, IntArray, pair_of_tracks

Rng = np.random.Generator
# Gives the faulty tracks before the converter; arguments: tracks of the encoder during the fault, shape
# (2, n), and full scale of the converter, both in counts; random generator.
Change = Callable[[FloatArray, int, Rng], ArrayLike]


class Signal(Enum):
    """Which of the two tracks a fault is on: a mask of shape (2, 1)."""

    SINE = ((True,), (False,))
    COSINE = ((False,), (True,))
    BOTH = ((True,), (True,))


@dataclass(frozen=True)
class Samples:
    """Samples as received, one element per sampling interval.

    sine, cosine        ADC counts, int64, zero at mid-scale, shape (n,)
    delivered           False where a sample is missing; its counts are meaningless
    full_scale_counts   2**(adc_bits - 1): counts lie in -full_scale..full_scale - 1
    """

    sine: IntArray
    cosine: IntArray
    delivered: BoolArray
    full_scale_counts: int

    @classmethod
    def of(cls, sine: ArrayLike, cosine: ArrayLike, adc_bits: int = 12) -> Self:
        """Samples that were all delivered. ValueError for two shapes, or ``adc_bits`` not 4..16."""
        integer_in("adc_bits", adc_bits, 4, 16)
        s, c = (np.asarray(one, dtype=np.int64) for one in pair_of_tracks(sine, cosine))
        return cls(s, c, np.ones(s.shape, dtype=np.bool_), 1 << (adc_bits - 1))

    def __len__(self) -> int:
        return len(self.sine)

    def tracks(self, places: slice | IntArray) -> FloatArray:
        return np.stack([self.sine[places], self.cosine[places]]).astype(np.float64)

    def put(self, span: slice, signal: Signal, faulty: ArrayLike) -> Samples:
        """A copy with ``faulty`` tracks within ``span``, rounded and clipped by the converter."""
        full, tracks = self.full_scale_counts, np.where(signal.value, faulty, self.tracks(span))
        counts = np.clip(np.rint(tracks), -full, full - 1).astype(np.int64)
        s, c = self.sine.copy(), self.cosine.copy()
        s[span], c[span] = counts
        return replace(self, sine=s, cosine=c)


@dataclass(frozen=True)
class Fault:
    """A fault model: ``faulty`` gives the samples with the fault in a span."""

    faulty: Callable[[Samples, slice, Rng], Samples]

    def inject(self, samples: Samples, start: int, stop: int, rng: Rng) -> Samples:
        """``samples`` with the fault in the intervals start..stop, 0 <= start < stop <= len(samples), or
        ValueError.
        """
        if not 0 <= start < stop <= len(samples):
            raise ValueError(f"0 <= start < stop <= {len(samples)} must hold, not {start} and {stop}")
        return self.faulty(samples, slice(start, stop), rng)


def changed(change: Change, signal: Signal = Signal.BOTH) -> Fault:
    """A fault that converts the tracks in the span by ``change``."""
    return Fault(
        lambda samples, span, rng: samples.put(
            span, signal, change(samples.tracks(span), samples.full_scale_counts, rng)
        )
    )


def moved(places: Callable[[slice], IntArray], signal: Signal = Signal.BOTH) -> Fault:
    """A fault that shows the samples of other ``places`` in the span."""
    return Fault(lambda samples, span, rng: samples.put(span, signal, samples.tracks(places(span))))


def last_good(span: slice) -> IntArray:
    """The last index before ``span``, repeated for each index of the span."""
    return np.full(span.stop - span.start, max(span.start - 1, 0))


def open_track(signal: Signal, noise_lsb: float = 0.0) -> Fault:
    """A broken wire: the input is pulled to mid-scale and picks up noise, ``noise_lsb`` counts rms."""
    return changed(lambda tracks, full, rng: rng.normal(0.0, noise_lsb, tracks.shape), signal)


def shorted_track(signal: Signal, high: bool) -> Fault:
    """A track short-circuited to a supply: the converter shows its upper or lower end."""
    return changed(lambda tracks, full, rng: full - 1 if high else -full, signal)


def stuck_track(signal: Signal, counts: float | None = None) -> Fault:
    """A track that stays at ``counts``; None: at the value of its last good sample."""
    if counts is None:
        return moved(last_good, signal)
    return changed(lambda tracks, full, rng: counts, signal)


def joined_tracks() -> Fault:
    """Tracks short-circuited to each other: both show their mean."""
    return changed(lambda tracks, full, rng: tracks.mean(axis=0))


def swapped_tracks() -> Fault:
    """Sine and cosine exchanged: the machine seems to turn in the other direction."""
    return changed(lambda tracks, full, rng: tracks[::-1])


def inverted_tracks(signal: Signal) -> Fault:
    """The wires of a differential track exchanged: its sign is wrong."""
    return changed(lambda tracks, full, rng: -tracks, signal)


def track_drift(
    *,
    sine_offset: float = 0.0,
    cosine_offset: float = 0.0,
    sine_gain: float = 1.0,
    cosine_gain: float = 1.0,
    phase_rad: float = 0.0,
    ramp_samples: int = 100,
) -> Fault:
    """Offset, gain and phase of the tracks drift: a slow ramp that ends at these values.

    sine_offset, cosine_offset   counts, added
    sine_gain, cosine_gain       factors of the tracks; 1: no change
    phase_rad                    the cosine track becomes A cos(x - phase_rad)
    ramp_samples                 intervals until the end values, at least 1: ValueError
    """
    integer_in("ramp_samples", ramp_samples, 1, 1 << 31)
    gain, offset = np.array([[sine_gain], [cosine_gain]]), np.array([[sine_offset], [cosine_offset]])

    def drifted(tracks: FloatArray, full: int, rng: Rng) -> FloatArray:
        sine, cosine = tracks
        part = np.minimum(np.arange(1, len(sine) + 1) / ramp_samples, 1.0)
        turned = np.stack([sine, cosine * np.cos(part * phase_rad) + sine * np.sin(part * phase_rad)])
        return np.asarray(turned * (1.0 + part * (gain - 1.0)) + part * offset, np.float64)

    return changed(drifted)


def oscillation(
    signal: Signal, amplitude_counts: float, periods_per_sample: float, shift_rad: float = 0.0
) -> Fault:
    """The same sine added to the tracks: an oscillating amplifier, or coupled hum.

    ``periods_per_sample`` is its frequency as sampled.
    """

    def change(tracks: FloatArray, full: int, rng: Rng) -> FloatArray:
        angle = 2.0 * math.pi * periods_per_sample * np.arange(tracks.shape[1]) + shift_rad
        return np.asarray(tracks + amplitude_counts * np.sin(angle), np.float64)

    return changed(change, signal)


def frozen_samples() -> Fault:
    """The last good sample is repeated."""
    return moved(last_good)
