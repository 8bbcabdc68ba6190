"""One engine for the campaigns: selection of episodes, processes, sums, table, goals.

A campaign is a table of faults, a table of set-ups, and a function that draws, plays and judges the episodes
of one cell, i.e. a fault with a set-up (:class:`Work`), and counts the results (:class:`Sums`). An episode
is a function of its cell, seed and number only.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatch
from typing import NamedTuple

from tools.site.text import table as markdown_table

EXAMPLES = 5


class Cell(NamedTuple):
    fault: str
    setup: str


class Work(NamedTuple):
    """Episodes of a cell, by number: the work of one process at a time."""

    cell: Cell
    seed: int
    numbers: range


@dataclass
class Sums:
    """Counts by name, and some examples of results that must not occur."""

    counts: Counter[str] = field(default_factory=Counter)
    examples: list[str] = field(default_factory=list)

    def add(self, said: Mapping[str, int], example: str = "") -> None:
        self.counts.update({"episodes": 1} | {name: int(count) for name, count in said.items()})
        if example and len(self.examples) < EXAMPLES:
            self.examples.append(example)

    def merge(self, other: Sums) -> None:
        self.counts.update(other.counts)
        self.examples = (self.examples + other.examples)[:EXAMPLES]

    def __getitem__(self, name: str) -> int:
        return self.counts[name]

    def percent(self, part: str, whole: str = "episodes") -> float:
        """``part`` / ``whole`` in per cent; 100 if ``whole`` is 0."""
        return 100.0 * self[part] / self[whole] if self[whole] else 100.0


Results = dict[Cell, Sums]
Rows = list[list[str]]


@dataclass(frozen=True)
class Campaign:
    """Faults x set-ups.

    play    plays a piece of work; must be importable, or a partial of an importable function
    misses  gives the goals that a cell misses
    chunk   number of episodes that are drawn together
    runs    whether this fault applies to this set-up
    """

    faults: Sequence[str]
    setups: Sequence[str]
    play: Callable[[Work], Sums]
    misses: Callable[[Cell, Sums], Iterable[str]]
    chunk: int = 20
    runs: Callable[[Cell], bool] = lambda cell: True

    def cells(self) -> list[Cell]:
        every = (Cell(fault, setup) for fault in self.faults for setup in self.setups)
        return [cell for cell in every if self.runs(cell)]

    def run(self, seeds: Sequence[int], episodes: int, processes: int) -> Results:
        """Run ``episodes`` of each cell and seed; the result does not depend on ``processes``."""
        results: Results = {cell: Sums() for cell in self.cells()}
        work = [
            Work(cell, seed, range(first, min(first + self.chunk, episodes)))
            for cell in results
            for seed in seeds
            for first in range(0, episodes, self.chunk)
        ]
        if processes == 1:
            played = list(map(self.play, work))
        else:
            with multiprocessing.get_context("spawn").Pool(processes) as pool:
                played = list(pool.imap(self.play, work))
        for one, sums in zip(work, played, strict=True):
            results[one.cell].merge(sums)
        return results

    def missed(self, results: Results) -> list[str]:
        """All goals missed, with examples."""
        found = []
        for cell, sums in results.items():
            misses = list(self.misses(cell, sums))
            found += [f"{cell.fault}:{cell.setup}: {miss}" for miss in misses]
            found += [f"    {example}" for example in sums.examples if misses]
        return found


def total(results: Results, fault: str = "*", setup: str = "*") -> Sums:
    """Sum over all cells with these names, which may contain * and ?."""
    found = Sums()
    for cell, sums in results.items():
        if fnmatch(cell.fault, fault) and fnmatch(cell.setup, setup):
            found.merge(sums)
    return found


def chosen(names: Iterable[str], patterns: Sequence[str]) -> list[str]:
    """Names that match one of the patterns; ValueError for a pattern without a match."""
    every = list(names)
    for pattern in patterns:
        if not any(fnmatch(name, pattern) for name in every):
            raise ValueError(f"there is no {pattern}; there are {', '.join(every)}")
    return [name for name in every if any(fnmatch(name, pattern) for pattern in patterns)]


def by_setup(results: Results, text: Callable[[Sums], str]) -> Rows:
    """Table of faults (rows) and set-ups (columns), if all apply to each other; the first row is the head."""
    faults, setups = (list(dict.fromkeys(names)) for names in zip(*results, strict=True))
    rows = [[fault, *(text(results[Cell(fault, setup)]) for setup in setups)] for fault in faults]
    return [["fault", *setups], *rows]


def by_count(results: Results, counts: Sequence[str], *, each_setup: bool = False) -> Rows:
    """Table with a row for each fault (``each_setup``: and set-up) and a column for each count."""
    groups: list[tuple[str, str]] = []
    for fault in dict.fromkeys(cell.fault for cell in results):
        groups += [cell for cell in results if each_setup and cell.fault == fault]
        groups.append((fault, "*"))
    setups = dict.fromkeys(cell.setup for cell in results)
    groups += [("*", setup) for setup in setups if len(setups) > 1] + [("*", "*")]
    rows = [["fault", "set-up", *counts]]
    for group in groups:
        sums = total(results, *group)
        rows.append([*(name.replace("*", "all") for name in group), *(str(sums[one]) for one in counts)])
    return rows


def parser(prog: str, doc: str | None, episodes: int, seed: int) -> argparse.ArgumentParser:
    options = argparse.ArgumentParser(prog=f"python -m {prog}", description=(doc or "").partition("\n")[0])
    options.add_argument("--episodes", type=at_least(1), default=episodes, metavar="N", help="of each cell")
    options.add_argument("--seed", type=at_least(0), nargs="+", default=[seed], metavar="S")
    for option, into in (("--class", "faults"), ("--setup", "setup")):
        options.add_argument(option, dest=into, nargs="+", default=["*"], metavar="NAME", help="with * and ?")
    options.add_argument("--jobs", dest="processes", type=at_least(1), default=2, metavar="N")
    options.add_argument("--json", action="store_true", help="all sums as JSON in place of the table")
    return options


def at_least(least: int) -> Callable[[str], int]:
    """Type for argparse: a whole number >= ``least``."""

    def number(text: str) -> int:
        value = int(text)
        if value < least:
            raise argparse.ArgumentTypeError(f"{value} is not {least} or more")
        return value

    return number


def run(campaign: Campaign, said: argparse.Namespace, table: Callable[[Results], Rows]) -> int:
    """Run with these options and print the results; returns the exit status, 1 if a goal is missed."""
    results = campaign.run(said.seed, said.episodes, said.processes)
    missed = campaign.missed(results)
    if said.json:
        cells = [
            {"fault": cell.fault, "setup": cell.setup, **sums.counts, "examples": sums.examples}
            for cell, sums in results.items()
        ]
        print(json.dumps(cells, indent=1))
    else:
        head, *body = table(results)
        print(*markdown_table(head, body), sep="\n")
        print(f"goals missed: {sum(not line.startswith(' ') for line in missed)}")
    for line in missed:
        print(line, file=sys.stderr)
    return 1 if missed else 0
