"""Wire campaign: faults of time and of the wire, frame by frame through the whole module.

    python -m tools.faults.wire.campaign [--episodes N] [--jobs N] [--class NAME] [--setup NAME]
    python -m tools.faults.wire.campaign --episode CLASS:SETUP:SEED --trace

Own motion, own wire, own judge: only canfb.FeedbackModule and canfb.Frame are used. The result depends on
--seed only. Exit status 1 when a valid position was wrong, or a healthy machine was not kept after its start.
docs/evidence.md says what the classes and columns mean.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from tools.faults.engine import Campaign, Cell, Sums, Work, by_count, chosen, parser, report
from tools.faults.wire.classes import CLASSES
from tools.faults.wire.judge import EMCY_LIMIT, Verdict
from tools.faults.wire.play import Episode, play
from tools.faults.wire.setups import SETUPS, setup_of
from tools.faults.wire.stalls import IN_A_ROW, RATES_HZ, WHO, stall
from tools.faults.wire.trace import trace

CONFIRMED = 3
FAULTS, NAMES = [one.name for one in CLASSES], [one.name for one in SETUPS]
TIMED = [one.name for one in SETUPS if one.times and not one.servo]
OUTCOMES = ("wrong", "physics", "lost", "flagged", "kept")


class Part(NamedTuple):
    """What a campaign consists of, and the columns of its table."""

    campaign: Campaign
    counts: tuple[str, ...]


def play_class(work: Work) -> Sums:
    """Episodes of a class of wire faults."""
    sums = Sums()
    for n in range(work.first, work.first + work.size):
        place = FAULTS.index(work.cell.fault), NAMES.index(work.cell.setup)
        episode = Episode(*place, work.seed * 1_000_000 + n)
        # A new module takes longer than an episode: beyond the first, results count without a second play.
        verdict = play(episode, confirm=sums["wrong"] < CONFIRMED).verdict
        sums.add(counted(verdict), example(episode, verdict))
    return sums


def counted(verdict: Verdict) -> dict[str, int]:
    """What an episode adds to the sums."""
    return {
        verdict.outcome: 1,
        "early": verdict.early > 0,
        "after start": verdict.after_start > 0,
        "accel.": verdict.acceleration_wrong > 0,
        "EMCY": verdict.emergencies > EMCY_LIMIT,
        "PDOs": verdict.unanswered > 0,
    }


def example(episode: Episode, verdict: Verdict) -> str:
    """Of a silent wrong position; nothing if there is none."""
    if verdict.outcome != "wrong":
        return ""
    first = verdict.first_wrong
    where = f"{first.error:+.1f} cycles at {first.now:.1f} T" if first else ""
    return f"{episode}: {verdict.wrong} frames, first {where}"


def class_misses(cell: Cell, sums: Sums) -> Iterator[str]:
    """Silent wrong positions, and healthy machines that were not kept."""
    wire_class, setup = CLASSES[FAULTS.index(cell.fault)], SETUPS[NAMES.index(cell.setup)]
    if sums["wrong"]:
        yield f"{sums['wrong']} of {sums['episodes']} silent wrong"
    if wire_class.valid(setup) and sums["after start"]:
        yield f"{sums['after start']} of {sums['episodes']} not valid after the start"
    if wire_class.survives and sums["lost"]:
        yield f"{sums['lost']} of {sums['episodes']} lost, which need not be"
    if sums["PDOs"]:
        yield f"SYNCs without their PDO in {sums['PDOs']} of {sums['episodes']}"


def classes(faults: Sequence[str] = FAULTS, setups: Sequence[str] = NAMES) -> Part:
    """Wire faults."""

    def runs(cell: Cell) -> bool:
        return CLASSES[FAULTS.index(cell.fault)].of(SETUPS[NAMES.index(cell.setup)])

    counts = ("episodes", *OUTCOMES, "early", "accel.", "EMCY", "PDOs")
    return Part(Campaign(faults, setups, play_class, class_misses, runs=runs), counts)


def play_stalls(work: Work) -> Sums:
    """Machines with stalls; the fault is who stalls, and the rate."""
    sums, (who, rate) = Sums(), work.cell.fault.removesuffix(" Hz").rsplit(" ", 1)
    for n in range(work.first, work.first + work.size):
        for is_short in (True, False):
            sums.add(stall(who, int(rate), setup_of(work.cell.setup), work.seed + n, is_short))
    return sums


def kept_misses(cell: Cell, sums: Sums) -> Iterator[str]:
    """Where one motion only fits, it is kept; nothing is valid and wrong."""
    if sums["wrong"]:
        yield f"{sums['wrong']} valid and wrong"
    if sums["kept"] < sums["one motion fits"]:
        yield f"{sums['kept']} of {sums['one motion fits']} kept"


def part_of(options: argparse.Namespace) -> tuple[Part, int]:
    """What is to be played, and how many episodes; ValueError for names that there are not."""
    if options.stalls:
        faults = [f"{who} {rate} Hz" for who in WHO for rate in RATES_HZ]
        setups = chosen(TIMED, options.setup)
        stalls = Campaign(faults, setups, play_stalls, kept_misses, 4)
        machines = -(-options.stalls // (len(faults) * len(setups) * (IN_A_ROW + 1)))
        return Part(stalls, ("one motion fits", "kept", "longer", "kept of longer", "wrong")), machines
    return classes(chosen(FAULTS, options.faults), chosen(NAMES, options.setup)), options.episodes


def main(argv: Sequence[str] | None = None) -> int:
    options = parser("tools.faults.wire.campaign", __doc__, 30, 1997)
    options.add_argument("--by-setup", action="store_true", help="a row for each class and set-up")
    options.add_argument("--stalls", type=int, metavar="N", help="stalls of 1 to 500 ms only")
    options.add_argument("--episode", metavar="CLASS:SETUP:SEED", help="one episode only")
    options.add_argument("--trace", action="store_true", help="with --episode: every frame")
    options.add_argument("--list", action="store_true", help="the names of classes and set-ups")
    said = options.parse_args(argv)
    if said.list:
        print(*FAULTS, "", *NAMES, sep="\n")
        return 0
    try:
        if said.episode:
            return trace(Episode.parse(said.episode), every=said.trace)
        part, episodes = part_of(said)
    except ValueError as error:
        options.error(f"{error}; --list shows the names")
    results = part.campaign.run(said.seed, episodes, said.processes)
    rows = by_count(results, part.counts, each_setup=said.by_setup)
    return report(part.campaign, results, rows, json=said.json)


if __name__ == "__main__":
    sys.exit(main())
