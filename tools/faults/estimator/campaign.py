"""Campaign of the cycle count: every kind of fault on motions that keep what is declared.

    python -m tools.faults.estimator.campaign [--episodes N] [--seed S ...] [--bound B ...]
    python -m tools.faults.estimator.campaign --show "KIND:BOUND:SEED:NUMBER"

Each cell of the table has silent errors, the part that is kept (valid and right at the end), and the samples
that were not valid where it was kept; in brackets where more samples are bad than is declared. e: episodes
that were not valid before their fault. The result depends on the seeds and the options of the machine only.
Exit status 1 if there are silent errors in a kind of fault that is covered. With ``--exceed F`` the
machine uses F times the bound that is declared: then nothing is covered, and the exit status is 0.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from tools.faults.estimator.declared import Declared
from tools.faults.estimator.episodes import Episode, Published, chain_for, draw, play
from tools.faults.estimator.judge import Verdict, judge, proof
from tools.faults.estimator.kinds import KINDS, NAMES, Kind, State
from tools.faults.side_by_side import side_by_side
from tools.site.markdown import table

CHUNK = 100
BOUNDS = (0.01, 0.05, 0.1, 0.2)
EXAMPLES = 5
Player = Callable[[Episode], Published]


class Cell(NamedTuple):
    """One kind of fault on one machine."""

    kind: str
    declared: Declared


class Chunk(NamedTuple):
    """Episodes that are drawn together; the draws depend on kind, machine, seed and number."""

    cell: Cell
    seed: int
    number: int
    episodes: int
    on_module: bool = False
    exceed: float = 1.0


@dataclass
class Tally:
    """Sums over the episodes of a cell."""

    episodes: int = 0
    early: int = 0
    silent: int = 0
    excused: int = 0
    kept: int = 0
    not_valid: int = 0
    lost: int = 0
    causes: dict[str, int] = field(default_factory=dict)
    examples: list[str] = field(default_factory=list)

    def add(self, verdict: Verdict, name: str) -> None:
        """Count one episode; ``name`` is what ``--show`` takes."""
        if verdict.early:
            self.early += 1
            return
        self.episodes += 1
        self.silent += verdict.silent
        self.excused += verdict.excused
        self.lost += verdict.lost
        if verdict.kept:
            self.kept += 1
            self.not_valid += verdict.not_valid
        for one in set(verdict.wrong.values()):
            self.causes[one.value] = self.causes.get(one.value, 0) + 1
        if verdict.silent:
            self.examples = [*self.examples, name][:EXAMPLES]

    def merge(self, other: Tally) -> None:
        for one in fields(self):
            if one.type == "int":
                setattr(self, one.name, getattr(self, one.name) + getattr(other, one.name))
        for name, count in other.causes.items():
            self.causes[name] = self.causes.get(name, 0) + count
        self.examples = (self.examples + other.examples)[:EXAMPLES]

    @property
    def kept_percent(self) -> float:
        return 100.0 * self.kept / max(1, self.episodes)

    @property
    def not_valid_when_kept(self) -> float:
        return self.not_valid / max(1, self.kept)

    def text(self, lasting: bool) -> str:
        """silent, kept %, samples not valid; an e where episodes were not valid before their fault."""
        early = f" e{self.early}" if self.early else ""
        if lasting:
            return f"{self.silent}{early}"
        return f"{self.silent} {self.kept_percent:.0f} {self.not_valid_when_kept:.1f}{early}"


def rng_of(chunk: Chunk) -> np.random.Generator:
    """Draws of one chunk, whatever else is run."""
    declared = chunk.cell.declared
    words = [round(1e6 * one) for one in (declared.acceleration, declared.phase_error)]
    name = chunk.cell.kind.encode()
    return np.random.default_rng([chunk.seed, chunk.number, declared.samples_per_sync, *words, *name])


def kind_of(name: str) -> Kind:
    return KINDS[NAMES.index(name)]


def episodes_of(chunk: Chunk) -> list[Episode]:
    machine = _with_bound(chunk.cell.declared, chunk.exceed * chunk.cell.declared.acceleration)
    return draw(kind_of(chunk.cell.kind), machine, chunk.episodes, rng_of(chunk))


def run_chunk(chunk: Chunk) -> tuple[Chunk, Tally]:
    """Draw, play and judge."""
    player: Player = play
    if chunk.on_module:
        # Only where it is used: the module takes longer to load than all else.
        from tools.faults.estimator.on_module import ModulePlayer

        player = ModulePlayer(chunk.cell.declared).play
    elif chunk.exceed != 1.0:
        player = partial(_play_as, chunk.cell.declared)
    tally = Tally()
    for n, episode in enumerate(episodes_of(chunk)):
        bound = chunk.cell.declared.acceleration
        name = f"{chunk.cell.kind}:{bound}:{chunk.seed}:{chunk.number * CHUNK + n}"
        tally.add(judge(episode, player(episode)), name)
    return chunk, tally


def _play_as(declared: Declared, episode: Episode) -> Published:
    """Through a chain that is told another bound than that of the machine."""
    return play(episode, chain_for(replace(episode, declared=declared)))


def chunks(
    cells: Iterable[Cell],
    seeds: Sequence[int],
    episodes: int,
    on_module: bool = False,
    exceed: float = 1.0,
) -> Iterator[Chunk]:
    """All of them, in the order of the table; ``episodes`` of each cell and seed."""
    for cell in cells:
        for seed in seeds:
            for number in range(-(-episodes // CHUNK)):
                yield Chunk(cell, seed, number, min(CHUNK, episodes - number * CHUNK), on_module, exceed)


def run(work: Sequence[Chunk], processes: int) -> dict[Cell, Tally]:
    """Sums of all cells."""
    tallies: dict[Cell, Tally] = {}
    for chunk, tally in side_by_side(run_chunk, work, processes):
        tallies.setdefault(chunk.cell, Tally()).merge(tally)
    return tallies


def text_of(cell: Cell, tallies: dict[Cell, Tally]) -> str:
    """One cell of the table; in brackets what the declaration does not cover."""
    kind = kind_of(cell.kind)
    text = tallies[cell].text(kind.lasting)
    return text if kind.is_covered(cell.declared) else f"({text})"


def as_text(tallies: dict[Cell, Tally], kinds: Sequence[str], machines: Sequence[Declared]) -> str:
    """Kinds below each other, machines side by side."""
    head = [
        "fault",
        *(f"A = {one.acceleration:g}, m = {one.bad}" for one in machines),
    ]
    rows = [[kind, *(text_of(Cell(kind, one), tallies) for one in machines)] for kind in kinds]
    sums = []
    for one in machines:
        of = [tallies[Cell(kind, one)] for kind in kinds]
        covered = [tallies[Cell(kind, one)] for kind in kinds if kind_of(kind).is_covered(one)]
        sums.append(
            f"{sum(t.silent for t in covered)} of {sum(t.episodes for t in covered)}, "
            f"{sum(t.silent for t in of)} of {sum(t.episodes for t in of)}"
        )
    return "\n".join(table(head, [*rows, ["silent: as declared, all", *sums]]))


def show(name: str, machine: Declared, on_module: bool = False) -> str:
    """One episode in full."""
    kind, bound, seed, number = name.rsplit(":", 3)
    machine = _with_bound(machine, float(bound))
    chunk = Chunk(Cell(kind, machine), int(seed), int(number) // CHUNK, CHUNK, on_module)
    episode = episodes_of(chunk)[int(number) % CHUNK]
    player: Player = play
    if on_module:
        from tools.faults.estimator.on_module import ModulePlayer  # as in run_chunk

        player = ModulePlayer(machine).play
    published = player(episode)
    verdict = judge(episode, published)
    said = verdict.wrong
    lines = [f"{kind}, {machine}, fault at {episode.fault}, speed {episode.speed:.4f}"]
    lines.append("   k  instant     true position  phase   state    published        status  error")
    for k in range(len(episode.truth)):
        error = published.position[k] - episode.truth[k]
        lines.append(
            f"{k:4} {episode.instants[k]:8.3f} {episode.truth[k]:17.4f} {episode.phase[k]:7.4f} "
            f"{State(int(episode.state[k])).name:8} {published.position[k]:16.4f} "
            f"{int(published.status[k]):04X} {error:+8.3f} {said[k].value if k in said else ''}"
        )
    lines.append(
        f"early {verdict.early}, silent {verdict.silent}, kept {verdict.kept}, not valid {verdict.not_valid}"
    )
    if verdict.wrong:
        lines.append(proof(episode, published, max(verdict.wrong)))
    return "\n".join(lines)


def _with_bound(machine: Declared, bound: float) -> Declared:
    return replace(machine, acceleration=bound)


def as_json(tallies: dict[Cell, Tally]) -> str:
    """All sums, for a program."""
    return json.dumps(
        [
            {"kind": cell.kind, "declared": asdict(cell.declared), **asdict(tally)}
            for cell, tally in tallies.items()
        ],
        indent=1,
    )


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.faults.estimator.campaign", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--episodes", type=int, default=1500, metavar="N", help="of each cell and seed")
    parser.add_argument("--seed", type=int, nargs="+", default=[24], metavar="S")
    parser.add_argument("--bound", type=float, nargs="+", metavar="B", help="acceleration")
    parser.add_argument("--phase-error", type=float, default=0.0125, metavar="CYCLES")
    parser.add_argument("--bad-samples", type=int, metavar="M", help="default: by the acceleration")
    parser.add_argument("--samples-per-sync", type=int, choices=(1, 2, 3, 4), default=1)
    parser.add_argument("--kind", nargs="+", choices=NAMES, metavar="KIND", help="default: all")
    parser.add_argument("--module", action="store_true", help="as frames through the whole module")
    parser.add_argument(
        "--exceed", type=float, default=1.0, metavar="F", help="machine, times what is declared"
    )
    parser.add_argument("--processes", type=int, default=2, metavar="N")
    parser.add_argument("--show", metavar="EPISODE", help="print this one, KIND:BOUND:SEED:NUMBER")
    parser.add_argument("--json", action="store_true", help="print all sums as JSON instead")
    options = parser.parse_args(argv)
    if options.episodes < 1 or options.processes < 1:
        parser.error("--episodes and --processes must be at least 1")
    if not options.exceed > 0.0 or (options.module and options.exceed != 1.0):
        parser.error("--exceed must be above 0, and is for the chain only")
    if options.module and options.samples_per_sync != 1:
        parser.error("--module has one sample for each SYNC")
    machine = Declared(
        0.0,
        options.phase_error,
        options.bad_samples,
        options.samples_per_sync,
    )
    if options.show:
        print(show(options.show, machine, options.module))
        return 0
    machines = [_with_bound(machine, bound) for bound in options.bound or BOUNDS]
    kinds = [one for one in options.kind or NAMES if _can_run(kind_of(one), machine, options.module)]
    cells = [Cell(kind, one) for kind in kinds for one in machines]
    work = list(chunks(cells, options.seed, options.episodes, options.module, options.exceed))
    tallies = run(work, options.processes)
    print(as_json(tallies) if options.json else as_text(tallies, kinds, machines))
    for tally in tallies.values():
        for example in tally.examples:
            print(f"silent: {example}", file=sys.stderr)
    if options.exceed > 1.0:
        return 0
    covered = [tally for cell, tally in tallies.items() if kind_of(cell.kind).is_covered(cell.declared)]
    return 1 if any(tally.silent for tally in covered) else 0


def _can_run(kind: Kind, machine: Declared, on_module: bool) -> bool:
    """Sets of elapsed times and uneven instants are those of one sample for each SYNC."""
    uneven = bool(kind.jitter) or kind.stall is not None
    if kind.elapsed and (on_module or machine.samples_per_sync > 1):
        return False
    return not (uneven and (on_module or machine.samples_per_sync > 1))


if __name__ == "__main__":
    sys.exit(main())
