"""What a program says of the nodes that it serves: their names, what was saved, counters at the end."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from canfb import objects as od
from canfb.cia301.datatypes import encode
from canfb.device.lss.lss import UNCONFIGURED
from canfb.device.node import Node
from canfb.module.feedback_module import FeedbackModule
from canfb.module.parameters import configured_defaults

COUNTERS = {
    "missed": od.COUNTER_MISSED,
    "residual": od.COUNTER_RESIDUAL,
    "amplitude": od.COUNTER_AMPLITUDE,
    "coasted": od.COUNTER_COASTED,
    "lost": od.COUNTER_LOST,
}
"""What the closing line counts."""


class Served(Protocol):
    """A device of ours around a node."""

    @property
    def node(self) -> Node:
        """Its node."""


def name_of(device: Served) -> str:
    """The node-ID that it has, or is going to have; before its start."""
    node = device.node
    node.storage.power_on()  # a node-ID stored by LSS takes precedence over the configuration
    node.lss.power_on()
    node_id = node.lss.pending_node_id
    if node_id == UNCONFIGURED:
        return f"without a node-ID yet (LSS, serial number {_serial_number(node)})"
    return f"{node_id} ({node_id:02X}h)"


def title_of(device: Served) -> str:
    """The node, by the node-ID that it has now."""
    node_id = device.node.node_id
    if node_id == UNCONFIGURED:
        return f"node without a node-ID (serial number {_serial_number(device.node)})"
    return f"node {node_id} ({node_id:02X}h)"


def short_title_of(device: Served) -> str:
    """The same, for a line with figures."""
    node_id = device.node.node_id
    return title_of(device) if node_id == UNCONFIGURED else f"node {node_id}"


def duplicates_of(device: Served) -> str:
    """Frames of another node with the same node-ID, "" for none."""
    duplicates = device.node.counters.duplicate_frames
    return f"; {duplicates} frames of another node with this node-ID" if duplicates else ""


def _serial_number(node: Node) -> int:
    return int(node.dictionary.entry(*od.IDENTITY_SERIAL_NUMBER).value)


def what_is_saved(module: FeedbackModule, name: str) -> list[str]:
    """Which values of the configuration are not used, because others were saved: a line, or none."""
    module.node.storage.restore()  # the start does it again
    changed = []
    for index, subindex in configured_defaults(module.config):
        entry = module.dictionary.entry(index, subindex)
        if encode(entry.data_type, entry.value) != encode(entry.data_type, entry.default):
            changed.append(f"{index:04X}h:{subindex:02X}")
    objects = ", ".join(changed)
    if not changed:
        return []
    return [f"node {name}: saved values take precedence over the configuration: {objects}"]


def speeds_of(modules: Iterable[tuple[FeedbackModule, str]]) -> list[str]:
    """How fast the encoders may turn for a jitter of SYNC: a line for all modules with the same speeds."""
    names: dict[str, list[str]] = {}
    for module, name in modules:
        if text := module.speed_limit():
            names.setdefault(text, []).append(name)
    return [f"node {', '.join(those)}: {text}" for text, those in names.items()]


def summary_of(module: FeedbackModule) -> str:
    """Samples and counters of the module, at the end."""
    counts = ", ".join(f"{name} {module.dictionary.entry(*place).value}" for name, place in COUNTERS.items())
    samples = module.dictionary.entry(*od.FEEDBACK_SAMPLES).value
    return f"{short_title_of(module)}: {samples} samples; {counts}{duplicates_of(module)}"
