"""The campaigns of the tracks and of the cycle count: their goals hold, their judges see what is planted."""

import json
from dataclasses import replace

import numpy as np
import pytest

from canfb.simulation.faults import Samples
from folding import each
from tools.faults.engine import Cell, Sums, Work, total
from tools.faults.samples import campaign
from tools.faults.samples.campaign import Player
from tools.faults.samples.episodes import KINDS, Declared, Episode, Published, State, draw
from tools.faults.samples.judge import Cause, Verdict, judge, proof
from tools.faults.samples.tracks import ENCODER, SETTINGS, judge_tracks

SLOW, FAST = Declared(0.01), Declared(0.2)


@each("phases, error, wrong, causes, said", [
    ([0.5, 0.5], 0.5, slice(10, 12), {Cause.ILLEGAL}, {"declared": 1, "seen": 0, "legal": 0}),  # silent
    ([0.5] * 4, 0.5, slice(10, 14), {Cause.ILLEGAL}, {"declared": 0}),  # more than is declared
    ([0.5], 1.0, slice(11, None), {Cause.ILLEGAL}, {"declared": 1, "matters": 1}),  # a cycle lost
    ([0.3, 0.3], 0.3, slice(10, 12), {Cause.EXCUSED}, {"legal": 1, "seen": 0}),  # a legal motion
    ([0.1, 0.1], 0.0, slice(0, 0), set(), {"matters": 0, "declared": 1}),  # a small error
])  # fmt: skip
def test_the_judge_of_the_tracks_sees_what_is_planted(
    phases: list[float], error: float, wrong: slice, causes: set[Cause], said: dict[str, int]
) -> None:
    """A machine at standstill whose samples show these phases for a while."""
    setting = SETTINGS["default"]
    position = np.concatenate((np.full(10, 0.1), 0.1 + np.array(phases), np.full(20, 0.1)))
    samples = Samples.of(*ENCODER.sample(position), adc_bits=12)
    phase, _ = setting.phases(samples.sine, samples.cosine)
    truth, at = np.full(len(samples), 0.1), np.arange(float(len(samples)))
    state = np.zeros(len(samples), np.int8)
    episode = Episode(setting, 10, at, truth, samples.sine, samples.cosine, phase, state, 0.0)
    published = truth.copy()
    published[wrong] += error
    verdict, found = judge_tracks(setting, episode, Published(published, np.ones(len(samples), np.int64)))
    assert set(verdict.wrong.values()) == causes
    assert {name: found[name] for name in said} == said


def test_the_goals_of_the_tracks_hold() -> None:
    one = campaign.campaign(Player("tracks"))
    results = one.run([2], 6, 1)
    assert [miss for miss in one.missed(results) if not miss.startswith(" ")] == []
    for name in ("both open", "short to a supply", "lost", "lost, 1", "lost, 3"):
        sums = total(results, name)
        assert sums["soon"] == sums["episodes"] == 18, name
    excused = {name: total(results, setup=name)["excused"] for name in SETTINGS}
    assert min(excused["default"], excused["accelerating"]) > 10 * excused["commissioned"]


def test_a_followed_drift_changes_nothing() -> None:
    kinds = ["gain drift", "late, 1"]
    runs = (campaign.campaign(Player("tracks", adapt=one), kinds).run([3], 10, 1) for one in (False, True))
    plain, adapting = ([total(run)[name] for name in ("seen", "early", "silent")] for run in runs)
    assert plain == adapting


def drawn(name: str, machine: Declared) -> Episode:
    return draw(KINDS[name], machine, 1, np.random.default_rng(8))[0]


def judged(episode: Episode, error: np.ndarray, valid: np.ndarray) -> Verdict:
    """Of one who says the true position plus this error."""
    right = episode.phase + np.rint(episode.truth - episode.phase)
    return judge(episode, Published(np.where(valid, right, 0.0) + error, valid * 1))


def test_the_judge_of_the_count_sees_what_is_planted() -> None:
    episode = drawn("missing 1", SLOW)
    good, at = episode.state == State.GOOD, np.arange(len(episode.state))
    none = np.zeros(len(good))
    kept = judged(episode, none, good)
    assert (kept.kept, kept.not_valid, kept.silent, kept.early) == (True, 1, False, False)
    assert not judged(episode, none, at < episode.fault).kept
    assert judged(episode, none, at >= episode.fault).early
    silent = judged(episode, np.where(at > episode.fault + 3, 1.0, 0.0), good)
    assert silent.silent
    assert set(silent.wrong.values()) == {Cause.ILLEGAL}
    assert min(silent.wrong) == episode.fault + 4


def test_the_wrong_one_of_two_legal_motions_was_guessed() -> None:
    """0.2 and one missed sample: the speed may have changed by a whole cycle (docs/supervision.md)."""
    episode = drawn("missing 1", FAST)
    k = np.arange(len(episode.truth))
    # With 0.19 - 1/3 in three intervals it is another legal motion.
    truth = (7.3 + 0.19 * k**2 / 2.0).astype(np.float64)
    episode = replace(episode, truth=truth, phase=np.mod(truth, 1.0))
    error = np.where(k > episode.fault, -1.0 * (k - episode.fault), 0.0)
    verdict = judged(episode, error, episode.state == State.GOOD)
    assert set(verdict.wrong.values()) == {Cause.GUESSED}
    assert proof(episode, episode.fault + 3).startswith("2 legal motions")


def test_what_the_samples_of_a_healthy_machine_would_be_is_excused() -> None:
    """Bad samples on the way of a machine that turns off by a whole cycle in three intervals."""
    episode = drawn("one bad", FAST)
    k, fault = np.arange(len(episode.truth)), episode.fault
    truth = np.full(len(k), 0.25)
    bad = (k >= fault) & (k < fault + 3)  # from there on the counts are those of the true motion
    error = np.where(bad, 0.2 * (k - fault + 1) * (k - fault + 2) / 2, 0.0)
    states = np.where(bad, State.BAD, State.GOOD).astype(np.int8)
    phase = (truth + error) % 1.0
    episode = replace(episode, truth=truth, phase=phase, state=states)
    verdict = judge(episode, Published(phase + np.rint(truth + error - phase), np.ones(len(k), np.int64)))
    assert set(verdict.wrong.values()) == {Cause.EXCUSED}
    assert not verdict.silent


def test_two_runs_are_the_same_and_the_number_of_processes_changes_nothing() -> None:
    one = campaign.campaign(Player("count"), ["one bad"], ["0.01"])
    first = one.run([3], 120, 1)
    assert first == one.run([3], 120, 2) != one.run([4], 120, 1)
    assert total(first)["episodes"] + total(first)["early"] == 120
    assert one.missed(first) == []


def test_a_silent_error_is_a_goal_missed_where_what_is_declared_holds() -> None:
    one = campaign.campaign(Player("count"), ["missing 1", "two glitches"], ["0.01"])
    results = {cell: Sums() for cell in one.cells()}
    verdict = Verdict(False, {3: Cause.GUESSED}, True, 0, False)
    for cell, sums in results.items():
        sums.add(campaign.counted(verdict, {"declared": cell.fault == "missing 1"}), "here")
    assert one.missed(results) == ["missing 1:0.01: 1 of 1 silent", "    here"]
    (played,) = Player("count", exceed=1.5).played(Work(Cell("missing 1", "0.01"), 1, range(1)))
    assert not played.more["declared"]


def test_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["count", "--episodes", "20", "--class", "missing 3", "two *", "--setup", "0.01", "--jobs", "1"]
    assert campaign.main(words) == 0
    assert "| missing 3 | 0 100 3.0 |" in capsys.readouterr().out.splitlines()
    assert campaign.main([*words, "--json"]) == 0
    missing, _ = json.loads(capsys.readouterr().out)
    assert (missing["kept"], missing["not valid"]) == (20, 60)
    assert campaign.main(["count", "--show", "one bad:0.05:24:7"]) == 0
    assert "BAD" in capsys.readouterr().out
    shown = ("--show none:0.1:1:1", "--show one*:0.1:1:1", "--class stall none")
    for wrong in ("--episodes 0", "--seed -1", "--exceed 0", "--class none", "--adapt", *shown):
        with pytest.raises(SystemExit, match="2"):
            campaign.main(["count", *wrong.split()])
