"""From configuration to object dictionary (factory defaults), and from there to the chain (limits in force).

A configuration replaces defaults of the EDS; after that the dictionary alone is read.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from canfb import objects as od
from canfb.cia301 import cob
from canfb.device.od.dictionary import Dictionary, refuse_if
from canfb.eds_files import eds_path
from canfb.module.cia406.position import distinguishable_revolutions, single_turn_resolution
from canfb.module.interval import SamplingInterval
from canfb.module.module_config import MOST_ACCELERATION_RAD_S2, MOST_DECLARED_S, WRITE_LOCKS, ModuleConfig
from canfb.signal.chain import SignalChain
from canfb.signal.chain_config import MOST_CORNER_HZ
from canfb.signal.residual_noise import ResidualNoise
from canfb.view.module_view import LIMIT_UNITS, limit_settings, values_of

EDS = "canfb-module"
Values = dict[tuple[int, int], Any]  # of objects, by index and sub-index

# Fields of canfb.AdaptConfig, in units of 0.1 % or 1 mrad.
ADAPTATION_BOUNDS = {
    "offset": od.ADAPTATION_OFFSET_LIMIT,
    "gain": od.ADAPTATION_GAIN_LIMIT,
    "phase_rad": od.ADAPTATION_PHASE_LIMIT,
    "rate_per_hour": od.ADAPTATION_RATE_LIMIT,
}
ADAPTATION_UNIT = 1e-3

# Fields of SecondSensor.
SECOND_SENSOR = {
    "increments": od.SECOND_INCREMENTS,
    "revolutions": od.SECOND_REVOLUTIONS,
    "reversed": od.SECOND_REVERSED,
    "tolerance_revolutions": od.SECOND_TOLERANCE,
    "invalidates": od.SECOND_INVALIDATES,
}

# Fields of ModuleConfig that an object holds in the same unit.
SAME_UNIT = {
    "serial_number": od.IDENTITY_SERIAL_NUMBER,
    "cycles_per_revolution": od.ENCODER_CYCLES_PER_REVOLUTION,
    "corner_hz": od.ENCODER_CORNER_FREQUENCY,
    "cosine_corner_hz": od.ENCODER_COSINE_CORNER_FREQUENCY,
    "max_acceleration_rad_s2": od.SUPERVISION_ACCELERATION,
    "coast_samples": od.SUPERVISION_COAST,
    "frozen_samples": od.SUPERVISION_FROZEN,
    "noise_margin": od.SUPERVISION_NOISE_MARGIN,
    "bad_samples": od.SUPERVISION_BAD_SAMPLES,
    "sync_jitter_s": od.SUPERVISION_SYNC_JITTER,
    "answer_delay_s": od.SUPERVISION_ANSWER_DELAY,
    "sync_timeout_periods": od.SUPERVISION_PERIODS,
    "unlock_code": od.WRITE_LOCK_NEW_UNLOCK_CODE,
}


def factory_dictionary(config: ModuleConfig, *, samples_itself: bool = False) -> Dictionary:
    """The EDS with the defaults of ``config``; ``samples_itself``: a source replaces the ADC PDO."""
    dictionary = Dictionary.load(eds_path(EDS), config.node_id)
    apply_defaults(dictionary, configured_defaults(config))
    if samples_itself:  # its ADC PDOs are not valid
        pdos = {place: value for place, value in adc_pdos(config).items() if place[0] < od.RPDO_MAPPING}
        apply_defaults(dictionary, {place: cob.NOT_VALID | value for place, value in pdos.items()})
    return dictionary


def configured_defaults(config: ModuleConfig) -> Values:
    limits = config.limits
    resolution = single_turn_resolution(config.cycles_per_revolution)
    revolutions = distinguishable_revolutions(resolution)
    return {
        **adc_pdos(config),
        **_second_position(config),
        **{place: getattr(config, name) for name, place in SAME_UNIT.items()},
        **dict(zip(od.CONDITIONING, config.conditioning.values, strict=True)),
        **_adaptation(config),
        od.SERIAL_NUMBER: config.serial_number,
        od.ENCODER_FULL_SCALE: limits.full_scale_counts,
        od.ENCODER_LOWEST_AMPLITUDE: limits.amplitude_low_counts,
        od.ENCODER_HIGHEST_AMPLITUDE: limits.amplitude_high_counts,
        od.SUPERVISION_RESIDUAL_LIMIT: int(config.residual_limit * LIMIT_UNITS),
        od.SUPERVISION_COARSE_LIMIT: max(1, round(config.coarse_limit_revolutions * LIMIT_UNITS)),
        od.SUPERVISION_DOUBT_ACCELERATION: round(config.doubt_acceleration_cycles * LIMIT_UNITS),
        od.SUPERVISION_PHASE_ERROR: max(1, round(config.phase_error_cycles * LIMIT_UNITS)),
        od.PREDICTION_POSITION: int(config.predict),
        od.PREDICTION_NOMINAL_SYNC: int(config.nominal_sync),
        od.WRITE_LOCK_MODE: int(WRITE_LOCKS[config.write_lock]),
        od.UNITS_PER_REVOLUTION: resolution,
        od.TOTAL_RANGE: resolution * revolutions,
        od.SINGLE_TURN_RESOLUTION: resolution,
        od.DISTINGUISHABLE_REVOLUTIONS: revolutions,
    }


def _adaptation(config: ModuleConfig) -> Values:
    used = config.adaptation
    if used is None:
        return {od.ADAPTATION: 0}
    bounds = {place: getattr(used, name) for name, place in ADAPTATION_BOUNDS.items()}
    # A small bound must not be rounded to 0, which would turn it off.
    return {od.ADAPTATION: 1} | {
        place: max(1, round(value / ADAPTATION_UNIT)) if value else 0 for place, value in bounds.items()
    }


def adc_pdos(config: ModuleConfig) -> Values:
    pairs = [(od.SAMPLE_SINE, od.SAMPLE_COSINE), *od.SAMPLE_EARLIER][: config.samples_per_sync]
    times = [od.SAMPLE_TIME] if config.times else []
    return {**od.sample_pdos(od.RPDO, od.RPDO_MAPPING, pairs, times, config.encoder_interface)}


def _second_position(config: ModuleConfig) -> Values:
    second = config.second_position
    if second is None:
        return {}
    defaults: Values = {place: getattr(second, name) for name, place in SECOND_SENSOR.items()}
    if second.cob_id is not None:
        defaults[od.RPDO + config.adc_pdos, 1] = second.cob_id
        mapping = [len(second.mapping), *second.mapping]
        defaults |= {(od.RPDO_MAPPING + config.adc_pdos, n): entry for n, entry in enumerate(mapping)}
    return defaults


def apply_defaults(dictionary: Dictionary, defaults: Values) -> None:
    """Replace the defaults, to which a reset returns, and the values.

    They hold for any node-ID: the COB-ID of another node does not follow the node-ID of this one.
    """
    for (index, subindex), value in defaults.items():
        entry = dictionary.entry(index, subindex)
        entry.default, entry.follows_node_id = value, False
        entry.reset()


# Relative changes of the interval below which limits, and coefficients of the analog path, are kept.
SAME_NARROWED, SAME_ANALOG = 0.002, 2e-4
SAME_NOISE = 0.02  # relative change of the noise below which limits are kept

# Ranges of objects that the EDS does not limit.
RANGES: dict[od.Multiplexer, tuple[float, float]] = {
    od.ENCODER_CORNER_FREQUENCY: (0.0, MOST_CORNER_HZ),
    od.ENCODER_COSINE_CORNER_FREQUENCY: (0.0, MOST_CORNER_HZ),
    od.SUPERVISION_ACCELERATION: (0.0, MOST_ACCELERATION_RAD_S2),
    od.SUPERVISION_ORDER: (2, 2),
    od.SUPERVISION_JERK: (0.0, 0.0),
    od.SUPERVISION_SYNC_JITTER: (0.0, MOST_DECLARED_S),
    od.SUPERVISION_ANSWER_DELAY: (0.0, MOST_DECLARED_S),
}
APPLIED = (
    od.ENCODER_LOWEST_AMPLITUDE,
    od.ENCODER_CORNER_FREQUENCY,
    od.ENCODER_COSINE_CORNER_FREQUENCY,
    od.SUPERVISION_RESIDUAL_LIMIT,
    od.SUPERVISION_ACCELERATION,
    od.SUPERVISION_COAST,
    od.SUPERVISION_FROZEN,
    od.SUPERVISION_COARSE_LIMIT,
    od.SUPERVISION_NOISE_MARGIN,
    od.SUPERVISION_BAD_SAMPLES,
    od.SUPERVISION_DOUBT_ACCELERATION,
    od.SUPERVISION_PHASE_ERROR,
)


class Limits:
    """Applies 2001:02..06 and 2010h from the next sample on, after a write, a new interval or new noise.

    ``noise``     of the residual; :meth:`measured` is called with each block of it
    ``timed``     samples bring their time
    ``shortest_s``, ``longest_s``  an interval between them needs no :meth:`follow`
    ``in_force``  the limits of the chain: the same object until :meth:`apply`
    """

    def __init__(self, dictionary: Dictionary, chain: SignalChain, interval: SamplingInterval) -> None:
        self._chain, self._dictionary, self.interval = chain, dictionary, interval
        entry = dictionary.entry
        full_scale, high = entry(*od.ENCODER_FULL_SCALE), entry(*od.ENCODER_HIGHEST_AMPLITUDE)
        low = entry(*od.ENCODER_LOWEST_AMPLITUDE)
        self._margin = entry(*od.SUPERVISION_NOISE_MARGIN)
        self.noise = ResidualNoise()
        self.timed = False
        self.on_applied: Callable[[], None] = lambda: None
        for place, (least, most) in RANGES.items():
            entry(*place).on_check = _within(least, most)
        low.on_check = refuse_if(lambda value: value >= high.value and not self._upper_is_old)
        high.on_check = refuse_if(lambda value: value <= low.value and not self._upper_is_old)
        for place in APPLIED:
            entry(*place).on_written = self.apply
        # After a write of the full scale the highest amplitude is that of another converter until it is
        # written. Until then the lowest amplitude may exceed it, so that a master can write the sub-indices
        # in their order; no amplitude of a sample is accepted meanwhile.
        full_scale.on_written = lambda: self._scale_written(upper_is_old=True)
        high.on_written = lambda: self._scale_written(upper_is_old=high.value <= low.value)

    def reset(self) -> None:
        self._upper_is_old = False
        self.noise_changes()

    def noise_changes(self) -> None:
        self.noise.forget()
        self.apply()

    def unit_changed(self) -> None:
        """Take the interval in which the next sample is counted."""
        self.interval.speed_unit_s = self._chain.unit_s
        self.follow()

    def follow(self) -> None:
        """Adapt the limits to the interval, before a sample."""
        known_s = self.interval.known_s
        if self.shortest_s < known_s < self.longest_s:
            return
        if abs(known_s - self._applied_s) > SAME_NARROWED * self._applied_s:
            self.apply()
        else:
            self._use_interval()

    def _use_interval(self) -> None:
        chain, known_s, applied_s = self._chain, self.interval.known_s, self._applied_s
        chain.use_interval(self.interval.sample_s)
        same_s = SAME_NARROWED * applied_s if self._narrowed else math.inf
        self.shortest_s, self.longest_s = applied_s - same_s, applied_s + same_s
        if chain.tracks.needs_unit:
            same_s = SAME_ANALOG * known_s
            self.shortest_s = max(self.shortest_s, known_s - same_s)
            self.longest_s = min(self.longest_s, known_s + same_s)

    def measured(self) -> None:
        usable, applied = self.noise.usable_cycles, self._applied_noise
        if self._margin.value and not abs(usable - applied) <= SAME_NOISE * applied:
            self.apply()

    def apply(self) -> None:
        read: Any = values_of(self._dictionary.find)
        per_sync = self.interval.samples_per_sync
        self._applied_s = known_s = self.interval.known_s
        self._applied_noise = usable = self.noise.usable_cycles
        settings = replace(limit_settings(read), samples_per_sync=per_sync, timed=self.timed)
        noise_cycles = usable if usable == usable else None
        self.in_force = settings.chain_limits(known_s / per_sync, noise_cycles)
        self._chain.set_limits(self.in_force)
        self._narrowed = settings.acceleration_rad_s2 > 0.0 or self._chain.tracks.needs_unit
        self._use_interval()
        self.on_applied()

    def _scale_written(self, *, upper_is_old: bool) -> None:
        self._upper_is_old = upper_is_old
        self.apply()


def _within(least: float, most: float) -> Callable[[Any], None]:
    return refuse_if(lambda value: not least <= value <= most)
