"""The limits of the supervision in a module, 2001h and 2010h."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

from canfb import objects as od
from canfb.master.access import CommissioningError, NodeAccess
from canfb.objects import Multiplexer
from canfb.signal.chain_config import ChainLimits
from canfb.signal.declared import Declared
from canfb.signal.harmonics import Corners
from canfb.signal.supervision import SampleLimits
from canfb.view.module_view import (
    LIMIT_UNITS,
    NOTHING_NARROWS,
    LimitSettings,
    limit_settings,
)

AMPLITUDES = (od.ENCODER_LOWEST_AMPLITUDE, od.ENCODER_HIGHEST_AMPLITUDE)


class LimitObject(NamedTuple):
    """An object that holds a limit; its layout as in struct."""

    place: Multiplexer
    layout: str
    name: str
    unit: str


LIMITS = (
    LimitObject(od.ENCODER_LOWEST_AMPLITUDE, "H", "lowest amplitude", "counts"),
    LimitObject(od.ENCODER_HIGHEST_AMPLITUDE, "H", "highest amplitude", "counts"),
    LimitObject(od.SUPERVISION_RESIDUAL_LIMIT, "H", "residual limit", "1/65536 cycle"),
    LimitObject(od.SUPERVISION_ACCELERATION, "f", "largest acceleration", "rad/s²"),
    LimitObject(od.SUPERVISION_PHASE_ERROR, "H", "phase error", "1/65536 cycle"),
    LimitObject(od.SUPERVISION_FROZEN, "B", "equal samples of a frozen input", "samples"),
    LimitObject(od.SUPERVISION_COARSE_LIMIT, "H", "coarse track limit", "1/65536 revolution"),
    LimitObject(od.SUPERVISION_PERIODS, "B", "periods without SYNC or sample", "periods"),
)
CORNER = LimitObject(od.ENCODER_CORNER_FREQUENCY, "f", "corner frequency", "Hz")
"""Not a limit, but the limits of the amplitude hold for it; an older module does not have it."""
JITTER = LimitObject(od.SUPERVISION_SYNC_JITTER, "f", "jitter of the SYNC", "s")
KINDS = {one.place: one for one in (*LIMITS, CORNER, JITTER)}


@dataclass(frozen=True)
class SupervisionLimits:
    """Values of :data:`LIMITS` in their units, and what the chain needs beside them.

    coast_samples           2010:03
    motion                  noise margin, samples per SYNC, sample times
    noise_cycles            2011:0B; None: not known
    """

    values: Mapping[Multiplexer, float]
    full_scale_counts: int
    cycles_per_revolution: int
    coast_samples: int
    motion: LimitSettings = NOTHING_NARROWS
    noise_cycles: float | None = None

    @classmethod
    def read(cls, module: NodeAccess) -> SupervisionLimits:
        values = {}
        for place, layout, name, _ in LIMITS:
            values[place] = module.read(*place, layout)
            if not math.isfinite(values[place]):
                raise CommissioningError(f"{module.name}: {od.place_text(place)}, {name}, is {values[place]}")
        jitter_s = module.read_known(JITTER.place)  # an older module does not have it
        return cls(
            values if jitter_s is None else {**values, JITTER.place: jitter_s},
            module.integer(*od.ENCODER_FULL_SCALE, "H"),
            module.integer(*od.ENCODER_CYCLES_PER_REVOLUTION, "I"),
            module.integer(*od.SUPERVISION_COAST, "B"),
            limit_settings(module.read_known),
            (module.read_known(od.FEEDBACK_NOISE) or 0) / LIMIT_UNITS or None,
        )

    @property
    def corners(self) -> Corners:
        return Corners(
            self.values.get(CORNER.place, self.motion.corners.corner_hz), self.motion.corners.cosine_corner_hz
        )

    @property
    def settings(self) -> LimitSettings:
        return replace(
            self.motion,
            widest_cycles=self.values[od.SUPERVISION_RESIDUAL_LIMIT] / LIMIT_UNITS,
            acceleration_rad_s2=self.values[od.SUPERVISION_ACCELERATION],
            phase_error_cycles=self.values[od.SUPERVISION_PHASE_ERROR] / LIMIT_UNITS,
        )

    def bounds(self, interval_s: float) -> Declared:
        return self.settings.bounds(self.cycles_per_revolution, interval_s, self.noise_cycles)

    def kept_samples(self, interval_s: float, motion_cycles: float) -> int:
        """Missed or flagged samples in a row, at most 2010:03, with this largest acceleration."""
        return self.chain_limits(interval_s).kept_samples(motion_cycles)

    def changed(self, values: Mapping[Multiplexer, float]) -> SupervisionLimits:
        return replace(self, values={**self.values, **values})

    def acceleration_cycles(self, interval_s: float) -> float:
        """2010:02, cycles per interval squared, 0.0 for none."""
        return self.bounds(interval_s).acceleration or 0.0

    def residual_limit(self, interval_s: float) -> float:
        return self.bounds(interval_s).residual_limit

    def chain_limits(self, interval_s: float) -> ChainLimits:
        """For a chain that gets all samples one by one, ``interval_s`` apart."""
        low, high = (self.values[place] for place in AMPLITUDES)
        return ChainLimits.of(
            self.bounds(interval_s),
            sample=SampleLimits(self.full_scale_counts, low, high),
            cycles_per_revolution=self.cycles_per_revolution,
            coast_samples=min(self.coast_samples * self.motion.samples_per_sync, 255),
            frozen_samples=int(self.values[od.SUPERVISION_FROZEN]),
            coarse_limit_revolutions=self.values[od.SUPERVISION_COARSE_LIMIT] / LIMIT_UNITS,
            corners=self.corners,
        )


def write_limits(module: NodeAccess, limits: Mapping[Multiplexer, float]) -> None:
    """Write and read back; CommissioningError for a difference.

    The lower amplitude limit stays below the upper one at all times.
    """
    places = [place for place in KINDS if place in limits]
    low, high = AMPLITUDES
    if low in limits and high in limits and limits[low] >= module.integer(*high, "H"):
        places.remove(low)
        places.insert(places.index(high) + 1, low)
    if CORNER.place in limits:
        places = _about_the_corner(module, places, limits)
    error = od.SUPERVISION_PHASE_ERROR
    if error in limits and limits[error] > module.integer(*error, "H"):  # it widens what the others narrow
        places.sort(key=lambda place: place != error)
    for place in places:
        layout = KINDS[place].layout
        module.write(*place, layout, limits[place] if layout == "f" else int(limits[place]))
    for place in places:
        there = module.read(*place, KINDS[place].layout)
        if there != limits[place]:
            raise CommissioningError(
                f"{module.name}: {od.place_text(place)} reads {there:g}, not {limits[place]:g} as written"
            )


def _about_the_corner(
    module: NodeAccess, places: list[Multiplexer], limits: Mapping[Multiplexer, float]
) -> list[Multiplexer]:
    low, high = AMPLITUDES
    before, after = float(module.read(*CORNER.place, CORNER.layout)), limits[CORNER.place]
    rises = after > 0.0 and (before == 0.0 or after < before)
    order = [high, CORNER.place, low] if rises else [low, CORNER.place, high]
    first = [place for place in order if place in limits]
    return [*first, *(place for place in places if place not in first)]


def as_real32(value: float) -> float:
    """The value that a REAL32 holds."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0])
