"""``canfb run CONFIG.yaml``: feedback modules on a real bus."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Mapping
from typing import Any

from canfb.bus.hosting import open_source
from canfb.bus.opening import check_device_bus, describe, open_bus
from canfb.bus.readiness import Readiness
from canfb.bus.realtime import apply_realtime
from canfb.bus.runner import DeviceFailure, Runner, ending_on_signals
from canfb.bus.state_files import StateFiles
from canfb.cli.options import (
    Commands,
    add_bus_options,
    add_command,
    add_ready_file,
    bus_options,
    report,
    say,
)
from canfb.configuration import load_config
from canfb.device.datatypes import encode
from canfb.device.image import ParameterGroup
from canfb.device.lss import UNCONFIGURED
from canfb.errors import CanfbError
from canfb.module.config import ModuleConfig
from canfb.module.feedback_module import FeedbackModule
from canfb.module.parameters import configured_defaults
from canfb.simulation.scenario import SimulationConfig


def register(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(commands, "run", "run the feedback modules of a configuration on a bus", run)
    parser.add_argument("config", metavar="CONFIG.yaml")
    add_ready_file(parser)
    add_bus_options(parser)


def run(options: argparse.Namespace) -> int:
    """Serve the modules until Ctrl-C, SIGTERM or SIGHUP.

    A program error in one of them ends the process for all, with exit code 1.
    """
    config = load_config(options.config)
    words = bus_options(options, config.bus)
    check_device_bus(words)
    with contextlib.ExitStack() as resources:
        readiness = resources.enter_context(Readiness(options.ready_file, report))
        modules = [make_module(module, resources, words, config.simulation) for module in config.modules]
        bus = resources.enter_context(open_bus(words))
        runner = Runner(bus, list(modules), report)
        apply_realtime(config.realtime, report)
        nodes = ", ".join(_name(module) for module in modules)
        saved = [line for module in modules for line in _what_is_saved(module)]

        def ready() -> None:
            for line in (f"running node {nodes} on {describe(words)}; end with Ctrl-C", *saved):
                say(line)
            readiness.ready()

        with ending_on_signals(runner.stop):
            try:
                runner.run(ready=ready)
            except DeviceFailure as failure:
                (failed,) = (module for module in modules if module is failure.device)
                raise CanfbError(f"{_title(failed)}: {failure}; all modules of the process end") from failure
            finally:
                for module in modules:
                    say(_summary(module))
    return 0


def make_module(
    config: ModuleConfig,
    resources: contextlib.ExitStack,
    bus_words: Mapping[str, Any],
    simulation: SimulationConfig | None = None,
) -> FeedbackModule:
    """The module with its state_dir and its source, if it has them, held until `resources` are closed.

    The bit rate of the bus belongs to the system: LSS may choose the one that it has, and no other.
    """
    store = None
    if config.state_dir is not None:
        store = resources.enter_context(StateFiles(config.state_dir))
    bit_rate = bus_words.get("bitrate")
    bit_rates = [bit_rate // 1000] if isinstance(bit_rate, int) else []
    config, source = open_source(config, simulation or SimulationConfig(), resources)
    module = FeedbackModule(config, store, source=source, bit_rates_kbit_s=bit_rates)

    def tell(faults: Mapping[ParameterGroup, str]) -> None:
        for group, why in faults.items():
            name = group.name.lower()
            report(
                f"node {module.node.node_id}: stored {name} parameters in {config.state_dir} refused: {why}; "
                "the defaults are in force"
            )

    def tell_duplicate(can_id: int, now: float) -> None:
        report(f"{_title(module)}: another node sends with this node-ID ({can_id:03X}h)")

    module.on_parameter_faults = tell
    module.node.on_duplicate = tell_duplicate
    module.on_source = lambda text: report(f"node {module.node.node_id}: {text}")
    return module


def _name(module: FeedbackModule) -> str:
    """The node-ID that it has, or is going to have."""
    module.node.storage.power_on()  # a node-ID that LSS has stored comes before that of the configuration
    module.node.lss.power_on()
    node_id = module.node.lss.pending_node_id
    if node_id == UNCONFIGURED:
        return f"without a node-ID yet (LSS, serial number {module.config.serial_number})"
    return f"{node_id} ({node_id:02X}h)"


def _title(module: FeedbackModule) -> str:
    """The node, by the node-ID that it has now."""
    node_id = module.node.node_id
    if node_id == UNCONFIGURED:
        return f"node without a node-ID (serial number {module.config.serial_number})"
    return f"node {node_id} ({node_id:02X}h)"


def _what_is_saved(module: FeedbackModule) -> list[str]:
    """Which values of the configuration are not in force, because others were saved: a line, or none."""
    module.node.storage.restore()  # the start does it again
    changed = []
    for index, subindex in configured_defaults(module.config):
        entry = module.dictionary.entry(index, subindex)
        if encode(entry.data_type, entry.value) != encode(entry.data_type, entry.default):
            changed.append(f"{index:04X}h:{subindex:02X}")
    objects = ", ".join(changed)
    return [f"node {_name(module)}: saved values come before the configuration: {objects}"] if changed else []


def _summary(module: FeedbackModule) -> str:
    names = ("missed", "residual", "amplitude", "coasted", "lost")
    counts = ", ".join(
        f"{name} {module.dictionary.entry(0x2012, n).value}" for n, name in enumerate(names, 1)
    )
    samples = module.dictionary.entry(0x2011, 8).value
    node_id = module.node.node_id
    node = _title(module) if node_id == UNCONFIGURED else f"node {node_id}"
    duplicates = module.node.counters.duplicate_frames
    others = f"; {duplicates} frames of another node with this node-ID" if duplicates else ""
    return f"{node}: {samples} samples; {counts}{others}"
