"""Run a module on a bus that is full: 1 Mbit/s, and not a bit time between the frames.

    python -m tools.bench.full_bus [--cycles N]

A cycle is SYNC, the ADC PDO and the position PDO, with stuff bits as they may come at worst; the next SYNC
follows at once, which is a SYNC of 3.5 kHz. The runner is that of `canfb run`; the bus hands out the frames
with their receive times and costs nothing. Printed are what was lost, and how long the processor worked for
a second on the bus. Exit status 1 if a SYNC or a sample was lost, or a position was not valid.
"""

from __future__ import annotations

import argparse
import math
import struct
import sys
import time
from collections.abc import Iterable, Sequence
from typing import cast

try:
    from canfb.bus.frame_bus import FrameBus, Received
    from canfb.bus.runner import Runner
    from canfb.cia301.frame import frame_bits
    from canfb.module.feedback_module import FeedbackModule
    from canfb.module.module_config import ModuleConfig
except ImportError as error:
    sys.exit(f"{error}: run this file with the Python of the virtual environment")

SYNC, INTERFACE, MODULE = 0x080, 16, 32
BIT_S = 1e-6
PAIR = struct.Struct("<hh")
AMPLITUDE_COUNTS, SPEED_CYCLES = 1500, 0.237
START_S = 1000.0
SYNC_BITS, ADC_BITS, POSITION_BITS = frame_bits(0), frame_bits(4), frame_bits(8)
CYCLE_S = (SYNC_BITS + ADC_BITS + POSITION_BITS) * BIT_S
COUNTERS = {"missed": 1, "residual": 2, "lost": 5, "bad frames": 8, "SYNCs not heard": 14}


class FullBus:
    """SYNC and ADC PDO of each cycle, at the times at which they end; counts the positions."""

    def __init__(self, cycles: int) -> None:
        self._left, self._cycle, self._pdo_next = cycles, 0, False
        self.now = START_S
        self.over = False
        self.positions = self.not_valid = 0

    def clock(self) -> float:
        """Seconds, as the frames have them."""
        return self.now

    def receive(self, wait_s: float) -> list[Received] | None:
        """The next frame."""
        if not self._left:
            self.over = True
            return None
        end_of_sync = START_S + self._cycle * CYCLE_S + SYNC_BITS * BIT_S
        self._pdo_next = not self._pdo_next
        if self._pdo_next:
            self.now = end_of_sync
            return [(SYNC, b"", self.now)]
        self.now = end_of_sync + ADC_BITS * BIT_S
        angle = 2.0 * math.pi * SPEED_CYCLES * self._cycle
        self._cycle += 1
        self._left -= 1
        tracks = round(AMPLITUDE_COUNTS * math.sin(angle)), round(AMPLITUDE_COUNTS * math.cos(angle))
        return [(0x180 + INTERFACE, PAIR.pack(*tracks), self.now)]

    def send(self, can_id: int, data: bytes, remote: bool) -> bool:
        """The position PDO."""
        if can_id == 0x180 + MODULE:
            self.positions += 1
            self.not_valid += not data[4] & 1
        return True

    def hear(self, can_ids: Iterable[int] | None, remote_can_ids: Iterable[int]) -> None:
        """It has what is needed."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.bench.full_bus", description=__doc__.splitlines()[0] if __doc__ else None
    )
    parser.add_argument("--cycles", type=int, default=1_000_000)
    options = parser.parse_args(arguments)
    if options.cycles < 1:
        parser.error("--cycles must be 1 or more")
    module = FeedbackModule(ModuleConfig(node_id=MODULE, encoder_interface=INTERFACE, autostart=True))
    module.dictionary.entry(0x1801, 1).value |= 1 << 31  # the position once in each cycle
    bus = FullBus(options.cycles)
    runner = Runner(cast(FrameBus, bus), [module], clock=bus.clock, wall=bus.clock)
    began = time.process_time()
    runner.run(finished=lambda: bus.over)
    spent_s = time.process_time() - began
    lost = {name: module.dictionary.entry(0x2012, sub).value for name, sub in COUNTERS.items()}
    samples = module.dictionary.entry(0x2011, 8).value
    print(f"{options.cycles} cycles of {CYCLE_S * 1e6:.0f} us, {1.0 / CYCLE_S:.0f} Hz; {samples} samples")
    print(", ".join(f"{name} {count}" for name, count in lost.items()))
    print(f"{bus.positions} positions, {bus.not_valid} not valid")
    part = spent_s / (options.cycles * CYCLE_S)
    print(f"processor: {part:.0%} of a core, {spent_s / options.cycles * 1e6:.1f} us for a cycle")
    good = samples == options.cycles == bus.positions and not any(lost.values()) and not bus.not_valid
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
