"""Parameters of the signal chain, with their defaults and ranges."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from canfb.checks import integer_in, within
from canfb.signal.adaptation import AdaptConfig
from canfb.signal.conditioning import IDENTITY, Conditioning
from canfb.signal.correction import AnyTable, CorrectionTable, correction_of
from canfb.signal.front_end import NO_LOW_PASS, Corners
from canfb.signal.limits import (
    COAST_SAMPLES,
    DOUBT_ACCELERATION,
    MOST_BAD_SAMPLES,
    MOST_PHASE_ERROR_CYCLES,
    PHASE_ERROR_CYCLES,
    Declared,
)
from canfb.signal.sample import MOST_PER_SYNC
from canfb.signal.supervision import SampleLimits
from canfb.signal.tracker import RESIDUAL_LIMIT, check_residual_limit

# Defaults as parts of the full scale: a usual encoder drives the converter to 60..95 %, and
# with 40 % offset and 20 % amplitude error the raw amplitude still varies between 24 and 120 %.
AMPLITUDE_LOW = 0.2
AMPLITUDE_HIGH = 1.25
MOST_CORNER_HZ = 1e9  # 2001:05


@dataclass(frozen=True, kw_only=True)
class ChainLimits(Declared):
    """Limits that samples are checked against; they may change between two samples (2001h, 2010h).

    Fields as in :class:`ChainConfig` and :class:`Declared`. ValueError for a bad limit.
    """

    sample: SampleLimits
    cycles_per_revolution: int
    frozen_samples: int
    coarse_limit_revolutions: float
    corners: Corners = NO_LOW_PASS

    def __post_init__(self) -> None:
        check_residual_limit(self.residual_limit)
        integer_in("samples_per_sync", self.samples_per_sync, 1, MOST_PER_SYNC)


@dataclass(frozen=True, kw_only=True)
class ChainConfig:
    """Parameters of the signal chain. Every field has a default; ValueError for a bad one.

    cycles_per_revolution   of the encoder, 1..1048576 (2001:01)
    adc_bits                of the converter, 4..16; full scale is 2**(bits - 1) counts (2001:02)
    amplitude_low_counts    lowest accepted amplitude after conditioning, 0..65535 (2001:03);
                            None: 0.2 of the full scale
    amplitude_high_counts   highest accepted amplitude, 0..65535 (2001:04); None: 1.25 of the full scale
    corner_hz               corner frequency of the low-pass of the analog path, 0..1e9 Hz (2001:05), before
                            which the amplitude limits apply; 0: none
    cosine_corner_hz        the same for the cosine track, 0..1e9 Hz (2001:06); 0: equal
    residual_limit          largest accepted residual, 0 < limit <= 0.5 cycles (2010:01, eq. 12)
    coast_samples           0..255 intervals (of SYNC, if any) to bridge until the position is lost (2010:03)
    frozen_samples          0..255 successive repeats that reveal a dead converter, even at whole cycles per
                            sample (2010:04): 16 with half a count of noise. 0: off, for a converter
                            without noise
    coarse_limit_revolutions  largest error of the coarse track, above 0, at most 0.25 (2010:05)
    conditioning            offset, gain and phase error of the tracks, and delays of the analog path (2002h)
    max_acceleration_cycles  largest acceleration of the machine, 0..1000 cycles per interval^2; 0: not known
    phase_error_cycles      largest phase error of a good sample, above 0, at most 0.0625 cycles (2010:0C):
                            of encoder, conditioning and table
    bad_samples             0..8 successive samples that may be bad unnoticed (2010:0A); 0: as many as do no
                            harm
    doubt_acceleration_cycles  acceleration assumed in doubt if max_acceleration is not known, 0..0.5 cycles
                            per interval^2 (2010:0B); 0: none, any gap that two motions fit is a loss
    sync_jitter_s           largest distance of a SYNC from the even grid, 0..1 s (2010:0D); 0: not declared
    interval_s              sampling interval, 0..1000 s, for corner_hz, adapt and the cosine_delay_s of
                            conditioning; 0: not known
    adapt                   follow offset, gain and phase of the tracks slowly (2002:08): bounds of rate and
                            range, or true for the default bounds; false: off
    """

    cycles_per_revolution: int = 2500
    adc_bits: int = 12
    amplitude_low_counts: int | None = None
    amplitude_high_counts: int | None = None
    residual_limit: float = RESIDUAL_LIMIT
    coast_samples: int = COAST_SAMPLES
    frozen_samples: int = 0
    coarse_limit_revolutions: float = 1.0 / 32.0
    conditioning: Conditioning = field(default=IDENTITY)
    max_acceleration_cycles: float = 0.0
    phase_error_cycles: float = PHASE_ERROR_CYCLES
    bad_samples: int = 0
    doubt_acceleration_cycles: float = DOUBT_ACCELERATION
    corner_hz: float = 0.0
    cosine_corner_hz: float = 0.0
    sync_jitter_s: float = 0.0
    interval_s: float = 0.0
    adapt: AdaptConfig | bool = False

    def __post_init__(self) -> None:
        within(
            self,
            cycles_per_revolution=(1, 1048576),
            adc_bits=(4, 16),
            coast_samples=(0, 255),
            frozen_samples=(0, 255),
            bad_samples=(0, MOST_BAD_SAMPLES),
            max_acceleration_cycles=(0.0, 1000.0),
            phase_error_cycles=(0.0, MOST_PHASE_ERROR_CYCLES),
            doubt_acceleration_cycles=(0.0, 0.5),
            corner_hz=(0.0, MOST_CORNER_HZ),
            cosine_corner_hz=(0.0, MOST_CORNER_HZ),
            sync_jitter_s=(0.0, 1.0),
            interval_s=(0.0, 1000.0),
            amplitude_low_counts=(0, 65535),
            amplitude_high_counts=(0, 65535),
        )
        object.__setattr__(self, "residual_limit", check_residual_limit(self.residual_limit))
        limit = self.coarse_limit_revolutions
        if not isinstance(limit, (int, float)) or not 0.0 < limit <= 0.25:
            raise ValueError(f"coarse_limit_revolutions must be above 0 and at most 0.25, not {limit!r}")
        if not self.phase_error_cycles:
            raise ValueError("phase_error_cycles must be above 0: no encoder is without")
        if not isinstance(self.conditioning, Conditioning):
            raise ValueError("conditioning must be a Conditioning")
        if not isinstance(self.adapt, (AdaptConfig, bool)):
            raise ValueError(f"adapt must be true, false or a mapping with its bounds, not {self.adapt!r}")
        if self.limits.amplitude_low_counts >= self.limits.amplitude_high_counts:
            raise ValueError("amplitude_low_counts must be below amplitude_high_counts")

    @property
    def adaptation(self) -> AdaptConfig | None:
        """The bounds of ``adapt``; None: off."""
        return AdaptConfig() if self.adapt is True else self.adapt or None

    @property
    def full_scale_counts(self) -> int:
        """ADC full scale, 2**(adc_bits - 1)."""
        return 1 << (self.adc_bits - 1)

    @property
    def limits(self) -> SampleLimits:
        """The limits of one sample, counts, with the defaults filled in."""
        full, low, high = self.full_scale_counts, self.amplitude_low_counts, self.amplitude_high_counts
        return SampleLimits(
            full,
            round(AMPLITUDE_LOW * full) if low is None else low,
            round(AMPLITUDE_HIGH * full) if high is None else high,
        )

    @property
    def chain_limits(self) -> ChainLimits:
        """All limits, with the residual limit narrowed by the declared bounds."""
        acceleration = self.max_acceleration_cycles or None
        widest, error = self.residual_limit, self.phase_error_cycles
        limit = widest if acceleration is None else min(widest, acceleration + 4.0 * error)
        return ChainLimits(
            sample=self.limits,
            cycles_per_revolution=self.cycles_per_revolution,
            residual_limit=limit,
            widest_limit=self.residual_limit,
            acceleration=acceleration,
            phase_error=self.phase_error_cycles,
            bad=self.bad_samples,
            doubt_acceleration=self.doubt_acceleration_cycles,
            coast_samples=self.coast_samples,
            frozen_samples=self.frozen_samples,
            coarse_limit_revolutions=self.coarse_limit_revolutions,
            corners=Corners(self.corner_hz, self.cosine_corner_hz),
        )


def with_correction(config: ChainConfig, table: AnyTable) -> tuple[ChainConfig, CorrectionTable | None]:
    """``config`` with the conditioning of ``table`` if that is a calibration, and the table alone.

    TypeError unless ``config`` is a ChainConfig; errors of :func:`.correction_of`.
    """
    if not isinstance(config, ChainConfig):
        raise TypeError(f"config must be a ChainConfig, not {type(config).__name__}")
    used = correction_of(table, None if config.conditioning.is_identity else config.conditioning)
    return replace(config, conditioning=used.conditioning), used.table
