"""Fault campaign: inject every class of faults at every kind of speed, and count what the chain sees.

    python -m tools.faults.chain.campaign [--episodes N] [--clean N] [--setting NAME] [--json]

Each episode is a machine turning at up to 3000 rpm with 2500 cycles per revolution, sampled at
1 kHz with 12 bits, and a fault at a random instant. The result depends on --seed only. Exit status
1 when a goal is missed. docs/evidence.md says what the columns mean and what the goals are,
docs/legal-motion.md what no supervision can detect.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from functools import cache
from typing import NamedTuple

import numpy as np

from tools.faults.chain.classes import CLASSES
from tools.faults.chain.clean import CHUNK_SAMPLES, CleanResult, run_clean
from tools.faults.chain.judge import judge, play
from tools.faults.chain.plant import SETTINGS, Setting, Turning, speed_of_group
from tools.faults.chain.tally import IN_SHORT, Tally
from tools.faults.side_by_side import side_by_side
from tools.site.markdown import table

USUAL = tuple(range(len(SETTINGS)))
EPISODES_OF_GROUP = 10
GLITCH_FACTOR = 4  # glitches are short: more episodes of them
FALSE_ALARM_GOAL = 1e-8


class Group(NamedTuple):
    """Episodes of one class at one speed: what one process does at a time."""

    seed: int
    setting: int
    fault_class: int
    group: int
    adapt: bool = False


class Campaign(NamedTuple):
    """All that was counted."""

    tallies: dict[tuple[int, int], Tally]
    clean: CleanResult
    settings: Sequence[int] = USUAL

    @property
    def faulty(self) -> int:
        return sum(tally.faulty for tally in self.tallies.values())

    def misses(self) -> list[str]:
        """Every goal that was missed."""
        missed = [
            f"{SETTINGS[setting].name}, {CLASSES[fault_class].name}: {miss}"
            for (setting, fault_class), tally in self.tallies.items()
            for miss in tally.misses
        ]
        clean = self.clean
        if clean.flagged > FALSE_ALARM_GOAL * clean.samples:
            missed.append(f"{clean.flagged} false alarms in {clean.samples} clean samples")
        if clean.wrong:
            missed.append(f"{clean.wrong} wrong positions in clean samples")
        return missed


def groups(seed: int, episodes: int, settings: Sequence[int] = USUAL, adapt: bool = False) -> Iterator[Group]:
    """All groups, in the order of the table."""
    for setting in settings:
        for number, fault_class in enumerate(CLASSES):
            wanted = episodes * (GLITCH_FACTOR if fault_class.is_glitch else 1)
            for group in range(max(1, round(wanted / EPISODES_OF_GROUP))):
                yield Group(seed, setting, number, group, adapt)


@cache
def _setting(number: int, adapt: bool) -> Setting:
    return replace(SETTINGS[number], adapt=adapt)


def run_group(group: Group) -> tuple[Group, Tally]:
    """Get the machine to its speed, then one episode after the other from there."""
    rng = np.random.default_rng(np.random.SeedSequence(group[:4]))
    setting = _setting(group.setting, group.adapt)
    turning = Turning(setting, speed_of_group(group.group + 7 * group.fault_class, rng), rng)
    tally = Tally(false_alarms=turning.flagged)
    for number in range(EPISODES_OF_GROUP):
        episode = play(CLASSES[group.fault_class], turning, rng)
        tally.add(judge(setting, episode), f"{tuple(group[:4])} episode {number}")
    return group, tally


def _run_chunk(chunk: tuple[int, int, int, Sequence[Setting]]) -> CleanResult:
    return run_clean(*chunk)


def campaign(
    seed: int,
    episodes: int,
    clean: int,
    processes: int,
    settings: Sequence[int] = USUAL,
    adapt: bool = False,
) -> Campaign:
    """Run it all; the result depends on all but ``processes``."""
    sizes = [min(CHUNK_SAMPLES, clean - begin) for begin in range(0, clean, CHUNK_SAMPLES)]
    chosen = [_setting(one, adapt) for one in settings]
    chunks = [(seed, number, size, chosen) for number, size in enumerate(sizes)]
    tallies: dict[tuple[int, int], Tally] = {}
    for group, tally in side_by_side(run_group, groups(seed, episodes, settings, adapt), processes):
        tallies.setdefault((group.setting, group.fault_class), Tally()).merge(tally)
    result = CleanResult()
    for one in side_by_side(_run_chunk, chunks, processes):
        result = result.merged(one)
    return Campaign(tallies, result, settings)


def clean_line(clean: CleanResult) -> str:
    """What became of the clean samples, in a sentence."""
    return (
        f"Clean samples: {clean.samples}, up to {clean.largest_speed:.0f} cycles per sample. False alarms: "
        f"{clean.flagged}. Wrong positions: {clean.wrong}. Largest residual: {clean.largest_residual:.4f}."
    )


def as_text(result: Campaign) -> str:
    """The settings side by side, and what was missed."""
    names = [f"{SETTINGS[n].name}: {head}" for n in result.settings for head in IN_SHORT]
    rows = []
    total = {n: Tally() for n in result.settings}
    for number, fault_class in enumerate(CLASSES):
        tallies = {n: result.tallies[n, number] for n in result.settings}
        rows.append((fault_class.name, *(cell for one in tallies.values() for cell in one.in_short())))
        for n, one in tallies.items():
            total[n].merge(one)
    rows.append(("all", *(cell for one in total.values() for cell in one.in_short())))
    missed = result.misses()
    seeds = [seed for tally in result.tallies.values() for seed in tally.violations]
    return "\n".join(
        [
            *table(("fault", *names), rows),
            "",
            clean_line(result.clean),
            f"{result.faulty} faulty samples; goals missed: {len(missed)}",
            *missed,
            *(f"silent wrong position: (seed, setting, class, group) {seed}" for seed in seeds[:20]),
        ]
    )


def as_json(result: Campaign) -> str:
    """All sums, for a program."""
    settings = {
        SETTINGS[n].name: {fc.name: result.tallies[n, m].record() for m, fc in enumerate(CLASSES)}
        for n in result.settings
    }
    sums = {"faulty": result.faulty, "settings": settings, "clean": asdict(result.clean)}
    return json.dumps(sums | {"misses": result.misses()}, indent=1)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.faults.chain.campaign", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--episodes", type=int, default=1000, metavar="N", help="of each class and setting")
    parser.add_argument("--clean", type=int, default=10_000_000, metavar="N", help="clean samples")
    parser.add_argument("--seed", type=int, default=1997)
    parser.add_argument("--processes", type=int, default=2, metavar="N")
    names = [one.name for one in SETTINGS]
    parser.add_argument("--setting", choices=names, help="only this one (default: all)")
    parser.add_argument(
        "--adapt", action="store_true", help="with the drift of the tracks followed (2002:08)"
    )
    parser.add_argument("--json", action="store_true", help="print all sums as JSON instead")
    options = parser.parse_args(argv)
    if options.episodes < 1 or options.clean < 0 or options.seed < 0 or options.processes < 1:
        parser.error("--episodes and --processes must be at least 1, --clean and --seed not negative")
    settings = USUAL if options.setting is None else (names.index(options.setting),)
    result = campaign(
        options.seed, options.episodes, options.clean, options.processes, settings, options.adapt
    )
    print(as_json(result) if options.json else as_text(result))
    return 1 if result.misses() else 0


if __name__ == "__main__":
    sys.exit(main())
