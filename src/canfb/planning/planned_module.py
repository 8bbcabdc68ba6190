"""One module of a plan, by its objects: those of the configuration, or what was saved over them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from canfb import objects as od
from canfb.device.od.dcf import Place
from canfb.module.parameters import LIMIT_UNITS, TIMED
from canfb.planning.traffic import Values, mapped_objects, valid_pdos
from canfb.signal.limits import limit_narrowed_by_jerk, narrowed_residual_limit
from canfb.signal.third_order import THIRD


@dataclass(frozen=True, kw_only=True)
class PlannedModule:
    """A feedback module.

    node_id           1..127
    values            its objects, as a master would write them
    has_table         a correction table is in force
    samples_itself    a source in place of the ADC PDO
    """

    node_id: int
    values: Values = field(repr=False)
    has_table: bool = False
    samples_itself: bool = False

    @property
    def cycles_per_revolution(self) -> int:
        """2001:01."""
        return int(self.values[od.ENCODER_CYCLES_PER_REVOLUTION])

    @property
    def full_scale_counts(self) -> int:
        """2001:02."""
        return int(self.values[od.ENCODER_FULL_SCALE])

    @property
    def amplitude_limits_counts(self) -> tuple[int, int]:
        """2001:03 and 2001:04."""
        low, high = od.ENCODER_LOWEST_AMPLITUDE, od.ENCODER_HIGHEST_AMPLITUDE
        return int(self.values[low]), int(self.values[high])

    @property
    def frozen_samples(self) -> int:
        """2010:04, 0 is off."""
        return int(self.values[od.SUPERVISION_FROZEN])

    @property
    def widest_limit_cycles(self) -> float:
        """2010:01, the residual limit without narrowing."""
        return float(self.values[od.SUPERVISION_RESIDUAL_LIMIT]) / LIMIT_UNITS

    @property
    def known_acceleration_rad_s2(self) -> float:
        """2010:02, 0.0: not known."""
        return float(self.values[od.SUPERVISION_ACCELERATION])

    @property
    def known_jerk_rad_s3(self) -> float:
        """2010:08, 0.0: not known."""
        return float(self.values[od.SUPERVISION_JERK])

    @property
    def is_third_order(self) -> bool:
        """2010:07: the prediction has constant acceleration."""
        return int(self.values[od.SUPERVISION_ORDER]) == THIRD

    def residual_limit_cycles(self, interval_s: float) -> float:
        """The residual limit in force at this sampling interval."""
        widest, cycles = self.widest_limit_cycles, self.cycles_per_revolution
        if self.is_third_order:
            return limit_narrowed_by_jerk(widest, self.known_jerk_rad_s3, cycles, interval_s)
        return narrowed_residual_limit(widest, self.known_acceleration_rad_s2, cycles, interval_s)

    @cached_property
    def times(self) -> bool:
        """The ADC PDO brings the time of each sample, or the module takes the sample itself."""
        wanted = od.SAMPLE_TIME.mapped(32)
        return self.samples_itself or any(
            wanted in mapped_objects(self.values, od.RPDO_MAPPING + number - 1)
            for number, _ in valid_pdos(self.values, od.RPDO)
        )

    def with_values(self, values: Mapping[Place, Any]) -> PlannedModule:
        """The same with other values of these objects."""
        return replace(self, values={**self.values, **values})

    def with_times(self) -> PlannedModule:
        """The same with ``times: true``."""
        return self if self.times else self.with_values(TIMED)
