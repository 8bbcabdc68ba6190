"""From a configuration to nodes on a bus."""

from __future__ import annotations

import contextlib
import logging
import os
import random
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from canfb.bus.clocks import now_s
from canfb.bus.opening import check_device_bus, check_words, describe
from canfb.bus.runner import DeviceFailure
from canfb.configuration import Config, NodeConfig, RealtimeConfig, line_of
from canfb.device.node import Device
from canfb.device.storage.kept import ParameterGroup
from canfb.errors import CanfbError, ConfigError, saying
from canfb.hosting.captured_source import CapturedSource
from canfb.hosting.event_log import (
    EventLog,
    duplicates_of,
    name_of,
    short_title_of,
    speeds_of,
    summary_of,
    title_of,
    warn_of_another,
    what_is_saved,
)
from canfb.hosting.self_diagnosis import SelfDiagnosis
from canfb.hosting.serving import OnBus
from canfb.hosting.state_files import SavedParameters, StateFiles, ThreadedStore
from canfb.interface.encoder_interface import EncoderInterface, InterfaceConfig, SampleClock
from canfb.module.device_configuration import DeviceConfiguration, configuration_of
from canfb.module.events import NodeEvents
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import UNCONFIGURED, ModuleConfig
from canfb.sources.protocol import Converter, Source, SourceConfig, Surroundings


def check_machine(path: Path, config: Config) -> None:
    """ConfigError, with line and key, for a setting that this machine does not support."""
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
    with saying(ConfigError, f"state_dir {folder} cannot be used", OSError):
        there = next((part for part in (folder, *folder.absolute().parents) if part.exists()), Path("/"))
    if not there.is_dir():
        raise ConfigError(f"state_dir {folder} cannot be used: {there} is not a folder")
    if not os.access(there, os.W_OK | os.X_OK):
        raise ConfigError(f"state_dir {folder} cannot be used: {there} is not writable")


def _check_cpu(realtime: RealtimeConfig) -> None:
    cpu = realtime.cpu
    # Not sched_getaffinity: a process may select other processors than it was started on.
    count = os.cpu_count()
    if cpu is not None and count is not None and cpu >= count:
        raise ConfigError(f"cpu {cpu} in realtime: this machine has {count}, 0 to {count - 1}")
    if realtime.busy_poll and count == 1:
        raise ConfigError("busy_poll in realtime: this machine has one processor, which all programs share")


log = logging.getLogger(__name__)


class Hosting(OnBus):
    """Modules and encoder interfaces of a configuration on a bus: a context manager around :meth:`run`.

    ``words`` are options of python-can, default: those of ``config``. ConfigError or CanfbError on entering,
    for an unusable bus, state_dir or source.
    """

    def __init__(
        self, config: Config, words: Mapping[str, Any] | None = None, *, verbose: bool = False
    ) -> None:
        super().__init__(config.bus if words is None else words, config.realtime)
        self.config = config
        self._events = EventLog(verbose)
        kept = (one.state_dir for _, _, one in config.nodes if one.state_dir is not None)
        self.diagnosis = SelfDiagnosis(
            config, self.words, self._entered, folder=Path(next(kept, tempfile.gettempdir()))
        )

    def _make_devices(self, resources: contextlib.ExitStack) -> list[Device]:
        resources.enter_context(self.diagnosis.keeping_the_log())
        config = self.config
        self.modules = [make_module(one, resources, self.words, config) for one in config.modules]
        self.interfaces = [make_interface(one, resources, self.words, config) for one in config.interfaces]
        for module in self.modules:
            self._events.watch(module, module.events)
        for interface in self.interfaces:
            interface.observer = events = NodeEvents()
            self._events.watch(interface, events)
        self._nodes: list[FeedbackModule | EncoderInterface] = [*self.modules, *self.interfaces]
        return list(self._nodes)

    def _at_start(self) -> list[str]:
        named = [(module, name_of(module)) for module in self.modules]
        modules = ", ".join(name for _, name in named)
        interfaces = ", ".join(name_of(one) for one in self.interfaces)
        lists = [f"running node {modules}"] * bool(named)
        lists += [f"encoder interface: node {interfaces}"] * bool(interfaces)
        saved = [line for module, name in named for line in what_is_saved(module, name)]
        said = f"{', '.join(lists)} on {describe(self.words)}; end with Ctrl-C"
        return [said, *saved, *speeds_of(named)]

    def _at_end(self) -> list[str]:
        return [
            *(summary_of(module) for module in self.modules),
            *(
                f"{short_title_of(one)}: {one.samples} samples sent"
                f"{f'; {one.missed} SYNCs without one' if one.missed else ''}{duplicates_of(one)}"
                for one in self.interfaces
            ),
        ]

    def _meanwhile(self, now: float) -> None:
        self._events.tick(now)
        self._alive(now)
        self.diagnosis.step(self._nodes)
        super()._meanwhile(now)

    def run(
        self,
        ready: Callable[[], None] = lambda: None,
        alive: Callable[[float], None] = lambda now: None,
    ) -> None:
        """Serve the nodes until :meth:`stop`; call ``ready`` once on the bus, and ``alive`` periodically.

        CanfbError for a program error in a node, which ends all of them.
        """
        runner = self._entered()
        self._alive = alive
        lines = self._at_start()

        def on_the_bus() -> None:
            for line in lines:
                log.info(line)
            self._events.begin()
            ready()

        try:
            runner.run(ready=on_the_bus)
        except DeviceFailure as failure:
            raise CanfbError(
                f"{title_of(failure.device)}: {failure}; all nodes of the process end"
            ) from failure
        finally:
            self._events.close(now_s())
            for line in self._at_end():
                log.info(line)
            self.diagnosis.finish(self._nodes)


def make_module(
    config: ModuleConfig,
    resources: contextlib.ExitStack,
    bus_words: Mapping[str, Any],
    whole: Config | None = None,
) -> FeedbackModule:
    """The module with its state_dir and source, which `resources` closes."""
    store = open_store(config.state_dir, resources)
    source = None
    if config.source is not None:
        config, source = open_source(config, config.source, whole or Config(), resources)
    module = FeedbackModule(config, store, source=source, bit_rates_kbit_s=bit_rates_of(bus_words))
    warn_about(module, config.state_dir)
    module.on_warning = module.on_source
    return module


def open_store(state_dir: str | None, resources: contextlib.ExitStack) -> ThreadedStore | None:
    """The store, which `resources` closes; None without a state_dir."""
    if state_dir is None:
        return None
    files = resources.enter_context(StateFiles(state_dir))
    return resources.enter_context(contextlib.closing(ThreadedStore(files)))


def bit_rates_of(bus_words: Mapping[str, Any]) -> list[int]:
    """Bit rates that LSS may select, kbit/s: only the configured one."""
    bit_rate = bus_words.get("bitrate")
    return [bit_rate // 1000] if isinstance(bit_rate, int) else []


def warn_about(device: FeedbackModule | EncoderInterface, state_dir: str | None) -> None:
    def report_faults(faults: Mapping[ParameterGroup, str]) -> None:
        for group, why in faults.items():
            name = group.name.lower()
            log.warning(
                f"node {device.node_id}: stored {name} parameters in {state_dir} refused: {why}; "
                "the defaults are used"
            )

    device.on_parameter_faults = report_faults
    warn_of_another(device, title_of)
    device.on_source = lambda text: log.warning(f"node {device.node_id}: {text}")


Sampling = TypeVar("Sampling", ModuleConfig, InterfaceConfig)


def open_source(
    config: Sampling, settings: SourceConfig, whole: Config, resources: contextlib.ExitStack
) -> tuple[Sampling, Source]:
    """The source with these ``settings``, which ``resources`` closes, and ``config`` with its ADC bits.

    CanfbError for an unusable source.
    """

    def captured(*opening: Any) -> Source:
        return resources.enter_context(contextlib.closing(CapturedSource(*opening)))

    around = Surroundings(
        config.adc_bits,
        config.cycles_per_revolution,
        lambda *asked: whole.simulation.source(*asked),  # loads what simulates when it is asked for
        captured,
        resources,
    )
    source = settings.open(around)
    if isinstance(source, Converter):
        with saying(ConfigError, f"with {source.adc_bits} bits of {settings.title}", ValueError):
            config = replace(config, adc_bits=source.adc_bits)
    return config, source


def make_interface(
    config: InterfaceConfig,
    resources: contextlib.ExitStack,
    bus_words: Mapping[str, Any],
    whole: Config | None = None,
) -> EncoderInterface:
    """The interface with its source and state_dir, which `resources` closes."""
    store = open_store(config.state_dir, resources)
    config, source = open_source(config, config.source, whole or Config(), resources)
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
    """The module after power-on: its configuration, overridden by saved values.

    ConfigError without a node-ID, CanfbError for refused parameters.
    """
    store = None if config.state_dir is None else SavedParameters(config.state_dir)
    module = FeedbackModule(config, store, source=None if config.source is None else _NoSource())
    module.start(0.0)
    if module.node_id == UNCONFIGURED:
        raise ConfigError(
            f"the module with serial number {config.serial_number} has no node-ID yet; a DCF needs one: "
            "set node_id in the configuration, or assign one by LSS"
        )
    for group, why in module.storage.faults.items():
        raise CanfbError(f"stored {group.name.lower()} parameters in {config.state_dir} refused: {why}")
    return configuration_of(module)


class _NoSource:
    """Placeholder for a source that is never read."""

    def next(self) -> None:
        """No sample."""
