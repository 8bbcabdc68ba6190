"""A module and its encoder interface in simulated time, on a virtual bus: to look at a page without a bus."""

from __future__ import annotations

import contextlib
import struct
import tempfile
import time
from types import TracebackType
from typing import Any, Self
from uuid import uuid4

import can

from canfb import objects as od
from canfb.bus.hosting import make_module
from canfb.bus.opening import open_bus
from canfb.bus.scoping import ListeningThread
from canfb.bus.simulating import fed_module
from canfb.cia301 import cob
from canfb.cia301.frame import Frame
from canfb.configuration import Config
from canfb.module.module_config import ModuleConfig
from canfb.simulation.embedded_bus import EmbeddedBus
from canfb.simulation.scenario import EncoderScenario, HarmonicConfig, MotionConfig, SimulationConfig
from canfb.simulation.set_up import Play, set_up

NODE, RATE_HZ = 0x20, 200.0
STEP_S = 1.0 / RATE_HZ
LONGEST_LAG_S = 0.5  # a computer that is later than that has a slow machine
# A mediocre encoder, on a machine whose speed varies.
ENCODER = EncoderScenario(
    amplitude=0.73,
    sine_offset=0.04,
    cosine_offset=-0.03,
    sine_amplitude=1.03,
    cosine_amplitude=0.96,
    phase_error_rad=0.05,
    harmonics=[HarmonicConfig(order=3, sine=0.012, cosine=0.01)],
)
SIMULATION = SimulationConfig(encoder=ENCODER, motion=MotionConfig(rpm=60.0, ripple_rpm=3.0, ripple_hz=0.15))


# TPDO3 carries the velocity at each sample: seen from outside it would have the jitter of this computer.
TPDO3, MAPPING = od.TPDO + 2, od.TPDO_MAPPING + 2
BYTE, LONG = 0x2F, 0x23  # expedited downloads (CiA 301, 7.2.4.3.3)
MAPPED = (
    (LONG, MAPPING, 1, 0x20110720),
    (BYTE, MAPPING, 0, 1),
    (BYTE, TPDO3, 2, 254),
    (LONG, TPDO3, 1, cob.TPDO3 + NODE),
)
DOWNLOAD = struct.Struct("<BHBI")


class ScopeDemo:
    """Runs in a thread while it is entered; ``words`` are python-can's for its bus."""

    def __init__(self) -> None:
        self.words: dict[str, Any] = {"interface": "virtual", "channel": f"canfb scope {uuid4()}"}
        self._held = contextlib.ExitStack()
        folder = self._held.enter_context(tempfile.TemporaryDirectory(prefix="canfb-scope-"))
        module = ModuleConfig(node_id=NODE, autostart=True, state_dir=folder)
        self.config = Config(self.words, [module], simulation=SIMULATION)
        self.module = make_module(module, self._held, self.words)
        self._network = EmbeddedBus()
        self._heard: Frame | None = None
        self._stopped = False
        self._thread = ListeningThread(self._run, self._stop)

    def __enter__(self) -> Self:
        self._bus = self._held.enter_context(open_bus(self.words))
        (module,) = self.config.modules
        play = Play(rate_hz=RATE_HZ, autostart=True)
        network = set_up(SIMULATION, fed_module(module), play, lambda text: None)
        for device in (*network.devices, self.module):
            self._network.attach(device)
        for download in MAPPED:
            self._network.send(Frame(cob.SDO_REQUEST + NODE, DOWNLOAD.pack(*download)))
        self._network.taps.append(self._send)
        self._thread.begin(lambda: None)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._thread.end()
        finally:
            self.close()

    def close(self) -> None:
        """What it holds, also where it was never entered."""
        self._held.close()

    def _stop(self) -> None:
        self._stopped = True

    def _run(self) -> None:
        network, due = self._network, time.monotonic()
        while not self._stopped:
            message = self._bus.recv(max(0.0, due - time.monotonic()))
            if message is not None:
                self._heard = Frame(message.arbitration_id, bytes(message.data), message.is_remote_frame)
                network.send(self._heard)
            now = time.monotonic()
            if now >= due:
                network.run_until(network.now + STEP_S)
                due = max(due + STEP_S, now - LONGEST_LAG_S)

    def _send(self, frame: Frame, now: float) -> None:
        if frame is not self._heard:
            data = bytes(frame.data)
            self._bus.send(
                can.Message(
                    arbitration_id=frame.can_id, data=data, is_extended_id=False, is_remote_frame=frame.rtr
                )
            )
