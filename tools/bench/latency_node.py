"""A node for tools.bench.latency, in a process of its own: on a socket that is handed down, or on SocketCAN.

    python -m tools.bench.latency_node KIND FILE (--fd N | --channel vcan0) [--realtime]

KIND: `canfb` is `canfb run`; `floor` answers SYNC and ADC PDO as the module does, with an angle and without
anything else: what machine and bus take. FILE gets two doubles for each time that the node woke up for
frames: when the first of them came, and the processor time of all that it did then, both in seconds.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import socket
import sys
import tempfile
import time
from array import array
from pathlib import Path
from typing import Any

from canfb.bus import on_bus
from canfb.bus.frame_bus import Received
from canfb.bus.raw_can_bus import RawCanBus
from canfb.bus.realtime import apply_realtime, outside_collections
from canfb.bus.runner import LONGEST_WAIT_S, ending_on_signals
from canfb.cli.main import main as canfb
from canfb.configuration import RealtimeConfig
from tools.bench.bus import ADC_PDO, ENCODER_INTERFACE, NODE_ID, POSITION_PDO, SYNC

KINDS = ("floor", "canfb")
SYNCHRONOUS_PDO = 0x280 + NODE_ID
UNITS_PER_CYCLE = 8192
READY = "end with Ctrl-C"
PRIORITY = 80
TRACKS_AT = 0, 2  # sine and cosine in the ADC PDO


class TimedBus(RawCanBus):
    """Keeps the processor time from one call of :meth:`receive` to the next."""

    def __init__(self, raw: socket.socket) -> None:
        super().__init__(raw)
        self.woken = array("d")
        self._came_s = 0.0  # when the first of the frames came that are being served, if any
        self._began_s = 0.0

    def receive(self, wait_s: float) -> list[Received] | None:
        """That of the bus."""
        now = time.thread_time()
        if self._came_s:
            self.woken.append(self._came_s)
            self.woken.append(now - self._began_s)
        self._began_s = now
        frames = super().receive(wait_s)
        self._came_s = frames[0][2] if frames else 0.0
        return frames


def serve_floor(bus: RawCanBus, realtime: RealtimeConfig) -> int:
    """Until SIGTERM."""
    stopped: list[bool] = []
    apply_realtime(realtime)
    with ending_on_signals(lambda: stopped.append(True)):
        print(READY, flush=True)
        units = bytes(8)
        while not stopped:
            for can_id, data, _ in bus.receive(LONGEST_WAIT_S) or ():
                if can_id == SYNC:
                    bus.send(SYNCHRONOUS_PDO, units, False)
                elif can_id == ADC_PDO:
                    sine, cosine = (
                        int.from_bytes(data[at : at + 2], "little", signed=True) for at in TRACKS_AT
                    )
                    angle = math.atan2(sine, cosine) / (2.0 * math.pi)
                    units = (round(angle * UNITS_PER_CYCLE) % UNITS_PER_CYCLE).to_bytes(8, "little")
                    bus.send(POSITION_PDO, units, False)
    return 0


def serve_module(channel: str, wishes: dict[str, Any]) -> int:
    """`canfb run` until SIGTERM."""
    module = {"node_id": NODE_ID, "encoder_interface": ENCODER_INTERFACE, "autostart": True}
    words = {"interface": "socketcan", "channel": channel}
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "latency.yaml"
        config.write_text(json.dumps({"bus": words, "modules": [module], "realtime": wishes}))
        return canfb(["run", str(config)])


def main() -> int:
    """Serve one node."""
    parser = argparse.ArgumentParser()
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("file", type=Path)
    parser.add_argument("--fd", type=int)
    parser.add_argument("--channel", default="handed-down")
    parser.add_argument("--realtime", action="store_true")
    options = parser.parse_args()
    bus = TimedBus.open(options.channel) if options.fd is None else TimedBus(socket.socket(fileno=options.fd))
    cpu = max(os.sched_getaffinity(0))
    wishes: dict[str, Any] = (
        {"priority": PRIORITY, "lock_memory": True, "cpu": cpu} if options.realtime else {}
    )
    if options.kind == "floor":
        with outside_collections():
            status = serve_floor(bus, RealtimeConfig(**wishes))
    else:
        setattr(on_bus, "open_device_bus", lambda words: bus)  # noqa: B010
        status = serve_module(options.channel, wishes)
    with options.file.open("wb") as file:
        bus.woken.tofile(file)
    return status


if __name__ == "__main__":
    sys.exit(main())
