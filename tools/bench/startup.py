"""Measure how long commands take to start, against `python -c "import numpy"`.

    python -m tools.bench.startup [--rounds N] [--json]

Each round starts every program once, one after the other, so that all of them meet the same machine; a
ratio is made within a round. Printed are medians and the quartiles of the ratios, for the time on the wall
and for the time of the processor. numpy may use one thread. Exit status 1 if `canfb --help` takes more than
1.5 times as long as numpy, in the median of either.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from typing import NamedTuple

LIMIT = 1.5
REFERENCE = 'python -c "import numpy"'
LIMITED = "canfb --help"
PROGRAMS = {
    "python -c pass": ["-c", "pass"],
    REFERENCE: ["-c", "import numpy"],
    'python -c "import canfb"': ["-c", "import canfb"],
    LIMITED: ["-m", "canfb", "--help"],
    "canfb config example": ["-m", "canfb", "config", "example"],
    "canfb run --help": ["-m", "canfb", "run", "--help"],
}


class Spent(NamedTuple):
    """Seconds of one start."""

    wall_s: float
    cpu_s: float


class Ratios(NamedTuple):
    """Median and quartiles of one time over that of the reference."""

    median: float
    low: float
    high: float


class Figures(NamedTuple):
    """Medians of the times of a program, and their ratios to the reference."""

    wall_s: float
    wall_ratio: Ratios
    cpu_s: float
    cpu_ratio: Ratios


def start(arguments: Sequence[str]) -> Spent:
    """Run Python with these arguments to its end; RuntimeError if it fails."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    started = time.perf_counter()
    child = subprocess.Popen(
        [sys.executable, *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=environment,
    )
    _, status, usage = os.wait4(child.pid, 0)
    spent = Spent(time.perf_counter() - started, usage.ru_utime + usage.ru_stime)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode != 0:
        raise RuntimeError(f"{' '.join(arguments)}: exit status {child.returncode}")
    return spent


def measure(rounds: int) -> dict[str, list[Spent]]:
    """So many starts of each program, in turns; one more before, for the files and their bytecode."""
    found: dict[str, list[Spent]] = {name: [] for name in PROGRAMS}
    for count in range(rounds + 1):
        for name, arguments in PROGRAMS.items():
            spent = start(arguments)
            if count > 0:
                found[name].append(spent)
    return found


def ratios(times_s: Sequence[float], reference_s: Sequence[float]) -> Ratios:
    """Of each time to that of the reference in the same round."""
    each = [one / other for one, other in zip(times_s, reference_s, strict=True)]
    low, median, high = statistics.quantiles(each, n=4, method="inclusive") if len(each) > 1 else each * 3
    return Ratios(median, low, high)


def summary(found: dict[str, list[Spent]]) -> dict[str, Figures]:
    """The figures of each program."""
    wall_s = {name: [one.wall_s for one in spent] for name, spent in found.items()}
    cpu_s = {name: [one.cpu_s for one in spent] for name, spent in found.items()}
    return {
        name: Figures(
            statistics.median(wall_s[name]),
            ratios(wall_s[name], wall_s[REFERENCE]),
            statistics.median(cpu_s[name]),
            ratios(cpu_s[name], cpu_s[REFERENCE]),
        )
        for name in found
    }


def print_text(figures: dict[str, Figures]) -> None:
    print(f"{'':<26}{'wall ms':>8}{'ratio':>7}{'quartiles':>13}{'CPU ms':>8}{'ratio':>7}{'quartiles':>13}")
    for name, row in figures.items():
        wall = f"{1e3 * row.wall_s:>8.0f}{_text(row.wall_ratio)}"
        print(f"{name:<26}{wall}{1e3 * row.cpu_s:>8.0f}{_text(row.cpu_ratio)}")


def _text(ratio: Ratios) -> str:
    quartiles = f"{ratio.low:.2f}..{ratio.high:.2f}"
    return f"{ratio.median:>7.2f}{quartiles:>13}"


def as_json(figures: dict[str, Figures]) -> str:
    rows = {
        name: row._asdict() | {"wall_ratio": row.wall_ratio._asdict(), "cpu_ratio": row.cpu_ratio._asdict()}
        for name, row in figures.items()
    }
    return json.dumps(rows, indent=2)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.bench.startup", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--rounds", type=int, default=15, metavar="N")
    parser.add_argument("--json", action="store_true", help="the figures, for programs")
    options = parser.parse_args(arguments)
    if options.rounds < 1:
        parser.error("--rounds: 1 or more")
    figures = summary(measure(options.rounds))
    if options.json:
        print(as_json(figures))
    else:
        print_text(figures)
    limited = figures[LIMITED]
    return 0 if max(limited.wall_ratio.median, limited.cpu_ratio.median) <= LIMIT else 1


if __name__ == "__main__":
    sys.exit(main())
