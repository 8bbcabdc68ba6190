"""Measure what one frame costs in a process with one, eight or more modules.

    python -m tools.bench.modules [--modules 1,8,32] [--cycles N] [--repeat N]

One cycle is a SYNC, then an ADC PDO for each module, to which each answers with its position PDO; so the
number of frames grows with the modules, and the time for one frame ought not to. The runner is that of
`canfb run`, the bus costs nothing: it hands out messages that are made beforehand and forgets what is sent.
Times are those of the process; printed are medians.
"""

from __future__ import annotations

import argparse
import math
import statistics
import struct
import sys
import time
from collections.abc import Sequence
from typing import Any, cast

try:
    import can

    from canfb.bus.python_can_bus import PythonCanBus
    from canfb.bus.runner import Runner
    from canfb.module.feedback_module import FeedbackModule
    from canfb.module.module_config import ModuleConfig
except ImportError as error:
    sys.exit(f"{error}: run this file with the Python of the virtual environment")

FIRST_NODE, FIRST_INTERFACE = 1, 64
SYNC = 0x080
PAIR = struct.Struct("<hh")
AMPLITUDE_COUNTS = 1500
MOST_MODULES = 63
INTERVAL_S = 0.001


class FreeBus:
    """Hands out messages at once, and counts what is sent."""

    def __init__(self, messages: Sequence[can.Message]) -> None:
        self._messages = iter(messages)
        self.now = 1000.0
        self.sent = 0
        self.over = False

    def recv(self, timeout: float) -> can.Message | None:
        message = next(self._messages, None)
        self.over = message is None
        if message is not None:
            self.now = message.timestamp
        return message

    def clock(self) -> float:
        """Seconds, as the messages have them."""
        return self.now

    def send(self, message: can.Message) -> None:
        self.sent += 1


def message(can_id: int, timestamp: float, data: bytes = b"") -> can.Message:
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False, timestamp=timestamp)


def traffic(modules: int, cycles: int) -> list[can.Message]:
    """SYNC and ADC PDOs of machines that turn slowly."""
    messages = []
    for cycle in range(cycles):
        angle = 0.2 * cycle
        data = PAIR.pack(round(AMPLITUDE_COUNTS * math.sin(angle)), round(AMPLITUDE_COUNTS * math.cos(angle)))
        at = 1000.0 + INTERVAL_S * (cycle + 1)
        messages.append(message(SYNC, at))
        messages += [message(0x180 + FIRST_INTERFACE + n, at, data) for n in range(modules)]
    return messages


def microseconds_per_frame(modules: int, cycles: int) -> float:
    """Process time for one frame in or out, in the steady state."""
    devices = [
        FeedbackModule(
            ModuleConfig(node_id=FIRST_NODE + n, encoder_interface=FIRST_INTERFACE + n, autostart=True)
        )
        for n in range(modules)
    ]
    messages = traffic(modules, cycles)
    bus = FreeBus(messages)
    runner = Runner(PythonCanBus(cast(Any, bus)), list(devices), clock=bus.clock, wall=bus.clock)
    started = time.process_time()
    runner.run(finished=lambda: bus.over)
    spent = time.process_time() - started
    samples = [device.dictionary.entry(0x2011, 8).value for device in devices]
    if samples != [cycles] * modules:
        raise RuntimeError(f"not each module has had each sample: {samples}")
    return spent / (len(messages) + bus.sent) * 1e6


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.bench.modules", description=__doc__.splitlines()[0] if __doc__ else None
    )
    parser.add_argument("--modules", default="1,8,32", help="how many modules, 1 to 63, with commas")
    parser.add_argument("--cycles", type=int, default=200)
    parser.add_argument("--repeat", type=int, default=5)
    options = parser.parse_args(arguments)
    counts = [int(count) for count in options.modules.split(",")]
    if not all(1 <= count <= MOST_MODULES for count in counts):
        parser.error(f"--modules: 1 to {MOST_MODULES}")
    print("modules  us per frame")
    for count in counts:
        times = [microseconds_per_frame(count, options.cycles) for _ in range(options.repeat)]
        print(f"{count:7d}  {statistics.median(times):12.1f}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
