"""``canfb simulate``: a simulation on a bus."""

from __future__ import annotations

import contextlib
import logging
import math
from collections.abc import Callable, Mapping
from typing import Any

from canfb.bus.opening import describe
from canfb.cia301.codes import NmtState
from canfb.configuration import RealtimeConfig
from canfb.device.node import Device
from canfb.hosting.event_log import name_of, warn_of_another
from canfb.hosting.serving import OnBus
from canfb.module.module_config import ModuleConfig
from canfb.simulation.scenario import SimulationConfig
from canfb.simulation.set_up import Play, SimulatedNetwork, set_up

log = logging.getLogger(__name__)


class Simulating(OnBus):
    """A simulation on a bus until ``seconds`` of machine time, the end of a recording, or :meth:`stop`."""

    def __init__(
        self,
        simulation: SimulationConfig,
        module: ModuleConfig,
        play: Play,
        words: Mapping[str, Any],
        realtime: RealtimeConfig,
        seconds: float | None = None,
    ) -> None:
        super().__init__(words, realtime)
        self.network: SimulatedNetwork = set_up(simulation, module, play, log.warning)
        self._intervals = math.inf if seconds is None else seconds * self.network.rate_hz
        warn_of_another(self.network.interface, lambda node: f"encoder interface {name_of(node)}")
        if self.network.drive is not None:
            warn_of_another(self.network.drive, lambda node: f"drive {name_of(node)}")

    def _make_devices(self, resources: contextlib.ExitStack) -> list[Device]:
        return list(self.network.devices)

    def run(self, ready: Callable[[], None] = lambda: None) -> None:
        """Run to the end; call ``ready`` once on the bus."""
        runner, network = self._entered(), self.network

        def on_the_bus() -> None:
            log.info(
                f"encoder interface: node {name_of(network.interface)} on {describe(self.words)}"
                f"{', waits for NMT start (--autostart)' * (network.interface.state != NmtState.OPERATIONAL)}"
                "; end with Ctrl-C"
            )
            if network.drive is not None:
                log.info(network.drive.describe())
            if network.demand is not None:
                log.info(network.demand.describe())
                warning = network.demand.warning()
                if warning is not None:
                    log.warning(warning)
            ready()

        runner.run(lambda: network.interface.ended or len(network.recorder) >= self._intervals, on_the_bus)
