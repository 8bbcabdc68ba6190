"""What nodes on a bus share: one bus, one loop (canfb.bus.runner), one log.

Nothing in the loop takes long: saving and converters have threads, a reference measurement a process.
"""

from __future__ import annotations

import contextlib
import logging
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, Self

from canfb.bus.opening import check_device_bus, describe, open_device_bus
from canfb.bus.runner import Runner, outside_collections
from canfb.cia301 import cob
from canfb.cia301.frame import Frame
from canfb.configuration import RealtimeConfig
from canfb.device.lss import UNCONFIGURED
from canfb.device.node import Device, NodeDevice
from canfb.errors import CanfbError
from canfb.hosting.realtime import apply_realtime

# Listen for LISTEN_S first, so as not to disturb a running SDO transfer; then a node has ANSWER_S to respond.
LISTEN_S, ANSWER_S = 0.02, 0.1
READ_DEVICE_TYPE = b"\x40\x00\x10\x00\0\0\0\0"  # SDO upload of 1000h (CiA 301, 7.2.4.3.5)


class OnBus(ABC):
    """Owns bus, runner and the resources of the devices. Raises ConfigError and CanfbError."""

    def __init__(self, words: Mapping[str, Any], realtime: RealtimeConfig) -> None:
        self.words = dict(words)
        check_device_bus(self.words)
        self._realtime = realtime
        self._runner: Runner | None = None
        self._log_handlers = logging.getLogger("canfb").handlers

    @abstractmethod
    def _make_devices(self, resources: contextlib.ExitStack) -> list[Device]:
        """The devices; called before the bus is opened. ``resources`` closes what they open."""

    def _refuse_used_node_ids(self, runner: Runner, devices: list[Device]) -> None:
        """CanfbError if another node, not STOPPED or with a heartbeat, has the node-ID of one of them."""
        known = [one.node_id_at_power_on() for one in devices if isinstance(one, NodeDevice)]
        node_ids = [node for node in known if node != UNCONFIGURED]
        signs = {base + node: node for node in node_ids for base in (cob.SDO_RESPONSE, cob.ERROR_CONTROL)}
        asked = [Frame(cob.SDO_REQUEST + node, READ_DEVICE_TYPE) for node in node_ids]
        heard = runner.hears(signs, LISTEN_S) or runner.hears(signs, ANSWER_S, asked)
        if heard is not None:
            node = signs[heard]
            raise CanfbError(
                f"node {node} ({node:02X}h): another node on {describe(self.words)} has this node-ID "
                f"({heard:03X}h received); stop it, or set another node_id"
            )

    def _meanwhile(self, now: float) -> None:
        for handler in self._log_handlers:
            handler.flush()  # lines that a slow reader has not read yet

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as opened:
            devices = self._make_devices(opened)
            bus = opened.enter_context(open_device_bus(self.words))
            self._runner = Runner(bus, devices, meanwhile=self._meanwhile, busy_poll=self._realtime.busy_poll)
            self._refuse_used_node_ids(self._runner, devices)
            apply_realtime(self._realtime)
            opened.enter_context(outside_collections())
            self._resources = opened.pop_all()
        return self

    def __exit__(self, *raised: object) -> None:
        self._resources.close()

    def _entered(self) -> Runner:
        if self._runner is None:
            name = type(self).__name__
            raise RuntimeError(f"use {name} as a context manager: with {name}(...) as it")
        return self._runner

    def stop(self) -> None:
        if self._runner is not None:
            self._runner.stop()
