"""Measure how long a position takes: from the SYNC, and from the ADC PDO, to the position PDO.

    python -m tools.bench.latency [--cycles N] [--rate HZ] [--rounds N] [--markdown]
    python3 -m tools.vcan run -- .venv/bin/python -m tools.bench.latency --channel vcan0 --rate 100

`canfb run` is a process of its own; this program plays SYNC producer, encoder interface and a load: nothing
(alone), correction tables by SDO block transfer (sdo), or frames of other nodes up to 1 Mbit/s (full). The
bus is a pair of datagram sockets that carry struct can_frame, or with --channel a SocketCAN interface. Each
SYNC is answered by TPDO2 (type 1), each ADC PDO by TPDO1 (type 254). Nodes: `canfb`, as it is delivered;
`floor`, which answers and does nothing else: what machine and bus take. Realtime: SCHED_FIFO, mlockall and a
processor of its own, as far as the system permits. All combinations are measured, in turns.

docs/latency.md says how to read the figures.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import os
import statistics
import sys
import tempfile
import time
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path

from canfb.bus.realtime import apply_realtime
from canfb.configuration import RealtimeConfig
from tools.bench.latency_bus import Others
from tools.bench.latency_load import LOADS
from tools.bench.latency_node import KINDS, READY
from tools.bench.node_process import NodeProcess
from tools.bench.percentiles import HEAD, Table, cell

Combination = tuple[str, str, str]
PRIORITY = 90  # of this program, above that of the module
REALTIME = ("no", "yes")
BUS_HEAD = [
    *("load", "node", "realtime"),
    *("SYNC to TPDO2", "ADC PDO to TPDO1", "CPU of a wake-up", "not in time"),
]


@dataclass
class Found:
    """Of one combination, all rounds: times in µs."""

    from_sync_us: list[float] = field(default_factory=list)
    from_adc_us: list[float] = field(default_factory=list)
    not_in_time: int = 0
    woken_us: list[float] = field(default_factory=list)

    def cells(self) -> list[str]:
        """For a row."""
        ticks = self.woken_us and statistics.median(self.woken_us) == 0.0  # a clock that is too coarse
        times = (self.from_sync_us, self.from_adc_us, [] if ticks else self.woken_us)
        return [*map(cell, times), str(self.not_in_time)]


def measure_bus(
    found: Found, combination: Combination, channel: str | None, rate_hz: float, cycles: int
) -> None:
    """One round of one combination, with a process of its own."""
    load, kind, realtime = combination
    with tempfile.TemporaryDirectory() as folder:
        woken = Path(folder) / "woken"
        arguments = ["tools.bench.latency_node", kind, str(woken), *["--realtime"] * (realtime == "yes")]
        node = NodeProcess(arguments, channel, READY)
        try:
            with undisturbed(first=channel is None):
                others = Others(node.bus)
                others.warm_up(rate_hz, with_table=kind != "floor")
                began_s = time.time()
                times = others.play(cycles, rate_hz, LOADS[load]())
        finally:
            node.end()
        stamps_s = array("d", woken.read_bytes())
    found.from_sync_us += times.from_sync_us()
    found.from_adc_us += times.from_adc_us()
    found.woken_us += [
        took_s * 1e6 for at, took_s in zip(stamps_s[::2], stamps_s[1::2], strict=True) if at >= began_s
    ]
    found.not_in_time += times.not_in_time(1.0 / rate_hz)


def bus_rows(
    combinations: list[Combination], channel: str | None, rate_hz: float, cycles: int, rounds: int
) -> list[list[str]]:
    """All combinations in turns: other work on the machine then meets all of them."""
    found = {combination: Found() for combination in combinations}
    for number, combination in product(range(rounds), combinations):
        print(f"round {number + 1} of {rounds}: {', '.join(combination)}", file=sys.stderr)
        measure_bus(found[combination], combination, channel, rate_hz, -(-cycles // rounds))
    return [[*combination, *one.cells()] for combination, one in found.items()]


@contextlib.contextmanager
def undisturbed(*, first: bool) -> Iterator[None]:
    """No garbage is collected here; ``first``: this program has a processor before others, if permitted."""
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


def chosen(parser: argparse.ArgumentParser, words: str, known: Sequence[str], option: str) -> list[str]:
    """The words of an option, with commas between them."""
    parts = words.split(",")
    if not set(parts) <= set(known):
        parser.error(f"{option}: {', '.join(known)}, with commas between them")
    return parts


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; times in microseconds."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.bench.latency",
        description=__doc__,
        formatter_class=argparse.RawTextHelpFormatter,
    )
    parser.add_argument("--channel", help="SocketCAN interface (a pair of sockets)")
    parser.add_argument("--rate", type=float, default=1000.0, help="SYNC rate in Hz (1000)")
    parser.add_argument("--cycles", type=int, default=10_000, help="SYNC periods of each row (10000)")
    parser.add_argument(
        "--rounds", type=int, default=1, help="in how many parts they are measured, in turns (1)"
    )
    parser.add_argument("--loads", default=",".join(LOADS), help=f"of {', '.join(LOADS)}")
    parser.add_argument("--nodes", default=",".join(KINDS), help=f"of {', '.join(KINDS)}")
    parser.add_argument("--realtime", default=",".join(REALTIME), help=f"of {', '.join(REALTIME)}")
    parser.add_argument("--markdown", action="store_true", help="as Markdown")
    options = parser.parse_args(arguments)
    if not 1 <= options.rounds <= options.cycles or not 0.1 <= options.rate <= 10_000:
        parser.error("--rounds must be at least 1, --cycles at least as many, --rate 0.1 to 10000 Hz")
    loads = chosen(parser, options.loads, list(LOADS), "--loads")
    nodes = chosen(parser, options.nodes, KINDS, "--nodes")
    realtime = chosen(parser, options.realtime, REALTIME, "--realtime")
    if options.channel is not None and not os.path.exists(f"/sys/class/net/{options.channel}"):
        sys.exit(f"no interface {options.channel}: see docs/vcan.md, or omit --channel")
    table = Table(BUS_HEAD)
    combinations = [one for one in product(loads, nodes, realtime) if one[:2] != ("sdo", "floor")]
    table.rows = bus_rows(combinations, options.channel, options.rate, options.cycles, options.rounds)
    print(table.markdown() if options.markdown else table.text())
    print(f"Times in µs: {' / '.join(HEAD)}.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
