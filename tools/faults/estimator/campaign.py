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

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tools.faults.engine import Campaign, Cell, Results, Sums, Work, by_setup, chosen, parser, report, total
from tools.faults.estimator.declared import Declared
from tools.faults.estimator.episodes import Episode, Published, chain_for, draw, play
from tools.faults.estimator.judge import Verdict, judge, proof
from tools.faults.estimator.kinds import KINDS, NAMES, Kind, State

CHUNK = 100
BOUNDS = (0.01, 0.05, 0.1, 0.2)


@dataclass(frozen=True)
class Player:
    """Draws, plays and judges; the set-up of a cell is the bound of the machine.

    machine    what is declared, but for the acceleration
    exceed     the machine does so many times what is declared
    """

    machine: Declared
    exceed: float = 1.0

    def declared(self, setup: str) -> Declared:
        """Of this set-up."""
        return replace(self.machine, acceleration=float(setup))

    def episodes(self, work: Work) -> list[Episode]:
        """Draws of one chunk, whatever else is run."""
        declared = self.declared(work.cell.setup)
        words = [round(1e6 * one) for one in (declared.acceleration, declared.phase_error)]
        seeds = [work.seed, work.first // CHUNK, declared.samples_per_sync, *words, *work.cell.fault.encode()]
        machine = replace(declared, acceleration=self.exceed * declared.acceleration)
        return draw(kind_of(work.cell.fault), machine, work.size, np.random.default_rng(seeds))

    def published(self, declared: Declared, episodes: Sequence[Episode]) -> Iterator[Published]:
        """What is said of each."""
        for episode in episodes:
            yield play(episode, chain_for(replace(episode, declared=declared)))

    def __call__(self, work: Work) -> Sums:
        """One piece of work."""
        sums, episodes = Sums(), self.episodes(work)
        said = self.published(self.declared(work.cell.setup), episodes)
        for n, (episode, published) in enumerate(zip(episodes, said, strict=True)):
            verdict = judge(episode, published)
            name = f"{work.cell.fault}:{work.cell.setup}:{work.seed}:{work.first + n}"
            if verdict.early:
                sums.counts["early"] += 1
            else:
                sums.add(counted(verdict), name if verdict.silent else "")
        return sums

    def is_covered(self, cell: Cell) -> bool:
        """What is declared holds in this cell, so that no position may be valid and wrong."""
        return self.exceed <= 1.0 and kind_of(cell.fault).is_covered(self.declared(cell.setup))

    def can_run(self, cell: Cell) -> bool:
        """Sets of elapsed times and uneven instants are those of one sample for each SYNC."""
        kind = kind_of(cell.fault)
        special = bool(kind.jitter) or kind.stall is not None
        return not (special and self.machine.samples_per_sync > 1)

    def misses(self, cell: Cell, sums: Sums) -> Iterator[str]:
        """The goals that are missed."""
        if sums["silent"] and self.is_covered(cell):
            yield f"{sums['silent']} of {sums['episodes']} silent"

    def text(self, cell: Cell, sums: Sums) -> str:
        """silent, kept %, samples not valid; in brackets what the declaration does not cover."""
        kept = f" {sums.percent('kept'):.0f} {sums['not valid'] / max(1, sums['kept']):.1f}"
        early = f" e{sums['early']}" if sums["early"] else ""
        text = f"{sums['silent']}{'' if kind_of(cell.fault).lasting else kept}{early}"
        return text if kind_of(cell.fault).is_covered(self.declared(cell.setup)) else f"({text})"


def kind_of(name: str) -> Kind:
    """By its name."""
    return KINDS[NAMES.index(name)]


def counted(verdict: Verdict) -> dict[str, int]:
    """What an episode adds to the sums."""
    kept = {"kept": 1, "not valid": verdict.not_valid} if verdict.kept else {}
    causes = {cause.value: 1 for cause in set(verdict.wrong.values())}
    return {"silent": verdict.silent, "excused": verdict.excused, "lost": verdict.lost} | kept | causes


def table(player: Player, results: Results) -> list[list[str]]:
    """Kinds below each other, machines side by side, and the silent ones of all."""
    rows = by_setup(results, player.text)
    setups = rows[0][1:]
    covered = {cell: sums for cell, sums in results.items() if player.is_covered(cell)}
    sums = [(total(covered, setup=one), total(results, setup=one)) for one in setups]
    texts = [", ".join(f"{one['silent']} of {one['episodes']}" for one in pair) for pair in sums]
    machines = [player.declared(one) for one in setups]
    rows[0] = ["fault", *(f"A = {one.acceleration:g}, m = {one.bad}" for one in machines)]
    return [*rows, ["silent: as declared, all", *texts]]


def show(name: str, player: Player) -> str:
    """One episode in full."""
    kind, bound, seed, number = name.rsplit(":", 3)
    first = int(number) // CHUNK * CHUNK
    episode = player.episodes(Work(Cell(kind, bound), int(seed), first, CHUNK))[int(number) - first]
    (published,) = player.published(player.declared(bound), [episode])
    verdict = judge(episode, published)
    said = verdict.wrong
    lines = [f"{kind}, {episode.declared}, fault at {episode.fault}, speed {episode.speed:.4f}"]
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


def campaign(player: Player, kinds: Sequence[str] = NAMES, bounds: Sequence[float] = BOUNDS) -> Campaign:
    """Of these kinds of fault, and machines."""
    return Campaign(kinds, [f"{one:g}" for one in bounds], player, player.misses, CHUNK, player.can_run)


def main(argv: Sequence[str] | None = None) -> int:
    options = parser("tools.faults.estimator.campaign", __doc__, 1500, 24)
    options.add_argument("--bound", type=float, nargs="+", default=BOUNDS, metavar="B", help="acceleration")
    options.add_argument("--phase-error", type=float, default=0.0125, metavar="CYCLES")
    options.add_argument("--bad-samples", type=int, metavar="M", help="default: by the acceleration")
    options.add_argument("--samples-per-sync", type=int, choices=(1, 2, 3, 4), default=1)
    options.add_argument(
        "--exceed", type=float, default=1.0, metavar="F", help="machine, times what is declared"
    )
    options.add_argument("--show", metavar="EPISODE", help="print this one, KIND:BOUND:SEED:NUMBER")
    said = options.parse_args(argv)
    if not said.exceed > 0.0:
        options.error("--exceed must be above 0")
    machine = Declared(0.0, said.phase_error, said.bad_samples, said.samples_per_sync)
    player = Player(machine, said.exceed)
    if said.show:
        print(show(said.show, player))
        return 0
    try:
        one = campaign(player, chosen(NAMES, said.faults), said.bound)
    except ValueError as error:
        options.error(str(error))
    results = one.run(said.seed, said.episodes, said.processes)
    return report(one, results, table(player, results), json=said.json)


if __name__ == "__main__":
    sys.exit(main())
