"""The whole chain for one sample: conditioning, Table 1, correction, eq. 9, supervision."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from canfb.signal.conditioning import IDENTITY, Conditioning
from canfb.signal.correction import CorrectionTable
from canfb.signal.phase import raw_phase
from canfb.signal.recovery import Recovery
from canfb.signal.sample import Sample
from canfb.signal.supervision import MISSED, TABLE_ACTIVE, SampleLimits
from canfb.signal.tracker import RESIDUAL_LIMIT, Track, Tracker, check_residual_limit

# Defaults as parts of the full scale: a usual encoder drives the converter to 60..95 %, and
# with 40 % offset and 20 % amplitude error the raw amplitude still varies between 24 and 120 %.
AMPLITUDE_LOW = 0.2
AMPLITUDE_HIGH = 1.25


@dataclass(frozen=True, kw_only=True)
class ChainConfig:
    """Parameters of the signal chain. Every field has a default; ValueError for a bad one.

    cycles_per_revolution   1..1048576 (2001:01)
    adc_bits                4..16; full scale is 2**(bits - 1) counts (2001:02)
    amplitude_low_counts    lowest accepted amplitude after conditioning (2001:03);
                            None: 0.2 of the full scale
    amplitude_high_counts   highest accepted amplitude (2001:04); None: 1.25 of the full scale
    residual_limit          cycles, 0 < limit <= 0.5 (2010:01, eq. 12)
    coast_samples           0..255 sampling intervals to bridge before the position is lost (2010:03)
    conditioning            offset, gain and phase error of the tracks (2002h)
    """

    cycles_per_revolution: int = 2500
    adc_bits: int = 12
    amplitude_low_counts: int | None = None
    amplitude_high_counts: int | None = None
    residual_limit: float = RESIDUAL_LIMIT
    coast_samples: int = 3
    conditioning: Conditioning = field(default=IDENTITY)

    def __post_init__(self) -> None:
        integer_in("cycles_per_revolution", self.cycles_per_revolution, 1, 1048576)
        integer_in("adc_bits", self.adc_bits, 4, 16)
        integer_in("coast_samples", self.coast_samples, 0, 255)
        check_residual_limit(self.residual_limit)
        if not isinstance(self.conditioning, Conditioning):
            raise ValueError("conditioning must be a Conditioning")
        for name in ("amplitude_low_counts", "amplitude_high_counts"):
            if getattr(self, name) is not None:
                integer_in(name, getattr(self, name), 0, 65535)
        if self.limits.amplitude_low_counts >= self.limits.amplitude_high_counts:
            raise ValueError("amplitude_low_counts must be below amplitude_high_counts")

    @property
    def full_scale_counts(self) -> int:
        """ADC full scale, 2**(adc_bits - 1)."""
        return 1 << (self.adc_bits - 1)

    @property
    def limits(self) -> SampleLimits:
        """The limits of one sample, with the defaults filled in."""
        full, low, high = self.full_scale_counts, self.amplitude_low_counts, self.amplitude_high_counts
        return SampleLimits(
            full,
            round(AMPLITUDE_LOW * full) if low is None else low,
            round(AMPLITUDE_HIGH * full) if high is None else high,
        )


def integer_in(name: str, value: object, low: int, high: int) -> None:
    """ValueError that names the parameter unless ``value`` is a whole number low..high."""
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise ValueError(f"{name} must be a whole number {low}..{high}, not {value!r}")


class Feedback(NamedTuple):
    """Every stage of the chain for one sample.

    sine, cosine     conditioned tracks, counts
    amplitude        of the conditioned tracks, counts
    raw_phase        Table 1, cycles, 0..1; NaN without a phase
    cycles, phase    the position: cycle count and phase (cycles, 0..1). The measured one when
                     the sample was taken, the predicted one while coasting
    residual         eq. 12, cycles, 0..0.5; 0.5 when there was nothing to compare
    status           status word 2011:01 (:class:`canfb.signal.supervision.StatusBit`)
    speed_cycles     speed between the last two good samples, cycles per sampling interval
    samples          samples processed since the start: moves with every call
    """

    sine: float
    cosine: float
    amplitude: float
    raw_phase: float
    cycles: int
    phase: float
    residual: float
    status: int
    speed_cycles: float
    samples: int

    @property
    def valid(self) -> bool:
        """Status bit 0: the position may be used."""
        return bool(self.status & 1)


class SignalChain:
    """One encoder, sample by sample.

    A sample that fails a check is flagged in its own :class:`Feedback` and never moves the
    cycle count; see :mod:`canfb.signal.recovery` for what happens then.
    """

    def __init__(self, config: ChainConfig, table: CorrectionTable | None = None) -> None:
        self._tracker = Tracker(config.residual_limit)
        self._recovery = Recovery(self._tracker, config.coast_samples)
        self._samples = 0
        self._table: CorrectionTable | None = None
        self.set_limits(config.limits, config.residual_limit, config.coast_samples)
        self.activate(table, config.conditioning)

    @property
    def table(self) -> CorrectionTable | None:
        """The active correction table, None for the identity."""
        return self._table

    @property
    def conditioning(self) -> Conditioning:
        """The active conditioning."""
        return self._conditioning

    @property
    def lost(self) -> bool:
        """True from the moment the position is lost until :meth:`restart`."""
        return self._recovery.lost

    def set_limits(self, limits: SampleLimits, residual_limit: float, coast_samples: int) -> None:
        """Take new limits, between two samples. ValueError for a bad one, nothing changed then."""
        self._tracker.residual_limit = check_residual_limit(residual_limit)
        self._limits, self._bounds = limits, limits.bounds
        self._recovery.coast_samples = coast_samples

    def activate(self, table: CorrectionTable | None, conditioning: Conditioning) -> None:
        """Take a table (None: the identity) and a conditioning together, between two samples."""
        self._table = table
        self._conditioning = conditioning
        self._coefficients = conditioning.coefficients()
        self._base_status = 0 if table is None else TABLE_ACTIVE

    def restart(self, cycles: int = 0) -> None:
        """Forget the position: the next good sample starts at standstill with this cycle count."""
        self._recovery.restart(cycles)

    def resume(self) -> None:
        """Go on after a pause in which the machine stood still: less than half a cycle from here.

        A lost position is not picked up again: it starts anew at cycle count 0.
        """
        self._recovery.resume()

    def step(self, sample: Sample) -> Feedback:
        """Take one sample through the whole chain. A bad sample is flagged, it never raises."""
        sine, cosine, elapsed = sample.sine, sample.cosine, sample.elapsed
        offset_s, gain_s, offset_c, factor_c, skew = self._coefficients
        s = (sine - offset_s) * gain_s
        c = (cosine - offset_c) * factor_c - s * skew
        amplitude = math.sqrt(s * s + c * c)
        raw = raw_phase(s, c)
        lowest, highest, smallest, largest = self._bounds
        if lowest < sine < highest and lowest < cosine < highest and smallest <= amplitude <= largest:
            faults = 0
        else:
            faults = self._limits.faults(sine, cosine, amplitude)
        if faults or sample.invalid or raw != raw:
            track, bits = self._recovery.bad(elapsed)
        else:
            table = self._table
            phase = raw if table is None else table.correct(raw)
            track, bits = self._recovery.good(phase, elapsed)
        if elapsed > 1.0:
            bits |= MISSED
        return self._feedback(s, c, amplitude, raw, track, bits | faults)

    def miss(self) -> Feedback:
        """One sampling interval without a sample: the position coasts, flagged."""
        track, bits = self._recovery.bad(1.0)
        return self._feedback(math.nan, math.nan, 0.0, math.nan, track, bits | MISSED)

    def _feedback(
        self, s: float, c: float, amplitude: float, raw: float, track: Track, bits: int
    ) -> Feedback:
        self._samples = samples = self._samples + 1
        cycles, phase, residual, _ = track
        speed = self._tracker.step_cycles
        status = bits | self._base_status
        # The constructor of a named tuple takes twice the time of what it calls.
        return tuple.__new__(
            Feedback, (s, c, amplitude, raw, cycles, phase, residual, status, speed, samples)
        )
