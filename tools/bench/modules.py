"""Measure what one frame costs in a process with one, eight or more modules.

    python -m tools.bench.modules [--modules 1,8,32] [--cycles N] [--repeat N]

One cycle is a SYNC, then an ADC PDO for each module, to which each answers with its position PDOs; so the
number of frames grows with the modules, and the time for one frame ought not to. The runner is that of
`canfb run`, the bus costs nothing: it hands out the frames of a cycle and forgets what is sent. Times are
those of the process, measured in turns; printed are medians, the median ratio to the first row, and which
part of a processor a SYNC rate of 1 kHz takes.
"""

from __future__ import annotations

import argparse
import math
import statistics
import struct
import sys
import time
from collections.abc import Iterable, Sequence
from typing import cast

try:
    from canfb.bus.frame_bus import FrameBus, Received
    from canfb.bus.frame_reader import MOST_FRAMES
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
START_S = 1000.0


class FreeBus:
    """Hands out the frames of each cycle at once, in pieces as a bus does, and counts what is sent."""

    def __init__(self, modules: int, cycles: int) -> None:
        self._pieces = iter(traffic(modules, cycles))
        self.now = 0.0
        self.sent = self.received = 0
        self.over = False

    def clock(self) -> float:
        """Seconds, as the frames have them."""
        return self.now

    def receive(self, wait_s: float) -> list[Received] | None:
        """The next frames."""
        frames = next(self._pieces, None)
        self.over = frames is None
        if frames is not None:
            self.now = frames[0][2]
            self.received += len(frames)
        return frames

    def send(self, can_id: int, data: bytes, remote: bool) -> bool:
        """Forget it."""
        self.sent += 1
        return True

    def hear(self, can_ids: Iterable[int] | None, remote_can_ids: Iterable[int]) -> None:
        """It has what is needed."""


def traffic(modules: int, cycles: int) -> list[list[Received]]:
    """SYNC and ADC PDOs of machines that turn slowly."""
    pieces = []
    for cycle in range(cycles):
        angle = 0.2 * cycle
        data = PAIR.pack(round(AMPLITUDE_COUNTS * math.sin(angle)), round(AMPLITUDE_COUNTS * math.cos(angle)))
        at = START_S + INTERVAL_S * cycle
        frames = [(SYNC, b"", at), *((0x180 + FIRST_INTERFACE + n, data, at) for n in range(modules))]
        pieces += [frames[n : n + MOST_FRAMES] for n in range(0, len(frames), MOST_FRAMES)]
    return pieces


def cost(modules: int, cycles: int) -> tuple[float, float]:
    """Process time for one frame in or out, microseconds, and the frames of a cycle, in the steady state."""
    devices = [
        FeedbackModule(
            ModuleConfig(node_id=FIRST_NODE + n, encoder_interface=FIRST_INTERFACE + n, autostart=True)
        )
        for n in range(modules)
    ]
    bus = FreeBus(modules, cycles)
    runner = Runner(cast(FrameBus, bus), list(devices), clock=bus.clock, wall=bus.clock)
    started = time.process_time()
    runner.run(finished=lambda: bus.over)
    spent = time.process_time() - started
    samples = [device.dictionary.entry(0x2011, 8).value for device in devices]
    if samples != [cycles] * modules:
        raise RuntimeError(f"not each module has had each sample: {samples}")
    frames = bus.received + bus.sent
    return spent / frames * 1e6, frames / cycles


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
    rounds = [[cost(count, options.cycles) for count in counts] for _ in range(options.repeat)]
    print("modules  us per frame  ratio  processor at 1 kHz")
    for place, count in enumerate(counts):
        costs_us = [one[place][0] for one in rounds]
        ratio = statistics.median(one[place][0] / one[0][0] for one in rounds)
        middle_us = statistics.median(costs_us)
        part = middle_us * rounds[0][place][1] * 1e-6 / INTERVAL_S
        print(f"{count:7d}  {middle_us:12.1f}  {ratio:5.2f}  {part:17.0%}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
