"""What the estimator does at a start, while it coasts, at a loss, and with what is known from outside."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from canfb.objects import LossCause
from canfb.signal.bounded_motion import HOLE_INTERVALS, LONG_INTERVAL, BoundedMotion, Spot
from canfb.signal.doubt import Candidate, Doubt
from canfb.signal.estimator import Estimator
from canfb.signal.limits import Declared
from canfb.signal.speeds import steady_speed
from canfb.signal.supervision import COASTING, LOST, RESIDUAL, VALID
from tools.faults.machine import positions

SLOW = Declared(residual_limit=0.06, widest_limit=1.0 / 3.0, acceleration=0.01)


def phases(speed: float, samples: int, first: int = 0) -> list[float]:
    """Of a machine that starts at phase 0.3."""
    return [(0.3 + speed * n) % 1.0 for n in range(first, first + samples)]


def started(declared: Declared = SLOW, speed: float = 0.2, samples: int = 12) -> Estimator:
    """After so many good samples at constant speed."""
    estimator = Estimator(declared)
    estimator.restart(0, speed)
    for phase in phases(speed, samples):
        assert estimator.good(phase, 1.0)[1] == VALID
    return estimator


def take(estimator: Estimator, some: list[float], elapsed: float = 1.0) -> list[int]:
    """Status bits of these samples."""
    return [estimator.good(phase, elapsed)[1] for phase in some]


# Starts.


def test_a_start_has_no_second_chance_until_its_speed_has_shown() -> None:
    """With uneven times eight samples show a wrong speed; one that contradicts among them is no glitch."""
    estimator = Estimator(SLOW)
    assert estimator.good(0.3, 1.0)[1] == VALID
    for n in range(1, 5):  # these times may tell
        assert estimator.good(0.3, 0.9)[1] == (COASTING if n == 1 else VALID)
    assert estimator.good(0.8, 1.1)[1] == LOST | RESIDUAL
    assert estimator.loss_cause == LossCause.START


def test_a_glitch_soon_after_a_doubt_is_no_wrong_start() -> None:
    """Missed, valid again, and a contradiction three samples later, with uneven times throughout."""
    estimator = Estimator(SLOW)
    for n in range(12):
        assert estimator.good(0.3, 0.9)[1] == (COASTING if n == 1 else VALID)
    estimator.bad(1.0, missed=True)
    assert take(estimator, [0.3] * 5, 0.9) == [VALID] * 5
    assert not estimator.in_doubt
    assert estimator.good(0.8, 1.1)[1] == COASTING | RESIDUAL
    assert not estimator.lost


def test_another_period_at_a_start_leaves_its_speed_open() -> None:
    """After one sample: 0.1 cycle per interval beside the speed assumed, 0.2 per one twice as long."""
    estimator = Estimator(SLOW)
    estimator.restart(0, 0.25)
    assert estimator.good(0.3, 1.0)[1] == VALID
    estimator.rescale(0.5)
    for n in range(1, 10):
        assert estimator.good((0.3 + 0.7 * n) % 1.0, 1.0)[1] == VALID


# Coasting.


@pytest.mark.parametrize("coast", [0, 3, 8])
def test_it_coasts_for_so_many_intervals(coast: int) -> None:
    """Or over the samples that one long interval lacks."""
    declared = Declared(residual_limit=0.06, acceleration=0.01, coast_samples=coast)
    estimator = started(declared)
    assert [estimator.bad(1.0)[1] for _ in range(coast)] == [COASTING] * coast
    assert estimator.bad(1.0)[1] == LOST
    assert estimator.loss_cause == LossCause.COASTED
    assert started(declared, speed=0.0).good(0.3, coast + 1.0)[1] == VALID
    estimator = started(declared, speed=0.0)
    assert estimator.good(0.3, coast + 2.0)[1] & LOST
    assert estimator.loss_cause == LossCause.COASTED


def test_samples_that_were_counted_are_in_doubt_beside_a_flagged_one() -> None:
    """2010:02 is not known: two bad samples pass 1/3, not the 0.2 assumed in doubt. Then one is flagged.

    0.17 cycle per interval^2 throughout; the count through the bad samples was valid and one cycle off.
    """
    estimator = Estimator(Declared(bad=3, doubt_acceleration=0.2))
    estimator.restart(0, 0.2)
    truth = [0.3 + 0.2 * n + 0.085 * n * (n - 1) for n in range(40)]
    for position in truth[:20]:
        assert estimator.good(position % 1.0, 1.0)[1] == VALID
    for n, off in ((20, 0.1344), (21, 0.4317)):
        estimator.good((truth[n] + off) % 1.0, 1.0)
    estimator.bad(1.0)
    for position in truth[23:]:
        track, bits = estimator.good(position % 1.0, 1.0)
        assert bits != VALID or abs(track.cycles + track.phase - position) < 0.5


# Losses.


def test_causes_of_losses() -> None:
    """Two motions that no sample tells apart; a jump; no motion at all."""
    fast = Declared(residual_limit=0.25, acceleration=0.2)
    estimator = started(fast, 0.2)
    assert [estimator.bad(1.0, missed=True)[1] for _ in range(3)] == [COASTING] * 3
    take(estimator, phases(0.2, 4, 15))
    assert estimator.loss_cause == LossCause.AMBIGUOUS
    estimator = started(Declared(residual_limit=0.15, acceleration=0.1, bad=2), samples=24)
    take(estimator, [(one + 0.2) % 1.0 for one in phases(0.2, 20, 24)])
    assert estimator.loss_cause == LossCause.JUMP
    estimator = started(samples=24)
    take(estimator, [0.1, 0.7, 0.95, 0.2, 0.9, 0.45, 0.05, 0.6, 0.15, 0.75])
    assert estimator.loss_cause == LossCause.CONTRADICTED
    assert estimator.lost


# What is known from outside.


def test_an_absolute_value_ends_a_loss() -> None:
    estimator = started()
    estimator.lose(LossCause.COASTED)
    take(estimator, phases(0.2, 4, 12))
    estimator.found(7, 0)
    estimator.confirm_count()
    track, bits = estimator.good(phases(0.2, 1, 16)[0], 1.0)
    assert bits == VALID
    assert track.cycles == 7 + math.floor(0.3 + 0.2 * 16)


def test_a_speed_from_outside_is_no_count_to_start_from() -> None:
    """Uneven times confirm the speed that a witness gave; how far it went while lost they do not know."""
    estimator, position = started(speed=0.0), 0.3
    estimator.timed = True
    estimator.lose(LossCause.TIME, starts=False)
    estimator.found(0, 5)
    for elapsed in np.random.default_rng(1).uniform(0.8, 1.2, 60).tolist():
        position += 5.3 * elapsed
        assert estimator.good(position % 1.0, elapsed)[1] & LOST
    estimator.resume()
    assert not estimator.tracker.started, "after a pause it starts again"


def test_a_count_that_was_found_leaves_the_speed_and_the_places() -> None:
    estimator = started()
    estimator.found(100, 0)
    assert len(estimator.places) == 1 + 12  # with the one assumed before the first
    assert steady_speed(estimator.places) == pytest.approx(0.2)
    assert estimator.good(phases(0.2, 1, 12)[0], 1.0)[0].cycles == 100 + 2
    estimator.bad(1.0, missed=True)
    assert take(estimator, phases(0.2, 1, 14)) == [VALID]
    estimator.found(100, 0)  # while the doubt goes on
    assert estimator.good(phases(0.2, 1, 15)[0], 1.0)[0].cycles == 200 + 3


@pytest.mark.parametrize("noise", [0.0, 0.003])
def test_an_input_that_stands_after_a_motion_is_not_valid(noise: float) -> None:
    """An open track shows one phase, with noise; the same of a machine that stood before is valid."""
    for speed, bits in ((0.3, 0), (0.0, VALID)):
        estimator = started(speed=speed)
        last = phases(speed, 12)[-1]
        stood = 0.8 if speed else last
        estimator.bad(1.0)
        given = [stood + noise * (-1) ** n for n in range(20)]
        assert take(estimator, given)[-1] & VALID == bits


# The true motion is never among those that are removed: Doubt alone, on motions within what is declared.

BEFORE = 14  # good samples, the last eight in the first candidate
AFTER = 30
PHASE_ERROR = 0.0125
RUNS = 25


@dataclass
class Drive:
    """A motion of random acceleration within the bound, and the doubt that follows its samples."""

    doubt: Doubt
    phases: list[float]
    counts: dict[float, int]  # of the true motion, by phase


def drive(rng: np.random.Generator, bound: float, bad: int) -> Drive:
    at = np.arange(BEFORE + AFTER, dtype=float)
    u = bound * (rng.choice((-1.0, 1.0), (1, 120)) if rng.uniform() < 0.5 else rng.uniform(-1, 1, (1, 120)))
    whole = rng.uniform() < 0.5
    speed = np.array([float(rng.integers(-20, 21)) if whole else rng.uniform(-20.0, 20.0)])
    truth = positions(u, speed, rng, at[None, :])[0] + rng.uniform(-PHASE_ERROR, PHASE_ERROR, len(at))
    counts = np.floor(truth).astype(int)
    phases = (truth - counts).tolist()
    spots = tuple(Spot(float(n), int(counts[n]), phases[n]) for n in range(BEFORE - 8, BEFORE))
    doubt = Doubt(BoundedMotion(bound, PHASE_ERROR), bad, [], [Candidate(BEFORE - 1.0, spots, len(spots))])
    return Drive(doubt, phases, dict(zip(phases, counts.tolist(), strict=True)))


@pytest.mark.parametrize("bad", [1, 2, 3])
@pytest.mark.parametrize("bound", [0.02, 0.1, 0.2])
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
                assert any(
                    all(one.counts.get(spot.phase) == spot.cycles for spot in each.spots)
                    for each in one.doubt.candidates
                ), "one candidate at least has none but true samples"
                if verdict.candidate is not None:
                    assert verdict.candidate.last.cycles == one.counts[phase]
                    break
        contradictions += contradicted
    assert contradictions > RUNS // 4


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


# SYNC jitter makes some intervals longer than 1.5 of the nominal one, with no sample missing between.

SAMPLES = 400


def instants(rng: np.random.Generator, sigma: float) -> np.ndarray:
    """On a grid of 1, each off by jitter; the first ones even, so that the start is not what is tested."""
    off = rng.normal(0.0, sigma, SAMPLES)
    off[:20] = 0.0
    return np.arange(SAMPLES) + np.clip(off, -0.4, 0.4)


def accelerations(rng: np.random.Generator, most: float) -> Iterator[float]:
    """Of pieces of 0.1 interval: pulses of all that is allowed, of random lengths, signs and rests."""
    left, now = 200, 0.0
    while True:
        if not left:
            left, now = int(rng.integers(1, 40)), most * float(rng.choice([-1.0, 0.0, 1.0]))
        left -= 1
        yield now


def pulsed(rng: np.random.Generator, times: np.ndarray, most: float) -> np.ndarray:
    """Integrated exactly piece by piece; between two pieces the acceleration is constant."""
    fine = np.arange(-10, SAMPLES * 10 + 20) / 10.0
    a = np.fromiter(accelerations(rng, most), float, fine.size)
    v = np.concatenate([[0.0], np.cumsum(a * 0.1)[:-1]])
    x = np.concatenate([[0.0], np.cumsum(v * 0.1 + a * 0.005)[:-1]])
    at = np.searchsorted(fine, times, side="right") - 1
    rest = times - fine[at]
    return 0.3 + x[at] + v[at] * rest + a[at] * rest**2 / 2.0


def play(rng: np.random.Generator, most: float, sigma: float, **declared: float) -> tuple[int, int, int]:
    """Intervals longer than 1.5, samples that were not valid, valid positions that were wrong."""
    estimator = Estimator(Declared(phase_error=PHASE_ERROR, **declared))  # type: ignore[arg-type]
    times = instants(rng, sigma)
    truth = pulsed(rng, times, most)
    noise = rng.uniform(-PHASE_ERROR, PHASE_ERROR, SAMPLES)
    shown = truth + noise
    long = lost = wrong = 0
    base = None
    for k, position in enumerate(shown.tolist()):
        elapsed = 1.0 if k <= 0 else float(times[k] - times[k - 1])
        long += HOLE_INTERVALS <= elapsed < LONG_INTERVAL
        track, bits = estimator.good(position % 1.0, elapsed)
        count = track.cycles - int(np.floor(position))
        base = count if base is None else base
        lost += not bits & VALID
        wrong += bool(bits & VALID) and not bits & LOST and count != base
    return long, lost, wrong


def test_a_long_interval_costs_nothing_where_one_count_fits() -> None:
    """With more acceleration than is assumed in doubt (0.1), and none declared."""
    kept = long = 0
    for seed in range(60):
        intervals, lost, wrong = play(np.random.default_rng((seed, 1)), 0.12, 0.11)
        assert not wrong, seed
        long += intervals > 0
        kept += intervals > 0 and not lost
    assert long >= 10
    assert kept >= 0.8 * long


@pytest.mark.parametrize(("most", "seeds"), [(0.05, 20), (0.15, 60), (0.28, 15)])
@pytest.mark.parametrize("is_declared", [False, True])
def test_a_valid_position_behind_long_intervals_is_right(most: float, seeds: int, is_declared: bool) -> None:
    """All that the usual residual limit allows, with intervals that are often long.

    A LONG_INTERVAL of 1.55 is wrong for one seed of 20 at 0.15, and for none of 60 at the others.
    """
    long = 0
    for seed in range(seeds):
        named = {"acceleration": most} if is_declared else {}
        intervals, _, wrong = play(np.random.default_rng((seed, 2)), most, 0.25, **named)
        assert not wrong, seed
        long += intervals
    assert long > 60
