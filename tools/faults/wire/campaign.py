"""Wire campaign: faults of time and of the wire, frame by frame through the whole module.

    python -m tools.faults.wire.campaign [--episodes N] [--jobs N] [--class NAME] [--setup NAME]
    python -m tools.faults.wire.campaign --episode CLASS:SETUP:SEED --trace

Own motion, own wire, own judge: only canfb.FeedbackModule and canfb.Frame are used. The result depends on
--seed only. Exit status 1 when a valid position was wrong, or a healthy machine was not kept after its start.
docs/evidence.md says what the classes and columns mean.
"""

import sys
from collections.abc import Iterator, Sequence
from functools import partial

from tools.faults.engine import Campaign, Cell, Sums, Work, by_count, chosen, parser, run
from tools.faults.wire.classes import CLASSES, STALLS
from tools.faults.wire.judge import EMCY_LIMIT, Verdict
from tools.faults.wire.play import EVERY, Episode, play, trace
from tools.faults.wire.setups import SETUPS

COUNTS = (*("episodes", "wrong", "physics", "lost", "flagged", "kept"), *("early", "accel.", "EMCY", "PDOs"))


def play_class(work: Work) -> Sums:
    sums = Sums()
    for n in work.numbers:
        episode = Episode(*work.cell, work.seed * 1_000_000 + n)
        verdict = play(episode).verdict
        sums.add(counted(verdict), example(episode, verdict))
    return sums


def counted(verdict: Verdict) -> dict[str, int]:
    return {
        verdict.outcome: 1,
        "early": verdict.early > 0,
        "after start": verdict.after_start > 0,
        "accel.": verdict.acceleration_wrong > 0,
        "EMCY": verdict.emergencies > EMCY_LIMIT,
        "PDOs": verdict.unanswered > 0,
    }


def example(episode: Episode, verdict: Verdict) -> str:
    if verdict.outcome != "wrong":
        return ""
    first = verdict.first_wrong
    where = f"{first.error:+.1f} cycles at {first.now:.1f} T" if first else ""
    return f"{episode}: {verdict.wrong} frames, first {where}"


def class_misses(cell: Cell, sums: Sums) -> Iterator[str]:
    """Silent wrong positions, and healthy machines that were not kept."""
    wire_class, setup = EVERY[cell.fault], SETUPS[cell.setup]
    if sums["wrong"]:
        yield f"{sums['wrong']} of {sums['episodes']} silent wrong"
    if wire_class.demands_validity(setup) and sums["after start"]:
        yield f"{sums['after start']} of {sums['episodes']} not valid after the start"
    if wire_class.survives and sums["lost"]:
        yield f"{sums['lost']} of {sums['episodes']} lost, which need not be"
    if sums["PDOs"]:
        yield f"SYNCs without their PDO in {sums['PDOs']} of {sums['episodes']}"


def classes(faults: Sequence[str] = tuple(CLASSES), setups: Sequence[str] = tuple(SETUPS)) -> Campaign:
    def runs(cell: Cell) -> bool:
        return SETUPS[cell.setup].fits(EVERY[cell.fault].of)

    return Campaign(faults, setups, play_class, class_misses, runs=runs)


def main(argv: Sequence[str] | None = None) -> int:
    options = parser("tools.faults.wire.campaign", __doc__, 30, 1997)
    options.add_argument("--by-setup", action="store_true", help="a row for each class and set-up")
    options.add_argument("--stalls", action="store_true", help="stalls of 1 to 500 ms only")
    options.add_argument("--episode", metavar="CLASS:SETUP:SEED", help="one episode only")
    options.add_argument("--trace", action="store_true", help="with --episode: every frame")
    options.add_argument("--list", action="store_true", help="the names of classes and set-ups")
    said = options.parse_args(argv)
    if said.list:
        print(*EVERY, "", *SETUPS, sep="\n")
        return 0
    try:
        if said.episode:
            return trace(Episode.parse(said.episode), every=said.trace)
        faults = chosen(STALLS if said.stalls else CLASSES, said.faults)
        campaign = classes(faults, chosen(SETUPS, said.setup))
    except ValueError as error:
        options.error(f"{error}; --list shows the names")
    return run(campaign, said, partial(by_count, counts=COUNTS, each_setup=said.by_setup))


if __name__ == "__main__":
    sys.exit(main())
