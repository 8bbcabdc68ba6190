"""Measure what a cycle costs on a bus, in `canfb run` and in a stock canopen.LocalNode on python-can.

    python -m tools.bench.bus [--cycles N] [--repeat N] [--rate HZ] [--kinds stock,canfb]
    python3 -m tools.vcan run -- .venv/bin/python -m tools.bench.bus --channel vcan0

Each node is a process; this program plays SYNC producer and encoder interface: SYNC and ADC PDO, and the
position PDO comes back. The bus is a pair of datagram sockets that carry struct can_frame, so that what the
programs need shows without a driver, or with --channel a SocketCAN interface.

Printed are the processor time of a node for one cycle (user and system, of all its threads), at --rate and
when each cycle begins with the position of the one before, and the cycles per second then: medians of
--repeat rounds in turns, and the medians of their ratios to the first of --kinds.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import select
import socket
import statistics
import struct
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

from tools.bench.node_process import PATIENCE_S, NodeProcess

NODE_ID, ENCODER_INTERFACE = 32, 16
SYNC, ADC_PDO, POSITION_PDO = 0x080, 0x180 + ENCODER_INTERFACE, 0x180 + NODE_ID
CAN_FRAME = struct.Struct("=IB3x8s")
STEP_CYCLES = 0.1
SAMPLES_BEFORE_REPEAT = 1000  # 100 cycles of the encoder
WARM_UP = 300
MOST_MISSED = 0.5  # of the samples, on a machine that is busy with other work
KINDS = ("stock", "python-can", "canfb", "canfb:alone", "floor")


class Node:
    """A node as a process, and the far end of its bus. ``rate_hz`` is 0 for as fast as it goes."""

    def __init__(self, kind: str, channel: str | None, rate_hz: float) -> None:
        self.kind = kind
        self._rate_hz = rate_hz
        arguments = ["tools.bench.bus_node", kind, *["--true-time"] * bool(rate_hz)]
        self._process = NodeProcess(arguments, channel, ready="ready")
        self.bus = self._process.bus
        if channel is not None:
            only_position = struct.pack("=II", POSITION_PDO, 0x7FF)
            self.bus.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, only_position)
        self.bus.settimeout(PATIENCE_S)
        self._clock = self._process.processor_clock
        self._played = 0
        self.play(WARM_UP)

    def end(self) -> None:
        """End the process."""
        self._process.end()

    def play(self, cycles: int) -> tuple[float, float]:
        """Processor time of the node and time on the wall of so many cycles, seconds for one."""
        started, used = time.perf_counter(), time.clock_gettime(self._clock)
        if self._rate_hz:
            self._play_paced(cycles)
        else:
            for _ in range(cycles):
                self._send_samples()
                while not _is_position(self._receive()):
                    pass
        spent_s = time.clock_gettime(self._clock) - used
        return spent_s / cycles, (time.perf_counter() - started) / cycles

    def _play_paced(self, cycles: int) -> None:
        positions, start = 0, time.perf_counter()
        for cycle in range(cycles):
            self._send_samples()
            positions += self._positions_until(start + (cycle + 1) / self._rate_hz)
        if positions < (1.0 - MOST_MISSED) * cycles:
            sys.exit(f"the node {self.kind} sent {positions} positions for {cycles} samples")

    def _send_samples(self) -> None:
        self.bus.send(SYNC_FRAME)
        self.bus.send(ADC_FRAMES[self._played % SAMPLES_BEFORE_REPEAT])
        self._played += 1

    def _receive(self) -> bytes:
        try:
            return self.bus.recv(CAN_FRAME.size)
        except TimeoutError:
            sys.exit(f"the node {self.kind} does not answer")

    def _positions_until(self, moment: float) -> int:
        positions = 0
        while (left := moment - time.perf_counter()) > 0:
            if select.select([self.bus], [], [], left)[0]:
                positions += _is_position(self.bus.recv(CAN_FRAME.size))
        return positions


def _is_position(frame: bytes) -> bool:
    return bool(struct.unpack_from("=I", frame) == (POSITION_PDO,))


def adc_frame(number: int, step_cycles: float = STEP_CYCLES) -> bytes:
    """The ADC PDO of one sample of an encoder that turns steadily."""
    angle = 2.0 * math.pi * step_cycles * number
    data = struct.pack("<hh", round(1500 * math.sin(angle)), round(1500 * math.cos(angle)))
    return CAN_FRAME.pack(ADC_PDO, len(data), data)


SYNC_FRAME = CAN_FRAME.pack(SYNC, 0, b"")
ADC_FRAMES = [adc_frame(number) for number in range(SAMPLES_BEFORE_REPEAT)]


@dataclass
class Found:
    """Of each round: processor time of a cycle, µs, paced and not, and cycles per second when not paced."""

    paced_us: list[float] = field(default_factory=list)
    fast_us: list[float] = field(default_factory=list)
    fast_hz: list[float] = field(default_factory=list)


def measure(
    kinds: Sequence[str], channel: str | None, rate_hz: float, cycles: int, repeat: int
) -> list[Found]:
    """All kinds in turns, with one node at a time: on one interface they would hear each other."""
    found = [Found() for _ in kinds]
    for _ in range(repeat):
        for rate in (rate_hz, 0.0):
            for kind, one in zip(kinds, found, strict=True):
                with contextlib.closing(_Ending(Node(kind, channel, rate))) as played:
                    processor_s, wall_s = played.node.play(cycles)
                (one.paced_us if rate else one.fast_us).append(processor_s * 1e6)
                if not rate:
                    one.fast_hz.append(1.0 / wall_s)
    return found


@dataclass
class _Ending:
    node: Node

    def close(self) -> None:
        self.node.end()


def _against(ours: list[float], others: list[float]) -> str:
    # A node that a busy machine has not let run has spent nothing.
    ratio = statistics.median(one / two if two else math.nan for one, two in zip(ours, others, strict=True))
    return f"{statistics.median(ours):.0f} | {ratio:.2f}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.bench.bus",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--cycles", type=int, default=2000, help="of one round (2000)")
    parser.add_argument("--repeat", type=int, default=5, help="rounds (5)")
    parser.add_argument("--rate", type=float, default=1000.0, help="SYNC rate in Hz (1000)")
    parser.add_argument("--channel", help="a SocketCAN interface (a pair of sockets)")
    parser.add_argument("--kinds", default=",".join(KINDS), help=f"of {', '.join(KINDS)}")
    options = parser.parse_args(arguments)
    kinds = options.kinds.split(",")
    if not set(kinds) <= set(KINDS) or not 1.0 <= options.rate <= 1e4 or options.cycles < 1:
        parser.error(f"--kinds: {', '.join(KINDS)}; --rate: 1 to 10000 Hz; --cycles: at least 1")
    found = measure(kinds, options.channel, options.rate, options.cycles, options.repeat)
    first = found[0]
    print(f"| node | CPU µs per cycle at {options.rate:g} Hz | ratio | in turns | ratio | cycles/s | ratio |")
    print("|---" * 7 + "|")
    for kind, one in zip(kinds, found, strict=True):
        cells = (
            _against(one.paced_us, first.paced_us),
            _against(one.fast_us, first.fast_us),
            _against(one.fast_hz, first.fast_hz),
        )
        print(f"| {kind} | {' | '.join(cells)} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
