"""The limits of the supervision in a module, 2001h and 2010h: read, written, and put to the chain."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

from canfb import objects as od
from canfb.commissioning.access import CommissioningError, NodeAccess
from canfb.objects import Multiplexer
from canfb.signal.chain_config import ChainLimits
from canfb.signal.limits import cycles_per_interval_squared, narrowed_residual_limit
from canfb.signal.supervision import SampleLimits

LIMIT_UNITS = 65536  # of a cycle in 2010:01, of a revolution in 2010:05
AMPLITUDES = (od.ENCODER_LOWEST_AMPLITUDE, od.ENCODER_HIGHEST_AMPLITUDE)


class LimitObject(NamedTuple):
    """An object that holds a limit: its layout as in struct, its name and the unit of its value."""

    place: Multiplexer
    layout: str
    name: str
    unit: str


LIMITS = (
    LimitObject(od.ENCODER_LOWEST_AMPLITUDE, "H", "lowest amplitude", "counts"),
    LimitObject(od.ENCODER_HIGHEST_AMPLITUDE, "H", "highest amplitude", "counts"),
    LimitObject(od.SUPERVISION_RESIDUAL_LIMIT, "H", "residual limit", "1/65536 cycle"),
    LimitObject(od.SUPERVISION_ACCELERATION, "f", "largest acceleration", "rad/s²"),
    LimitObject(od.SUPERVISION_FROZEN, "B", "equal samples of a frozen input", "samples"),
    LimitObject(od.SUPERVISION_COARSE_LIMIT, "H", "coarse track limit", "1/65536 revolution"),
    LimitObject(od.SUPERVISION_PERIODS, "B", "periods without SYNC or sample", "periods"),
)
KINDS = {one.place: one for one in LIMITS}


@dataclass(frozen=True)
class SupervisionLimits:
    """Values of :data:`LIMITS`, and what the chain has to know beside them.

    values                  by object, in its unit
    full_scale_counts       2001:02
    cycles_per_revolution   2001:01
    coast_samples           2010:03
    """

    values: Mapping[Multiplexer, float]
    full_scale_counts: int
    cycles_per_revolution: int
    coast_samples: int

    @classmethod
    def read(cls, module: NodeAccess) -> SupervisionLimits:
        """From the module. CommissioningError if an object cannot be read, or holds no number."""
        values = {}
        for place, layout, name, _ in LIMITS:
            values[place] = module.read(*place, layout)
            if not math.isfinite(values[place]):
                raise CommissioningError(f"{module.name}: {place_words(place)}, {name}, is {values[place]}")
        return cls(
            values,
            module.integer(*od.ENCODER_FULL_SCALE, "H"),
            module.integer(*od.ENCODER_CYCLES_PER_REVOLUTION, "I"),
            module.integer(*od.SUPERVISION_COAST, "B"),
        )

    def changed(self, values: Mapping[Multiplexer, float]) -> SupervisionLimits:
        """With other values for some of the objects."""
        return replace(self, values={**self.values, **values})

    def acceleration_cycles(self, interval_s: float) -> float:
        """2010:02 in cycles per interval squared; 0.0: not known."""
        largest = self.values[od.SUPERVISION_ACCELERATION]
        return cycles_per_interval_squared(largest, self.cycles_per_revolution, interval_s)

    def residual_limit(self, interval_s: float) -> float:
        """The residual limit in force, cycles: 2010:01, narrowed by 2010:02."""
        limit = self.values[od.SUPERVISION_RESIDUAL_LIMIT] / LIMIT_UNITS
        largest = self.values[od.SUPERVISION_ACCELERATION]
        return narrowed_residual_limit(limit, largest, self.cycles_per_revolution, interval_s)

    def chain_limits(self, interval_s: float) -> ChainLimits:
        """As the module puts them in force at this sampling interval."""
        low, high = (self.values[place] for place in AMPLITUDES)
        return ChainLimits(
            sample=SampleLimits(self.full_scale_counts, low, high),
            cycles_per_revolution=self.cycles_per_revolution,
            residual_limit=self.residual_limit(interval_s),
            coast_samples=self.coast_samples,
            frozen_samples=int(self.values[od.SUPERVISION_FROZEN]),
            coarse_limit_revolutions=self.values[od.SUPERVISION_COARSE_LIMIT] / LIMIT_UNITS,
            acceleration=self.acceleration_cycles(interval_s) or None,
        )


def write_limits(module: NodeAccess, wanted: Mapping[Multiplexer, float]) -> None:
    """Write these objects and read them back. CommissioningError for what does not read as written.

    The lower amplitude limit stays below the upper one at every moment.
    """
    places = [place for place in KINDS if place in wanted]
    low, high = AMPLITUDES
    if low in wanted and high in wanted and wanted[low] >= module.integer(*high, "H"):
        places.remove(low)
        places.insert(places.index(high) + 1, low)
    for place in places:
        layout = KINDS[place].layout
        module.write(*place, layout, wanted[place] if layout == "f" else int(wanted[place]))
    for place in places:
        there = module.read(*place, KINDS[place].layout)
        if there != wanted[place]:
            raise CommissioningError(
                f"{module.name}: {place_words(place)} reads {there:g}, not {wanted[place]:g} as written"
            )


def as_real32(value: float) -> float:
    """The value that a REAL32 holds in its place."""
    held: float = struct.unpack("<f", struct.pack("<f", value))[0]
    return held


def place_words(place: Multiplexer) -> str:
    """2010:01."""
    return f"{place.object_index:04X}:{place.subindex:02X}"
