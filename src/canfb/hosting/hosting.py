"""From a configuration to modules and encoder interfaces that are served on a bus.

``canfb run`` and ``canfb interface`` do it. What cannot be on this machine (python-can, paths, processors) is
what ``canfb config check`` says; a module with what it has saved can also be had without a bus.
"""

from __future__ import annotations

import contextlib
import logging
import os
import random
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, TypeVar

from canfb.bus.opening import check_device_bus, check_words, describe
from canfb.configuration import Config, NodeConfig, RealtimeConfig, line_of
from canfb.device.storage.image import ParameterGroup
from canfb.errors import CanfbError, ConfigError
from canfb.hosting.captured_source import CapturedSource
from canfb.hosting.event_log import (
    Served,
    duplicates_of,
    name_of,
    short_title_of,
    speeds_of,
    summary_of,
    title_of,
    what_is_saved,
)
from canfb.hosting.serving import ServedDevice, Serving
from canfb.hosting.state_files import SavedParameters, StateFiles, ThreadedStore
from canfb.interface.encoder_interface import EncoderInterface
from canfb.interface.interface_config import InterfaceConfig
from canfb.interface.sample_instants import SampleClock
from canfb.module.device_configuration import DeviceConfiguration, configuration_of
from canfb.module.events import NodeEvents
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import UNCONFIGURED, ModuleConfig
from canfb.simulation.scenario import SimulationConfig
from canfb.sources.protocol import Capture, Converter, Picked, Source, SourceConfig, Surroundings


def check_machine(path: Path, config: Config) -> None:
    """ConfigError, in one line with file, line and key, for what cannot be on this machine."""
    try:
        keys: tuple[str | int, ...] = ("bus",)
        check_words(config.bus)
        check_device_bus(config.bus)
        for key, n, node in config.nodes:
            keys = (key, n, "state_dir")
            _check_state_dir(node)
            keys = (key, n, "source")
            if node.source is not None:
                node.source.check_machine()
        keys = ("realtime", "cpu")
        _check_cpu(config.realtime)
    except ConfigError as error:
        raise ConfigError(f"{path}:{line_of(path, *keys, said=str(error))}: {error}") from None


def _check_state_dir(node: NodeConfig) -> None:
    if node.state_dir is None:
        return
    folder = Path(node.state_dir)
    there = next((part for part in (folder, *folder.absolute().parents) if part.exists()), Path("/"))
    if not there.is_dir():
        raise ConfigError(f"state_dir {folder} cannot be used: {there} is not a folder")
    if not os.access(there, os.W_OK | os.X_OK):
        raise ConfigError(f"state_dir {folder} cannot be used: {there} is not writable")


def _check_cpu(realtime: RealtimeConfig) -> None:
    cpu = realtime.cpu
    # Not sched_getaffinity: a process may leave the processors that it was started on.
    count = os.cpu_count()
    if cpu is not None and count is not None and cpu >= count:
        raise ConfigError(f"cpu {cpu} in realtime: this machine has {count}, 0 to {count - 1}")
    if realtime.busy_poll and count == 1:
        raise ConfigError("busy_poll in realtime: this machine has one processor, which all programs share")


log = logging.getLogger(__name__)


class Hosting(Serving):
    """The modules of a configuration on a bus."""

    modules: list[FeedbackModule]

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
    on_parameter_faults: Callable[[Mapping[ParameterGroup, str]], None]
    on_duplicate: Callable[[int, float], None]
    on_source: Callable[[str], None] | None


def warn_about(device: _Warning, state_dir: str | None) -> None:
    """Log stored parameters that were refused, another node with its node-ID, and a source that fails."""

    def report_faults(faults: Mapping[ParameterGroup, str]) -> None:
        for group, why in faults.items():
            name = group.name.lower()
            log.warning(
                f"node {device.node.node_id}: stored {name} parameters in {state_dir} refused: {why}; "
                "the defaults are used"
            )

    def report_duplicate(can_id: int, now: float) -> None:
        log.warning(f"{title_of(device)}: another node on the bus uses this node-ID ({can_id:03X}h)")

    device.on_parameter_faults = report_faults
    device.on_duplicate = report_duplicate
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


class InterfaceHosting(Serving):
    """The encoder interfaces of a configuration on a bus. ``verbose``: each EMCY is logged, too."""

    interfaces: list[EncoderInterface]

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
        return [
            f"{short_title_of(one)}: {one.samples} samples sent"
            f"{f'; {one.missed} SYNCs without one' if one.missed else ''}{duplicates_of(one)}"
            for one in self.interfaces
        ]


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


def saved_configuration(config: ModuleConfig) -> DeviceConfiguration:
    """The module as it comes up: its configuration, and over it what is saved in its state_dir.

    ConfigError when it has no node-ID, CanfbError when what is saved is refused.
    """
    store = None if config.state_dir is None else SavedParameters(config.state_dir)
    module = FeedbackModule(config, store, source=None if config.source is None else _NoSource())
    module.start(0.0)
    if module.node.node_id == UNCONFIGURED:
        raise ConfigError(
            f"the module with serial number {config.serial_number} has no node-ID yet; a DCF needs one: "
            "set node_id in the configuration, or assign one by LSS"
        )
    for group, why in module.node.storage.faults.items():
        raise CanfbError(f"stored {group.name.lower()} parameters in {config.state_dir} refused: {why}")
    return configuration_of(module)


class _NoSource:
    """Stands in for a source that is never read."""

    def next(self) -> None:
        """No sample."""
