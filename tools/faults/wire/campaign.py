"""Wire campaign: faults of time and of the wire, frame by frame through the whole module.

    python -m tools.faults.wire.campaign [--episodes N] [--jobs N] [--class NAME] [--setup NAME]
    python -m tools.faults.wire.campaign --episode CLASS:SETUP:SEED --trace

Own motion, own wire, own judge: only canfb.FeedbackModule and canfb.Frame are used. The result depends on
--seed only. Exit status 1 when a valid position was wrong, or a healthy machine was not kept after its start.
docs/evidence.md says what the classes and columns mean.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
from collections.abc import Iterator, Sequence
from fnmatch import fnmatch
from pathlib import Path

from tools.faults.wire.availability import CHUNK, LIMITS, MOTIONS, OneLost, endurance, one_lost
from tools.faults.wire.classes import CLASSES
from tools.faults.wire.judge import Verdict
from tools.faults.wire.play import Episode, play
from tools.faults.wire.setups import SETUPS, Setup
from tools.faults.wire.stalls import IN_A_ROW, RATES_HZ, WHO, Stalled, stall, timed_setups
from tools.faults.wire.table import EXAMPLES, HEAD, Tally, markdown, plain
from tools.faults.wire.trace import trace

GROUP = 20
Key = tuple[int, int]


def groups(options: argparse.Namespace) -> Iterator[tuple[int, int, int, int]]:
    """Class, set-up, first seed and number of episodes: what one process does at a time."""
    for number, wire_class in enumerate(CLASSES):
        if not fnmatch(wire_class.name, options.wire_class):
            continue
        for place, setup in enumerate(SETUPS):
            if wire_class.of(setup) and fnmatch(setup.name, options.setup):
                for first in range(0, options.episodes, GROUP):
                    seed = options.seed * 1_000_000 + first
                    yield number, place, seed, min(GROUP, options.episodes - first)


def run_group(group: tuple[int, int, int, int]) -> tuple[Key, Tally]:
    """All episodes of a group."""
    number, place, seed, count = group
    tally = Tally()
    for one in range(seed, seed + count):
        episode = Episode(number, place, one)
        # A new module takes longer than an episode: beyond the examples, results count as they are.
        confirm = len(tally.examples) < EXAMPLES
        tally.add(episode, play(episode, confirm=confirm).verdict)
    return (number, place), tally


def campaign(options: argparse.Namespace) -> dict[Key, Tally]:
    """Run it all."""
    tallies: dict[Key, Tally] = {}
    if options.jobs == 1:
        results: Iterator[tuple[Key, Tally]] = map(run_group, groups(options))
        return _collect(tallies, results)
    with multiprocessing.get_context("spawn").Pool(options.jobs) as pool:
        return _collect(tallies, pool.imap(run_group, groups(options), chunksize=2))


def _collect(tallies: dict[Key, Tally], results: Iterator[tuple[Key, Tally]]) -> dict[Key, Tally]:
    for key, tally in results:
        tallies.setdefault(key, Tally()).merge(tally)
    return tallies


def rows(tallies: dict[Key, Tally], by_setup: bool) -> list[tuple[str, ...]]:
    """The table: a row for each class and set-up, or the sums over all set-ups only."""
    lines: list[tuple[str, ...]] = [HEAD]
    total = Tally()
    for number, wire_class in enumerate(CLASSES):
        of_class = Tally()
        for (one, place), tally in tallies.items():
            if one == number:
                of_class.merge(tally)
                if by_setup:
                    lines.append(tally.row(wire_class.name, SETUPS[place].name))
        if of_class.episodes:
            lines.append(of_class.row(wire_class.name, "all"))
        total.merge(of_class)
    if len({key[1] for key in tallies}) > 1:
        lines += [_sum_of_setup(tallies, place) for place in sorted({key[1] for key in tallies})]
    return [*lines, total.row("all", "all")]


def _sum_of_setup(tallies: dict[Key, Tally], place: int) -> tuple[str, ...]:
    total = Tally()
    for key, tally in tallies.items():
        if key[1] == place:
            total.merge(tally)
    return total.row("all", SETUPS[place].name)


def misses(tallies: dict[Key, Tally]) -> list[str]:
    """Every silent wrong position, an example of each, and every healthy machine that was not kept."""
    found = []
    for (number, place), tally in tallies.items():
        name = f"{CLASSES[number].name}:{SETUPS[place].name}"
        if tally.outcomes["wrong"]:
            found.append(f"{name}: {tally.outcomes['wrong']} of {tally.episodes} silent wrong")
            found += [f"    {example}" for example in tally.examples]
        if CLASSES[number].valid(SETUPS[place]) and tally.after_start:
            found.append(f"{name}: {tally.after_start} of {tally.episodes} not valid after the start")
        if CLASSES[number].survives and tally.outcomes["lost"]:
            found.append(f"{name}: {tally.outcomes['lost']} of {tally.episodes} lost, which need not be")
        if tally.unanswered:
            found.append(f"{name}: SYNCs without their PDO in {tally.unanswered} of {tally.episodes}")
    return found


def parser() -> argparse.ArgumentParser:
    """The options."""
    options = argparse.ArgumentParser(
        prog="python -m tools.faults.wire.campaign", description=(__doc__ or "").partition("\n")[0]
    )
    options.add_argument("--episodes", type=int, default=30, metavar="N", help="of each class and set-up")
    options.add_argument("--seed", type=int, default=1997)
    options.add_argument("--jobs", type=int, default=2, metavar="N", help="processes")
    options.add_argument("--class", dest="wire_class", default="*", metavar="NAME", help="with * and ?")
    options.add_argument("--setup", default="*", metavar="NAME", help="with * and ?")
    options.add_argument("--by-setup", action="store_true", help="a row for each class and set-up")
    options.add_argument("--markdown", type=Path, metavar="FILE", help="write the table as Markdown")
    options.add_argument(
        "--endurance", type=int, metavar="SAMPLES", help="a healthy machine at 3000 rpm only"
    )
    options.add_argument("--one-lost", action="store_true", help="one lost PDO at half the limit only")
    options.add_argument("--stalls", type=int, metavar="N", help="stalls of 1 to 500 ms only")
    options.add_argument("--episode", metavar="CLASS:SETUP:SEED", help="one episode only")
    options.add_argument("--trace", action="store_true", help="with --episode: every frame")
    options.add_argument("--list", action="store_true", help="the names of classes and set-ups")
    return options


def _endure(chunk: tuple[int, int, str]) -> Verdict:
    return endurance(*chunk)


def run_endurance(options: argparse.Namespace) -> int:
    """Prints what a healthy machine lost, in each set-up with sample times."""
    missed = 0
    seeds = range(options.seed, options.seed + max(1, options.endurance // CHUNK))
    chunks = [(seed, min(CHUNK, options.endurance)) for seed in seeds]
    with multiprocessing.get_context("spawn").Pool(options.jobs) as pool:
        for setup in (one.name for one in SETUPS if one.times and fnmatch(one.name, options.setup)):
            verdicts = list(pool.imap(_endure, [(*chunk, setup) for chunk in chunks]))
            shown, invalid = sum(v.shown for v in verdicts), sum(v.not_valid for v in verdicts)
            wrong, lost = sum(v.wrong for v in verdicts), sum(v.outcome == "lost" for v in verdicts)
            print(
                f"{setup}: {shown} positions, {invalid} not valid, {wrong} wrong, {lost}/{len(chunks)} lost"
            )
            missed += invalid + wrong
    return 1 if missed else 0


def _lose_one(case: tuple[str, float, int, str]) -> OneLost:
    return one_lost(*case)


def run_one_lost(options: argparse.Namespace) -> int:
    """Prints how many single losses are kept, where one motion only fits and where two do."""
    table: list[tuple[str, ...]] = [("motion", "limit", "unique", "kept", "two motions", "kept", "wrong")]
    total = OneLost()
    setups = [one.name for one in SETUPS if fnmatch(one.name, options.setup)]
    with multiprocessing.get_context("spawn").Pool(options.jobs) as pool:
        for motion in MOTIONS:
            for limit in LIMITS:
                count = OneLost()
                seeds = range(options.seed, options.seed + options.episodes)
                for one in pool.imap(
                    _lose_one, [(motion, limit, n, name) for n in seeds for name in setups], 4
                ):
                    count.merge(one)
                total.merge(count)
                table.append((motion, f"{limit:.2f}", *map(str, vars(count).values())))
    print(plain([*table, ("all", "", *map(str, vars(total).values()))]))
    return 1 if total.wrong or total.kept < total.unique else 0


def _stall(case: tuple[str, int, Setup, int, bool]) -> Stalled:
    return stall(*case)


def run_stalls(options: argparse.Namespace) -> int:
    """Prints what is kept of healthy machines while computers stall, and what is valid and wrong."""
    table: list[tuple[str, ...]] = [
        ("stalled", "Hz", "one motion fits", "kept", "longer", "kept", "valid and wrong")
    ]
    total = Stalled()
    setups = timed_setups(options.setup)
    machines = -(-options.stalls // (len(WHO) * len(RATES_HZ) * max(1, len(setups)) * (IN_A_ROW + 1)))
    seeds = range(options.seed, options.seed + machines)
    with multiprocessing.get_context("spawn").Pool(options.jobs) as pool:
        for who in WHO:
            for rate in RATES_HZ:
                cases = [
                    (who, rate, one, seed, short)
                    for one in setups
                    for seed in seeds
                    for short in (True, False)
                ]
                count = Stalled()
                for part in pool.imap(_stall, cases, 4):
                    count.merge(part)
                total.merge(count)
                table.append((who, str(rate), *map(str, vars(count).values())))
    print(plain([*table, ("all of them", "", *map(str, vars(total).values()))]))
    return 1 if total.wrong or total.kept < total.short else 0


def main(argv: Sequence[str] | None = None) -> int:
    options = parser().parse_args(argv)
    if options.list:
        print(*(one.name for one in CLASSES), "", *(one.name for one in SETUPS), sep="\n")
        return 0
    if options.episode:
        try:
            episode = Episode.parse(options.episode)
        except ValueError as error:
            print(f"{options.episode}: {error}; --list shows the names", file=sys.stderr)
            return 2
        return trace(episode, every=options.trace)
    if options.endurance:
        return run_endurance(options)
    if options.stalls:
        return run_stalls(options)
    if options.one_lost:
        return run_one_lost(options)
    tallies = campaign(options)
    table = rows(tallies, options.by_setup)
    print(plain(table))
    found = misses(tallies)
    print(f"goals missed: {len([line for line in found if line[0] != ' '])}", *found, sep="\n")
    if options.markdown is not None:
        options.markdown.write_text(markdown(table), encoding="utf-8")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
