"""The input of a plan, from a configuration and the command line."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from canfb import objects as od
from canfb.checks import integer_in, number_in
from canfb.configuration import Config
from canfb.device.od.dictionary import Dictionary
from canfb.eds_files import eds_path
from canfb.module.device_configuration import DeviceConfiguration
from canfb.module.module_config import ModuleConfig
from canfb.module.parameters import LIMIT_UNITS
from canfb.planning.planned_module import PlannedModule
from canfb.planning.situation import EncoderErrors, Situation, StatedMotion
from canfb.planning.traffic import Values
from canfb.signal.subsamples import MOST_PER_SYNC
from canfb.signal.third_order import check_order
from canfb.signal.tracker import check_residual_limit
from canfb.simulation.cia402.drive_config import DriveConfig
from canfb.simulation.demand import MotionDemand, of_motion
from canfb.simulation.scenario import SimulationConfig
from canfb.simulation.set_up import sync_rate
from canfb.simulation.simulated_axis import profile_demand
from canfb.simulation.sync_timing import CUT_OFF

RPM = 2.0 * math.pi / 60.0  # rad/s
LARGEST_ACCELERATION = 1e9  # rad/s^2, as 2010:02 has it
LARGEST_EXTRA = 1.0


@dataclass(frozen=True, kw_only=True)
class PlanOptions:
    """Command-line overrides of the configuration. None: as the configuration has it.

    bit_rate                   bit/s, 10000..1000000
    rate_hz                    SYNC rate, 0.1..100000 Hz
    jitter_us                  of the SYNC at its producer, +-, 0..1e6 us
    extra_load                 of frames of other nodes, 0..1
    heartbeat_ms               of each node that has none yet, 1..65535 ms
    rpm                        largest speed, 0..1e6 rpm
    acceleration_rad_s2        largest acceleration, 0..1e9 rad/s^2
    jerk_rad_s3                largest jerk, 0..1e12 rad/s^3
    noise_counts               rms noise of a track, 0..1000 counts
    phase_error_cycles         largest error of a phase, 0..0.25 cycle
    cycles_per_revolution      2001:01 of every module
    residual_limit             2010:01 of every module, cycles
    prediction_order           2010:07 of every module, 2 or 3
    samples_per_sync           1..4 pairs that the interface of every module sends for each SYNC
    noise_margin               2010:09 of every module, 0..255
    times                      True: the ADC PDOs carry sample times
    table                      True: a correction table is in force

    ValueError for a value that cannot be.
    """

    bit_rate: int | None = None
    rate_hz: float | None = None
    jitter_us: float | None = None
    extra_load: float | None = None
    heartbeat_ms: float | None = None
    rpm: float | None = None
    acceleration_rad_s2: float | None = None
    jerk_rad_s3: float | None = None
    noise_counts: float | None = None
    phase_error_cycles: float | None = None
    cycles_per_revolution: int | None = None
    residual_limit: float | None = None
    prediction_order: int | None = None
    samples_per_sync: int | None = None
    noise_margin: int | None = None
    times: bool = False
    table: bool = False

    def __post_init__(self) -> None:
        for name, low, high in (
            ("rate_hz", 0.1, 100_000.0),
            ("jitter_us", 0.0, 1e6),
            ("extra_load", 0.0, LARGEST_EXTRA),
            ("heartbeat_ms", 1.0, 65_535.0),
            ("rpm", 0.0, 1e6),
            ("acceleration_rad_s2", 0.0, LARGEST_ACCELERATION),
            ("jerk_rad_s3", 0.0, 1e12),
            ("noise_counts", 0.0, 1000.0),
            ("phase_error_cycles", 0.0, 0.25),
        ):
            if getattr(self, name) is not None:
                number_in(name, getattr(self, name), low, high)
        if self.bit_rate is not None:
            integer_in("bit_rate", self.bit_rate, 10_000, 1_000_000)
        if self.cycles_per_revolution is not None:
            integer_in("cycles_per_revolution", self.cycles_per_revolution, 1, 1_048_576)
        if self.residual_limit is not None:
            check_residual_limit(self.residual_limit)
        if self.prediction_order is not None:
            check_order("prediction_order", self.prediction_order)
        if self.samples_per_sync is not None:
            integer_in("samples_per_sync", self.samples_per_sync, 1, MOST_PER_SYNC)
        if self.noise_margin is not None:
            integer_in("noise_margin", self.noise_margin, 0, 255)


def situation_of(config: Config, modules: Iterable[DeviceConfiguration], stated: PlanOptions) -> Situation:
    """What is planned: ``modules`` are those of ``config`` as they come up, in its order.

    ValueError for a bit rate of the configuration that no classic CAN has.
    """
    simulation = config.simulation
    planned = tuple(
        _planned(module, one, stated) for module, one in zip(config.modules, modules, strict=True)
    )
    rate_hz = sync_rate(simulation, stated.rate_hz)
    jitter_us = simulation.sync_jitter_us + CUT_OFF * simulation.sync_jitter_rms_us
    bit_rate = stated.bit_rate or config.bus.get("bitrate") or simulation.bus_bit_rate
    integer_in("bitrate", bit_rate, 10_000, 1_000_000)
    return Situation(
        bit_rate=bit_rate,
        sync_hz=rate_hz,
        modules=planned,
        motion=_motion(simulation, config.modules[0], rate_hz, stated),
        errors=EncoderErrors(
            noise_counts=_first(stated.noise_counts, simulation.encoder.noise_lsb),
            amplitude=simulation.encoder.amplitude,
            phase_cycles=stated.phase_error_cycles,
        ),
        jitter_s=_first(stated.jitter_us, jitter_us) * 1e-6,
        aperture_s=CUT_OFF * simulation.aperture_jitter_s,
        extra_load=_first(stated.extra_load, simulation.bus_load),
        heartbeat_s=(stated.heartbeat_ms or 0.0) * 1e-3,
        others=_others(config),
    )


def _planned(config: ModuleConfig, found: DeviceConfiguration, stated: PlanOptions) -> PlannedModule:
    module = PlannedModule(
        node_id=found.node_id,
        values=found.values(with_table=False),
        has_table=stated.table or bool(found.table),
        samples_itself=config.source is not None,
    )
    if stated.cycles_per_revolution is not None:
        module = module.with_values({od.ENCODER_CYCLES_PER_REVOLUTION: stated.cycles_per_revolution})
    if stated.residual_limit is not None:
        limit = int(stated.residual_limit * LIMIT_UNITS)
        module = module.with_values({od.SUPERVISION_RESIDUAL_LIMIT: limit})
    if stated.prediction_order is not None:
        module = module.with_values({od.SUPERVISION_ORDER: stated.prediction_order})
    if stated.noise_margin is not None:
        module = module.with_values({od.SUPERVISION_NOISE_MARGIN: stated.noise_margin})
    if stated.samples_per_sync is not None:
        module = module.with_samples(stated.samples_per_sync)
    return module.with_times() if stated.times else module


def _motion(
    simulation: SimulationConfig, config: ModuleConfig, rate_hz: float, stated: PlanOptions
) -> StatedMotion:
    """What is stated, else what ``canfb simulate`` plays."""
    speed, acceleration, where = None, None, ""
    demand = _demand(simulation, config, rate_hz)
    if demand is not None:
        speed = (demand.speed_cycles or 0.0) * rate_hz / config.cycles_per_revolution * 2.0 * math.pi
        acceleration, where = demand.acceleration_rad_s2, demand.what
    if stated.rpm is not None:
        speed = stated.rpm * RPM
    is_final = stated.acceleration_rad_s2 is not None
    return StatedMotion(
        speed_rad_s=speed,
        acceleration_rad_s2=stated.acceleration_rad_s2 if is_final else acceleration,
        jerk_rad_s3=stated.jerk_rad_s3,
        is_final=is_final,
        where="" if is_final and stated.rpm is not None else where,
    )


def _demand(simulation: SimulationConfig, config: ModuleConfig, rate_hz: float) -> MotionDemand | None:
    """Demand of the motion of ``canfb simulate``; None if the configuration does not define a motion."""
    if simulation.drive is not None:
        return profile_demand(simulation.drive, _drive_objects(simulation.drive), config, rate_hz)
    if simulation.motion == SimulationConfig().motion:
        return None
    return of_motion(simulation.motion, config, rate_hz)


def _others(config: Config) -> tuple[tuple[int, Values], ...]:
    """The encoder interfaces but for their PDOs, which the RPDOs of the modules show, and the drive."""
    own = sorted({one.encoder_interface for one in config.modules if one.source is None})
    found: list[tuple[int, Values]] = [(node, {}) for node in own]
    drive = config.simulation.drive
    if drive is not None:
        objects = {(entry.index, entry.subindex): entry.value for entry in _drive_objects(drive)}
        found.append((drive.node_id, objects))
    return tuple(found)


def _drive_objects(drive: DriveConfig) -> Dictionary:
    return Dictionary.load(eds_path("drive"), drive.node_id)


def _first(stated: float | None, configured: float) -> float:
    return configured if stated is None else stated
