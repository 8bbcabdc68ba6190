"""The simulated machine as a source."""

from __future__ import annotations

from dataclasses import dataclass

from canfb.checks import number_in
from canfb.sources.protocol import Source, SourceConfig, Surroundings


@dataclass(frozen=True, kw_only=True)
class MotionSourceConfig(SourceConfig):
    """The machine of the ``simulation:`` section.

    rate_hz   samples per second, 0.1..100000
    """

    kind: str = "motion"
    rate_hz: float = 1000.0

    def __post_init__(self) -> None:
        super().__post_init__()
        number_in("rate_hz", self.rate_hz, 0.1, 100_000.0)

    def open(self, surroundings: Surroundings) -> Source:
        return surroundings.simulated(
            surroundings.adc_bits, surroundings.cycles_per_revolution, 1.0 / self.rate_hz
        )
