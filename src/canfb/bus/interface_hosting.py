"""From a configuration to encoder interfaces that are served on a bus, as ``canfb interface`` does it."""

from __future__ import annotations

import contextlib
import random
from collections.abc import Mapping
from typing import Any

from canfb.bus.hosting import bit_rates_of, open_source, open_store, warn_about
from canfb.bus.module_lines import duplicates_of, name_of, short_title_of
from canfb.bus.opening import describe
from canfb.bus.serving import ServedDevice, Serving
from canfb.configuration import Config
from canfb.interface.encoder_interface import EncoderInterface
from canfb.interface.interface_config import InterfaceConfig
from canfb.interface.sample_clock import SampleClock
from canfb.module.node_events import NodeEvents
from canfb.simulation.scenario import SimulationConfig


class InterfaceHosting(Serving):
    """The encoder interfaces of a configuration on a bus; ``words`` are its own if not given.

    ``verbose``: each EMCY is logged, too.
    """

    def __init__(
        self, config: Config, words: Mapping[str, Any] | None = None, *, verbose: bool = False
    ) -> None:
        super().__init__(config, words, verbose=verbose)
        self.interfaces: list[EncoderInterface] = []

    def _make_nodes(self, resources: contextlib.ExitStack) -> list[tuple[ServedDevice, NodeEvents]]:
        config = self.config
        self.interfaces = [
            make_interface(one, resources, self.words, config.simulation) for one in config.interfaces
        ]
        events = [NodeEvents() for _ in self.interfaces]
        for interface, its in zip(self.interfaces, events, strict=True):
            interface.observer = its
        return list(zip(self.interfaces, events, strict=True))

    def _at_start(self) -> list[str]:
        nodes = ", ".join(name_of(one) for one in self.interfaces)
        return [f"encoder interface: node {nodes} on {describe(self.words)}; end with Ctrl-C"]

    def _at_end(self) -> list[str]:
        return [summary_of_interface(one) for one in self.interfaces]


def make_interface(
    config: InterfaceConfig,
    resources: contextlib.ExitStack,
    bus_words: Mapping[str, Any],
    simulation: SimulationConfig | None = None,
) -> EncoderInterface:
    """The interface with its source and its state_dir, held until `resources` are closed.

    What its own clock shows at the start is arbitrary; a scan with a time stamp does not use it.
    """
    store = open_store(config.state_dir, resources)
    config, source = open_source(config, config.source, simulation or SimulationConfig(), resources)
    interface = EncoderInterface(
        config.node_id,
        source,
        autostart=config.autostart,
        store=store,
        serial_number=config.serial_number,
        times=config.times,
        samples_per_sync=config.samples_per_sync,
        clock=SampleClock(0.0, random.getrandbits(32)),
        bit_rates_kbit_s=bit_rates_of(bus_words),
    )
    warn_about(interface, config.state_dir)
    return interface


def summary_of_interface(interface: EncoderInterface) -> str:
    """What it has sampled, at the end."""
    missed = f"; {interface.missed} SYNCs without one" if interface.missed else ""
    return f"{short_title_of(interface)}: {interface.samples} samples sent{missed}{duplicates_of(interface)}"
