"""Devices on a bus, from the opening of the bus to its end."""

from __future__ import annotations

import contextlib
import logging
from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import TracebackType
from typing import Any, Self

from canfb.bus.opening import check_device_bus, open_device_bus
from canfb.bus.realtime import apply_realtime, outside_collections
from canfb.bus.runner import Runner
from canfb.configuration import RealtimeConfig
from canfb.device.hosted import Device


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
            self._runner = Runner(bus, devices, meanwhile=self._meanwhile)
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
