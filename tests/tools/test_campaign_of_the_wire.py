"""The wire campaign in a small variant: its judge sees what is planted, its wire is what it says."""

import struct
from dataclasses import replace

import numpy as np
import pytest

from canfb import FeedbackModule, Frame, ModuleConfig
from tools.faults.engine import Sums
from tools.faults.machine import Motion
from tools.faults.wire import campaign
from tools.faults.wire.classes import CLASSES
from tools.faults.wire.clocks import RATES_HZ, WHO
from tools.faults.wire.judge import VALID, Judge, Verdict
from tools.faults.wire.line import TICK_S, Line, Plan, Sent, Slot, lay
from tools.faults.wire.physics import stamp_tolerance, unseen
from tools.faults.wire.play import Episode, drive, plan_of, play
from tools.faults.wire.setups import RANGE_CYCLES, SDO_TX, SETUPS, TPDO1_ID, UNITS_PER_CYCLE, Options, set_up

SPEED = 7.0  # cycles/T
FOUND = (  # each was valid and wrong
    "PDO lost, late host:plain:23303000002", "PDO lost, late host:plain:77000046",
    "healthy, late host:plain:23501000000", "healthy, late host:plain:77000012",
    "deaf, late host:plain:1300001000009", "deaf, late host:times-free:1710001000108",
    "SYNC period changes:times-free:1710001000035", "SYNC, second producer:plain:34001000000",
    "SYNC, second producer:plain:54001000007", "SYNC, second producer:plain/rx:54001000007",
    "SYNC doubled, later:plain/rx:56001000010", "PDO replayed:counter:57001000007",
    "witness, deaf:servo:1870003000013", "SYNC, second producer:servo/rx:1970001000059",
    "SYNC of odd kind:servo:1940001000014", "SYNC, another rate, doubled:plain/rx:1930001000001",
    "stall of all, TPDO 1:times+counter/rx:1920002000003", "stamp, one bad, TPDO 1:servo/rx:1920002000020",
    "RPDO2 lost, SYNC lost:plain/rx:1910002000000", "RPDO2 lost, SYNC lost:counter/rx:1910002000012",
    "predict, SYNC stops or slows:times/rx:1950001000019", "predict, another rate:times/rx:1900002000001",
    "PDOs behind later SYNCs, some lost:plain/rx:1880006000008", "two faults, TPDO 1:servo/rx:8100001000000",
    "PDOs behind later SYNCs, some lost:plain/rx:1880006000010", "PDO replayed:counter:424001000000",
    "1006h wrong:counter:515001000000", "PDOs late by 1 and 2:counter/rx:737001000002",
    "PDOs late by 1 and 2:servo/rx:2010001000036", "SYNC, another rate:plain/rx:2030001000099",
    "coarse track, any loss:plain/rx:2040001000019", "stamp, one bad, TPDO 1:servo:2050001000026",
    "stamp, clock steps:times-free:2050001000070", "zero pulse false:servo/rx:2020001000001",
    "SYNC, another rate, times:servo/rx:997000331", "SYNC, another rate, times:servo/rx:997000993",
    "stamp, one bad:servo-3/rx:30700001000014", "stamp, one bad, TPDO 1:servo-3:30700001000026",
    "settings written:counter/rx:3040001000057", "NMT pause, samples later:counter/rx:6100001000009",
)  # fmt: skip
KEPT = ("PDOs behind later SYNCs:times+counter/rx:4010001000008",)  # each was lost
SEEN = ("healthy, zero pulses", "PDO lost, 5", "PDO lost, every n-th", "SYNC unheard by interface")


def plan_at(speed: float, slots: int = 60) -> Plan:
    """A machine at constant speed from the first slot on, for the judge only."""
    motion = Motion(start=0.25)
    motion.push(-speed - 1.0, 1.0, speed)  # it has its speed before the first slot
    rng = np.random.default_rng(1)
    return Plan(SETUPS["plain"], Options(), motion, rng, [Slot() for _ in range(slots)], 40, locked=True)


def honest(line: Line) -> list[Sent]:
    """What a module without fault sends: each sample's position, upon its PDO."""
    base = line.positions[0] - line.positions[0] % 1.0
    sent = []
    for one in line.events:
        if one.what == "pdo":
            units = round((line.positions[one.number] - base) * UNITS_PER_CYCLE)
            frame = Frame(TPDO1_ID, struct.pack("<IHH", units, VALID, 0))
            sent.append(Sent(one.time + 0.01, one, frame, one.number))
    return sent


def sdo(now: float, position: float, newest: int) -> list[Sent]:
    replies = [(0x2011, 1, VALID), (0x6004, 0, round(position * UNITS_PER_CYCLE))]
    return [Sent(now, None, Frame(SDO_TX, struct.pack("<BHBI", 0x43, *one)), newest) for one in replies]


def moved(sent: Sent, cycles: float) -> Sent:
    units, status, residual = struct.unpack("<IHH", sent.frame.data)
    units = (units + round(cycles * UNITS_PER_CYCLE)) % (RANGE_CYCLES * UNITS_PER_CYCLE)
    return sent._replace(frame=Frame(TPDO1_ID, struct.pack("<IHH", units, status, residual)))


@pytest.mark.parametrize("cycles", [1.0, -1.0, 0.6, SPEED, 400.0])
@pytest.mark.parametrize("at", [0, 41, 59])
def test_one_wrong_position_is_found(cycles: float, at: int) -> None:
    plan = plan_at(SPEED)
    line = lay(plan)
    sent = honest(line)
    sent[at] = moved(sent[at], cycles)
    result = Judge(plan, line).judge(sent)
    assert (result.outcome, result.wrong) == ("wrong", 1)
    assert result.first_wrong is not None
    assert result.first_wrong.error == pytest.approx(cycles, abs=0.01)


@pytest.mark.parametrize(("periods", "outcome"), [(2.9, "kept"), (3.2, "wrong"), (20.0, "wrong")])
def test_a_frozen_valid_position_is_wrong_after_the_deadline(periods: float, outcome: str) -> None:
    plan = plan_at(SPEED, slots=80)
    for slot in plan.slots[50:]:
        slot.produced = False
    line = lay(plan)
    frozen = line.positions[49] - (line.positions[0] - line.positions[0] % 1.0)
    sent = [*honest(line), *sdo(line.sample_times[49] + periods, frozen, 49)]
    assert Judge(plan, line).judge(sent).outcome == outcome


def test_after_a_reset_the_module_counts_from_where_it_starts_and_not_twice() -> None:
    plan = plan_at(SPEED)
    plan.actions += [(30.5, "nmt", bytes([129])), (33.5, "nmt", bytes([1]))]
    line = lay(plan)
    sent, start = honest(line), line.positions[35] - line.positions[35] % 1.0
    back = line.positions[0] - line.positions[0] % 1.0 - start
    restarted = sent[:30] + [moved(one, back) for one in sent[35:]]
    assert Judge(plan, line).judge(restarted).wrong == 0
    assert Judge(plan, line).judge([*restarted[:-1], moved(restarted[-1], 7.0)]).wrong == 1
    assert Judge(replace(plan, actions=[]), line).judge(restarted).wrong > 0


def test_a_sync_without_its_pdo_is_counted() -> None:
    plan = plan_of(Episode("SYNC faster, TPDO 1", "plain", 0))
    line = lay(plan)
    answers = [Sent(at.time, at, Frame(TPDO1_ID, bytes(8)), -1) for at in line.events if at.what == "sync"]
    for sent, unanswered in ((answers, 0), (answers[:20] + answers[23:], 3)):
        assert Judge(plan, line).judge(sent).unanswered == unanswered


@pytest.mark.parametrize("setup", SETUPS)
def test_a_machine_keeps_its_limits(setup: str) -> None:
    for seed in range(3):
        played = play(Episode("healthy", setup, seed))
        x = played.plan.motion.at(np.arange(played.plan.end))
        assert np.abs(np.diff(x, 2)).max() <= 1.01 * (played.plan.options.limit or 0.25), seed
        assert played.verdict.wrong == 0, seed


def test_physics_excuses_little() -> None:
    plan = plan_at(SPEED)
    assert unseen(plan) == ""
    plan.slots[30].produced = False
    assert unseen(plan) == "P1"
    for setup in ("counter", "times", "plain/rx"):
        assert unseen(replace(plan, setup=SETUPS[setup])) == ""
    for slot in plan.slots[30:40]:
        slot.produced = False
    assert unseen(plan) == ""
    extra = plan_at(SPEED)
    extra.slots[30].again.append((500.0, False, True))
    assert unseen(extra) == ""
    extra.slots[30].again.append((500.0, True, False))
    assert unseen(extra) == "P1"
    assert unseen(extra, until=30.5) == ""
    assert unseen(replace(extra, setup=SETUPS["counter"])) == ""
    late = plan_at(SPEED)
    for slot in late.slots[30:]:
        slot.pdo_late_us = 1000.0
    assert unseen(late) == "P3"
    late.slots[50].pdo_late_us = 0.0
    assert unseen(late) == ""


@pytest.mark.parametrize("bad", ["bad again", "bad again after reset", "bad at the start"])
def test_an_aimed_time_is_off_by_whole_cycles_and_by_more_than_physics_excuses(bad: str) -> None:
    setups = [setup for setup, one in SETUPS.items() if one.fits(CLASSES[f"stamp, {bad}"].of)]
    for seed in range(12):
        plan = plan_of(Episode(f"stamp, {bad}", setups[seed % len(setups)], seed))
        for number, ticks in ((n, slot.stamp_add) for n, slot in enumerate(plan.slots) if slot.stamp_add):
            periods = abs(ticks) * TICK_S / plan.options.interval_s
            cycles = periods * abs(plan.motion.speed(number + 1.0))
            assert cycles == pytest.approx(round(cycles), abs=0.02)
            assert periods > stamp_tolerance(plan.setup, plan.options.interval_s)


def test_an_episode_is_the_same_each_time_and_on_a_module_that_was_reset() -> None:
    episode = Episode.parse("PDO lost, 2:times+counter/rx:11")
    earlier = Episode.parse("stamp, bad again after reset:times:3")
    assert play(earlier).verdict.outcome != "lost"
    before, plan = plan_of(earlier), plan_of(episode)
    module = FeedbackModule(ModuleConfig(node_id=32, encoder_interface=16))
    module.start(100.0)
    drive(module, before, lay(before).events, set_up(module, before.setup, before.options, 100.0))
    module.receive(Frame(0x000, bytes([129, 32])), 200.0)
    module.chain.restart()  # a new module knows nothing of the machine of the last episode
    sent = drive(module, plan, lay(plan).events, set_up(module, plan.setup, plan.options, 200.0))
    frames = [[one.frame for one in of_one] for of_one in (play(episode).sent, play(episode).sent, sent)]
    assert frames[0] == frames[1] == frames[2]
    assert str(episode) == "PDO lost, 2:times+counter/rx:11"


@pytest.mark.parametrize("name", SEEN)
def test_nothing_is_silent(name: str) -> None:
    for setup in SETUPS:
        assert play(Episode(name, setup, 5)).verdict.outcome != "wrong", setup


@pytest.mark.parametrize("episode", [*FOUND, *KEPT])
def test_what_was_found_is_not_silent(episode: str) -> None:
    outcome = play(Episode.parse(episode)).verdict.outcome
    assert outcome in ("flagged", "kept") or (outcome == "lost" and episode not in KEPT)


def test_a_speed_over_doubtful_intervals_does_not_excuse_the_next_doubt() -> None:
    assert play(Episode.parse("deaf, late host:plain:1700003000488")).verdict.outcome == "lost"


@pytest.mark.parametrize("setup", ["times", "times-free", "times+counter", "times/rx"])
@pytest.mark.parametrize("who", WHO)
def test_stalls_that_leave_one_motion_are_kept(who: str, setup: str) -> None:
    """Without receive times, frames that are dropped in a stall may still cost it."""
    rates_hz = RATES_HZ if setup == "times/rx" or who != "module, queue" else ()
    for rate_hz in rates_hz:
        short = play(Episode(f"stalls of {who}, {rate_hz} Hz", setup, 1)).verdict
        assert short.outcome in ("kept", "flagged"), rate_hz
        assert short.right_at_end
    assert play(Episode(f"longer stall of {who}, 500 Hz", setup, 1)).verdict.outcome != "wrong"


def test_what_is_planted_is_a_goal_missed() -> None:
    one = campaign.classes(["healthy", "PDO lost, 2"], ["plain"])
    results = {cell: Sums() for cell in one.cells()}
    for sums in results.values():
        sums.add(campaign.counted(Verdict("wrong", after_start=1)), "here")
    assert [line for line in one.missed(results) if line[0] != " "] == [
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
