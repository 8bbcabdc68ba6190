"""What a reference measurement gives."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import Correction, CorrectionTable
from canfb.signal.phase import FloatArray


class Reason(StrEnum):
    """Why a reference measurement is refused, or that it is accepted; `.text` says it in a sentence."""

    text: str

    def __new__(cls, word: str, text: str = "") -> Reason:
        """Make the member with its text."""
        member = str.__new__(cls, word)
        member._value_ = word
        member.text = text
        return member

    ACCEPTED = "accepted", "the measurement is usable"
    SAMPLES = "samples", "too few usable samples"
    CLIPPED = "clipped", "the tracks reach the ends of the converter's range"
    ELLIPSE = "ellipse", "the tracks form no ellipse: a dead track, noise, too short a distance"
    COVERAGE = "coverage", "parts of the cycle were never or hardly sampled"
    CYCLES = "cycles", "too few cycles"
    LOCKED = "locked", "the motion is locked to the samples: too few different phases"
    NOISE = "noise", "noise of tracks or motion leaves the table too uncertain"
    MONOTONIC = "monotonic", "raw phase does not rise through the cycle, or is too far from the phase"
    SPEED = "speed", "too few samples in each cycle for this method: too fast"
    INTERRUPTED = (
        "interrupted",
        "the samples ended before there were enough: the module left OPERATIONAL",
    )
    FAILED = "failed", "the computation itself failed"

    @property
    def number(self) -> int:
        """The value of object 2030:07."""
        return list(Reason).index(self)

    @classmethod
    def of_number(cls, number: int) -> Reason:
        """The reason by its number in 2030:07; FAILED if the number is not known."""
        members = list(cls)
        return members[number] if number < len(members) else cls.FAILED


class Method(StrEnum):
    """How a table was made."""

    MOTION = "motion"
    ZERO_CROSSINGS = "zero crossings"


TRACK_POINTS = 1024


class ErrorHarmonic(NamedTuple):
    """One harmonic of the error: amplitude cos(2 pi order phase + angle), amplitude in cycles."""

    order: int
    amplitude_cycles: float
    angle_rad: float


@dataclass(frozen=True, eq=False)
class ErrorCurve:
    """Mean deviation from smooth motion over the phase, in cycles, on data not used for the fit.

    phase    middle of each bin, cycles
    before   identity table, its mean removed
    after    correction table
    NaN in a bin without samples.
    """

    phase: FloatArray
    before: FloatArray
    after: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """A reference measurement: correction table, conditioning, and their quality.

    table            correction table; phase 0 at the positive zero crossing of the conditioned sine
    conditioning     to be activated together with the table
    method           a ``Method``: "motion" or "zero crossings"
    reason           a ``Reason``: "accepted", else why it is refused
    coverage         fraction of the cycle that has samples, 0..1
    cycles_used      cycles passed by the samples used, as counted from them
    samples_used     samples used; samples_rejected: usable ones omitted as faults
    residual_rms     rms deviation of a sample from smooth motion with the table, cycles: noise
                     of the samples included, on data not used for the table it is measured with
    residual_peak    largest such deviation
    before_rms       the same with the same conditioning and the identity table
    before_peak
    uncertainty_rms  expected error of the table itself, rms over the cycle, cycles
    uncertainty_peak expected largest error of the table
    noise_counts     rms noise of a track, counts (converter, quantisation)
    noise_cycles     rms of the deviation from the smooth motion, as a phase
    bound_rms        Cramer-Rao bound of the table's rms error with noise_counts, cycles; None
                     where it is not computed
    cramer_rao_ratio measured error of the table (from the scatter of tables of independent parts
                     of the data) over that bound; below 1 only by chance. None where it is not computed
    cramer_rao_scatter  relative standard deviation of that ratio, large for few tables
    track_orders     orders of the tracks' Fourier series that the data supports; empty where
                     the method has none
    harmonics        of the error of the conditioned arc tangent, largest first
    curve            deviation over the phase, before and after
    block_samples    samples over which the motion was assumed to be smooth
    tracks           mean tracks, raw ADC counts, sine above cosine, at phases n/1024;
                     None if unknown
    """

    table: CorrectionTable
    conditioning: Conditioning
    method: Method
    reason: Reason = Reason.ACCEPTED
    coverage: float
    cycles_used: float
    samples_used: int
    samples_rejected: int
    residual_rms: float
    residual_peak: float
    before_rms: float
    before_peak: float
    uncertainty_rms: float
    uncertainty_peak: float
    noise_counts: float
    noise_cycles: float
    bound_rms: float | None = None
    cramer_rao_ratio: float | None = None
    cramer_rao_scatter: float | None = None
    track_orders: tuple[int, ...] = ()
    harmonics: tuple[ErrorHarmonic, ...] = ()
    curve: ErrorCurve
    block_samples: int
    tracks: FloatArray | None = None

    @property
    def correction(self) -> Correction:
        """Table and conditioning, to be activated together."""
        return Correction(self.table, self.conditioning)

    @property
    def accepted(self) -> bool:
        """True if the measurement is usable."""
        return self.reason == Reason.ACCEPTED

    @property
    def verdict(self) -> str:
        """One line for people."""
        return (
            f"{'accepted' if self.accepted else 'refused'}: {self.reason.text}; "
            f"deviation from smooth motion {100 * self.before_rms:.3g} % -> {100 * self.residual_rms:.3g} % "
            f"of a cycle rms, table good to {100 * self.uncertainty_peak:.2g} %, "
            f"{self.cycles_used:.0f} cycles, coverage {100 * self.coverage:.0f} %"
        )


def error_harmonics(
    phase: FloatArray, angle: FloatArray, smallest_cycles: float, highest: int = 64
) -> tuple[ErrorHarmonic, ...]:
    """Harmonics of ``angle - phase`` at equidistant ``phase`` (cycles), those above ``smallest_cycles``."""
    spectrum = np.fft.rfft(angle - phase) / len(phase)
    found = [
        ErrorHarmonic(order, 2.0 * float(abs(spectrum[order])), float(np.angle(spectrum[order])))
        for order in range(1, min(highest, len(spectrum) - 1) + 1)
    ]
    return tuple(
        sorted(
            (h for h in found if h.amplitude_cycles > smallest_cycles),
            key=lambda h: -h.amplitude_cycles,
        )
    )
