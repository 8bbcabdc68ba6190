"""A node for tools.bench.bus, in its own process: on an inherited socket, or on SocketCAN.

    python -m tools.bench.bus_node KIND (--fd N | --channel vcan0) [--realtime yes|busy]

KIND: `stock` is a canopen.LocalNode that answers with atan2, on python-can; `canfb` is `canfb run`; `floor`
answers SYNC and ADC PDO with an angle and does nothing else: the time that machine and bus take. It prints a
line with READY when it is on the bus.
"""

import argparse
import json
import logging
import math
import os
import signal
import socket
import sys
import tempfile
from pathlib import Path
from typing import Any

import can
import canopen
from can.interfaces.socketcan import SocketcanBus, socketcan

from canfb.bus.raw_can_bus import RawCanBus
from canfb.bus.runner import LONGEST_WAIT_S, outside_collections
from canfb.cli.main import main as canfb
from canfb.configuration import RealtimeConfig
from canfb.hosting import serving
from canfb.hosting.realtime import apply_realtime
from tools.bench.cycle import (
    ADC_PDO,
    ENCODER_INTERFACE,
    NODE_ID,
    PAIR,
    POSITION_PDO,
    SYNC,
    UNITS_PER_CYCLE,
    stock_node,
)

NODES = ("stock", "canfb", "floor")
READY = "end with Ctrl-C"
PRIORITY = 80
REALTIME = ("no", "yes", "busy")
SYNCHRONOUS_PDO = 0x280 + NODE_ID


def python_can_bus(options: argparse.Namespace) -> can.BusABC:
    """The SocketCAN bus of python-can; on the inherited socket, if there is one."""
    if options.fd is None:
        return SocketcanBus(options.channel)
    given = socket.socket(fileno=options.fd)
    logging.getLogger("can").setLevel(logging.CRITICAL)  # it warns that this socket lacks options of CAN
    vars(socketcan).update(create_socket=lambda: given, bind_socket=lambda *arguments: None)
    return SocketcanBus("given")


def raw_bus(options: argparse.Namespace) -> RawCanBus:
    if options.fd is None:
        return RawCanBus.open(options.channel)
    return RawCanBus(socket.socket(fileno=options.fd))


def serve_stock(bus: can.BusABC, realtime: RealtimeConfig) -> None:
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
    network = canopen.Network(bus)
    stock_node(network)
    network.connect()
    apply_realtime(realtime)
    print(READY, flush=True)
    signal.sigwait({signal.SIGTERM})


def serve_floor(bus: RawCanBus, realtime: RealtimeConfig) -> None:
    apply_realtime(realtime)
    units = bytes(8)
    wait_s = 0.0 if realtime.busy_poll else LONGEST_WAIT_S
    with outside_collections():
        print(READY, flush=True)
        while True:
            can_id, data, _ = bus.receive(wait_s) or (-1, b"", 0.0)
            if can_id == SYNC:
                bus.send(SYNCHRONOUS_PDO, units, False)
            elif can_id == ADC_PDO:
                angle = math.atan2(*PAIR.unpack(data)) / (2.0 * math.pi)
                units = (round(angle * UNITS_PER_CYCLE) % UNITS_PER_CYCLE).to_bytes(8, "little")
                bus.send(POSITION_PDO, units, False)


def serve_module(bus: RawCanBus, realtime: dict[str, Any]) -> int:
    setattr(serving, "open_device_bus", lambda words: bus)  # noqa: B010
    module = {"node_id": NODE_ID, "encoder_interface": ENCODER_INTERFACE, "autostart": True}
    words = {"interface": "socketcan", "channel": "handed-down"}
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "module.yaml"
        config.write_text(json.dumps({"bus": words, "modules": [module], "realtime": realtime}))
        return canfb(["run", str(config)])


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("kind", choices=NODES)
    parser.add_argument("--fd", type=int)
    parser.add_argument("--channel")
    parser.add_argument("--realtime", choices=REALTIME, default="no")
    options = parser.parse_args()
    cpu = max(os.sched_getaffinity(0))
    wishes: dict[str, dict[str, Any]] = {
        "no": {},
        "yes": {"priority": PRIORITY, "lock_memory": True, "cpu": cpu},
        "busy": {"lock_memory": True, "cpu": cpu, "busy_poll": True},
    }
    realtime = wishes[options.realtime]
    if options.kind == "stock":
        serve_stock(python_can_bus(options), RealtimeConfig(**realtime))
    elif options.kind == "floor":
        serve_floor(raw_bus(options), RealtimeConfig(**realtime))
    else:
        return serve_module(raw_bus(options), realtime)
    return 0


if __name__ == "__main__":
    sys.exit(main())
