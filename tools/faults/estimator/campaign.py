"""Campaign of the cycle count: every kind of fault on motions that keep what is declared.

    python -m tools.faults.estimator.campaign [--episodes N] [--seed S ...] [--bound B ...]
    python -m tools.faults.estimator.campaign --show "KIND:BOUND:SEED:NUMBER"

docs/evidence.md says what the cells mean; e: episodes that were not valid before their fault. The result
depends on the seeds and the options of the machine only. Exit status 1 if there are silent errors in a kind
of fault that is covered. With ``--exceed F`` the machine does F times what is declared: nothing is covered.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

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
from tools.faults.estimator.episodes import Episode, Published, chain_for, draw, play
from tools.faults.estimator.judge import Verdict, judge, proof
from tools.faults.estimator.kinds import KINDS, Declared, State

CHUNK = 100
BOUNDS = (0.01, 0.05, 0.1, 0.2)


class Played(NamedTuple):
    name: str
    episode: Episode
    published: Published
    verdict: Verdict


@dataclass(frozen=True)
class Player:
    """Draws, plays and judges; the set-up of a cell is the bound of the machine.

    machine    what is declared, but for the acceleration
    exceed     the machine does so many times what is declared
    """

    machine: Declared
    exceed: float = 1.0

    def declared(self, setup: str) -> Declared:
        return replace(self.machine, acceleration=float(setup))

    def episodes(self, work: Work) -> list[Episode]:
        declared = self.declared(work.cell.setup)
        words = [round(1e6 * one) for one in (declared.acceleration, declared.phase_error)]
        seeds = [work.seed, work.first // CHUNK, declared.samples_per_sync, *words, *work.cell.fault.encode()]
        machine = replace(declared, acceleration=self.exceed * declared.acceleration)
        return draw(KINDS[work.cell.fault], machine, work.size, np.random.default_rng(seeds))

    def played(self, work: Work) -> Iterator[Played]:
        declared = self.declared(work.cell.setup)
        for number, episode in zip(work.numbers, self.episodes(work), strict=True):
            published = play(episode, chain_for(replace(episode, declared=declared)))
            name = f"{work.cell.fault}:{work.cell.setup}:{work.seed}:{number}"
            yield Played(name, episode, published, judge(episode, published))

    def __call__(self, work: Work) -> Sums:
        sums = Sums()
        for name, _, _, verdict in self.played(work):
            if verdict.early:
                sums.counts["early"] += 1
            else:
                sums.add(counted(verdict), name if verdict.silent else "")
        return sums

    def is_covered(self, cell: Cell) -> bool:
        """What is declared holds in this cell, so that no position may be valid and wrong."""
        return self.exceed <= 1.0 and KINDS[cell.fault].is_covered(self.declared(cell.setup))

    def can_run(self, cell: Cell) -> bool:
        return KINDS[cell.fault].is_even or self.machine.samples_per_sync == 1

    def misses(self, cell: Cell, sums: Sums) -> Iterator[str]:
        if sums["silent"] and self.is_covered(cell):
            yield f"{sums['silent']} of {sums['episodes']} silent"

    def text(self, cell: Cell, sums: Sums) -> str:
        """silent, kept %, samples not valid; in brackets what the declaration does not cover."""
        kind = KINDS[cell.fault]
        kept = f" {sums.percent('kept'):.0f} {sums['not valid'] / max(1, sums['kept']):.1f}"
        early = f" e{sums['early']}" if sums["early"] else ""
        text = f"{sums['silent']}{'' if kind.lasting else kept}{early}"
        return text if kind.is_covered(self.declared(cell.setup)) else f"({text})"

    def table(self, results: Results) -> Rows:
        """Kinds below each other, machines side by side, and the silent ones of all."""
        head, *rows = by_setup(results, self.text)
        covered = {cell: sums for cell, sums in results.items() if self.is_covered(cell)}
        sums = [(total(covered, setup=one), total(results, setup=one)) for one in head[1:]]
        texts = [", ".join(f"{one['silent']} of {one['episodes']}" for one in pair) for pair in sums]
        machines = [self.declared(one) for one in head[1:]]
        head = ["fault", *(f"A = {one.acceleration:g}, m = {one.bad}" for one in machines)]
        return [head, *rows, ["silent: as declared, all", *texts]]


def counted(verdict: Verdict) -> dict[str, int]:
    kept = {"kept": 1, "not valid": verdict.not_valid} if verdict.kept else {}
    causes = {cause.value: 1 for cause in set(verdict.wrong.values())}
    return {"silent": verdict.silent, "excused": verdict.excused, "lost": verdict.lost} | kept | causes


def show(name: str, player: Player) -> str:
    kind, bound, seed, number = name.rsplit(":", 3)
    first = int(number) // CHUNK * CHUNK
    every = list(player.played(Work(Cell(kind, bound), int(seed), first, CHUNK)))
    _, episode, published, verdict = every[int(number) - first]
    lines = [f"{kind}, {episode.declared}, fault at {episode.fault}, speed {episode.speed:.4f}"]
    lines.append("   k  instant     true position  phase   state    published        status  error")
    for k, (truth, position) in enumerate(zip(episode.truth, published.position, strict=True)):
        cause = verdict.wrong[k].value if k in verdict.wrong else ""
        lines.append(
            f"{k:4} {episode.instants[k]:8.3f} {truth:17.4f} {episode.phase[k]:7.4f} "
            f"{State(int(episode.state[k])).name:8} {position:16.4f} "
            f"{int(published.status[k]):04X} {position - truth:+8.3f} {cause}"
        )
    lines.append(
        f"early {verdict.early}, silent {verdict.silent}, kept {verdict.kept}, not valid {verdict.not_valid}"
    )
    if verdict.wrong:
        lines.append(proof(episode, published, max(verdict.wrong)))
    return "\n".join(lines)


def campaign(
    player: Player, kinds: Sequence[str] = tuple(KINDS), bounds: Sequence[float] = BOUNDS
) -> Campaign:
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
    player = Player(Declared(0.0, said.phase_error, said.bad_samples, said.samples_per_sync), said.exceed)
    if said.show:
        print(show(said.show, player))
        return 0
    try:
        one = campaign(player, chosen(KINDS, said.faults), said.bound)
    except ValueError as error:
        options.error(str(error))
    return run(one, said, player.table)


if __name__ == "__main__":
    sys.exit(main())
