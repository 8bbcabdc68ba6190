"""The configuration of a plan: modules that are alike, or those of a file, each with a node-ID."""

from __future__ import annotations

from dataclasses import replace

from canfb.checks import integer_in
from canfb.configuration import Config
from canfb.module.module_config import UNCONFIGURED, ModuleConfig

FIRST_MODULE, FIRST_INTERFACE, MOST_MODULES = 0x20, 0x10, 32
FURTHER_INTERFACES = FIRST_MODULE + MOST_MODULES


def modules_alike(count: int, adc_bits: int) -> Config:
    """``count`` modules (1..32) as delivered, each with an encoder interface of its own. ValueError."""
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
    """The same, with a free node-ID for each module that is to get one by LSS."""
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
