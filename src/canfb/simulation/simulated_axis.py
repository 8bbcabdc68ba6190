"""The drive of ``canfb simulate``: motor, encoder and CiA 402 node, as the configuration has them."""

from __future__ import annotations

from dataclasses import dataclass, replace

from canfb.device.od.dictionary import Dictionary
from canfb.errors import ConfigError
from canfb.signal.chain_config import ChainConfig
from canfb.simulation.cia402.coupling import Coupling
from canfb.simulation.cia402.drive import FeedbackModuleLink, ServoDrive
from canfb.simulation.cia402.motor import Motor, MotorConfig
from canfb.simulation.cia402.plant import Plant, PlantSource
from canfb.simulation.demand import MotionDemand, of_drive
from canfb.simulation.fed_module import FedModule
from canfb.simulation.scenario import SimulationConfig

PROFILE_VELOCITY, INCREMENTS = (0x6081, 0), (0x608F, 1)  # increments per second, per revolution


@dataclass(frozen=True)
class SimulatedAxis:
    """A drive with its motor, and the encoder on the shaft; ``module_id`` is the module it listens to."""

    plant: Plant
    source: PlantSource
    drive: ServoDrive
    module_id: int
    demand: MotionDemand | None = None
    """What it asks of the module, None without a known SYNC rate."""

    def describe(self) -> str:
        """One line on the drive."""
        node, module = self.drive.node.node_id, self.module_id
        return f"drive: node {node} ({node:02X}h), position from node {module} ({module:02X}h)"

    def summary(self) -> str:
        """One line at the end."""
        state = self.drive.state.name.replace("_", " ").capitalize()
        error = f", error {self.drive.error:04X}h" if self.drive.error else ""
        return f"drive: {state}{error}; the shaft is at {self.plant.motor.revolutions:.3f} revolutions"


def simulated_axis(
    simulation: SimulationConfig,
    module: FedModule,
    *,
    autostart: bool = False,
    rate_hz: float | None = None,
) -> SimulatedAxis | None:
    """The drive of the configuration, None without one. ConfigError if it cannot be."""
    settings = simulation.drive
    if settings is None:
        return None
    if not module.has_node_id:
        raise ConfigError("drive: the module whose position the drive uses has no node_id (255)")
    plant = Plant(Motor(settings, settings.start_revolutions))
    chain = module.chain
    encoder = simulation.encoder.encoder(chain.adc_bits)
    source = PlantSource(
        encoder,
        plant,
        chain.cycles_per_revolution,
        simulation.seed,
        simulation.aperture_jitter_s,
        Coupling(settings.slip_revolutions, settings.slip_at_s),
    )
    link = FeedbackModuleLink(
        node_id=module.node_id,
        increments_per_revolution=module.increments_per_revolution,
        total_range=module.total_range,
        synchronous=settings.synchronous_feedback,
    )
    drive = ServoDrive(
        settings.node_id, plant, link, autostart=autostart, motor_increments=settings.motor_increments
    )
    demand = None
    if rate_hz is not None:
        per_sync = module.samples_per_sync
        demand = profile_demand(settings, drive.dictionary, chain, rate_hz * per_sync)
        demand = replace(demand, per_sync=per_sync)
    return SimulatedAxis(plant, source, drive, module.node_id, demand)


def profile_demand(
    motor: MotorConfig, dictionary: Dictionary, chain: ChainConfig, rate_hz: float
) -> MotionDemand:
    """What a drive with this dictionary asks of the module: its profile velocity, and all its torque."""
    speed = dictionary.entry(*PROFILE_VELOCITY).value / dictionary.entry(*INCREMENTS).value
    return of_drive(motor, chain, rate_hz, speed)
