"""Nodes of a configuration on a bus: from the opening of the bus to its end.

And what they say at the start, while they run, and at the end.
"""

from __future__ import annotations

import contextlib
import logging
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

from canfb.bus.opening import check_device_bus, open_device_bus
from canfb.bus.runner import BusCounters, DeviceFailure, Runner, outside_collections
from canfb.configuration import Config, RealtimeConfig
from canfb.device.device_protocol import Device
from canfb.errors import CanfbError
from canfb.hosting.event_log import EventLog, Served, title_of
from canfb.hosting.realtime import apply_realtime
from canfb.hosting.self_diagnosis import SelfDiagnosis
from canfb.module.events import NodeEvents


class OnBus(ABC):
    """A context manager that holds the bus, the runner, and what the devices need, while it is entered.

    ``words`` are python-can's own for the bus. ConfigError for a bus on which a device would hear itself;
    CanfbError, on entering, for one that cannot be opened.
    """

    def __init__(self, words: Mapping[str, Any], realtime: RealtimeConfig) -> None:
        self.words = dict(words)
        check_device_bus(self.words)
        self._realtime = realtime
        self._runner: Runner | None = None
        self._resources = contextlib.ExitStack()
        self._log_handlers = logging.getLogger("canfb").handlers

    @abstractmethod
    def _make_devices(self, resources: contextlib.ExitStack) -> list[Device]:
        """The devices; what they have open is closed with ``resources``. Before the bus is opened."""

    def _meanwhile(self, now: float) -> None:
        """Called now and then, between frames."""
        for handler in self._log_handlers:
            handler.flush()  # what a slow reader has not taken yet

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as opened:
            devices = self._make_devices(opened)
            bus = opened.enter_context(open_device_bus(self.words))
            self._runner = Runner(bus, devices, meanwhile=self._meanwhile, busy_poll=self._realtime.busy_poll)
            apply_realtime(self._realtime)
            opened.enter_context(outside_collections())
            self._resources = opened.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._resources.close()

    def stop(self) -> None:
        """End the run; may be called from a signal handler or another thread."""
        if self._runner is not None:
            self._runner.stop()


log = logging.getLogger(__name__)


class ServedDevice(Served, Device, Protocol):
    """A device around a node of ours."""


class Serving(OnBus):
    """Nodes on a bus. Use it as a context manager around :meth:`run`.

    ``words`` are python-can's own for the bus (interface, channel, ...), those of ``config`` if not given.
    What there is to say goes to the loggers ``canfb.*``: information on what runs and what happens
    (:class:`.EventLog`, which ``verbose`` makes say more), warnings on what fails and on what works again.
    ConfigError for a bus on which a device would hear itself; CanfbError, on entering, for a bus, a state_dir
    or a source that cannot be used.
    """

    def __init__(self, config: Config, words: Mapping[str, Any] | None, *, verbose: bool) -> None:
        super().__init__(config.bus if words is None else words, config.realtime)
        self.config = config
        self._nodes: list[ServedDevice] = []
        self._events = EventLog(verbose)
        self._alive: Callable[[float], None] = lambda now: None
        self._looked_s = 0.0
        folders = [Path(one.state_dir) for _, _, one in config.nodes if one.state_dir is not None]
        folder = folders[0] if folders else Path(tempfile.gettempdir())
        self._diagnosis = SelfDiagnosis(config, self.words, self._bus_counters, folder)

    @abstractmethod
    def _make_nodes(self, resources: contextlib.ExitStack) -> list[tuple[ServedDevice, NodeEvents]]:
        """The nodes, each with its events; what they have open is closed with ``resources``."""

    @abstractmethod
    def _at_start(self) -> list[str]:
        """What to say when the nodes are on the bus; asked before their start."""

    @abstractmethod
    def _at_end(self) -> list[str]:
        """What to say of the nodes at the end."""

    def _make_devices(self, resources: contextlib.ExitStack) -> list[Device]:
        resources.enter_context(self._diagnosis.keeping_the_log())
        made = self._make_nodes(resources)
        for device, events in made:
            self._events.watch(device, events)
        self._nodes = [device for device, _ in made]
        return list(self._nodes)

    def _meanwhile(self, now: float) -> None:
        self._looked_s = now
        self._events.tick(now)
        self._alive(now)
        self._diagnosis.step(self._nodes)
        super()._meanwhile(now)

    def _bus_counters(self) -> BusCounters:
        return BusCounters() if self._runner is None else self._runner.counters

    def diagnose(self) -> None:
        """Write a diagnosis soon, into the first state_dir, else the folder of temporary files.

        A line of the log says where. It may be called by a signal handler.
        """
        self._diagnosis.request()

    def run(
        self,
        ready: Callable[[], None] = lambda: None,
        alive: Callable[[float], None] = lambda now: None,
    ) -> None:
        """Serve the nodes until :meth:`stop`. ``ready`` is called when they are on the bus.

        ``alive`` is called again and again with the time, seconds (monotonic), as long as they are served.

        A program error in one of them ends it for all, with CanfbError.
        """
        if self._runner is None:
            name = type(self).__name__
            raise RuntimeError(f"use {name} as a context manager: with {name}(config) as hosting")
        self._alive = alive
        lines = self._at_start()

        def on_the_bus() -> None:
            for line in lines:
                log.info(line)
            self._events.begin()
            ready()

        try:
            self._runner.run(ready=on_the_bus)
        except DeviceFailure as failure:
            (failed,) = (device for device in self._nodes if device is failure.device)
            raise CanfbError(f"{title_of(failed)}: {failure}; all nodes of the process end") from failure
        finally:
            self._events.close(max(self._looked_s, *(device.node.now for device in self._nodes)))
            for line in self._at_end():
                log.info(line)
