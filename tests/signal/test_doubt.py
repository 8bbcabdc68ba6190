"""The true motion is never among those that are removed: Doubt alone, on motions within what is declared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from canfb.signal.bounded_motion import BoundedMotion, Spot
from canfb.signal.doubt import Candidate, Doubt
from tools.faults.machine import positions

BEFORE = 14  # good samples, the last eight in the first candidate
AFTER = 30
PHASE_ERROR = 0.0125
RUNS = 25
BOUNDS = [0.02, 0.1, 0.2]


@dataclass
class Drive:
    """A motion of random acceleration within the bound, and the doubt that follows its samples."""

    doubt: Doubt
    instants: np.ndarray
    phases: list[float]
    counts: dict[float, int]  # of the true motion, by phase

    def keeps_the_truth(self) -> bool:
        """One candidate at least has none but true samples."""
        return any(
            all(self.counts.get(spot.phase) == spot.cycles for spot in one.spots)
            for one in self.doubt.candidates
        )


def drive(
    rng: np.random.Generator,
    bound: float,
    bad: int,
    instants: np.ndarray | None = None,
    error: float = PHASE_ERROR,
) -> Drive:
    at = np.arange(BEFORE + AFTER, dtype=float) if instants is None else instants
    u = bound * (
        rng.choice((-1.0, 1.0), (1, 120)) if rng.uniform() < 0.5 else rng.uniform(-1.0, 1.0, (1, 120))
    )
    whole = rng.uniform() < 0.5
    speed = np.array([float(rng.integers(-20, 21)) if whole else rng.uniform(-20.0, 20.0)])
    truth = positions(u, speed, rng, at[None, :])[0] + rng.uniform(-error, error, len(at))
    counts = np.floor(truth).astype(int)
    phases = (truth - counts).tolist()
    spots = tuple(Spot(float(at[n]), int(counts[n]), phases[n]) for n in range(BEFORE - 8, BEFORE))
    motion = BoundedMotion(bound, error)
    doubt = Doubt(motion, bad, [], [Candidate(float(at[BEFORE - 1]), spots, len(spots))])
    return Drive(doubt, at, phases, dict(zip(phases, counts.tolist(), strict=True)))


@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize("bound", BOUNDS)
def test_missing_and_flagged_samples_never_remove_the_truth(bound: float, uneven: bool) -> None:
    rng = np.random.default_rng([int(100 * bound), uneven])
    for _ in range(RUNS):
        at = None
        if uneven:
            at = np.cumsum(rng.uniform(0.5, 1.45, BEFORE + AFTER))
        one = drive(rng, bound, 1, at)
        state = rng.choice(3, AFTER, p=(0.65, 0.25, 0.1))
        for k in range(BEFORE, BEFORE + AFTER):
            elapsed = float(one.instants[k] - one.instants[k - 1])
            if state[k - BEFORE]:
                one.doubt.skip(elapsed, flagged=state[k - BEFORE] == 2)
                continue
            verdict = one.doubt.take(one.phases[k], elapsed)
            if verdict.lost is not None:
                break
            assert one.keeps_the_truth()
            if verdict.candidate is not None:
                assert verdict.candidate.last.cycles == one.counts[one.phases[k]]


@pytest.mark.parametrize("bad", [1, 2, 3])
@pytest.mark.parametrize("bound", BOUNDS)
def test_bad_samples_that_contradict_leave_the_truth(bound: float, bad: int) -> None:
    """Up to m in a row, any phase. Before the contradiction their motion is a legal one."""
    rng = np.random.default_rng([int(100 * bound), bad])
    contradictions = 0
    for _ in range(RUNS):
        one = drive(rng, bound, bad)
        first = BEFORE + int(rng.integers(0, 4))
        wrong = set(range(first, first + int(rng.integers(1, bad + 1))))
        contradicted = False
        for k in range(BEFORE, BEFORE + AFTER):
            phase = float(rng.uniform()) if k in wrong else one.phases[k]
            misfit = not any(
                found for c in one.doubt.candidates for found in c.successors(phase, 1.0, one.doubt.motion)
            )
            contradicted |= misfit
            verdict = one.doubt.take(phase, 1.0)
            if verdict.lost is not None:
                break
            if contradicted:
                assert one.keeps_the_truth()
                if verdict.candidate is not None:
                    assert verdict.candidate.last.cycles == one.counts[phase]
                    break
        contradictions += contradicted
    assert contradictions > RUNS // 4


def test_wider_limits_in_a_doubt_keep_the_truth() -> None:
    rng = np.random.default_rng(2)
    for _ in range(RUNS):
        one = drive(rng, 0.02, 2)
        one.doubt.skip(1.0, flagged=True)
        one.doubt.take(one.phases[BEFORE + 1], 1.0)
        assert one.keeps_the_truth()
        one.doubt.declare(BoundedMotion(0.05, 0.02), 1)
        for k in range(BEFORE + 2, BEFORE + AFTER):
            verdict = one.doubt.take(one.phases[k], 1.0)
            if verdict.lost is not None:
                break
            assert one.keeps_the_truth()


def test_a_flagged_sample_is_decided_after_few() -> None:
    """At 0.01: the windows are 0.12 wide, and 1e-5 takes some six samples."""
    rng = np.random.default_rng(4)
    for _ in range(RUNS):
        one = drive(rng, 0.01, 1)
        one.doubt.skip(1.0, flagged=True)
        for k in range(BEFORE + 1, BEFORE + AFTER):
            verdict = one.doubt.take(one.phases[k], 1.0)
            if verdict.settled:
                break
        assert verdict.candidate is not None
        assert k <= BEFORE + 8
