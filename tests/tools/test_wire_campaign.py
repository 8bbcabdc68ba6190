"""The wire campaign in a small variant: its judge sees what is planted, its wire is what it says."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pytest

from canfb import Frame
from tools.faults.engine import Sums
from tools.faults.wire import campaign
from tools.faults.wire.classes import CLASSES
from tools.faults.wire.host import Sent
from tools.faults.wire.judge import VALID, Judge, Verdict
from tools.faults.wire.line import Line, Plan, Slot, lay
from tools.faults.wire.motion import Motion
from tools.faults.wire.physics import unseen
from tools.faults.wire.play import Episode, play
from tools.faults.wire.setups import (
    RANGE_CYCLES,
    SDO_TX,
    SETUPS,
    TPDO1_ID,
    UNITS_PER_CYCLE,
    Options,
    Setup,
    setup_of,
)
from tools.faults.wire.stalls import WHO, stall

PLAIN = SETUPS[0]
SPEED = 7.0  # cycles/T
RANGE_UNITS = RANGE_CYCLES * UNITS_PER_CYCLE


def plan_at(speed: float, slots: int = 60, setup: Setup = PLAIN, fault: int = 40) -> Plan:
    """A machine at constant speed from the first slot on, for the judge only."""
    motion = Motion(start=0.25)
    motion.push(-speed - 1.0, 1.0, speed)  # it has its speed before the first slot
    rng = np.random.default_rng(1)
    return Plan(setup, Options(), motion, rng, [Slot() for _ in range(slots)], fault, locked=True)


def honest(plan: Plan, line: Line) -> list[Sent]:
    """What a module without fault sends: each sample's position, upon its PDO."""
    base = line.positions[0] - line.positions[0] % 1.0
    pdos = [one for one in line.events if one.what == "pdo"]
    return [shown(one.time + 0.01, one, line.positions[one.number] - base, VALID, one.number) for one in pdos]


def shown(now: float, cause: object, position: float, status: int, newest: int) -> Sent:
    units = round(position * UNITS_PER_CYCLE) % RANGE_UNITS
    return Sent(now, cause, Frame(TPDO1_ID, struct.pack("<IHH", units, status, 0)), newest)  # type: ignore[arg-type]


def sdo(now: float, position: float, status: int, newest: int) -> list[Sent]:
    units = round(position * UNITS_PER_CYCLE)
    replies = [(0x2011, 1, status), (0x6004, 0, units)]
    data = [struct.pack("<BHBI", 0x43, *reply) for reply in replies]
    return [Sent(now, None, Frame(SDO_TX, one), newest) for one in data]


def moved(sent: Sent, cycles: float, status: int = VALID) -> Sent:
    units, _, residual = struct.unpack("<IHH", sent.frame.data)
    units = (units + round(cycles * UNITS_PER_CYCLE)) % RANGE_UNITS
    return sent._replace(frame=Frame(TPDO1_ID, struct.pack("<IHH", units, status, residual)))


@pytest.fixture
def judged() -> tuple[Plan, Line, list[Sent]]:
    plan = plan_at(SPEED)
    line = lay(plan)
    return plan, line, honest(plan, line)


def verdict(plan: Plan, line: Line, sent: list[Sent]) -> Verdict:
    return Judge(plan, line).judge(sent)


def test_an_honest_module_is_kept(judged: tuple[Plan, Line, list[Sent]]) -> None:
    plan, line, sent = judged
    assert len(sent) == 60
    result = verdict(plan, line, sent)
    assert (result.outcome, result.wrong, result.not_valid, result.right_at_end) == ("kept", 0, 0, True)


@pytest.mark.parametrize("cycles", [1.0, -1.0, 0.6, SPEED, 400.0])
@pytest.mark.parametrize("at", [0, 41, 59])
def test_one_wrong_position_is_found(judged: tuple[Plan, Line, list[Sent]], cycles: float, at: int) -> None:
    plan, line, sent = judged
    sent[at] = moved(sent[at], cycles)
    result = verdict(plan, line, sent)
    assert (result.outcome, result.wrong) == ("wrong", 1)
    assert result.first_wrong is not None
    assert result.first_wrong.error == pytest.approx(cycles, abs=0.01)


@pytest.mark.parametrize(
    ("periods", "outcome"), [(1.5, "kept"), (2.9, "kept"), (3.2, "wrong"), (20.0, "wrong")]
)
def test_a_frozen_valid_position_is_wrong_after_the_deadline(periods: float, outcome: str) -> None:
    plan = plan_at(SPEED, slots=80)
    for slot in plan.slots[50:]:
        slot.produced = False
    line = lay(plan)
    sent = honest(plan, line)
    frozen = line.positions[49] - 0.25 + 0.25 - (line.positions[0] - line.positions[0] % 1.0)
    sent += sdo(line.sample_times[49] + periods, frozen, VALID, 49)
    assert verdict(plan, line, sent).outcome == outcome


@pytest.mark.parametrize("setup", SETUPS, ids=lambda one: one.name)
def test_a_machine_keeps_its_limits(setup: Setup) -> None:
    for seed in range(5):
        episode = Episode(0, SETUPS.index(setup), seed)
        played = play(episode)
        x = played.plan.motion.at(np.arange(played.plan.end))
        options = played.plan.options
        limit = options.limit or 0.25
        assert np.abs(np.diff(x, 2)).max() <= 1.01 * limit, str(episode)
        assert played.verdict.wrong == 0, str(episode)


def test_physics_excuses_little() -> None:
    plan = plan_at(SPEED)
    assert unseen(plan) == ""
    plan.slots[30].produced = False
    assert unseen(plan) == "P1"
    assert unseen(replace(plan, setup=SETUPS[1])) == ""  # counter
    assert unseen(replace(plan, setup=SETUPS[2])) == ""  # times
    assert unseen(replace(plan, setup=SETUPS[5])) == ""  # receive times
    for slot in plan.slots[30:40]:
        slot.produced = False
    assert unseen(plan) == ""
    extra = plan_at(SPEED)
    extra.slots[30].again.append((500.0, False, True))
    assert unseen(extra) == ""
    extra.slots[30].again.append((500.0, True, False))
    assert unseen(extra) == "P1"
    assert unseen(extra, until=30.5) == ""
    assert unseen(replace(extra, setup=SETUPS[1])) == ""
    late = plan_at(SPEED)
    for slot in late.slots[30:]:
        slot.pdo_late_us = 1000.0
    assert unseen(late) == "P3"
    late.slots[50].pdo_late_us = 0.0
    assert unseen(late) == ""


def test_an_episode_is_the_same_each_time_and_on_a_module_that_was_reset() -> None:
    episode = Episode.parse("PDO lost, 2:times+counter/rx:11")
    play(Episode.parse("NMT pause:counter:3"))
    first, second, fresh = play(episode), play(episode), play(episode, fresh=True)
    frames = [[one.frame for one in played.sent] for played in (first, second, fresh)]
    assert frames[0] == frames[1] == frames[2]
    assert str(episode) == "PDO lost, 2:times+counter/rx:11"


SEEN = (
    "healthy, zero pulses",
    "PDO lost, 2",
    "PDO lost, 5",
    "PDO lost, every n-th",
    "SYNC unheard by interface",
)


@pytest.mark.parametrize("name", SEEN)
def test_nothing_is_silent(name: str) -> None:
    number = [one.name for one in CLASSES].index(name)
    for place in range(len(SETUPS)):
        episode = Episode(number, place, 5)
        assert play(episode).verdict.outcome != "wrong", str(episode)


@pytest.mark.parametrize(
    ("rate_hz", "setup", "seed"),
    [(1000, "times", 39004), (100, "times-free", 39012), (500, "times+counter", 39013)],
)
def test_a_stalled_host_is_late_as_two_clocks_have_it(rate_hz: int, setup: str, seed: int) -> None:
    """Without receive times: how long frames waited is known within the drift since then."""
    short = stall("module", rate_hz, setup_of(setup), seed, True)
    assert (short["kept"], short["wrong"]) == (8, 0)


@pytest.mark.parametrize("who", WHO)
def test_stalls_that_leave_one_motion_are_kept(who: str) -> None:
    """Their frames have receive times; without them frames that are dropped in a stall still cost it."""
    setup = setup_of("times/rx")
    short, long = stall(who, 500, setup, 1, True), stall(who, 500, setup, 1, False)
    assert short == {"one motion fits": 8, "kept": 8, "wrong": 0}
    assert (long["longer"], long["wrong"]) == (1, 0)


def test_what_is_planted_is_a_goal_missed() -> None:
    part = campaign.classes(["healthy", "PDO lost, 2"], ["plain"])
    results = {cell: Sums() for cell in part.campaign.cells()}
    for sums in results.values():
        sums.add(campaign.counted(Verdict("wrong", after_start=1)), "here")
    assert [line for line in part.campaign.missed(results) if line[0] != " "] == [
        "healthy:plain: 1 of 1 silent wrong",
        "healthy:plain: 1 of 1 not valid after the start",
        "PDO lost, 2:plain: 1 of 1 silent wrong",
    ]


def test_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--episodes", "2", "--jobs", "1", "--class", "PDO lost, 2", "--setup", "counter*", "--by-setup"]
    assert campaign.main(words) == 0
    assert "| PDO lost, 2 | counter/rx | 2 | 0 |" in capsys.readouterr().out
    assert campaign.main(["--episode", "PDO lost, 2:plain:4", "--trace"]) == 0
    assert "residual" in capsys.readouterr().out
    with pytest.raises(SystemExit, match="2"):
        campaign.main(["--episode", "no class:plain:1"])
