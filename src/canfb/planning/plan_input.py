"""The input of a plan: a bus, its SYNC, its modules, and the motion of their encoders.

:func:`plan_of` takes it from a configuration, unless :class:`PlanOptions` override it;
:func:`modules_alike` and :func:`numbered` make the configuration.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from canfb import objects as od
from canfb.checks import integer_in, within
from canfb.configuration import Config
from canfb.device.od.dictionary import Dictionary
from canfb.eds_files import eds_path
from canfb.module.device_configuration import DeviceConfiguration
from canfb.module.module_config import MOST_ACCELERATION_RAD_S2, UNCONFIGURED, ModuleConfig
from canfb.module.parameters import adc_pdos
from canfb.planning.plan import RPM, Plan
from canfb.planning.planned_bus import PlannedModule, Values
from canfb.signal.sample import MOST_PER_SYNC
from canfb.signal.tracker import check_residual_limit
from canfb.simulation.cia402.plant import DriveConfig
from canfb.simulation.embedded_bus import CUT_OFF
from canfb.simulation.scenario import SimulationConfig
from canfb.simulation.set_up import MotionDemand, of_drive, of_motion, sync_rate
from canfb.view.module_view import LIMIT_UNITS


@dataclass(frozen=True, kw_only=True)
class PlanOptions:
    """Command-line overrides of the configuration. None: as configured.

    bit_rate                   bit/s, 10000..1000000
    rate_hz                    SYNC rate, 0.1..100000 Hz
    jitter_us                  of the SYNC at its producer, +-, 0..1e6 us
    extra_load                 bus load of other nodes, 0..1
    heartbeat_ms               of each node without one, 1..65535 ms
    rpm                        largest speed, 0..1e6 rpm
    acceleration_rad_s2        largest acceleration, 0..1e9 rad/s^2
    noise_counts               rms noise of a track, 0..1000 counts
    phase_error_cycles         largest phase error, 0..0.25 cycle
    cycles_per_revolution      2001:01 of every module
    residual_limit             2010:01 of every module, cycles
    samples_per_sync           1..8 pairs per SYNC from the interface of every module
    noise_margin               2010:09 of every module, 0..255
    times                      True: the ADC PDOs carry sample times
    table                      True: a correction table is in force

    ValueError out of range.
    """

    bit_rate: int | None = None
    rate_hz: float | None = None
    jitter_us: float | None = None
    extra_load: float | None = None
    heartbeat_ms: float | None = None
    rpm: float | None = None
    acceleration_rad_s2: float | None = None
    noise_counts: float | None = None
    phase_error_cycles: float | None = None
    cycles_per_revolution: int | None = None
    residual_limit: float | None = None
    samples_per_sync: int | None = None
    noise_margin: int | None = None
    times: bool = False
    table: bool = False

    def __post_init__(self) -> None:
        within(
            self,
            rate_hz=(0.1, 100_000.0),
            jitter_us=(0.0, 1e6),
            extra_load=(0.0, 1.0),
            heartbeat_ms=(1.0, 65_535.0),
            rpm=(0.0, 1e6),
            acceleration_rad_s2=(0.0, MOST_ACCELERATION_RAD_S2),
            noise_counts=(0.0, 1000.0),
            phase_error_cycles=(0.0, 0.25),
            bit_rate=(10_000, 1_000_000),
            cycles_per_revolution=(1, 1_048_576),
            samples_per_sync=(1, MOST_PER_SYNC),
            noise_margin=(0, 255),
        )
        if self.residual_limit is not None:
            check_residual_limit(self.residual_limit)


def plan_of(config: Config, modules: Iterable[DeviceConfiguration], options: PlanOptions) -> Plan:
    """The plan: ``modules`` are those of ``config`` after power-on, in its order.

    ValueError for a configured bit rate that classic CAN does not support.
    """
    simulation = config.simulation
    planned = tuple(
        _planned(module, one, options) for module, one in zip(config.modules, modules, strict=True)
    )
    rate_hz = sync_rate(simulation, options.rate_hz)
    jitter_us = simulation.sync_jitter_us + CUT_OFF * simulation.sync_jitter_rms_us
    bit_rate = options.bit_rate or config.bus.get("bitrate") or simulation.bus_bit_rate
    integer_in("bitrate", bit_rate, 10_000, 1_000_000)
    return Plan(
        bit_rate=bit_rate,
        sync_hz=rate_hz,
        modules=planned,
        noise_counts=_first(options.noise_counts, simulation.encoder.noise_lsb),
        amplitude=simulation.encoder.amplitude,
        phase_cycles=options.phase_error_cycles,
        **_motion(simulation, config.modules[0], rate_hz, options),
        jitter_s=_first(options.jitter_us, jitter_us) * 1e-6,
        aperture_s=CUT_OFF * simulation.aperture_jitter_ns * 1e-9,
        extra_load=_first(options.extra_load, simulation.bus_load),
        heartbeat_s=(options.heartbeat_ms or 0.0) * 1e-3,
        others=_others(config),
    )


def _planned(config: ModuleConfig, found: DeviceConfiguration, options: PlanOptions) -> PlannedModule:
    limit = options.residual_limit
    given = {
        od.ENCODER_CYCLES_PER_REVOLUTION: options.cycles_per_revolution,
        od.SUPERVISION_RESIDUAL_LIMIT: None if limit is None else int(limit * LIMIT_UNITS),
        od.SUPERVISION_NOISE_MARGIN: options.noise_margin,
    }
    samples_itself = config.source is not None
    module = PlannedModule(
        node_id=found.node_id,
        values={
            **found.values(with_table=False),
            **(adc_pdos(replace(config, times=False)) if samples_itself else {}),
            **{place: value for place, value in given.items() if value is not None},
        },
        has_table=options.table or bool(found.table),
        samples_itself=samples_itself,
    )
    per_sync = options.samples_per_sync or module.settings.samples_per_sync
    return module.with_samples(per_sync, times=options.times or module.times)


def _motion(
    simulation: SimulationConfig, config: ModuleConfig, rate_hz: float, options: PlanOptions
) -> dict[str, Any]:
    speed, acceleration, where = None, None, ""
    demand = _demand(simulation, config, rate_hz)
    if demand is not None:
        speed = demand.speed_cycles * rate_hz / config.cycles_per_revolution * 2.0 * math.pi
        acceleration, where = demand.followed.acceleration_rad_s2, demand.what
    if options.rpm is not None:
        speed = options.rpm / RPM
    is_final = options.acceleration_rad_s2 is not None
    return {
        "speed_rad_s": speed,
        "acceleration_rad_s2": options.acceleration_rad_s2 if is_final else acceleration,
        "is_final": is_final,
        "where": "" if is_final and options.rpm is not None else where,
    }


def _demand(simulation: SimulationConfig, config: ModuleConfig, rate_hz: float) -> MotionDemand | None:
    if simulation.drive is not None:
        return of_drive(simulation.drive, _drive_objects(simulation.drive), config, rate_hz)
    if simulation.motion == SimulationConfig().motion:
        return None
    return of_motion(simulation.motion, config, rate_hz)


def _others(config: Config) -> tuple[tuple[int, Values], ...]:
    own = sorted({one.encoder_interface for one in config.modules if one.source is None})
    found: list[tuple[int, Values]] = [(node, {}) for node in own]
    drive = config.simulation.drive
    if drive is not None:
        objects = {(entry.index, entry.subindex): entry.value for entry in _drive_objects(drive)}
        found.append((drive.node_id, objects))
    return tuple(found)


def _drive_objects(drive: DriveConfig) -> Dictionary:
    return Dictionary.load(eds_path("drive"), drive.node_id)


def _first(given: float | None, configured: float) -> float:
    return configured if given is None else given


FIRST_MODULE, FIRST_INTERFACE, MOST_MODULES = 0x20, 0x10, 32
FURTHER_INTERFACES = FIRST_MODULE + MOST_MODULES


def modules_alike(count: int | None, adc_bits: int | None) -> Config:
    """``count`` modules (1..32, None: 1), factory defaults, each with its encoder interface. ValueError."""
    count, adc_bits = 1 if count is None else count, 12 if adc_bits is None else adc_bits
    integer_in("modules", count, 1, MOST_MODULES)
    room = FIRST_MODULE - FIRST_INTERFACE
    return Config(
        modules=[
            ModuleConfig(
                node_id=FIRST_MODULE + n,
                encoder_interface=FIRST_INTERFACE + n if n < room else FURTHER_INTERFACES + n,
                adc_bits=adc_bits,
            )
            for n in range(count)
        ]
    )


def numbered(config: Config) -> Config:
    """``config`` with a free node-ID for each module that gets one by LSS."""
    nodes = {node for one in config.modules for node in (one.node_id, one.encoder_interface)}
    if config.simulation.drive is not None:
        nodes.add(config.simulation.drive.node_id)
    free = (node for node in range(127, 0, -1) if node not in nodes)
    return replace(
        config,
        modules=[
            replace(one, node_id=next(free)) if one.node_id == UNCONFIGURED else one for one in config.modules
        ],
    )
