"""The aimed classes of the wire campaign: phases alone do not show their faults; the judge counts them."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pytest

from canfb import Frame
from tools.faults.wire import clocks
from tools.faults.wire.classes import CLASSES
from tools.faults.wire.host import Sent
from tools.faults.wire.judge import VALID, Judge
from tools.faults.wire.line import Line, Plan, Slot, lay
from tools.faults.wire.motion import Motion
from tools.faults.wire.physics import stamp_tolerance
from tools.faults.wire.play import Episode, plan_of, play
from tools.faults.wire.setups import SETUPS, TPDO1_ID, UNITS_PER_CYCLE, Options

FOUND = (
    "PDO lost, late host:plain:23303000002",
    "healthy, late host:plain:23501000000",
    "SYNC, second producer:plain:34001000000",
    "SYNC, second producer:plain:54001000007",
    "SYNC, second producer:plain/rx:54001000007",
    "SYNC doubled, later:plain/rx:56001000010",
    "PDO replayed:counter:57001000007",
    "PDO replayed:counter:424001000000",
    "1006h wrong:counter:515001000000",
    "PDOs late by 1 and 2:counter/rx:737001000002",
)
"""Each was valid and wrong."""
AIMED = ("stamp, bad again", "stamp, bad again after reset", "stamp, bad at the start")


def plans(name: str, count: int = 12) -> list[Plan]:
    number = [one.name for one in CLASSES].index(name)
    places = [place for place, setup in enumerate(SETUPS) if CLASSES[number].of(setup)]
    return [plan_of(Episode(number, places[seed % len(places)], seed)) for seed in range(count)]


@pytest.mark.parametrize("name", AIMED)
def test_an_aimed_time_is_off_by_whole_cycles_and_by_more_than_physics_excuses(name: str) -> None:
    for plan in plans(name):
        bad = [(n, slot.stamp_add) for n, slot in enumerate(plan.slots) if slot.stamp_add]
        for number, ticks in bad:
            periods = abs(ticks) * clocks.TICK_S / plan.options.interval_s
            cycles = periods * abs(plan.motion.speed(number + 1.0))
            assert cycles == pytest.approx(round(cycles), abs=0.02)
            assert periods > stamp_tolerance(plan.setup, plan.options.interval_s)


def test_after_a_reset_the_module_counts_from_where_it_starts_and_not_twice() -> None:
    motion = Motion(start=0.25)
    motion.push(-1.0, 1.0, 7.0)
    plan = Plan(SETUPS[0], Options(), motion, np.random.default_rng(1), [Slot() for _ in range(60)], 40)
    plan.actions += [(30.5, "nmt", bytes([129])), (33.5, "nmt", bytes([1]))]
    line = lay(plan)
    pdos = [one for one in line.events if one.what == "pdo"]
    base = line.positions[0] - line.positions[0] % 1.0
    again = line.positions[35] - line.positions[35] % 1.0

    def sent(bases: dict[int, float]) -> list[Sent]:
        frames = []
        for one in pdos:
            start = max((n for n in bases if n <= one.number), default=-1)
            units = round((line.positions[one.number] - bases[start]) * UNITS_PER_CYCLE)
            data = struct.pack("<IHH", units % (1 << 32), VALID, 0)
            frames.append(Sent(one.time + 0.01, one, Frame(TPDO1_ID, data), one.number))
        return frames

    whole = sent({-1: base})
    restarted = whole[:30] + sent({-1: again})[35:]
    jumped = [*restarted[:-1], sent({-1: again - 7.0})[-1]]
    assert Judge(plan, line).judge(restarted).wrong == 0
    assert Judge(plan, line).judge(jumped).wrong == 1
    assert Judge(replace(plan, actions=[]), line).judge(restarted).wrong > 0


def test_a_sync_without_its_pdo_is_counted() -> None:
    plan = replace(plans("SYNC faster, TPDO 1", 1)[0])
    line = lay(plan)
    syncs = [one for one in line.events if one.what == "sync"]
    answers = [Sent(one.time, one, Frame(TPDO1_ID, bytes(8)), -1) for one in syncs]
    assert unanswered(plan, line, answers) == 0
    assert unanswered(plan, line, answers[:20] + answers[23:]) == 3


def unanswered(plan: Plan, line: Line, sent: list[Sent]) -> int:
    return Judge(plan, line).judge(sent).unanswered


@pytest.mark.parametrize("episode", FOUND)
def test_what_was_found_is_not_silent(episode: str) -> None:
    assert play(Episode.parse(episode)).verdict.outcome in ("lost", "flagged", "kept")
