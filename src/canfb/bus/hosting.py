"""From a configuration to modules that are served on a bus, as ``canfb run`` does it."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Protocol, TypeVar

from canfb.bus.background_store import ThreadedStore
from canfb.bus.captured_source import CapturedSource
from canfb.bus.module_lines import Served, name_of, speeds_of, summary_of, title_of, what_is_saved
from canfb.bus.opening import describe
from canfb.bus.serving import ServedDevice, Serving
from canfb.bus.state_files import StateFiles
from canfb.configuration import Config
from canfb.device.storage.image import ParameterGroup
from canfb.errors import ConfigError
from canfb.interface.interface_config import InterfaceConfig
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.module.node_events import NodeEvents
from canfb.simulation.scenario import SimulationConfig
from canfb.sources.protocol import Converter, Source
from canfb.sources.source_config import SourceConfig
from canfb.sources.surroundings import Capture, Picked, Surroundings

log = logging.getLogger(__name__)


class Hosting(Serving):
    """The modules of a configuration on a bus; ``words`` are those of the configuration if not given."""

    def __init__(
        self, config: Config, words: Mapping[str, Any] | None = None, *, verbose: bool = False
    ) -> None:
        super().__init__(config, words, verbose=verbose)
        self.modules: list[FeedbackModule] = []

    def _make_nodes(self, resources: contextlib.ExitStack) -> list[tuple[ServedDevice, NodeEvents]]:
        config = self.config
        self.modules = [
            make_module(module, resources, self.words, config.simulation) for module in config.modules
        ]
        return [(module, module.events) for module in self.modules]

    def _at_start(self) -> list[str]:
        named = [(module, name_of(module)) for module in self.modules]
        nodes = ", ".join(name for _, name in named)
        saved = [line for module, name in named for line in what_is_saved(module, name)]
        return [f"running node {nodes} on {describe(self.words)}; end with Ctrl-C", *saved, *speeds_of(named)]

    def _at_end(self) -> list[str]:
        return [summary_of(module) for module in self.modules]


def make_module(
    config: ModuleConfig,
    resources: contextlib.ExitStack,
    bus_words: Mapping[str, Any],
    simulation: SimulationConfig | None = None,
) -> FeedbackModule:
    """The module with its state_dir and its source, if it has them, held until `resources` are closed."""
    store = open_store(config.state_dir, resources)
    source = None
    if config.source is not None:
        config, source = open_source(config, config.source, simulation or SimulationConfig(), resources)
    module = FeedbackModule(config, store, source=source, bit_rates_kbit_s=bit_rates_of(bus_words))
    warn_about(module, config.state_dir)
    module.on_warning = module.on_source
    return module


def open_store(state_dir: str | None, resources: contextlib.ExitStack) -> ThreadedStore | None:
    """The state_dir, held until `resources` are closed; None without one."""
    if state_dir is None:
        return None
    return resources.enter_context(ThreadedStore(resources.enter_context(StateFiles(state_dir))))


def bit_rates_of(bus_words: Mapping[str, Any]) -> list[int]:
    """In kbit/s: the bit rate of the bus belongs to the system, and LSS may choose the one that it has."""
    bit_rate = bus_words.get("bitrate")
    return [bit_rate // 1000] if isinstance(bit_rate, int) else []


class _Warning(Served, Protocol):
    on_parameter_faults: Callable[[Mapping[ParameterGroup, str]], None] | None
    on_duplicate: Callable[[int, float], None] | None
    on_source: Callable[[str], None] | None


def warn_about(device: _Warning, state_dir: str | None) -> None:
    """Log stored parameters that were refused, another node with its node-ID, and a source that fails."""

    def tell(faults: Mapping[ParameterGroup, str]) -> None:
        for group, why in faults.items():
            name = group.name.lower()
            log.warning(
                f"node {device.node.node_id}: stored {name} parameters in {state_dir} refused: {why}; "
                "the defaults are used"
            )

    def tell_duplicate(can_id: int, now: float) -> None:
        log.warning(f"{title_of(device)}: another node on the bus uses this node-ID ({can_id:03X}h)")

    device.on_parameter_faults = tell
    device.on_duplicate = tell_duplicate
    device.on_source = lambda text: log.warning(f"node {device.node.node_id}: {text}")


Sampling = TypeVar("Sampling", ModuleConfig, InterfaceConfig)


def open_source(
    config: Sampling, settings: SourceConfig, simulation: SimulationConfig, resources: contextlib.ExitStack
) -> tuple[Sampling, Source]:
    """The source with these ``settings``, and the configuration with the bits of its converter.

    What is open is closed with ``resources``. CanfbError, in one line, for a source that cannot be used.
    """

    def captured(opened: Callable[[], Capture], name: str, wait_s: float, picked: Picked | None) -> Source:
        return resources.enter_context(CapturedSource(opened, name, wait_s, picked))

    around = Surroundings(config.adc_bits, config.cycles_per_revolution, simulation, captured, resources)
    source = settings.open(around)
    if isinstance(source, Converter):
        try:
            config = replace(config, adc_bits=source.adc_bits)
        except ValueError as error:
            raise ConfigError(f"with {source.adc_bits} bits of {settings.title}: {error}") from None
    return config, source
