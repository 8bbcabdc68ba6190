"""The campaign of the cycle count: repeatable, and its judge can tell silent from excused."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from tools.faults.engine import Cell, total
from tools.faults.estimator import campaign
from tools.faults.estimator.campaign import Player
from tools.faults.estimator.declared import Declared
from tools.faults.estimator.episodes import Episode, Published, draw, play
from tools.faults.estimator.judge import Cause, judge, proof
from tools.faults.estimator.kinds import KINDS, State
from tools.faults.estimator.machine import Array

SLOW, FAST = Declared(0.01), Declared(0.2)


def kind(name: str):
    return next(one for one in KINDS if one.name == name)


def _episode(name: str, machine: Declared) -> Episode:
    return draw(kind(name), machine, 1, np.random.default_rng(8))[0]


def _saying(episode: Episode, error: np.ndarray, valid: np.ndarray) -> Published:
    return Published(
        np.where(valid, episode.phase + np.rint(episode.truth - episode.phase), 0.0) + error, valid * 1
    )


def test_a_right_chain_is_kept_and_one_that_says_nothing_is_lost() -> None:
    episode = _episode("missing 1", SLOW)
    good = episode.state == State.GOOD
    verdict = judge(episode, _saying(episode, np.zeros(len(good)), good))
    assert (verdict.kept, verdict.not_valid, verdict.silent, verdict.early) == (True, 1, False, False)
    before = np.arange(len(good)) < episode.fault
    assert not judge(episode, _saying(episode, np.zeros(len(good)), before)).kept
    assert judge(episode, _saying(episode, np.zeros(len(good)), ~before)).early


def test_a_position_a_cycle_off_is_silent() -> None:
    episode = _episode("missing 1", SLOW)
    good = episode.state == State.GOOD
    error = np.where(np.arange(len(good)) > episode.fault + 3, 1.0, 0.0)
    verdict = judge(episode, _saying(episode, error, good))
    assert verdict.silent
    assert set(verdict.wrong.values()) == {Cause.ILLEGAL}
    assert min(verdict.wrong) == episode.fault + 4


def test_the_wrong_one_of_two_legal_motions_was_guessed() -> None:
    """0.2 and one missed sample: the speed may have changed by a whole cycle (docs/supervision.md)."""
    episode = _episode("missing 1", FAST)
    k = np.arange(len(episode.truth))
    # With 0.19 - 1/3 in three intervals it is another legal motion.
    truth: Array = (7.3 + 0.19 * k**2 / 2.0).astype(np.float64)
    episode = replace(episode, truth=truth, phase=np.mod(truth, 1.0))
    error = np.where(k > episode.fault, -1.0 * (k - episode.fault), 0.0)
    verdict = judge(episode, _saying(episode, error, episode.state == State.GOOD))
    assert set(verdict.wrong.values()) == {Cause.GUESSED}
    assert proof(episode, play(episode), episode.fault + 3).startswith("2 legal motions")


def test_what_the_samples_of_a_healthy_machine_would_be_is_excused() -> None:
    """One bad sample on the way of a machine that turns off by a whole cycle in three intervals."""
    episode = _episode("one bad", FAST)
    k = np.arange(len(episode.truth))
    truth = np.full(len(k), 0.25)
    other = truth + np.where(
        k < episode.fault, 0.0, 0.2 * (k - episode.fault + 1) * (k - episode.fault + 2) / 2
    )
    late = episode.fault + 3
    phase = np.where(k < late, other, truth) % 1.0  # from there on the counts are those of the true motion
    states = np.where((k >= episode.fault) & (k < late), State.BAD, State.GOOD).astype(np.int8)
    episode = replace(episode, truth=truth, phase=phase, state=states)
    error = np.where((k >= episode.fault) & (k < late), other - truth, 0.0)
    said = Published(phase + np.rint(truth + error - phase), np.ones(len(k), np.int64))
    verdict = judge(episode, said)
    assert set(verdict.wrong.values()) == {Cause.EXCUSED}
    assert not verdict.silent


def test_two_runs_are_the_same_and_the_number_of_processes_changes_nothing() -> None:
    one = campaign.campaign(Player(Declared(0.0)), ["one bad"], [0.01])
    first = one.run([3], 120, 1)
    assert first == one.run([3], 120, 2) != one.run([4], 120, 1)
    assert total(first)["episodes"] + total(first)["early"] == 120
    assert one.missed(first) == []


def test_a_silent_error_is_a_goal_missed_where_what_is_declared_holds() -> None:
    player = Player(Declared(0.0))
    cells = {name: Cell(name, "0.01") for name in ("missing 1", "random")}
    one = campaign.campaign(player, list(cells), [0.01])
    results = {cell: campaign.Sums() for cell in cells.values()}
    for sums in results.values():
        sums.add({"silent": 1}, "here")
    assert one.missed(results) == ["missing 1:0.01: 1 of 1 silent", "    here"]
    assert replace(player, exceed=1.5).is_covered(cells["missing 1"]) is False


def test_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--episodes", "20", "--kind", "missing 3", "stays *", "--bound", "0.01", "--jobs", "1"]
    assert campaign.main(words) == 0
    assert "| missing 3 | 0 100 3.0 |" in capsys.readouterr().out.splitlines()
    assert campaign.main([*words, "--json"]) == 0
    missing, _ = json.loads(capsys.readouterr().out)
    assert (missing["kept"], missing["not valid"]) == (20, 60)
    assert campaign.main(["--show", "one bad:0.05:24:7"]) == 0
    assert "BAD" in capsys.readouterr().out
    for wrong in (["--episodes", "0"], ["--exceed", "0"], ["--kind", "none of these"]):
        with pytest.raises(SystemExit, match="2"):
            campaign.main(wrong)
