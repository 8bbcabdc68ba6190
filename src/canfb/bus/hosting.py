"""From a configuration to modules that are served on a bus, as ``canfb run`` does it."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from canfb.bus.background_store import ThreadedStore
from canfb.bus.captured_source import CapturedSource
from canfb.bus.event_log import EventLog
from canfb.bus.module_lines import name_of, speeds_of, summary_of, title_of, what_is_saved
from canfb.bus.on_bus import OnBus
from canfb.bus.opening import describe
from canfb.bus.runner import DeviceFailure
from canfb.bus.state_files import StateFiles
from canfb.configuration import Config
from canfb.device.hosted import Device
from canfb.device.storage.image import ParameterGroup
from canfb.errors import CanfbError, ConfigError
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.simulation.scenario import SimulationConfig
from canfb.sources.protocol import Converter, Source
from canfb.sources.surroundings import Capture, Surroundings

log = logging.getLogger(__name__)


class Hosting(OnBus):
    """The modules of a configuration on a bus. Use it as a context manager around :meth:`run`.

    ``words`` are python-can's own for the bus (interface, channel, ...), those of the configuration if not
    given. What there is to say goes to the loggers ``canfb.*``: information on what runs and what happens
    (:class:`.EventLog`, which ``verbose`` makes say more), warnings on what fails and on what works again.
    ConfigError for a bus on which a device would hear itself; CanfbError, on
    entering, for a bus, a state_dir or a source that cannot be used.
    """

    def __init__(
        self, config: Config, words: Mapping[str, Any] | None = None, *, verbose: bool = False
    ) -> None:
        super().__init__(config.bus if words is None else words, config.realtime)
        self.config = config
        self.modules: list[FeedbackModule] = []
        self._events = EventLog(verbose)
        self._alive: Callable[[float], None] = lambda now: None
        self._looked_s = 0.0

    def _make_devices(self, resources: contextlib.ExitStack) -> list[Device]:
        config = self.config
        self.modules = [
            make_module(module, resources, self.words, config.simulation) for module in config.modules
        ]
        for made in self.modules:
            self._events.watch(made)
        return list(self.modules)

    def _meanwhile(self, now: float) -> None:
        self._looked_s = now
        self._events.tick(now)
        self._alive(now)
        super()._meanwhile(now)

    def run(
        self,
        ready: Callable[[], None] = lambda: None,
        alive: Callable[[float], None] = lambda now: None,
    ) -> None:
        """Serve the modules until :meth:`stop`. ``ready`` is called when they are on the bus.

        ``alive`` is called again and again with the time, seconds (monotonic), as long as they are served.

        A program error in one of them ends it for all, with CanfbError.
        """
        if self._runner is None:
            raise RuntimeError("use Hosting as a context manager: with Hosting(config) as hosting")
        self._alive = alive
        named = [(module, name_of(module)) for module in self.modules]
        nodes = ", ".join(name for _, name in named)
        saved = [line for module, name in named for line in what_is_saved(module, name)]
        speeds = speeds_of(named)

        def on_the_bus() -> None:
            for line in (f"running node {nodes} on {describe(self.words)}; end with Ctrl-C", *saved, *speeds):
                log.info(line)
            self._events.begin()
            ready()

        try:
            self._runner.run(ready=on_the_bus)
        except DeviceFailure as failure:
            (failed,) = (module for module in self.modules if module is failure.device)
            raise CanfbError(f"{title_of(failed)}: {failure}; all modules of the process end") from failure
        finally:
            self._events.close(max(self._looked_s, *(module.node.now for module in self.modules)))
            for module in self.modules:
                log.info(summary_of(module))


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
        files = resources.enter_context(StateFiles(config.state_dir))
        store = resources.enter_context(ThreadedStore(files))
    bit_rate = bus_words.get("bitrate")
    bit_rates = [bit_rate // 1000] if isinstance(bit_rate, int) else []
    config, source = open_source(config, simulation or SimulationConfig(), resources)
    module = FeedbackModule(config, store, source=source, bit_rates_kbit_s=bit_rates)

    def tell(faults: Mapping[ParameterGroup, str]) -> None:
        for group, why in faults.items():
            name = group.name.lower()
            log.warning(
                f"node {module.node.node_id}: stored {name} parameters in {config.state_dir} refused: {why}; "
                "the defaults are used"
            )

    def tell_duplicate(can_id: int, now: float) -> None:
        log.warning(f"{title_of(module)}: another node on the bus uses this node-ID ({can_id:03X}h)")

    module.on_parameter_faults = tell
    module.node.on_duplicate = tell_duplicate
    module.on_source = module.on_warning = lambda text: log.warning(f"node {module.node.node_id}: {text}")
    return module


def open_source(
    config: ModuleConfig, simulation: SimulationConfig, resources: contextlib.ExitStack
) -> tuple[ModuleConfig, Source | None]:
    """The source, or None for the ADC PDO, and the configuration with the bits of its converter.

    What is open is closed with ``resources``. CanfbError, in one line, for a source that cannot be used.
    """
    settings = config.source
    if settings is None:
        return config, None

    def captured(opened: Callable[[], Capture], name: str, wait_s: float) -> Source:
        return resources.enter_context(CapturedSource(opened, name, wait_s))

    around = Surroundings(config.adc_bits, config.cycles_per_revolution, simulation, captured, resources)
    source = settings.open(around)
    if isinstance(source, Converter):
        try:
            config = replace(config, adc_bits=source.adc_bits)
        except ValueError as error:
            raise ConfigError(f"with {source.adc_bits} bits of {settings.title}: {error}") from None
    return config, source
