"""``canfb run CONFIG.yaml``: feedback modules on a real bus."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Mapping

from canfb.bus.opening import describe, open_bus
from canfb.bus.realtime import apply_realtime
from canfb.bus.runner import Runner, ending_on_signals
from canfb.bus.state_files import StateFiles
from canfb.cli.options import Commands, add_bus_options, add_command, bus_options, report
from canfb.configuration import load_config
from canfb.device.image import ParameterGroup
from canfb.module.config import ModuleConfig
from canfb.module.feedback_module import FeedbackModule


def register(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(commands, "run", "run the feedback modules of a configuration on a bus", run)
    parser.add_argument("config", metavar="CONFIG.yaml")
    add_bus_options(parser)


def run(options: argparse.Namespace) -> int:
    """Serve the modules until Ctrl-C or SIGTERM."""
    config = load_config(options.config)
    words = bus_options(options, config.bus)
    with contextlib.ExitStack() as resources:
        modules = [make_module(module, resources) for module in config.modules]
        bus = resources.enter_context(open_bus(words))
        runner = Runner(bus, list(modules), report)
        apply_realtime(config.realtime, report)
        nodes = ", ".join(f"{module.config.node_id} ({module.config.node_id:02X}h)" for module in modules)
        with ending_on_signals(runner.stop):
            print(f"running node {nodes} on {describe(words)}; end with Ctrl-C", flush=True)
            runner.run()
    for module in modules:
        print(_summary(module), flush=True)
    return 0


def make_module(config: ModuleConfig, resources: contextlib.ExitStack) -> FeedbackModule:
    """The module with its state_dir, if it has one, which is held until `resources` are closed."""
    store = None
    if config.state_dir is not None:
        store = resources.enter_context(StateFiles(config.state_dir))
    module = FeedbackModule(config, store)

    def tell(faults: Mapping[ParameterGroup, str]) -> None:
        for group, why in faults.items():
            name = group.name.lower()
            report(
                f"node {config.node_id}: stored {name} parameters in {config.state_dir} refused: {why}; "
                "the defaults are in force"
            )

    module.on_parameter_faults = tell
    return module


def _summary(module: FeedbackModule) -> str:
    names = ("missed", "residual", "amplitude", "coasted", "lost")
    counts = ", ".join(
        f"{name} {module.dictionary.entry(0x2012, n).value}" for n, name in enumerate(names, 1)
    )
    samples = module.dictionary.entry(0x2011, 8).value
    return f"node {module.config.node_id}: {samples} samples; {counts}"
