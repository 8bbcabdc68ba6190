"""The fault campaign in a small variant: its goals hold, and its judge can tell when they do not."""

from __future__ import annotations

import numpy as np
import pytest

from canfb.simulation.faults import Samples
from tools.faults.chain import campaign
from tools.faults.chain.judge import Episode, judge
from tools.faults.chain.plant import DEFAULT, ENCODER
from tools.faults.engine import total

# Faults beyond what is declared: a phase error of 0.4 cycle where 0.0125 are declared; nine bad samples in a
# row where three are; three beside a flagged one at 0.2 cycle per interval^2, where two motions fit them.
BEYOND = ("phase drift:default: ", "random counts:default: ", "random counts, 3:accelerating: ")


def still(phases: list[float], before: int = 10) -> Samples:
    """A machine at standstill whose samples show these phases for a while."""
    position = np.concatenate((np.full(before, 0.1), 0.1 + np.array(phases), np.full(20, 0.1)))
    return Samples.of(*ENCODER.sample(position), adc_bits=12)


def episode_of(phases: list[float], error: float, wrong: slice, status: int = 1) -> Episode:
    samples = still(phases)
    truth = np.full(len(samples), 0.1)
    errors = np.zeros(len(samples))
    errors[wrong] = error
    stop = 10 + len(phases)
    return Episode(10, stop, samples, samples, truth, errors, np.full(len(samples), status, dtype=np.int64))


@pytest.mark.parametrize(
    ("phases", "error", "wrong", "status", "said"),
    [
        ([0.5, 0.5], 0.5, slice(10, 12), 1, {"silent": 2, "wrong": 2, "flagged": 0, "legal": 0}),
        ([0.5], 1.0, slice(11, None), 1, {"cycle lost": 1}),
        ([0.3, 0.3], 0.3, slice(10, 12), 1, {"legal": 1, "silent": 0, "wrong": 2}),
        ([0.5, 0.5], 0.5, slice(10, 12), 2, {"false alarms": 1}),
    ],
    ids=["silent", "a cycle lost", "a legal motion", "flagged before"],
)
def test_the_judge_sees_what_is_planted(
    phases: list[float], error: float, wrong: slice, status: int, said: dict[str, int]
) -> None:
    found = judge(DEFAULT, episode_of(phases, error, wrong, status))
    assert {name: found[name] for name in said} == said


def test_the_goals_hold(capsys: pytest.CaptureFixture[str]) -> None:
    one = campaign.campaign(campaign.FAULTS, campaign.NAMES)
    results = one.run([2], 10, 1)
    assert [miss for miss in one.missed(results) if not miss.startswith((" ", *BEYOND))] == []
    assert total(results)["faulty"] > 60_000
    for name in ("both open", "short to a supply", "lost", "lost, 1", "lost, 3"):
        sums = total(results, name)
        assert sums["soon"] == sums["episodes"] == 30, name
    wrong = {name: total(results, setup=name)["wrong"] for name in campaign.NAMES}
    assert min(wrong["default"], wrong["accelerating"]) > 20 * wrong["commissioned"]
