"""Modules that a monitor knows beforehand: by a configuration, or as the EDS delivers them."""

from __future__ import annotations

from collections.abc import Sequence

from canfb.configuration import Config
from canfb.module.module_config import UNCONFIGURED, ModuleConfig
from canfb.module.parameters import factory_dictionary
from canfb.monitoring.layout import NodeLayout, Origin, layout_of
from canfb.objects import Multiplexer
from canfb.view.pdo_map import Number, Read


def known_layouts(config: Config, nodes: Sequence[int] = ()) -> list[NodeLayout]:
    """Of these nodes (1..127); without any, of all modules of the configuration that have a node-ID."""
    return [_layout(module, origin) for module, origin in _known(config, nodes)]


def known_objects(config: Config, nodes: Sequence[int] = ()) -> dict[int, Read]:
    """Objects of the same modules by node-ID, as configured or by default."""
    return {module.node_id: _reader(module) for module, _ in _known(config, nodes)}


def _known(config: Config, nodes: Sequence[int]) -> list[tuple[ModuleConfig, Origin]]:
    configured = {module.node_id: module for module in config.modules if module.node_id != UNCONFIGURED}
    return [
        (configured[node], Origin.CONFIGURATION)
        if node in configured
        else (_as_delivered(node), Origin.DEFAULT)
        for node in dict.fromkeys(nodes or configured)
    ]


def assumed_layout(node_id: int) -> NodeLayout:
    """Of a node (1..127) that looks like a module: as the EDS has it."""
    return _layout(_as_delivered(node_id), Origin.ASSUMED)


def _as_delivered(node_id: int) -> ModuleConfig:
    """The encoder interface is the usual one, which cannot be the module itself."""
    usual = ModuleConfig(node_id=UNCONFIGURED).encoder_interface
    return ModuleConfig(node_id=node_id, encoder_interface=usual if node_id != usual else node_id % 127 + 1)


def _layout(config: ModuleConfig, origin: Origin) -> NodeLayout:
    return layout_of(config.node_id, _reader(config), origin)


def _reader(config: ModuleConfig) -> Read:
    dictionary = factory_dictionary(config, samples_itself=config.source is not None)

    def read(place: Multiplexer) -> Number | None:
        entry = dictionary.find(*place)
        return None if entry is None else entry.value

    return read
