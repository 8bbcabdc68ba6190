"""How near a replay came to its limits."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from canfb.objects import StatusBit
from canfb.replay.sample_columns import Block

BoolArray = npt.NDArray[np.bool_]


@dataclass
class Extreme:
    """The value that came nearest to its limit: when (stamp of the log, seconds), and the limit then.

    ``margin`` is the part of the limit that was left, 1 - value/limit (limit/value for a lower limit);
    below 0 it was passed. NaN before there was any value.
    """

    value: float = math.nan
    limit: float = math.nan
    time_s: float = math.nan
    margin: float = math.nan

    def look(self, block: Block, value: npt.NDArray[np.float64], limit: npt.NDArray[np.float64]) -> None:
        """At more values with their limits; NaN is none."""
        with np.errstate(divide="ignore", invalid="ignore"):
            self._take(block["time_s"], value, limit, 1.0 - value / limit)

    def look_above(
        self, block: Block, value: npt.NDArray[np.float64], limit: npt.NDArray[np.float64]
    ) -> None:
        """The same for a lower limit."""
        with np.errstate(divide="ignore", invalid="ignore"):
            self._take(block["time_s"], value, limit, 1.0 - limit / value)

    def _take(self, times: npt.NDArray[np.float64], value: object, limit: object, margin: object) -> None:
        values, limits = np.asarray(value, np.float64), np.asarray(limit, np.float64)
        margins = np.where(np.isfinite(values) & np.isfinite(limits), np.asarray(margin, np.float64), np.nan)
        if np.isnan(margins).all():
            return
        place = int(np.nanargmin(margins))
        if not self.margin <= margins[place]:
            self.value, self.limit = float(values[place]), float(limits[place])
            self.time_s, self.margin = float(times[place]), float(margins[place])


@dataclass
class Margins:
    """Of all samples that came, also of those before the newest of a SYNC.

    residual          cycles, against the residual limit; while the position was followed
    amplitude_low, amplitude_high   counts, after conditioning
    acceleration      cycles per interval squared, against the residual limit: what eq. 9 leaves of an
                      acceleration is the residual (eq. 10)
    machine_acceleration   the same against 2010:02, if that is set
    speed_rad_s       the largest; its limit is what the SYNC jitter allows, inf with sample times
    acceleration_rad_s2    the largest
    """

    residual: Extreme = field(default_factory=Extreme)
    amplitude_low: Extreme = field(default_factory=Extreme)
    amplitude_high: Extreme = field(default_factory=Extreme)
    acceleration: Extreme = field(default_factory=Extreme)
    machine_acceleration: Extreme = field(default_factory=Extreme)
    speed_rad_s: Extreme = field(default_factory=Extreme)
    acceleration_rad_s2: float = 0.0
    max_speed_rad_s: float = math.inf
    """What the jitter allows, as the module last knew it; set by the replay."""

    def take(self, block: Block) -> None:
        """More samples."""
        status = block["status"]
        came = status & StatusBit.MISSED == 0
        followed = came & (status & (StatusBit.COASTING | StatusBit.LOST) == 0)
        limit = block["residual_limit"]
        # A residual over its limit is coasted over: it counts as well. Samples coasted for another reason
        # have none.
        compared = came & (status & StatusBit.LOST == 0) & ((followed) | (status & StatusBit.RESIDUAL != 0))
        residual = _where(compared & (block["samples"] > 2), block["residual"])
        self.residual.look(block, residual, limit)
        amplitude = _where(came, block["amplitude_counts"])
        self.amplitude_low.look_above(block, amplitude, block["amplitude_low_counts"].astype(np.float64))
        self.amplitude_high.look(block, amplitude, block["amplitude_high_counts"].astype(np.float64))
        self._take_motion(block, followed & (status & StatusBit.VALID != 0))

    def _take_motion(self, block: Block, valid: BoolArray) -> None:
        acceleration = _where(valid, np.abs(block["acceleration_cycles"]))
        self.acceleration.look(block, acceleration, block["residual_limit"])
        known = block["acceleration_limit_cycles"]
        self.machine_acceleration.look(block, acceleration, _where(known > 0.0, known))
        interval_s = _where(valid & (block["interval_s"] > 0.0), block["interval_s"])
        rad = 2.0 * math.pi / block["cycles_per_revolution"]
        speed = np.abs(block["speed_cycles"]) * rad / interval_s
        fastest = np.full(len(speed), self.max_speed_rad_s)
        if math.isinf(self.max_speed_rad_s):
            self._note_speed(block, speed)
        else:
            self.speed_rad_s.look(block, speed, fastest)
        squared = acceleration * rad / interval_s**2
        if not np.isnan(squared).all():
            self.acceleration_rad_s2 = max(self.acceleration_rad_s2, float(np.nanmax(squared)))

    def _note_speed(self, block: Block, speed: npt.NDArray[np.float64]) -> None:
        if np.isnan(speed).all():
            return
        place = int(np.nanargmax(speed))
        if not self.speed_rad_s.value >= speed[place]:
            self.speed_rad_s = Extreme(float(speed[place]), math.inf, float(block["time_s"][place]), 1.0)


def _where(chosen: BoolArray, values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return np.where(chosen, values, np.nan)
