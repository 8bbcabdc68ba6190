"""A node for tools.bench.bus, in a process of its own: on a socket that is handed down, or on SocketCAN.

    python -m tools.bench.bus_node KIND (--fd N | --channel vcan0)

KIND: `stock` is a canopen.LocalNode that answers with atan2, on python-can; `python-can` is the runner of
`canfb run` with one module on python-can, `canfb` the same as it is delivered. `alone` after a colon
(`canfb:alone`) switches the second TPDO of the module off, which the stock node does not have. `floor`
answers with a constant: what the bus takes. Without --true-time the time of the module passes by the SYNC.
"""

from __future__ import annotations

import argparse
import gc
import logging
import signal
import socket
import sys
import time
from collections.abc import Callable
from typing import Any, cast

import can
import canopen
from can.interfaces.socketcan import SocketcanBus, socketcan

from canfb.bus.frame_bus import FrameBus, Received
from canfb.bus.python_can_bus import PythonCanBus
from canfb.bus.raw_can_bus import RawCanBus
from canfb.bus.runner import Runner, ending_on_signals
from tools.bench.cycle import ADC_PDO, INTERVAL_S, POSITION_PDO, SYNC, feedback_module, stock_node

NO_TPDO2 = 0x8000_0000


def python_can_bus(options: argparse.Namespace) -> can.BusABC:
    """python-can's own SocketCAN bus; on the socket that was handed down, if one was."""
    if options.fd is None:
        return SocketcanBus(options.channel)
    given = socket.socket(fileno=options.fd)
    logging.getLogger("can").setLevel(logging.CRITICAL)  # it is no CAN socket, and takes no such option
    stand_ins: dict[str, Callable[..., Any]] = {
        "create_socket": lambda: given,
        "bind_socket": lambda *arguments: None,
    }
    for name, stand_in in stand_ins.items():
        setattr(socketcan, name, stand_in)
    return SocketcanBus("given")


def serve_stock(options: argparse.Namespace) -> None:
    """Until SIGTERM."""
    network = canopen.Network(python_can_bus(options))
    stock_node(network)
    network.connect()
    say_ready()
    signal.sigwait({signal.SIGTERM})


def serve_module(options: argparse.Namespace, bus: FrameBus) -> None:
    """Until SIGTERM."""
    module = feedback_module()
    if options.alone:
        entry = module.dictionary.entry(0x1801, 1)
        entry.store(entry.value | NO_TPDO2)
    if options.true_time:
        runner = Runner(bus, [module])
    else:
        timed = ByTheSync(bus)
        runner = Runner(cast(FrameBus, timed), [module], clock=timed.clock, wall=timed.clock)
    with ending_on_signals(runner.stop):
        runner.run(ready=say_ready)


class ByTheSync:
    """A bus whose time passes by 1 ms with each SYNC: the module takes those that come early for doubles."""

    def __init__(self, bus: FrameBus) -> None:
        self._bus = bus
        self.send, self.hear = bus.send, bus.hear
        self.now = 1000.0

    def clock(self) -> float:
        """Seconds; the true clock is read all the same, for what it costs."""
        time.monotonic()
        return self.now

    def receive(self, wait_s: float) -> list[Received] | None:
        """The next frames."""
        frames = self._bus.receive(wait_s)
        if frames is None:
            return None
        stamped = []
        for can_id, data, _ in frames:
            if can_id == SYNC:
                self.now += INTERVAL_S
            stamped.append((can_id, data, self.now))
        return stamped


def serve_constant(bus: FrameBus) -> None:
    """Until SIGTERM, which ends it."""
    say_ready()
    while True:
        for can_id, _, _ in bus.receive(2 * INTERVAL_S) or ():
            if can_id == ADC_PDO:
                bus.send(POSITION_PDO, bytes(8), False)


def say_ready() -> None:
    """For the program that measures."""
    gc.collect()
    print("ready", flush=True)


def main() -> int:
    """Serve one node."""
    parser = argparse.ArgumentParser()
    parser.add_argument("kind")
    parser.add_argument("--fd", type=int)
    parser.add_argument("--channel")
    parser.add_argument("--true-time", action="store_true")
    options = parser.parse_args()
    kind, _, alone = options.kind.partition(":")
    options.alone = bool(alone)
    if kind == "stock":
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
        serve_stock(options)
    elif kind == "python-can":
        serve_module(options, PythonCanBus(python_can_bus(options)))
    else:
        given = None if options.fd is None else socket.socket(fileno=options.fd)
        bus = RawCanBus.open(options.channel) if given is None else RawCanBus(given)
        if kind == "floor":
            serve_constant(bus)
        else:
            serve_module(options, bus)
    return 0


if __name__ == "__main__":
    sys.exit(main())
