"""Fault campaign: inject every class of faults at every kind of speed, and count what the chain sees.

    python -m tools.faults.chain.campaign [--episodes N] [--class FAULT] [--setting NAME] [--json]

Each episode is a machine turning at up to 3000 rpm with 2500 cycles per revolution, sampled at 1 kHz with
12 bits, and a fault at a random instant. The cells: seen of those that matter, and lost, in per cent. Exit
status 1 when a goal is missed. docs/evidence.md says what the columns mean, docs/supervision.md what no
supervision can detect.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np

from tools.faults.chain.classes import CLASSES
from tools.faults.chain.judge import judge, play
from tools.faults.chain.plant import SETTINGS, Setting, Turning, speed_of_group
from tools.faults.engine import (
    Campaign,
    Cell,
    Results,
    Rows,
    Sums,
    Work,
    by_setup,
    chosen,
    parser,
    run,
    total,
)

CHUNK = 10
DETECTION_GOAL = 0.99
FAULTS, NAMES = [one.name for one in CLASSES], [one.name for one in SETTINGS]


@cache
def _setting(name: str, adapt: bool) -> Setting:
    return replace(SETTINGS[NAMES.index(name)], adapt=adapt)


def run_group(work: Work, adapt: bool = False) -> Sums:
    """Get the machine to its speed, then one episode after the other from there."""
    number, group = FAULTS.index(work.cell.fault), work.first // CHUNK
    seeds = (work.seed, NAMES.index(work.cell.setup), number, group)
    rng = np.random.default_rng(np.random.SeedSequence(seeds))
    setting = _setting(work.cell.setup, adapt)
    turning = Turning(setting, speed_of_group(group + 7 * number, rng), rng)
    sums = Sums()
    sums.counts["false alarms"] = turning.flagged
    for episode in range(work.size):
        said = judge(setting, play(CLASSES[number], turning, rng))
        sums.add(said, f"{seeds} episode {episode}" if said.get("silent") else "")
    return sums


def misses(cell: Cell, sums: Sums) -> Iterator[str]:
    if sums["silent"]:
        yield f"{sums['silent']} silent wrong positions"
    illegal = sums["matters"] - sums["legal"]
    if sums["seen"] < DETECTION_GOAL * illegal:
        yield f"only {sums['seen']} of {illegal} detected that are no legal motions"
    if sums["false alarms"]:
        yield f"{sums['false alarms']} false alarms before the fault"


def cell_text(cell: Cell, sums: Sums) -> str:
    return f"{sums.percent('seen', 'matters'):.1f} {sums.percent('lost'):.1f}"


def table(results: Results) -> Rows:
    """Faults below each other, settings side by side, and all faults."""
    rows = by_setup(results, cell_text)
    last = [cell_text(Cell("", name), total(results, setup=name)) for name in rows[0][1:]]
    return [*rows, ["all", *last]]


def campaign(faults: Sequence[str], settings: Sequence[str], adapt: bool = False) -> Campaign:
    return Campaign(faults, settings, partial(run_group, adapt=adapt), misses, CHUNK)


def main(argv: Sequence[str] | None = None) -> int:
    options = parser("tools.faults.chain.campaign", __doc__, 200, 1997)
    options.add_argument("--setting", dest="setup", nargs="+", help="the same as --setup")
    options.add_argument(
        "--adapt", action="store_true", help="with the drift of the tracks followed (2002:08)"
    )
    said = options.parse_args(argv)
    try:
        one = campaign(chosen(FAULTS, said.faults), chosen(NAMES, said.setup), said.adapt)
    except ValueError as error:
        options.error(str(error))
    return run(one, said, table)


if __name__ == "__main__":
    sys.exit(main())
