"""The drive of ``canfb simulate``: motor, encoder and CiA 402 node, as the configuration has them."""

from __future__ import annotations

import argparse
from dataclasses import dataclass

from canfb import objects as od
from canfb.cli.options import chosen_module
from canfb.configuration import Config
from canfb.errors import ConfigError
from canfb.module.config import UNCONFIGURED
from canfb.module.parameters import configured_defaults
from canfb.simulation.cia402.drive import FeedbackModuleLink, ServoDrive
from canfb.simulation.cia402.motor import Motor
from canfb.simulation.cia402.plant import Plant, PlantSource
from canfb.simulation.demand import Demand, of_drive

PROFILE_VELOCITY, INCREMENTS = (0x6081, 0), (0x608F, 1)  # increments per second, per revolution


@dataclass(frozen=True)
class SimulatedAxis:
    """A drive with its motor, and the encoder on the shaft; ``module_id`` is the module it listens to."""

    plant: Plant
    source: PlantSource
    drive: ServoDrive
    module_id: int
    demand: Demand | None = None
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


def simulated_axis(options: argparse.Namespace, config: Config) -> SimulatedAxis | None:
    """The drive of the configuration, None without one. ConfigError if it cannot be."""
    settings = config.simulation.drive
    if settings is None:
        return None
    for option in ("samples", "rpm"):
        if getattr(options, option) is not None:
            raise ConfigError(f"--{option}: the drive of the configuration moves the encoder; leave out one")
    module = chosen_module(options, config)
    if module.node_id == UNCONFIGURED:
        raise ConfigError("drive: the module has no node_id (255) whose position the drive could take")
    plant = Plant(Motor(settings, settings.start_revolutions))
    encoder = config.simulation.encoder.encoder(module.adc_bits)
    simulation = config.simulation
    source = PlantSource(
        encoder, plant, module.cycles_per_revolution, simulation.seed, simulation.aperture_jitter_s
    )
    scale = configured_defaults(module)
    link = FeedbackModuleLink(
        node_id=module.node_id,
        increments_per_revolution=scale[od.UNITS_PER_REVOLUTION],
        total_range=scale[od.TOTAL_RANGE],  # without scaling, too
        synchronous=settings.synchronous_feedback,
    )
    drive = ServoDrive(settings.node_id, plant, link, autostart=options.autostart or module.autostart)
    demand = None
    if options.rate is not None:
        speed = drive.dictionary.entry(*PROFILE_VELOCITY).value / drive.dictionary.entry(*INCREMENTS).value
        demand = of_drive(settings, module, options.rate, speed)
    return SimulatedAxis(plant, source, drive, module.node_id, demand)
