"""Between configuration, object dictionary and signal chain: factory defaults, and the limits in force.

A configuration replaces defaults of the EDS (:func:`configured_defaults`); after that the dictionary alone
is read. :class:`Limits` hands its values to the chain, whenever an SDO write, the interval of SYNC or the
measured noise changes one. What they narrow the residual limit to is worked out in
:mod:`canfb.view.limits_in_force`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from operator import eq
from typing import Any

from canfb import objects as od
from canfb.cia301 import cob
from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.cia301.frame import mapping_values
from canfb.device.od.dictionary import Dictionary
from canfb.eds_files import eds_path
from canfb.module.cia406.position import distinguishable_revolutions, single_turn_resolution
from canfb.module.interval import SamplingInterval
from canfb.module.module_config import (
    MOST_ACCELERATION_RAD_S2,
    MOST_SYNC_JITTER_S,
    WRITE_LOCKS,
    ModuleConfig,
)
from canfb.signal.chain import SignalChain
from canfb.signal.chain_config import MOST_CORNER_HZ, ChainConfig, ChainLimits
from canfb.signal.residual_noise import ResidualNoise
from canfb.signal.supervision import SampleLimits
from canfb.view.limits_in_force import limit_settings

EDS = "canfb-module"


def factory_dictionary(config: ModuleConfig, *, samples_itself: bool = False) -> Dictionary:
    """The object dictionary of a module: the EDS, its defaults replaced; nothing saved is in it.

    ``samples_itself``: a source takes the place of the ADC PDO.
    """
    dictionary = Dictionary.load(eds_path(EDS), config.node_id)
    apply_defaults(dictionary, configured_defaults(config))
    if samples_itself:
        apply_defaults(dictionary, without_adc_pdo(config))
    return dictionary


SAME_NARROWED, SAME_ANALOG = 0.002, 2e-4  # of the interval: no reason for new limits, other coefficients
SAME_NOISE = 0.02  # of it: no reason for new limits
LIMIT_UNITS = 65536  # 2010:01 and 2011:02 count in 1/65536 cycle
ADAPTATION_BOUNDS = {
    "offset": od.ADAPTATION_OFFSET_LIMIT,
    "gain": od.ADAPTATION_GAIN_LIMIT,
    "phase_rad": od.ADAPTATION_PHASE_LIMIT,
    "rate_per_hour": od.ADAPTATION_RATE_LIMIT,
}
"""The fields of :class:`canfb.AdaptConfig`, in units of 0.1 % or 1 mrad."""
ADAPTATION_UNIT = 1e-3


def configured_defaults(config: ModuleConfig) -> dict[tuple[int, int], Any]:
    """The defaults of the EDS that a configuration replaces, by index and sub-index."""
    limits = config.limits
    resolution = single_turn_resolution(config.cycles_per_revolution)
    revolutions = distinguishable_revolutions(resolution)
    conditioning: dict[tuple[int, int], float] = dict(
        zip(od.CONDITIONING, config.conditioning.values, strict=True)
    )
    return {
        **adc_pdos(config),
        **_second_position(config),
        od.IDENTITY_SERIAL_NUMBER: config.serial_number,
        od.SERIAL_NUMBER: config.serial_number,
        od.ENCODER_CYCLES_PER_REVOLUTION: config.cycles_per_revolution,
        od.ENCODER_FULL_SCALE: limits.full_scale_counts,
        od.ENCODER_LOWEST_AMPLITUDE: limits.amplitude_low_counts,
        od.ENCODER_HIGHEST_AMPLITUDE: limits.amplitude_high_counts,
        od.ENCODER_CORNER_FREQUENCY: config.corner_hz,
        od.ENCODER_COSINE_CORNER_FREQUENCY: config.cosine_corner_hz,
        **conditioning,
        **_adaptation(config),
        od.SUPERVISION_RESIDUAL_LIMIT: int(config.residual_limit * LIMIT_UNITS),
        od.SUPERVISION_ACCELERATION: config.max_acceleration_rad_s2,
        od.SUPERVISION_COAST: config.coast_samples,
        od.SUPERVISION_FROZEN: config.frozen_samples,
        od.SUPERVISION_COARSE_LIMIT: max(1, round(config.coarse_limit_revolutions * LIMIT_UNITS)),
        od.SUPERVISION_NOISE_MARGIN: config.noise_margin,
        od.SUPERVISION_BAD_SAMPLES: config.bad_samples,
        od.SUPERVISION_DOUBT_ACCELERATION: round(config.doubt_acceleration_cycles * LIMIT_UNITS),
        od.SUPERVISION_PHASE_ERROR: max(1, round(config.phase_error_cycles * LIMIT_UNITS)),
        od.SUPERVISION_SYNC_JITTER: config.sync_jitter_s,
        od.SUPERVISION_PERIODS: config.sync_timeout_periods,
        od.PREDICTION_POSITION: int(config.predict),
        od.PREDICTION_NOMINAL_SYNC: int(config.nominal_sync),
        od.WRITE_LOCK_MODE: int(WRITE_LOCKS[config.write_lock]),
        od.WRITE_LOCK_NEW_UNLOCK_CODE: config.unlock_code,
        od.UNITS_PER_REVOLUTION: resolution,
        od.TOTAL_RANGE: resolution * revolutions,
        od.SINGLE_TURN_RESOLUTION: resolution,
        od.DISTINGUISHABLE_REVOLUTIONS: revolutions,
    }


def _adaptation(config: ModuleConfig) -> dict[tuple[int, int], Any]:
    """2002:08, and its bounds if there are any."""
    used = config.adaptation
    if used is None:
        return {od.ADAPTATION: 0}
    bounds = {place: getattr(used, name) for name, place in ADAPTATION_BOUNDS.items()}
    # Not 0, which would turn it off.
    return {od.ADAPTATION: 1} | {
        place: max(1, round(value / ADAPTATION_UNIT)) if value else 0 for place, value in bounds.items()
    }


def adc_pdos(config: ModuleConfig) -> dict[tuple[int, int], Any]:
    """The RPDOs of what the encoder interface sends: its TPDO1, and others for what that has no room for."""
    pairs = [(od.SAMPLE_SINE, od.SAMPLE_COSINE), *od.SAMPLE_EARLIER][: config.samples_per_sync]
    objects = [one.mapped(16) for pair in pairs for one in pair]
    if config.times:
        objects.append(od.SAMPLE_TIME.mapped(32))
    mapping: dict[tuple[int, int], Any] = dict(mapping_values(od.RPDO_MAPPING, objects))
    for index in {index for index, _ in mapping}:
        number = index - od.RPDO_MAPPING
        mapping[od.RPDO + number, 1] = cob.TPDOS[number] + config.encoder_interface
    return mapping


def _second_position(config: ModuleConfig) -> dict[tuple[int, int], Any]:
    """2014h, and the first RPDO after those of the encoder interface if it is to bring 2000:0E."""
    second = config.second_position
    if second is None:
        return {}
    defaults: dict[tuple[int, int], Any] = {
        od.SECOND_INCREMENTS: second.increments,
        od.SECOND_REVOLUTIONS: second.revolutions,
        od.SECOND_REVERSED: int(second.reversed),
        od.SECOND_TOLERANCE: second.tolerance_revolutions,
        od.SECOND_INVALIDATES: int(second.invalidates),
    }
    if second.cob_id is not None:
        number = config.adc_pdos
        defaults[od.RPDO + number, 1] = second.cob_id
        mapping = second.mapping
        defaults[od.RPDO_MAPPING + number, 0] = len(mapping)
        defaults |= {(od.RPDO_MAPPING + number, n): entry for n, entry in enumerate(mapping, 1)}
    return defaults


def without_adc_pdo(config: ModuleConfig) -> dict[tuple[int, int], Any]:
    """What :func:`configured_defaults` becomes for a module with its own ADC: RPDO1 is not valid."""
    return {
        place: cob.NOT_VALID | value
        for place, value in adc_pdos(config).items()
        if place[0] < od.RPDO_MAPPING and place[1] == 1
    }


def apply_defaults(dictionary: Dictionary, defaults: dict[tuple[int, int], Any]) -> None:
    """Replace defaults and values of the dictionary: a reset comes back to these.

    They hold whatever the node-ID is: a COB-ID of another node does not move with that of this one.
    """
    for (index, subindex), value in defaults.items():
        entry = dictionary.entry(index, subindex)
        entry.default, entry.follows_node_id = value, False
        entry.reset()


class Limits:
    """Objects 2001:02..06 and 2010h: written by SDO, in force from the next sample on."""

    def __init__(self, dictionary: Dictionary, chain: SignalChain, interval: SamplingInterval) -> None:
        self._chain = chain
        self._dictionary, entry = dictionary, dictionary.entry
        self._cycles_per_revolution = entry(*od.ENCODER_CYCLES_PER_REVOLUTION)
        self._full_scale = entry(*od.ENCODER_FULL_SCALE)
        self._low, self._high = entry(*od.ENCODER_LOWEST_AMPLITUDE), entry(*od.ENCODER_HIGHEST_AMPLITUDE)
        self._corner, self._cosine_corner = (
            entry(*od.ENCODER_CORNER_FREQUENCY),
            entry(*od.ENCODER_COSINE_CORNER_FREQUENCY),
        )
        self._residual = entry(*od.SUPERVISION_RESIDUAL_LIMIT)
        self._acceleration = entry(*od.SUPERVISION_ACCELERATION)
        self._coast, self._frozen = entry(*od.SUPERVISION_COAST), entry(*od.SUPERVISION_FROZEN)
        self._coarse, self._margin = entry(*od.SUPERVISION_COARSE_LIMIT), entry(*od.SUPERVISION_NOISE_MARGIN)
        self._bad, self._assumed = (
            entry(*od.SUPERVISION_BAD_SAMPLES),
            entry(*od.SUPERVISION_DOUBT_ACCELERATION),
        )
        self._phase_error = entry(*od.SUPERVISION_PHASE_ERROR)
        self.noise = ResidualNoise()
        """Of the residual, as measured; :meth:`measured` is called with each block of it."""
        self._applied_noise = math.nan
        self.timed = False
        """Samples bring their time, in units of 100 ns."""
        self.interval = interval
        self._applied_s = 0.0
        self._shortest_s = self._longest_s = 0.0  # while the interval is between them, all stays
        self.narrowed = False
        """The limits, or what the analog path does, depend on the sampling interval, which may change."""
        self.in_force = ChainConfig().chain_limits
        """What the chain has, narrowed or not: the same object until :meth:`apply`."""
        self.on_applied: Callable[[], None] | None = None
        self._upper_is_old = False
        self._full_scale.on_check = self._check(lambda full_scale: full_scale > 0)
        self._low.on_check = self._check(lambda low: low < self._high.value or self._upper_is_old)
        self._high.on_check = self._check(lambda high: high > self._low.value)
        self._acceleration.on_check = self._check(lambda value: 0.0 <= value <= MOST_ACCELERATION_RAD_S2)
        for gone, only in ((od.SUPERVISION_ORDER, 2), (od.SUPERVISION_JERK, 0.0)):
            entry(*gone).on_check = self._check(partial(eq, only))
        entry(*od.SUPERVISION_SYNC_JITTER).on_check = self._check(
            lambda value: 0.0 <= value <= MOST_SYNC_JITTER_S
        )
        for corner in (self._corner, self._cosine_corner):
            corner.on_check = self._check(lambda value: 0.0 <= value <= MOST_CORNER_HZ)
        for changed in (
            self._full_scale,
            self._low,
            self._high,
            self._residual,
            self._acceleration,
            self._coast,
            self._frozen,
            self._coarse,
            self._margin,
            self._bad,
            self._assumed,
            self._phase_error,
            self._corner,
            self._cosine_corner,
        ):
            changed.on_written = self.apply
        self._full_scale.on_written = self._full_scale_written
        self._high.on_written = self._upper_written

    def reset(self) -> None:
        """After a reset of the node: the values of the dictionary belong together."""
        self._upper_is_old = False
        self.noise_changes()

    def noise_changes(self) -> None:
        """Another table, or other samples: the noise is another one, and not known yet."""
        self.noise.forget()
        self.apply()

    def unit_changed(self) -> None:
        """The limits are those of the interval in which the next sample is counted, also of the first one."""
        self.interval.speed_unit_s = self._chain.unit_s
        if self.narrowed:
            self.follow()

    def follow(self) -> None:
        """Before a sample, if it is :attr:`narrowed`: take limits and analog path along with the interval."""
        known_s = self.interval.known_s
        if self._shortest_s < known_s < self._longest_s:
            return
        if abs(known_s - self._applied_s) > SAME_NARROWED * self._applied_s:
            self.apply()
        else:
            self._use_interval()

    def _use_interval(self) -> None:
        """The analog path at this interval, and how far it may change before something is to be done."""
        chain, known_s, applied_s = self._chain, self.interval.known_s, self._applied_s
        chain.use_interval(self.interval.sample_s)
        same_s = SAME_NARROWED * applied_s
        self._shortest_s, self._longest_s = applied_s - same_s, applied_s + same_s
        if chain.tracks.needs_unit:
            same_s = SAME_ANALOG * known_s
            self._shortest_s = max(self._shortest_s, known_s - same_s)
            self._longest_s = min(self._longest_s, known_s + same_s)

    def measured(self) -> None:
        """Another block of :attr:`noise`: the limits follow where it has changed."""
        usable, applied = self.noise.usable_cycles, self._applied_noise
        if self._margin.value and not abs(usable - applied) <= SAME_NOISE * applied:
            self.apply()

    def _read(self, place: od.Multiplexer) -> Any:
        """The value of an object; None if it does not exist."""
        return self._dictionary.entry(*place).value if place in self._dictionary else None

    def apply(self) -> None:
        """Put the values of the dictionary in force."""
        known_s, per_sync = self.interval.known_s, self.interval.samples_per_sync
        self._applied_noise = usable = self.noise.usable_cycles
        settings = replace(limit_settings(self._read), samples_per_sync=per_sync, timed=self.timed)
        noise_cycles = usable if usable == usable else None
        bounds = settings.bounds(self._cycles_per_revolution.value, known_s / per_sync, noise_cycles)
        self._applied_s = known_s
        self.in_force = ChainLimits.of(
            bounds,
            sample=SampleLimits(self._full_scale.value, self._low.value, self._high.value),
            cycles_per_revolution=self._cycles_per_revolution.value,
            coast_samples=self._coast.value,
            frozen_samples=self._frozen.value,
            coarse_limit_revolutions=self._coarse.value / LIMIT_UNITS,
            samples_per_sync=per_sync,
            corners=settings.corners,
        )
        self._chain.set_limits(self.in_force)
        self._use_interval()
        self.narrowed = self._acceleration.value > 0.0 or self._chain.tracks.needs_unit
        if self.on_applied is not None:
            self.on_applied()

    def _full_scale_written(self) -> None:
        """The upper amplitude is that of another converter until it is written: a lower one may pass it.

        So a master can write the sub-indices in their order. Meanwhile no amplitude is accepted.
        """
        self._upper_is_old = True
        self.apply()

    def _upper_written(self) -> None:
        self._upper_is_old = False
        self.apply()

    @staticmethod
    def _check(good: Callable[[Any], bool]) -> Callable[[Any], None]:
        def check(value: Any) -> None:
            if not good(value):
                raise SdoAbort(AbortCode.INVALID_VALUE)

        return check
