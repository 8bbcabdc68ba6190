"""One module of a plan, by its objects: those of the configuration, or what was saved over them.

:func:`laid_out` gives the RPDOs that bring its samples another layout.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from canfb import objects as od
from canfb.cia301 import cob
from canfb.cia301.frame import mapping_values
from canfb.device.od.dcf import Place
from canfb.planning.traffic import Values
from canfb.view.limits_in_force import LimitSettings, limit_settings
from canfb.view.pdo_map import Pdo, valid_pdos

NEWEST = (od.SAMPLE_SINE, od.SAMPLE_COSINE)
TIME = od.SAMPLE_TIME.mapped(32)
NODE_ID = 0x7F


def _of_samples(values: Values) -> list[Pdo]:
    pdos = valid_pdos(values.get, od.RPDO, od.RPDO_MAPPING)
    return [pdo for pdo in pdos if pdo.carries(od.SAMPLE_SINE.object_index)]


def laid_out(values: Values, pairs: int, times: bool) -> dict[Place, Any]:
    """The objects of the RPDOs with ``pairs`` 1..8 pairs of each SYNC, and the time of the newest or not.

    What else they bring stays. RPDOs of the same interface come first, then free ones. ValueError if there
    are too few.
    """
    pdos = _of_samples(values)
    tracks = next((pdo for pdo in pdos if {one.mapped(16) for one in NEWEST} <= set(pdo.entries)), None)
    if tracks is None:
        raise ValueError("samples_per_sync needs an RPDO that brings 2000:01 and 2000:02")
    interface = tracks.can_id & NODE_ID
    own = [pdo for pdo in pdos if pdo.can_id & NODE_ID == interface]
    entries = [one.mapped(16) for pair in (NEWEST, *od.SAMPLE_EARLIER)[:pairs] for one in pair]
    entries += [TIME] if times else []
    known = {one.mapped(16) for pair in (NEWEST, *od.SAMPLE_EARLIER) for one in pair} | {TIME}
    entries += [entry for pdo in own for entry in pdo.entries if entry not in known]
    return _filled(values, [pdo.number for pdo in own], interface, entries)


def _filled(values: Values, own: list[int], interface: int, entries: list[int]) -> dict[Place, Any]:
    """These entries in the RPDOs ``own`` of an interface, and in others that are not valid."""
    in_use = {pdo.number for pdo in valid_pdos(values.get, od.RPDO, od.RPDO_MAPPING)}
    free = [number for number in range(1, len(cob.TPDOS) + 1) if number not in in_use]
    numbers = own + [number for number in free if (od.RPDO + number - 1, 1) in values]
    changed: dict[Place, Any] = {}
    pdos = mapping_values(0, entries)  # by the place of the PDO among ``numbers``
    needed = 1 + max(place for place, _ in pdos)
    if needed > len(numbers):
        raise ValueError(f"the samples need {needed} RPDOs, and there are {len(numbers)} for them")
    for (place, subindex), value in pdos.items():
        changed[od.RPDO_MAPPING + numbers[place] - 1, subindex] = value
    for number in numbers[len(own) : needed]:
        changed[od.RPDO + number - 1, 1] = cob.TPDOS[number - 1] + interface
    for number in own[needed:]:
        changed[od.RPDO + number - 1, 1] = cob.NOT_VALID | values[od.RPDO + number - 1, 1]
    return changed


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
        """2010:01."""
        return self.settings.widest_cycles

    @property
    def known_acceleration_rad_s2(self) -> float:
        """2010:02, 0.0: not known."""
        return self.settings.acceleration_rad_s2

    @cached_property
    def settings(self) -> LimitSettings:
        return limit_settings(self.values.get)

    @property
    def coast_samples(self) -> int:
        """2010:03, in intervals from sample to sample."""
        return int(self.values[od.SUPERVISION_COAST]) * self.samples_per_sync

    @property
    def declared_jitter_s(self) -> float:
        """2010:0D, 0.0: not declared."""
        return float(self.values[od.SUPERVISION_SYNC_JITTER])

    @cached_property
    def times(self) -> bool:
        return self.samples_itself or self.settings.timed

    @cached_property
    def samples_per_sync(self) -> int:
        return 1 if self.samples_itself else self.settings.samples_per_sync

    @property
    def sample_bytes(self) -> int:
        return 0 if self.samples_itself else sum(pdo.length_bytes for pdo in _of_samples(self.values))

    def with_values(self, values: Mapping[Place, Any]) -> PlannedModule:
        return replace(self, values={**self.values, **values})

    def with_times(self) -> PlannedModule:
        """``times: true``. ValueError without room in the RPDOs."""
        if self.times:
            return self
        return self.with_values(laid_out(self.values, self.samples_per_sync, times=True))

    def with_samples(self, per_sync: int) -> PlannedModule:
        """``samples_per_sync``, 1..8. ValueError without room in the RPDOs."""
        if self.samples_itself or per_sync == self.samples_per_sync:
            return self
        return self.with_values(laid_out(self.values, per_sync, self.times))
