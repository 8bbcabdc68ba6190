"""What the estimator does at a start, while it coasts, at a loss, and with what is known from outside."""

from __future__ import annotations

import math

import pytest

from canfb.objects import LossCause
from canfb.signal.estimator import Estimator
from canfb.signal.limits import Declared
from canfb.signal.speeds import steady_speed
from canfb.signal.supervision import COASTING, LOST, RESIDUAL, VALID

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
    for _ in range(3):
        estimator.bad(1.0, missed=True)
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


def test_a_count_that_was_found_leaves_the_speed_and_the_places() -> None:
    estimator = started()
    samples = len(estimator.places)
    estimator.found(100, 0)
    assert len(estimator.places) == samples
    assert steady_speed(estimator.places) == pytest.approx(0.2)
    assert estimator.good(phases(0.2, 1, 12)[0], 1.0)[0].cycles == 100 + 2


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
