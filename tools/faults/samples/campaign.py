"""Campaign of samples: faults of the tracks, or of the cycle count, on motions that keep what is declared.

    python -m tools.faults.samples.campaign tracks|count [--episodes N] [--class FAULT] [--setup NAME]
    python -m tools.faults.samples.campaign count --show "KIND:SETUP:SEED:NUMBER"

docs/evidence.md explains the cells. Machines turn at up to 125 cycles per sample. Set-ups of ``count``
are accelerations. The result depends on the seeds only. Exit status 1 if a goal is missed. With
``--exceed F`` the machine accelerates F times as much as declared.
"""

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from tools.faults import engine
from tools.faults.engine import Campaign, Cell, Results, Rows, Sums, Work, total
from tools.faults.samples import tracks
from tools.faults.samples.episodes import KINDS, Declared, Episode, Published, State, chain_for, draw, play
from tools.faults.samples.judge import Cause, Verdict, judge, proof

CHUNK = 100
DETECTION_GOAL = 0.99


def count_text(sums: Sums) -> str:
    """silent, kept %, samples not valid; in brackets: not covered by the declaration."""
    kept = f" {sums.percent('kept'):.0f} {sums['not valid'] / max(1, sums['kept']):.1f}"
    text = f"{sums['silent'] + sums['beyond']}{kept}"
    return text if sums["declared"] else f"({text})"


def tracks_text(sums: Sums) -> str:
    """Per cent detected of the faults that matter, and per cent lost."""
    return f"{sums.percent('seen', 'matters'):.1f} {sums.percent('lost'):.1f}"


class Table(NamedTuple):
    faults: Mapping[str, Any]
    setups: Mapping[str, Any]
    draw: Callable[..., Iterable[Episode]]
    text: Callable[[Sums], str]


TABLES = {
    "tracks": Table(tracks.TRACK_FAULTS, tracks.SETTINGS, tracks.draw, tracks_text),
    "count": Table(KINDS, {f"{one:g}": Declared(one) for one in (0.01, 0.05, 0.1, 0.2)}, draw, count_text),
}


class Played(NamedTuple):
    name: str
    episode: Episode
    published: Published
    verdict: Verdict
    more: dict[str, int]


@dataclass(frozen=True)
class Player:
    """Draws, plays and judges.

    exceed     acceleration of the machine / declared acceleration
    adapt      with adaptation to the drift of the tracks (2002:08)
    """

    table: str
    exceed: float = 1.0
    adapt: bool = False

    def played(self, work: Work) -> Iterator[Played]:
        table = TABLES[self.table]
        kind, declared = table.faults[work.cell.fault], table.setups[work.cell.setup]
        if self.adapt:
            declared = replace(declared, adapt=True)
        words = [round(1e6 * one) for one in (declared.acceleration, declared.phase_error)]
        seeds = [
            work.seed,
            work.numbers.start // CHUNK,
            declared.samples_per_sync,
            *words,
            *work.cell.fault.encode(),
        ]
        machine = replace(declared, acceleration=self.exceed * declared.acceleration)
        episodes = table.draw(kind, machine, CHUNK, np.random.default_rng(seeds))
        for number, episode in zip(work.numbers, episodes, strict=False):
            published = play(episode, chain_for(episode, declared))
            if self.table == "tracks":
                verdict, more = tracks.judge_tracks(declared, episode, published)
            else:
                verdict, more = judge(episode, published), {"declared": kind.is_covered(declared)}
            more["declared"] = more["declared"] and self.exceed <= 1.0
            yield Played(f"{':'.join(work.cell)}:{work.seed}:{number}", episode, published, verdict, more)

    def __call__(self, work: Work) -> Sums:
        sums = Sums()
        for name, _, _, verdict, more in self.played(work):
            if verdict.early:
                sums.counts["early"] += 1
            else:
                sums.add(counted(verdict, more), name if verdict.silent and more["declared"] else "")
        return sums


def counted(verdict: Verdict, more: dict[str, int]) -> dict[str, int]:
    kept = {"kept": 1, "not valid": verdict.not_valid} if verdict.kept else {}
    causes = {cause.value: 1 for cause in Cause if cause in verdict.wrong.values()}
    silent = {"silent" if more["declared"] else "beyond": verdict.silent}
    return {"excused": verdict.excused, "lost": verdict.lost, **more, **silent, **kept, **causes}


def misses(cell: Cell, sums: Sums) -> Iterator[str]:
    if sums["silent"]:
        yield f"{sums['silent']} of {sums['declared']} silent"
    illegal = sums["matters"] - sums["legal"]
    if sums["seen"] < DETECTION_GOAL * illegal:
        yield f"only {sums['seen']} of {illegal} detected that are no legal motions"
    if sums["early"]:
        yield f"{sums['early']} not valid before the fault"


def table_of(text: Callable[[Sums], str], results: Results) -> Rows:
    """Table of faults (rows) and set-ups (columns); then silent errors of all, as declared and beyond."""
    head, *rows = engine.by_setup(results, text)
    sums = [total(results, setup=one) for one in head[1:]]
    silent = [f"{one['silent']} of {one['declared']}" for one in sums]
    beyond = [f"{one['beyond']} of {one['episodes'] - one['declared']}" for one in sums]
    all_faults = [["all", *map(text, sums)], ["silent, as declared", *silent], ["silent, beyond", *beyond]]
    return [head, *rows, *all_faults]


def show(name: str, player: Player) -> str:
    """Text on one episode. ValueError for an unknown fault or set-up."""
    kind, setup, seed, number = name.rsplit(":", 3)
    if Cell(kind, setup) not in campaign(player).cells():
        raise ValueError(f"there is no {kind}:{setup}")
    first = int(number) // CHUNK * CHUNK
    every = list(player.played(Work(Cell(kind, setup), int(seed), range(first, first + CHUNK))))
    _, episode, published, verdict, _ = every[int(number) - first]
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
        lines.append(proof(episode, max(verdict.wrong)))
    return "\n".join(lines)


def campaign(player: Player, faults: Sequence[str] = ("*",), setups: Sequence[str] = ("*",)) -> Campaign:
    table = TABLES[player.table]
    return Campaign(
        engine.chosen(table.faults, faults), engine.chosen(table.setups, setups), player, misses, CHUNK
    )


def main(argv: Sequence[str] | None = None) -> int:
    options = engine.parser("tools.faults.samples.campaign", __doc__, 200, 24)
    options.add_argument("table", choices=TABLES, help="faults of the tracks, or of the cycle count")
    options.add_argument("--adapt", action="store_true", help="tracks: their drift is followed (2002:08)")
    options.add_argument(
        "--exceed", type=float, default=1.0, metavar="F", help="machine, times what is declared"
    )
    options.add_argument("--show", metavar="EPISODE", help="print this one, KIND:SETUP:SEED:NUMBER")
    said = options.parse_args(argv)
    if not said.exceed > 0.0 or (said.adapt and said.table != "tracks"):
        options.error("--exceed must be above 0, and --adapt is for the tracks")
    player = Player(said.table, said.exceed, said.adapt)
    try:
        if said.show:
            print(show(said.show, player))
            return 0
        one = campaign(player, said.faults, said.setup)
    except ValueError as error:
        options.error(str(error))
    return engine.run(one, said, lambda results: table_of(TABLES[said.table].text, results))


if __name__ == "__main__":
    sys.exit(main())
