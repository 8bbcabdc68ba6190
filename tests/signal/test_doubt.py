"""Doubt: runs of samples, how many of them are proof, and when none will come."""

from __future__ import annotations

import numpy as np
import pytest

from canfb.signal.chain import SignalChain
from canfb.signal.chain_config import ChainConfig
from canfb.signal.recovery.bridge import Place
from canfb.signal.recovery.doubt import LONGEST_DOUBT, LONGEST_RUN, SHORTEST_RUN, Doubt, Undecided
from canfb.signal.sample import Sample
from canfb.simulation.encoder import Encoder

SPEED = 5.3


def at(position: float, elapsed: float = 1.0) -> Place:
    cycles = int(position // 1)
    return Place(cycles, position - cycles, elapsed)


def doubt_at(position: float, rough: float = 0.0, doubted: int = 3) -> Doubt:
    """After 16 places up to this position at constant speed, every other one off by ``rough``."""
    before = [at(position + (k - 15) * SPEED + rough * (k % 2)) for k in range(16)]
    return Doubt(before, doubted, 1 / 3)


def meet(doubt: Doubt, position: float, elapsed: float = 1.0, coast: int = 3) -> list[Place] | Undecided:
    doubt.meet(position % 1.0, elapsed)
    return doubt.decide(coast)


def test_four_samples_of_a_steady_machine_are_proof() -> None:
    doubt = doubt_at(100.2)
    doubt.wait(1.0)
    for k in range(2, SHORTEST_RUN + 1):
        assert meet(doubt, 100.2 + k * SPEED) is Undecided.YET
    places = meet(doubt, 100.2 + (SHORTEST_RUN + 1) * SPEED)
    assert not isinstance(places, Undecided)
    assert [place.cycles + place.phase for place in places] == pytest.approx(
        [100.2 + k * SPEED for k in range(2, SHORTEST_RUN + 2)]
    )
    assert {place.elapsed for place in places} == {1.0}


@pytest.mark.parametrize(("rough", "samples"), [(0.0005, 4), (0.005, 5), (0.012, 6), (0.02, 7)])
def test_a_rough_machine_needs_more_of_them(rough: float, samples: int) -> None:
    doubt = doubt_at(100.2, rough)
    doubt.wait(1.0)
    k = 1
    while (places := meet(doubt, 100.2 + (k + 1) * SPEED + rough * (k % 2))) is Undecided.YET:
        k += 1
    assert k == samples
    assert not isinstance(places, Undecided)
    assert len(places) == samples


@pytest.mark.parametrize("rough", [0.01, 0.05])
def test_a_run_rougher_than_the_machine_was_is_no_proof(rough: float) -> None:
    doubt = doubt_at(100.2)
    doubt.wait(1.0)
    found = [meet(doubt, 100.2 + (k + 2) * SPEED + rough * (k % 2)) for k in range(LONGEST_RUN)]
    assert found[:-1] == [Undecided.YET] * (LONGEST_RUN - 1)
    assert found[-1] is Undecided.FOR_EVER, "and never will be"


@pytest.mark.parametrize("jitter", [0.0, 1e-3, -0.01, 0.2])
def test_samples_at_uneven_times_are_a_run(jitter: float) -> None:
    doubt = doubt_at(100.2)
    doubt.wait(1.0 + jitter)
    time = 1.0 + jitter
    for k in range(4):
        elapsed = 1.0 - jitter if k % 2 else 1.0 + jitter
        time += elapsed
        places = meet(doubt, 100.2 + time * SPEED, elapsed)
    assert not isinstance(places, Undecided)
    assert places[-1].cycles + places[-1].phase == pytest.approx(100.2 + time * SPEED)


def test_all_of_a_smooth_run_is_taken() -> None:
    """A fault that looks like a machine: to leave out its first samples would give it any way."""
    doubt = doubt_at(100.2)
    found = [meet(doubt, 100.2 + k * SPEED + 0.45 + 0.2 * k) for k in range(1, 8)]
    assert Undecided.FOR_EVER in found
    assert all(isinstance(one, Undecided) for one in found)


def test_it_is_over_when_no_good_sample_comes() -> None:
    doubt = doubt_at(100.2)
    for _ in range(3):
        doubt.wait(1.0)
        assert not doubt.is_over(3)
    doubt.wait(1.0)
    assert doubt.is_over(3)


def test_samples_that_contradict_each_other_are_not_good_ones() -> None:
    ended = []
    for seed in range(20):
        doubt, samples = doubt_at(100.2), 0
        for phase in np.random.default_rng(seed).uniform(size=50).tolist():
            assert isinstance(meet(doubt, phase), Undecided)
            samples += 1
            if doubt.is_over(3):
                break
        ended.append(samples)
    assert max(ended) <= 3 + LONGEST_DOUBT + 1
    assert np.median(ended) < 12


def test_good_samples_that_are_never_enough_end_it_too() -> None:
    doubt = doubt_at(100.2)
    time = 0
    while not doubt.is_over(3):
        doubt.wait(1.0)
        assert meet(doubt, 100.2 + (time + 2) * SPEED) is Undecided.YET
        time += 2
    assert time == 3 + LONGEST_DOUBT + 1


def test_the_prediction_goes_on_with_what_was_met() -> None:
    doubt = doubt_at(100.2)
    predicted = doubt.wait(1.0)
    assert predicted.cycles + predicted.phase == pytest.approx(100.2 + SPEED)
    assert (predicted.residual, predicted.ok) == (0.5, False)
    met = doubt.meet((100.25 + 2 * SPEED) % 1.0, 1.0)
    assert met is not None
    assert met.cycles + met.phase == pytest.approx(100.25 + 2 * SPEED)
    assert met.residual == pytest.approx(0.05)
    assert doubt.meet((100.25 + 3 * SPEED + 0.3) % 1.0, 1.0) is None
    predicted = doubt.wait(1.0)
    assert predicted.cycles + predicted.phase == pytest.approx(100.25 + 4 * SPEED)


@pytest.mark.parametrize("seed", [755, 2666, 3751, 4247, 5827, 12748, 14115, 14185, 14889, 16589, 19954])
def test_after_a_glitch_in_a_machine_that_changes_its_acceleration_no_wrong_count_is_valid(seed: int) -> None:
    """Three samples of any phase, accelerations up to 0.2 cycle per interval squared, no table."""
    rng = np.random.default_rng(seed)
    acceleration = np.repeat(rng.uniform(-0.2, 0.2, 4), 50)
    truth = rng.uniform() + np.cumsum(np.cumsum(acceleration))
    at = int(rng.integers(60, 120))
    sine, cosine = Encoder(noise_lsb=0.5).sample(truth, rng)
    phase = rng.uniform(0, 6.3, 3)
    sine[at : at + 3], cosine[at : at + 3] = 1500 * np.sin(phase), 1500 * np.cos(phase)
    chain = SignalChain(ChainConfig())
    out = [chain.step(Sample(s, c)) for s, c in zip(sine.tolist(), cosine.tolist(), strict=True)]
    error = np.array([one.cycles + one.phase for one in out]) - truth
    error -= np.rint(error[0])
    valid = np.array([one.valid for one in out])
    assert not valid[at : at + 8].all()
    assert np.abs(error[at + 8 :][valid[at + 8 :]]).max(initial=0.0) < 0.05
