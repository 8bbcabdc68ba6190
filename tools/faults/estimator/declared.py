"""What is declared of a machine, and the chain that is configured with it.

:func:`config_of` and :func:`limits_of` are the only places that know how a chain gets its limits.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from canfb import CorrectionTable, SignalChain
from canfb.signal.chain_config import ChainConfig, ChainLimits
from canfb.signal.limits import PHASE_ERROR_CYCLES, samples_without_harm

RESIDUAL_LIMIT = 1.0 / 3.0
COAST_SAMPLES = 8
MOST_BAD = 3


@dataclass(frozen=True)
class Declared:
    """The largest acceleration, cycles per interval^2.

    phase_error     largest error of the phase of a good sample, cycles
    bad_samples     how many neighbouring samples may be bad without a sign of it; None: see ``bad``
    samples_per_sync  intervals are those from sample to sample
    """

    acceleration: float
    phase_error: float = PHASE_ERROR_CYCLES
    bad_samples: int | None = None
    samples_per_sync: int = 1

    @property
    def bad(self) -> int:
        """``bad_samples``, by default as many as cannot do harm at twice the acceleration, 1 to 3."""
        if self.bad_samples is not None:
            return self.bad_samples
        return max(1, min(MOST_BAD, samples_without_harm(2.0 * self.acceleration)))

    @property
    def residual_limit(self) -> float:
        """Of eq. 9: the motion and the errors of all phases in it."""
        return min(RESIDUAL_LIMIT, self.acceleration + 4.0 * self.phase_error)


def config_of(declared: Declared) -> ChainConfig:
    """As far as a :class:`ChainConfig` can say it: the rest is in :func:`limits_of`."""
    return ChainConfig(
        coast_samples=COAST_SAMPLES,
        max_acceleration_cycles=declared.acceleration,
        phase_error_cycles=declared.phase_error,
        bad_samples=declared.bad,
    )


def limits_of(declared: Declared) -> ChainLimits:
    """All limits, to be given to :meth:`SignalChain.set_limits`."""
    return replace(config_of(declared).chain_limits, samples_per_sync=declared.samples_per_sync)


def make_chain(declared: Declared, table: CorrectionTable | None = None) -> SignalChain:
    """A chain for this machine: coasts for 8 samples, otherwise the defaults."""
    chain = SignalChain(config_of(declared), table)
    chain.set_limits(limits_of(declared))
    return chain
