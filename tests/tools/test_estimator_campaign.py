"""The campaign of the cycle count: repeatable, and its judge can tell silent from excused."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from tools.faults.engine import Cell, Work, total
from tools.faults.estimator import campaign
from tools.faults.estimator.campaign import Player
from tools.faults.estimator.declared import Declared
from tools.faults.estimator.episodes import Episode, Published, draw, play
from tools.faults.estimator.judge import Cause, judge, proof
from tools.faults.estimator.kinds import KINDS, State
from tools.faults.estimator.machine import KINDS as MOTIONS
from tools.faults.estimator.machine import Array, derivatives, positions

SLOW, FAST = Declared(0.01), Declared(0.2)


def kind(name: str):
    return next(one for one in KINDS if one.name == name)


def test_half_of_the_machines_use_all_of_the_bound_and_none_more() -> None:
    machine, order = Declared(0.1), 2
    rng = np.random.default_rng(1)
    u = derivatives(machine, rng, np.full(400, 20), 60)
    largest = np.abs(u).max(axis=1)
    assert len(MOTIONS) == 10
    assert 0.4 < (largest > 0.9 * machine.acceleration).mean() < 0.7
    assert largest.max() <= machine.acceleration
    even = positions(u, np.full(400, 100.0), rng)
    assert np.abs(np.diff(even, order, axis=1)).max() <= machine.acceleration + 1e-9
    instants = np.sort(rng.uniform(0.0, 55.0, (400, 50)), axis=1)
    at = positions(u, np.full(400, 100.0), rng, instants)
    for row, times in zip(at[:20], instants[:20], strict=True):
        values, n = row, order
        for step in range(1, n + 1):
            values = np.diff(values) / (times[step:] - times[:-step]) * step
        apart = np.min([times[k + order] - times[k] for k in range(len(times) - order)])
        assert np.abs(values).max() <= machine.acceleration + 1e-9 / max(apart, 1e-3) ** order


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
    """0.2 and one missed sample: the speed may have changed by a whole cycle (docs/legal-motion.md)."""
    episode = _episode("missing 1", FAST)
    k = np.arange(len(episode.truth))
    # With 0.19 - 1/3 in three intervals it is another legal motion.
    truth: Array = (7.3 + 0.19 * k**2 / 2.0).astype(np.float64)
    episode = replace(episode, truth=truth, phase=np.mod(truth, 1.0))
    error = np.where(k > episode.fault, -1.0 * (k - episode.fault), 0.0)
    verdict = judge(episode, _saying(episode, error, episode.state == State.GOOD))
    assert set(verdict.wrong.values()) == {Cause.GUESSED}
    assert proof(episode, play(episode), episode.fault + 3).startswith("2 legal motions")


def test_one_of_two_legal_motions_was_guessed_also_where_neither_is_the_true_one() -> None:
    episode = _episode("missing 1", FAST)
    k = np.arange(len(episode.truth))
    legal: Array = (7.3 + 0.19 * k**2 / 2.0).astype(np.float64)
    states = np.where(k > episode.fault, State.BAD, episode.state).astype(np.int8)
    truth = np.where(k > episode.fault, legal + 5.0, legal)
    episode = replace(episode, truth=truth, phase=np.mod(legal, 1.0), state=states)
    good = states != State.MISSING
    verdict = judge(episode, _saying(episode, np.where(k > episode.fault, -5.0, 0.0), good))
    assert set(verdict.wrong.values()) == {Cause.GUESSED}


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


def test_a_machine_that_does_more_than_declared_is_drawn_so_and_played_as_declared() -> None:
    """Half more than 0.05: residuals are over the limit before the fault in some; the draws stay the same."""
    work = Work(Cell("missing 3", "0.05"), 24, 0, 40)
    usual, more = Player(Declared(0.0, 0.002)), Player(Declared(0.0, 0.002), exceed=1.5)
    (bound,) = {one.declared.acceleration for one in more.episodes(work)}
    assert bound == pytest.approx(0.075)
    kept = usual(work)
    assert (kept["early"], kept["silent"], kept["kept"]) == (0, 0, 40)
    assert more(work)["early"] > 0


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
