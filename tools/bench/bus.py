"""Measure a node on a bus: processor time of a cycle, and how long a position takes after SYNC and ADC PDO.

    python -m tools.bench.bus [--nodes stock,canfb] [--loads alone,sdo,full] [--realtime no,yes,busy]
                              [--cycles N] [--rounds N] [--rate HZ]
    python3 -m tools.vcan run -- .venv/bin/python -m tools.bench.bus --channel vcan0 --rate 100

Each node is a process of its own: `canfb` is `canfb run`, `stock` a canopen.LocalNode that answers with
atan2, `floor` answers and does nothing else: what machine and bus take.
This program plays SYNC producer, encoder interface and a load: nothing (alone), correction tables by SDO
block transfer (sdo), or frames of other nodes up to 1 Mbit/s (full). The bus is a pair of datagram sockets
that carry struct can_frame, or with --channel a SocketCAN interface. Each SYNC is answered by TPDO2 (type 1;
not by `stock`), each ADC PDO by TPDO1 (type 254). Realtime: SCHED_FIFO, mlockall and a processor of its own,
as far as the system permits; busy: the node never sleeps.

All combinations are measured in turns, in --rounds parts. Printed are the processor time of the node for one
cycle (user and system, of all its threads), its ratio to that of the first row, both as medians of the
rounds, and percentiles of the times. docs/latency.md says how to read the figures.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import math
import os
import signal
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np

from canfb.configuration import RealtimeConfig
from canfb.hosting.realtime import apply_realtime
from tools.bench.bus_node import NODES, READY, REALTIME
from tools.bench.bus_others import LOADS, Others
from tools.site.text import table

Combination = tuple[str, str, str]
PRIORITY = 90  # priority of this program, above that of the node
PATIENCE_S = 20.0
PARTS = (0.5, 0.99, 0.999, 1.0)
HEAD = (
    *("load", "node", "realtime", "CPU of a cycle", "ratio"),
    *("SYNC to TPDO2", "ADC PDO to TPDO1", "later than a period"),
)


class NodeProcess:
    """Runs tools.bench.bus_node on a bus until :meth:`end`; this program uses :attr:`bus`."""

    def __init__(self, arguments: Sequence[str], channel: str | None) -> None:
        command = [sys.executable, "-m", "tools.bench.bus_node", *arguments]
        if channel is None:
            self.bus, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
            command += ["--fd", str(theirs.fileno())]
        else:
            theirs = self.bus = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
            self.bus.bind((channel,))
            command += ["--channel", channel]
        self._process = subprocess.Popen(
            command, stdout=subprocess.PIPE, text=True, pass_fds=[theirs.fileno()]
        )
        if theirs is not self.bus:
            theirs.close()
        assert self._process.stdout is not None
        if not any(READY in line for line in iter(self._process.stdout.readline, "")):
            sys.exit(f"{' '.join(arguments)} did not start")
        self._clock = (~self._process.pid << 3) | 2  # CPU clock of the process: clock_getcpuclockid(3)

    def processor_s(self) -> float:
        return time.clock_gettime(self._clock)

    def end(self) -> None:
        """End the process."""
        self._process.send_signal(signal.SIGTERM)
        try:
            self._process.communicate(timeout=PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.communicate()
        finally:
            self.bus.close()


@dataclass
class Found:
    """Results of one combination: processor time of a cycle in each round, latencies of all rounds, µs."""

    processor_us: list[float] = field(default_factory=list)
    from_sync_us: list[float] = field(default_factory=list)
    from_adc_us: list[float] = field(default_factory=list)
    late: int = 0

    def cells(self, first: Found) -> list[str]:
        # On a busy machine a node may not have run at all in a round: 0.
        pairs = zip(self.processor_us, first.processor_us, strict=True)
        ratio = statistics.median(one / two if two else math.nan for one, two in pairs)
        return [
            *(f"{statistics.median(self.processor_us):.0f}", f"{ratio:.2f}"),
            *(percentiles(self.from_sync_us), percentiles(self.from_adc_us), str(self.late)),
        ]


def percentiles(values: Sequence[float]) -> str:
    """p50, p99, p99.9 and maximum, by nearest rank: each is one of the values."""
    found = np.quantile(values, PARTS, method="inverted_cdf") if values else ()
    return " / ".join(f"{value:.0f}" if value >= 10 else f"{value:.1f}" for value in found) or "-"


def measure(found: Found, one: Combination, channel: str | None, rate_hz: float, cycles: int) -> None:
    """One round of one combination, with one node at a time: on one interface several would interfere."""
    load, kind, realtime = one
    node = NodeProcess([kind, "--realtime", realtime], channel)
    try:
        with undisturbed(first=channel is None):
            others = Others(node.bus)
            others.warm_up(rate_hz, kind)
            used_s = node.processor_s()
            times = others.play(cycles, rate_hz, LOADS[load]())
            used_s = node.processor_s() - used_s
    finally:
        node.end()
    found.processor_us.append(used_s * 1e6 / cycles)
    found.from_sync_us += times.from_sync_us()
    found.from_adc_us += times.from_adc_us()
    found.late += times.not_in_time(1.0 / rate_hz)


@contextlib.contextmanager
def undisturbed(*, first: bool) -> Iterator[None]:
    """Context without garbage collection; ``first``: this program has real-time priority, if permitted."""
    gc.collect()
    gc.disable()
    usual = os.sched_getaffinity(0)
    if first:
        apply_realtime(RealtimeConfig(priority=PRIORITY, cpu=min(usual)), report=lambda line: None)
    try:
        yield
    finally:
        gc.enable()
        if first:
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
            os.sched_setaffinity(0, usual)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.bench.bus",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    choices = {"nodes": NODES, "loads": tuple(LOADS), "realtime": REALTIME}
    parser.add_argument("--channel", help="SocketCAN interface (a pair of sockets)")
    parser.add_argument("--rate", type=float, default=1000.0, help="SYNC rate in Hz (1000)")
    parser.add_argument("--cycles", type=int, default=10_000, help="SYNC periods of each row (10000)")
    parser.add_argument("--rounds", type=int, default=5, help="in how many parts, in turns (5)")
    parser.add_argument("--nodes", default=",".join(NODES), help=f"of {', '.join(NODES)} (all)")
    parser.add_argument("--loads", default="alone", help=f"of {', '.join(LOADS)} (alone)")
    parser.add_argument("--realtime", default="no", help=f"of {', '.join(REALTIME)} (no)")
    options = parser.parse_args(arguments)
    if not 1 <= options.rounds <= options.cycles or not 0.1 <= options.rate <= 10_000:
        parser.error("--rounds must be at least 1, --cycles at least as many, --rate 0.1 to 10000 Hz")
    chosen = {name: getattr(options, name).split(",") for name in choices}
    for name, known in choices.items():
        if not set(chosen[name]) <= set(known):
            parser.error(f"--{name}: {', '.join(known)}, with commas between them")
    if options.channel is not None and not os.path.exists(f"/sys/class/net/{options.channel}"):
        sys.exit(f"no interface {options.channel}: see docs/vcan.md, or omit --channel")
    found = {
        one: Found()
        for one in product(chosen["loads"], chosen["nodes"], chosen["realtime"])
        if one[0] != "sdo" or one[1] not in ("stock", "floor")  # these lack block transfer
    }
    if not found:
        parser.error("--loads sdo: stock and floor have no block transfer")
    for number, (one, figures) in product(range(options.rounds), found.items()):
        print(f"round {number + 1} of {options.rounds}: {', '.join(one)}", file=sys.stderr)
        measure(figures, one, options.channel, options.rate, -(-options.cycles // options.rounds))
    rows = [[*one, *figures.cells(next(iter(found.values())))] for one, figures in found.items()]
    print("\n".join(table(HEAD, rows)))
    print("\nTimes in µs: p50 / p99 / p99.9 / max.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
