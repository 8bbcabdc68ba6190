"""Result of a reference measurement, with its errors over the phase; criteria for refusing it; drift from
the active table.

A bad measurement is never returned as good.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from canfb.errors import CalibrationError
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import AnyTable, Correction, CorrectionTable, correction_of
from canfb.signal.phase import BoolArray, FloatArray, IntArray, raw_phases, wrap


class Reason(StrEnum):
    """Why a reference measurement is refused, or that it is accepted; `.text` says it in a sentence."""

    text: str

    def __new__(cls, word: str, text: str = "") -> Reason:
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
        "the samples ended before there were enough: the module left OPERATIONAL, or its input changed",
    )
    FAILED = "failed", "the computation itself failed"
    CHANGED = "changed", "the tracks change during the measurement"

    @property
    def number(self) -> int:
        """The value of object 2030:07."""
        return list(Reason).index(self)

    @classmethod
    def of_number(cls, number: int) -> Reason:
        """The reason by its number in 2030:07; FAILED if the number is not known."""
        members = list(cls)
        return members[number] if number < len(members) else cls.FAILED


@contextlib.contextmanager
def naming_speed(hertz: float) -> Iterator[None]:
    """CalibrationErrors raised in this context name the speed, cycles per second."""
    try:
        yield
    except CalibrationError as error:
        raise CalibrationError(f"at {hertz:.6g} cycles/s: {error}", error.reason) from error


class Method(StrEnum):
    """How a table was made."""

    MOTION = "motion"
    ZERO_CROSSINGS = "zero crossings"


BINS = 64  # bins of the phase in a cycle
MIN_PER_BIN = 2


def bins_of(phase: FloatArray) -> IntArray:
    return (phase % 1.0 * BINS).astype(np.int64) % BINS


def samples_in_bins(phase: FloatArray) -> IntArray:
    return np.bincount(bins_of(phase), minlength=BINS)


def mean_in_bins(phase: FloatArray, values: FloatArray) -> FloatArray:
    """Mean of the values in each bin of the phase; NaN in an empty bin."""
    count = samples_in_bins(phase)
    mean = np.bincount(bins_of(phase), values, BINS) / np.where(count, count, np.nan)
    return np.asarray(mean, np.float64)


def coverage(phase: FloatArray) -> float:
    """Fraction of the 64 bins of the cycle that have two of these phases (cycles), neighbours included."""
    return covered(samples_in_bins(phase))


def covered(counts: Sequence[int] | IntArray) -> float:
    here = np.asarray(counts)
    return float(np.mean(np.roll(here, 1) + here + np.roll(here, -1) >= MIN_PER_BIN))


def about_mean(
    off: FloatArray, of: FloatArray | None = None, weights: FloatArray | None = None
) -> FloatArray:
    """Phases (cycles) less their mean, or the mean of ``of``; within half a cycle.

    The mean is the angle of the mean of the unit vectors, weighted by ``weights`` if given.
    """
    vectors = np.exp(2j * np.pi * (off if of is None else of))
    middle = np.angle(np.average(vectors, weights=weights)) / (2.0 * np.pi)
    return wrap(off - middle)


def root_mean(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def robust_rms(values: FloatArray) -> float:
    """Standard deviation, from the median."""
    return 1.4826 * float(np.median(np.abs(values))) if len(values) else 0.0


def runs(marked: BoolArray) -> IntArray:
    """First and end of runs of True, shape (n, 2)."""
    return np.flatnonzero(np.diff(marked, prepend=False, append=False)).reshape(-1, 2)


def peak(values: FloatArray) -> float:
    return float(np.abs(values).max()) if len(values) else 0.0


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


def error_curve(position: FloatArray, before: FloatArray, after: FloatArray) -> ErrorCurve:
    each = (mean_in_bins(position, one) for one in (before, after))
    return ErrorCurve((np.arange(BINS) + 0.5) / BINS, *each)


TRACK_POINTS = 1024
PEAK_SIGMAS = 4.0  # the stated largest error of a table, in standard deviations


@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """A reference measurement: correction table, conditioning, and their quality.

    table            correction table; phase 0 at the positive zero crossing of the conditioned sine
    conditioning     to be activated together with the table
    method           a ``Method``
    reason           a ``Reason``: "accepted", else why it is refused
    coverage         fraction of the cycle that has samples, 0..1
    cycles_used      cycles passed by the samples used
    samples_used     samples used; samples_rejected: usable ones omitted as faults
    residual_rms     rms deviation of samples from smooth motion, cycles, noise included, with a table
                     from other samples
    residual_peak    largest such deviation
    before_rms       the same with the identity table
    before_peak
    uncertainty_rms  expected error of the table, rms over the cycle, cycles
    uncertainty_peak largest expected error
    change_rms       rms difference of tables from parts of the time, cycles; 0: not above noise
    noise_counts     rms noise of a track, counts
    noise_cycles     rms deviation from the smooth motion, as a phase
    bound_rms        Cramer-Rao bound of the table's rms error, cycles; None: not computed
    cramer_rao_ratio measured error of the table over that bound; None: not computed
    cramer_rao_scatter  relative standard deviation of that ratio
    track_orders     orders of the tracks' Fourier series that the data supports; empty: none chosen
    harmonics        of the error of the conditioned arc tangent, largest first
    curve            deviation over the phase, before and after
    block_samples    samples over which the motion was assumed to be smooth
    tracks           mean tracks, raw ADC counts, sine above cosine, at phases n/1024
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
    change_rms: float = 0.0
    bound_rms: float | None = None
    cramer_rao_ratio: float | None = None
    cramer_rao_scatter: float | None = None
    track_orders: tuple[int, ...] = ()
    harmonics: tuple[ErrorHarmonic, ...] = ()
    curve: ErrorCurve
    block_samples: int
    tracks: FloatArray

    def __post_init__(self) -> None:
        # Mark the table, so that it cannot be used without its conditioning by mistake.
        object.__setattr__(self, "table", self.table.made_for(self.conditioning))

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
        """Result, reason and figures in one line."""
        return (
            f"{'accepted' if self.accepted else 'refused'}: {self.reason.text}; "
            f"deviation from smooth motion {100 * self.before_rms:.3g} % -> {100 * self.residual_rms:.3g} % "
            f"of a cycle rms, table good to {100 * self.uncertainty_peak:.2g} %, "
            f"{self.cycles_used:.0f} cycles, coverage {100 * self.coverage:.0f} %"
        )


MIN_COVERAGE = 0.95
MIN_CYCLES = 10.0
# The paper's method leaves 0.05 % of a cycle; a table with a larger rms uncertainty is refused.
MAX_UNCERTAINTY_CYCLES = 5e-4
# Largest change during a measurement, half of the rms error of Table 1: below it the table still helps, and
# the change is its stated error.
MOST_CHANGE_CYCLES = 8.0 * MAX_UNCERTAINTY_CYCLES
# Largest rms deviation of single samples, along the curve and across it.
MAX_OFF_CYCLES = 0.03
# With well mixed phases in every block the unknown motion costs little information. If it increases the
# uncertainty by more than this factor, the motion is to blame, not the noise.
LOCKED_LOSS = 3.0

CHANGE_SPEED = (
    "run the machine through many cycles, at a speed that is neither a whole number of cycles per "
    "sample nor a simple fraction of one"
)


def check_distance(coverage: float, cycles: float) -> None:
    if coverage < MIN_COVERAGE:
        raise CalibrationError(
            f"only {100 * coverage:.0f} % of the cycle was sampled: {CHANGE_SPEED}",
            Reason.LOCKED if cycles >= MIN_CYCLES else Reason.COVERAGE,
        )
    if cycles < MIN_CYCLES:
        raise CalibrationError(
            f"the samples cover {cycles:.1f} cycles, too few: at least {MIN_CYCLES:.0f} are needed; "
            f"{CHANGE_SPEED}",
            Reason.CYCLES,
        )


def no_fit(what: str, loss: float) -> CalibrationError:
    """The error for tracks and motion that cannot be separated.

    ``loss``: :func:`.joint.information_loss`.
    """
    if loss > LOCKED_LOSS:
        return CalibrationError(
            f"{what}: the motion is almost locked to the samples; {CHANGE_SPEED}", Reason.LOCKED
        )
    return CalibrationError(
        f"{what}: noise, too much acceleration between samples, or uneven sample times that are not known",
        Reason.NOISE,
    )


def changed(what: str) -> CalibrationError:
    return CalibrationError(
        f"the tracks change during the measurement, {what}: let the electronics warm up, check plugs and "
        "mounting, and measure again",
        Reason.CHANGED,
    )


def judge(found: Calibration, loss: float = 1.0) -> Calibration:
    """The calibration if it is usable, else CalibrationError with it and the reason."""
    try:
        check_distance(found.coverage, found.cycles_used)
        if found.change_rms > MOST_CHANGE_CYCLES:
            raise changed(f"tables of parts of the time differ by {found.change_rms:.1e} cycle rms")
        if found.uncertainty_rms > max(MAX_UNCERTAINTY_CYCLES, found.change_rms):
            size, rms = len(found.table.entries), found.uncertainty_rms
            raise no_fit(f"the table of {size} entries would be uncertain by {rms:.1e} cycle rms", loss)
    except CalibrationError as error:
        refused = replace(found, reason=Reason(error.reason))
        raise CalibrationError(str(error), error.reason, refused) from None
    return found


class Drift(NamedTuple):
    """Difference of two tables, cycles, without its constant part: for the active table its present error.

    rms    over the cycle, weighted by distance
    peak   the largest
    Both contain the uncertainty of the new measurement
    (``uncertainty_rms`` and ``uncertainty_peak`` of :class:`canfb.Calibration`).
    """

    rms: float = 0.0
    peak: float = 0.0


def drift(fresh: Calibration, table: AnyTable, conditioning: Conditioning | None = None) -> Drift:
    """Drift of the encoder measured by ``fresh`` from ``table`` and ``conditioning``.

    ``table`` (or a calibration) and ``conditioning`` are the active ones; None is the identity. The constant
    part of the difference is removed, because the origin of the phase is a convention; with different
    conditionings the phases of the measured tracks are compared. TypeError for other types, ValueError for
    the table of a calibration without its conditioning.
    """
    if not isinstance(fresh, Calibration) or not isinstance(conditioning, Conditioning | None):
        raise TypeError(
            "drift takes a Calibration, a CorrectionTable and a Conditioning, not "
            f"{type(fresh).__name__}, {type(table).__name__} and {type(conditioning).__name__}"
        )
    used = correction_of(table, conditioning)
    active = CorrectionTable.identity() if used.table is None else used.table
    if used.conditioning == fresh.conditioning:  # the difference is linear between the entries of both
        was = raw = np.unique(
            np.concatenate([np.arange(len(one) + 1) / len(one) for one in (active, fresh.table)])
        )
    else:
        sine, cosine = np.append(fresh.tracks, fresh.tracks[:, :1], axis=1)
        was, raw = (raw_phases(*one.apply(sine, cosine)) for one in (used.conditioning, fresh.conditioning))
    now = fresh.table(raw)
    moved = np.abs(wrap(np.diff(now)))
    weights = (np.append(moved, 0.0) + np.append(0.0, moved)) / 2.0
    off = active(was) - now
    nowhere = np.isnan(off)  # the conditioned tracks pass through zero, where there is no phase
    off[nowhere] = 0.0
    off = about_mean(off, weights=weights)
    off -= np.average(off, weights=weights)
    off[nowhere] = 0.5
    first, last = off[:-1], off[1:]
    square = np.average((first * first + first * last + last * last) / 3.0, weights=moved)
    return Drift(float(np.sqrt(square)), float(np.abs(off).max()))


SIGNIFICANT = 3.0


THIRDS, FINE = 3, 9  # parts of the time: thirds show a slow drift best, ninths changes near either end


def largest_change(tables: FloatArray, noise: FloatArray) -> Drift:
    """Largest significant difference of two tables (parts, phases); ``noise``: their errors, rms; cycles."""
    centred = tables - tables.mean(axis=1, keepdims=True)
    found = Drift()
    for first, second in zip(*np.triu_indices(len(centred), 1), strict=True):
        off = centred[first] - centred[second]
        square, expected = float(np.mean(off**2)), float(noise[first] ** 2 + noise[second] ** 2)
        if square > SIGNIFICANT**2 * expected:
            found = max(found, Drift(float(np.sqrt(square - expected)), float(np.abs(off).max())))
    return found
