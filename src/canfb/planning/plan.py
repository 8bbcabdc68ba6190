"""A plan: bus, SYNC, modules, motion; the resulting limits with their margins; errors always detected.

The residual of a healthy machine is at most

    a N/(2 pi) T^2  +  4 v u  +  4 e  +  noise

with acceleration a, speed v, phase error e, sampling interval T, and the uncertainty u of the sampling
instant: half the range of the SYNC, with sample times half a unit of these. Phase errors add linearly
for the largest, quadratically for the rms.

n bad samples in a row are harmless if (n + 2) (L + a) <= 1 and floor((n + 2)^2 / 4) (L + a) <= 1, with the
residual limit L and the acceleration a in cycles per interval squared (docs/supervision.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from typing import Any

from canfb.planning.planned_bus import (
    BusLoad,
    PlannedModule,
    Values,
    adc_messages,
    in_order,
    node_messages,
    sync_message,
)
from canfb.signal.limits import (
    ROUNDING,
    RPM as RPM,
    SHARP as SHARP,
    Declared,
    cycles_per_interval_squared,
    max_acceleration,
    max_speed,
    samples_without_harm,
)
from canfb.signal.sample import TICK_S

ROUNDED_AMPLITUDE = 0.75  # default amplitude, part of full scale, that of the simulated encoder
RAW_PHASE_ERROR_CYCLES = 0.0113  # largest error of Table 1, without a correction table
TABLE_PHASE_ERROR_CYCLES = 0.001  # largest error that a reference measurement leaves
PEAK = 6.0  # standard deviations of noise that one of 5e8 healthy samples exceeds
ROUNDING_VARIANCE = 1.0 / 12.0  # counts^2
WEIGHTS, SQUARES = 4.0, 6.0  # sums of the absolute values and the squares of the weights 1, -2, 1 of eq. 9
HALF_TICK_S = TICK_S / 2.0  # largest error about the mean of a sample time, which is rounded down
HALF_A_UNIT = 0.5 / 65536  # rounding of 2010:0C, cycle
SUM_ROUNDING, ROUNDING_CYCLES = 1e-6, 1e-9  # for rounding: a limit equal to the motion holds


@dataclass(frozen=True)
class CountDetection:
    """Detection by the supervision of eq. 12.

    limit_cycles       residual limit L: a smaller jump of the phase may pass
    motion_cycles      part of it used by the motion: largest acceleration, cycles per interval squared
    error_cycles       largest phase error, without noise
    declared           declared limits of machine and encoder: motions considered after a gap
    """

    limit_cycles: float
    motion_cycles: float
    error_cycles: float
    declared: Declared

    @property
    def bad_samples(self) -> int:
        return samples_without_harm(self.limit_cycles + self.motion_cycles)

    @property
    def missed_samples(self) -> int:
        return self.declared.kept_samples(self.motion_cycles)

    def kept_with(self, **declared: Any) -> int:
        """:attr:`missed_samples` with these other values of :class:`Declared`."""
        return replace(self.declared, **declared).kept_samples(self.motion_cycles)

    @property
    def is_declared(self) -> bool:
        return (
            self.motion_cycles <= self.declared.followed + ROUNDING
            and self.error_cycles <= self.declared.phase_error + HALF_A_UNIT
        )

    @property
    def half_cycle(self) -> bool:
        """Whether a jump of half a cycle (both tracks inverted) is detected at once."""
        return self.limit_cycles + self.motion_cycles < 0.5

    @property
    def is_sharp(self) -> bool:
        """Whether L + a is at most 1/6 (docs/supervision.md)."""
        return self.limit_cycles + self.motion_cycles <= SHARP + ROUNDING


class Limited(StrEnum):
    """Quantities with a limit."""

    BUS = "bus load"
    SPEED = "speed"
    ACCELERATION = "acceleration"
    RESIDUAL = "residual"


@dataclass(frozen=True)
class Margin:
    """A given value against its limit.

    module    module that has the limit; None: the bus
    factor    limit / value; inf without limit or value
    """

    limited: Limited
    module: PlannedModule | None
    factor: float

    @property
    def holds(self) -> bool:
        return self.factor >= 1.0


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Input of a plan, and the resulting margins.

    bit_rate        bit/s, 10000..1000000
    sync_hz         SYNC rate
    jitter_s        of the SYNC at its producer, +-
    aperture_s      jitter of the sampling instant, +-, added to the error of the SYNC or sample time
    extra_load      of frames of other nodes, 0..1
    heartbeat_s     of nodes without one, 0.0: none
    modules         at least one
    others          objects of further nodes, by node-ID
    speed_rad_s, acceleration_rad_s2   largest ones of the machine; None: not given
    is_final        these apply even if 2010:02 of a module is larger
    where           origin of these values, for messages
    noise_counts    rms noise of a track before the ADC, counts
    amplitude       of the tracks, relative to full scale
    phase_cycles    largest phase error in eq. 9; None: the usual one, with or without table
    """

    bit_rate: int
    sync_hz: float
    modules: tuple[PlannedModule, ...]
    speed_rad_s: float | None = None
    acceleration_rad_s2: float | None = None
    is_final: bool = False
    where: str = ""
    noise_counts: float = 0.5
    amplitude: float = ROUNDED_AMPLITUDE
    phase_cycles: float | None = None
    jitter_s: float = 0.0
    aperture_s: float = 0.0
    extra_load: float = 0.0
    heartbeat_s: float = 0.0
    others: tuple[tuple[int, Values], ...] = ()

    @cached_property
    def bus(self) -> BusLoad:
        beat_s = self.heartbeat_s
        messages = [sync_message(self.modules[0].values)]
        for one in self.modules:
            messages += node_messages(one.values, one.node_id, sampled=True, heartbeat_s=beat_s)
            messages += [] if one.samples_itself else adc_messages(one.values)
        for node_id, values in self.others:
            messages += node_messages(values, node_id, sampled=False, heartbeat_s=beat_s)
        return BusLoad(self.bit_rate, self.sync_hz, in_order(messages), self.extra_load)

    @cached_property
    def budgets(self) -> tuple[ResidualBudget, ...]:
        return tuple(ResidualBudget(self, module) for module in self.modules)

    @cached_property
    def margins(self) -> tuple[Margin, ...]:
        """All margins, smallest factor first."""
        found = [Margin(Limited.BUS, None, over(1.0, self.bus.load))]
        for budget in self.budgets:
            found += [Margin(limited, budget.module, factor) for limited, factor in budget.margins.items()]
        return tuple(sorted(found, key=lambda margin: margin.factor))

    @property
    def tightest(self) -> Margin:
        return self.margins[0]

    @property
    def holds(self) -> bool:
        return all(margin.holds for margin in self.margins)


@dataclass(frozen=True)
class ResidualBudget:
    """Residual of one module with the motion of the plan, in which missing values count as 0."""

    plan: Plan
    module: PlannedModule

    @property
    def interval_s(self) -> float:
        return 1.0 / self.sample_hz

    @property
    def sample_hz(self) -> float:
        return self.plan.sync_hz * self.module.settings.samples_per_sync

    @cached_property
    def limit_cycles(self) -> float:
        """Residual limit at the given speed: uncertain sample times widen a narrowed limit."""
        return self.module.settings.limit_cycles(
            self.plan.sync_hz, self.measured_noise_cycles, self.plan.speed_rad_s
        )

    @cached_property
    def declared(self) -> Declared:
        return self.module.settings.bounds(self.interval_s, self.measured_noise_cycles)

    def detection(self, limit_cycles: float | None = None) -> CountDetection:
        """Detection with the limit in force, or with ``limit_cycles``."""
        limit = self.limit_cycles if limit_cycles is None else limit_cycles
        return CountDetection(
            limit,
            self.motion_cycles,
            self.phase_error_cycles,
            self.declared if limit == self.limit_cycles else replace(self.declared, residual_limit=limit),
        )

    @property
    def is_narrowed(self) -> bool:
        return self.declared.residual_limit < self.module.settings.widest_cycles

    @cached_property
    def measured_noise_cycles(self) -> float:
        """Rms of the residual without motion (2011:0B)."""
        return math.sqrt(SQUARES) * math.hypot(
            self.phase_noise_cycles, self.phase_error_cycles / math.sqrt(3.0)
        )

    @property
    def has_noise_margin(self) -> bool:
        margin = self.module.settings.noise_margin * self.measured_noise_cycles or math.inf
        return self.is_narrowed and margin < self._declared_cycles

    @property
    def asked_rad_s2(self) -> float | None:
        """Acceleration to follow: the given one, or 2010:02 if larger."""
        given, known = self.plan.acceleration_rad_s2, self.module.settings.acceleration_rad_s2
        return given if self.plan.is_final or not known else max(known, given or 0.0)

    @cached_property
    def sync_jitter_s(self) -> float:
        """Half the range of SYNC jitter by producer and preceding frames; 2010:0D if larger."""
        return max(self.plan.jitter_s + self.plan.bus.sync_delay_s / 2.0, self.module.settings.sync_jitter_s)

    @cached_property
    def uncertainty_s(self) -> float:
        """Half the range of the sampling instant; 0.0 for a module that samples itself."""
        if self.module.samples_itself:
            return 0.0
        jitter_s = 0.0 if self.module.settings.samples_per_sync > 1 else self.sync_jitter_s
        return (self.known_uncertainty_s if self.module.times else jitter_s) + self.plan.aperture_s

    @property
    def known_uncertainty_s(self) -> float:
        """Resolution of sample times, by which the module widens its limit."""
        return HALF_TICK_S if self.module.times and not self.module.samples_itself else 0.0

    @property
    def parts_cycles(self) -> dict[str, float]:
        instants = self.instants_cycles
        return {
            "acceleration": self.motion_cycles,
            "sampling instants": instants,
            "errors of the encoder": self.rest_cycles(instants) - instants,
        }

    @cached_property
    def motion_cycles(self) -> float:
        return cycles_per_interval_squared(
            self.asked_rad_s2 or 0.0, self.module.settings.cycles_per_revolution, self.worst_interval_s
        )

    @cached_property
    def needed_cycles(self) -> float:
        return sum(self.parts_cycles.values())

    @cached_property
    def margins(self) -> dict[Limited, float]:
        each = {
            Limited.SPEED: (self.largest_speed_rad_s, self.plan.speed_rad_s),
            Limited.ACCELERATION: (self.largest_acceleration_rad_s2, self.asked_rad_s2),
            Limited.RESIDUAL: (self.limit_cycles, self.needed_cycles),
        }
        return {what: over(limit, value) for what, (limit, value) in each.items() if value is not None}

    @property
    def equation_rad_s2(self) -> float:
        """Largest acceleration by eq. 12 without errors."""
        return self._acceleration(self.limit_cycles, self.sample_hz)

    @property
    def paper_rad_s2(self) -> float:
        """Largest acceleration by eq. 10."""
        return max_acceleration(self.module.settings.cycles_per_revolution, self.sample_hz)

    @property
    def largest_acceleration_rad_s2(self) -> float:
        """Largest acceleration at the given speed, or a low one if that alone exceeds the limit.

        0.0 if the errors use the whole limit.
        """
        left = self.left_cycles(self.limit_cycles, self.declared.residual_limit)
        return self._acceleration(left, 1.0 / self.worst_interval_s)

    @property
    def equation_speed_rad_s(self) -> float:
        """Largest speed v with 4 v u < L, without other errors; inf if u = 0."""
        return self._speed_beside(0.0)

    @property
    def largest_speed_rad_s(self) -> float:
        """Largest speed at the given acceleration, or without one if that alone exceeds the limit.

        0.0 if the errors use the whole limit, inf if the sampling instants are known.
        """
        left = self.declared.residual_limit - self.motion_cycles
        motion = 0.0 if left < self.rest_cycles(0.0) - ROUNDING_CYCLES else self.motion_cycles
        return self._speed_beside(motion + self.phase_cycles)

    def _speed_beside(self, needed_cycles: float) -> float:
        own_s = self.uncertainty_s - self.known_uncertainty_s
        return min(
            self.speed_rad_s(self.declared.residual_limit - needed_cycles, own_s),
            self.speed_rad_s(self.module.settings.widest_cycles - needed_cycles, self.uncertainty_s),
        )

    @property
    def least_sync_hz(self) -> float:
        """The lowest SYNC rate at which the motion stays within the limit; inf if none suffices.

        Calculated with 2010:01, because a narrowed limit depends on the rate. A speed that alone is too high
        is ignored.
        """
        widest = self.module.settings.widest_cycles
        taken, left = self.motion_cycles, self.left_cycles(widest, widest)
        if not taken:
            return 0.0
        return self.plan.sync_hz * math.sqrt(taken / left) if left > 0.0 else math.inf

    @cached_property
    def off_s(self) -> float:
        """Largest deviation of known sample times from equal intervals, +-.

        0.0 without sample times: the deviation then counts as an error of the position.
        """
        by_sync = self.module.settings.samples_per_sync == 1 and not self.module.samples_itself
        return self.sync_jitter_s if self.module.times and by_sync else 0.0

    @property
    def worst_interval_s(self) -> float:
        """Equal interval with the residual of the worst unequal intervals g, h: a h (g + h) / 2."""
        return math.sqrt((self.interval_s + 2.0 * self.off_s) * (self.interval_s + self.off_s))

    @cached_property
    def phase_noise_cycles(self) -> float:
        """Rms noise of a phase; inf without amplitude."""
        counts = math.sqrt(self.plan.noise_counts**2 + ROUNDING_VARIANCE)
        amplitude = self.plan.amplitude * self.module.settings.sample.full_scale_counts
        return counts / (2.0 * math.pi * amplitude) if amplitude else math.inf

    @property
    def phase_error_cycles(self) -> float:
        """Phase error without noise, given or usual."""
        if self.plan.phase_cycles is not None:
            return self.plan.phase_cycles
        return TABLE_PHASE_ERROR_CYCLES if self.module.has_table else RAW_PHASE_ERROR_CYCLES

    @property
    def phase_cycles(self) -> float:
        """Phase errors in a residual: their largest sum or, with 2010:09, six sigma of its noise."""
        largest = WEIGHTS * self.phase_error_cycles + PEAK * math.sqrt(SQUARES) * self.phase_noise_cycles
        return min(largest, PEAK * self.measured_noise_cycles) if self.has_noise_margin else largest

    @property
    def instants_cycles(self) -> float:
        cycles_per_s = (
            (self.plan.speed_rad_s or 0.0) * self.module.settings.cycles_per_revolution / (2 * math.pi)
        )
        return WEIGHTS * cycles_per_s * self.uncertainty_s

    def rest_cycles(self, instants_cycles: float) -> float:
        """Residual without motion; without a table at least 4 x 2010:0C."""
        uncorrected = self.plan.phase_cycles is None and not self.module.has_table
        rest = self.phase_cycles + instants_cycles
        return max(rest, self._declared_cycles) if uncorrected else rest

    @property
    def _declared_cycles(self) -> float:
        return WEIGHTS * self.module.settings.phase_error_cycles

    def left_cycles(self, limit_cycles: float, slow_limit_cycles: float) -> float:
        """Part of a limit left for motion; if the speed leaves none, the part for a slow machine."""
        left = limit_cycles - self.rest_cycles(self.instants_cycles)
        return left if left > 0.0 else slow_limit_cycles - self.rest_cycles(0.0)

    def speed_rad_s(self, left_cycles: float, uncertainty_s: float) -> float:
        """Speed at which uncertain instants use ``left_cycles``; inf if they are known."""
        if left_cycles <= 0.0:
            return 0.0
        if uncertainty_s <= 0.0:
            return math.inf
        return max_speed(self.module.settings.cycles_per_revolution, uncertainty_s, min(left_cycles, 0.5))

    def _acceleration(self, left_cycles: float, rate_hz: float) -> float:
        cycles = self.module.settings.cycles_per_revolution
        return max_acceleration(cycles, rate_hz, min(left_cycles, 0.5)) if left_cycles > 0.0 else 0.0


def over(limit: float, value: float) -> float:
    """``limit`` / ``value``; inf for value 0 or without limit."""
    if value == 0.0 or math.isinf(limit):
        return math.inf
    factor = limit / value
    return 1.0 if math.isclose(factor, 1.0, rel_tol=SUM_ROUNDING) else factor
