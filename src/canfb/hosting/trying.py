"""A simulated network on a bus, for ``canfb try``."""

from __future__ import annotations

import contextlib
import logging
import os
import platform
import socket
import tempfile
import threading
import time
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, Self

import can

from canfb.bus.bus_state import BUS_FAILS
from canfb.bus.frame_bus import ERROR, EXTENDED, REMOTE
from canfb.bus.opening import MULTICAST, group_port, open_device_bus
from canfb.bus.shared_bus import beside
from canfb.cia301.frame import HIGHEST_ID, Frame
from canfb.configuration import Config
from canfb.errors import BusError, saying
from canfb.hosting.event_log import EventLog
from canfb.hosting.hosting import make_module
from canfb.simulation.embedded_bus import EmbeddedBus
from canfb.simulation.set_up import Play, set_up

log = logging.getLogger(__name__)

START_ALL = Frame(0x000, b"\x01\x00")  # NMT (CiA 301, 7.2.8.3.1)
LONGEST_LAG_S = 0.5  # if the computer lags by more, the machine runs slower than real time
LOOPBACK = "127.0.0.1"
PRIVATE_GROUPS = 16  # groups that one user of one computer can use at the same time


@contextlib.contextmanager
def private_bus() -> Iterator[dict[str, Any]]:
    """Bus options for a multicast group of this user on this computer. BusError if all are in use."""
    user = f"{platform.node()} {os.getuid() if hasattr(os, 'getuid') else os.environ.get('USERNAME')}"
    for number in range(PRIVATE_GROUPS):
        place = zlib.crc32(f"{user} {number}".encode()) % (256 * 254)
        group = f"239.255.{place // 254}.{place % 254 + 1}"  # the local scope of RFC 2365
        # An open TCP port of the same number reserves the group; it is freed however the process ends.
        with socket.socket() as lock:
            try:
                lock.bind((LOOPBACK, group_port(group)))
            except OSError:
                continue
            yield {"interface": MULTICAST, "channel": group, "hop_limit": 0}
            return
    raise BusError(f"{PRIVATE_GROUPS} private buses of this user are in use; end one of them")


class NetworkOnBus:
    """The first module of ``config``, its encoder interface and the SYNC at ``rate_hz``, in a thread.

    A master starts them. Saved parameters are removed at the end. CanfbError if the bus fails.
    """

    def __init__(self, config: Config, rate_hz: float) -> None:
        self.config = config
        self.on_end: Callable[[], None] = lambda: None
        self._events = EventLog()
        self._rate_hz = rate_hz
        self._network = EmbeddedBus()
        self._received: Frame | None = None
        self._stopped = threading.Event()

    def __enter__(self) -> Self:
        network, events = self._network, self._events
        with contextlib.ExitStack() as held:
            folder = held.enter_context(tempfile.TemporaryDirectory(prefix="canfb-"))
            module = replace(self.config.modules[0], state_dir=folder)
            self.config = replace(self.config, modules=[module])
            self.module = make_module(module, held, self.config.bus)
            self._bus = held.enter_context(open_device_bus(self.config.bus))
            play = Play(rate_hz=self._rate_hz)
            simulated = set_up(self.config.simulation, module, play, log.warning)
            events.watch(self.module, self.module.events)
            held.callback(lambda: events.close(network.now))
            network.observers.append(self._send)
            for device in (*simulated.devices, self.module):
                network.attach(device)
            network.send(START_ALL)
            events.begin()
            held.enter_context(beside(self._run, self.stop, self._failed))
            self._held = held.pop_all()
        return self

    def __exit__(self, *raised: object) -> None:
        self._held.close()

    def stop(self) -> None:
        self._stopped.set()

    def wait(self) -> None:
        self._stopped.wait()

    def _failed(self) -> None:
        self._stopped.set()
        self.on_end()

    def _run(self) -> None:
        network, step_s, due = self._network, 1.0 / self._rate_hz, time.monotonic()
        with saying(BusError, BUS_FAILS, can.CanError, OSError):
            while not self._stopped.is_set():
                self._receive(max(0.0, due - time.monotonic()))
                now = time.monotonic()
                if now >= due:
                    network.run_until(network.now + step_s)
                    due = max(due + step_s, now - LONGEST_LAG_S)
                    self._events.tick(network.now)

    def _receive(self, wait_s: float) -> None:
        received = self._bus.receive(wait_s)
        if received is not None and not received[0] & (ERROR | EXTENDED):
            can_id, data, _ = received
            self._received = Frame(can_id & HIGHEST_ID, data, bool(can_id & REMOTE))
            self._network.send(self._received)

    def _send(self, frame: Frame, now: float) -> None:
        if frame is not self._received:
            self._bus.send(frame.can_id, bytes(frame.data), frame.rtr)
