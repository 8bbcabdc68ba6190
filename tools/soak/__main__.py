"""Soak: many cycles in simulated time with everything that happens to a bus, and resources that stay flat.

    python -m tools.soak [--cycles N] [--setup NAME] [--seed N] [--json]

The network has module, encoder interface, SYNC at 1 kHz, master, monitor and event log; its machine moves
and rests. In some set-ups the module is in the runner of `canfb run`. Disturbances follow one after the other
(disturbances.py). A lost position is restored by an NMT reset at standstill, as in docs/troubleshooting.md.
Exit status 1 if a valid position was wrong, a cycle was not counted, the position was not restored without a
restart of the process, memory, its blocks or file descriptors grew, or the log was too long; 2 for a wrong
option.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from statistics import linear_regression
from typing import Any, NamedTuple

from tools.faults.engine import at_least
from tools.soak.disturbances import disturbances_of
from tools.soak.world import INTERVAL_S, SETUPS, Findings, Setup, World

WARM = 0.3  # part of the cycles in which caches fill, before resources are observed
# Growth is reported only if it occurs in both halves of the observation: what is loaded once grows in one.
MOST_GROWTH_BYTES, MOST_GROWTH_BLOCKS = 2 << 20, 10_000
MOST_LINES_PER_S = 10.0  # log lines per second of simulated time
LOOKS = 20


class Resources(NamedTuple):
    """Resources of this process. Not gc.get_objects(), which would keep tuples that other threads build."""

    memory_bytes: int
    blocks: int
    descriptors: int

    @classmethod
    def now(cls) -> Resources:
        gc.collect()
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return cls(
            pages * os.sysconf("SC_PAGE_SIZE"), sys.getallocatedblocks(), len(os.listdir("/proc/self/fd"))
        )


def soak(setup: Setup, cycles: int, seed: int) -> dict[str, Any]:
    """Run this number of SYNC cycles, with successive random disturbances."""
    world, disturbances = World(setup, seed), disturbances_of(setup)
    found, looks = world.found, list[Resources]()
    began = time.perf_counter()
    try:
        while found.cycles < cycles:
            world.pass_(world.rng.uniform(0.05, 0.5))
            name = world.rng.choice(sorted(disturbances))
            world.suffer(name, disturbances[name])
            if found.cycles / cycles >= WARM + len(looks) * (1.0 - WARM) / LOOKS:
                looks.append(Resources.now())
    finally:
        world.close()
    elapsed_s = time.perf_counter() - began
    looks.append(Resources.now())
    more = {
        "cycles_per_s": found.cycles / elapsed_s,
        "bytes_per_million_cycles": slope(looks[:-1], found.cycles),
    }
    return as_figures(setup, found, looks) | more


def slope(looks: list[Resources], cycles: int) -> float:
    """Growth of memory, bytes per million cycles: the regression line through equidistant observations."""
    if len(looks) < 2:
        return 0.0
    per_look = linear_regression(range(len(looks)), [look.memory_bytes for look in looks]).slope
    return per_look * LOOKS / (1.0 - WARM) / cycles * 1e6


def as_figures(setup: Setup, found: Findings, looks: Sequence[Resources]) -> dict[str, Any]:
    first, half, last = looks[0], looks[len(looks) // 2], looks[-1]
    limits = {"memory_bytes": MOST_GROWTH_BYTES, "blocks": MOST_GROWTH_BLOCKS}
    halves = [(half, first), (last, half)]
    grown = [
        name
        for name, most in limits.items()
        if min(getattr(later, name) - getattr(before, name) for later, before in halves) > most
    ]
    grown += ["descriptors"] if last.descriptors > first.descriptors else []
    bounded = found.log_lines <= 50 + MOST_LINES_PER_S * found.cycles * INTERVAL_S
    return {
        "setup": setup.name,
        **{name: value for name, value in asdict(found).items() if name != "done"},
        "disturbances": dict(sorted(found.done.items())),
        "warm": first._asdict(),
        "end": last._asdict(),
        "grown": grown,
        "good": not found.bad and not grown and bounded,
    }


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.soak", description=(__doc__ or "").partition("\n")[0]
    )
    names = [one.name for one in SETUPS]
    parser.add_argument("--cycles", type=at_least(1), default=100_000, metavar="N", help="of each set-up")
    parser.add_argument("--setup", choices=names, help="only this one")
    parser.add_argument("--seed", type=at_least(0), default=28)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(argv)
    chosen = [one for one in SETUPS if options.setup in (None, one.name)]
    results = []
    for setup in chosen:
        results.append(soak(setup, options.cycles, options.seed))
        if not options.json:
            for name, value in results[-1].items():
                print(f"{name}: {value}", flush=True)
            print()
    if options.json:
        print(json.dumps(results, indent=1))
    return 0 if all(one["good"] for one in results) else 1


if __name__ == "__main__":
    sys.exit(main())
