from __future__ import annotations

import math

import numpy as np
import pytest

from canfb.objects import StatusBit
from canfb.signal.chain import SignalChain
from canfb.signal.chain_config import ChainConfig
from canfb.signal.feedback import Feedback
from canfb.signal.sample import Sample
from ideal_tracks import counts_at

N = 2500
AMPLITUDE = 1500.0
COARSE_ERROR = 0.008  # revolutions, once per revolution: an offset of 5 % on the coarse track


class Machine:
    """A machine with coarse track and zero pulse; the truth is ``position``, in cycles."""

    def __init__(self, speed: float, *, coarse: bool = True, pulse: bool = True, seed: int = 1) -> None:
        self.speed, self.coarse, self.pulse = speed, coarse, pulse
        self.position = 1234.56
        self._rng = np.random.default_rng(seed)

    def sample(self, acceleration: float = 0.0) -> Sample:
        before = self.position
        self.speed += acceleration
        self.position += self.speed
        angle = 2 * math.pi * self.position
        sine, cosine = (round(AMPLITUDE * f(angle) + self._rng.normal(0, 0.5)) for f in (math.sin, math.cos))
        return Sample(sine, cosine, 1.0, False, *self._coarse(), self._zero_pulse(before))

    def _coarse(self) -> tuple[float | None, float | None]:
        if not self.coarse:
            return None, None
        turn = self.position / N
        return counts_at(turn + COARSE_ERROR * math.sin(2 * math.pi * turn), AMPLITUDE)

    def _zero_pulse(self, before: float) -> float | None:
        low, high = sorted((before, self.position))
        pulse = math.floor(high / N) * N
        if not self.pulse or not low < pulse <= high:
            return None
        return round((pulse - before) / (self.position - before) * 65535) / 65536


def run(chain: SignalChain, machine: Machine, samples: int) -> list[tuple[Feedback, float]]:
    return [(chain.step(machine.sample()), machine.position) for _ in range(samples)]


def spoil(chain: SignalChain, machine: Machine, samples: int) -> list[Feedback]:
    """So many samples with both tracks dead."""
    return [chain.step(machine.sample()._replace(sine=0, cosine=0)) for _ in range(samples)]


def errors(got: list[tuple[Feedback, float]]) -> np.ndarray:
    return np.array([feedback.cycles + feedback.phase - truth for feedback, truth in got if feedback.valid])


def starts_at_rest(coarse: bool, pulse: bool) -> tuple[SignalChain, Machine]:
    chain, machine = SignalChain(ChainConfig()), Machine(0.0, coarse=coarse, pulse=pulse)
    run(chain, machine, 40)
    while machine.speed < 83.0:
        chain.step(machine.sample(0.1))
    run(chain, machine, 200)
    return chain, machine


@pytest.mark.parametrize("outage", [4, 30, 500])
def test_a_lost_position_is_set_right_by_coarse_track_and_zero_pulse(outage: int) -> None:
    chain, machine = starts_at_rest(coarse=True, pulse=True)
    before = run(chain, machine, 100)
    reference = np.median(errors(before))
    assert before[-1][0].status & StatusBit.REFERENCED
    assert spoil(chain, machine, outage)[-1].status & StatusBit.LOST
    after = run(chain, machine, 1200)
    assert after[-1][0].valid
    wrong = errors(after) - reference
    whole_revolutions = np.rint(wrong / N) * N
    assert np.abs(wrong - whole_revolutions).max() < 0.04
    assert outage < 10 or any(feedback.jump_cycles for feedback, _ in after)
    shown = np.diff([feedback.cycles + feedback.phase - truth for feedback, truth in after])
    jumps = [k for k, step in enumerate(shown) if abs(step) > 90.0]
    assert all(after[k][0].jump_cycles != 0 for k in jumps), "a jump is reported by the sample before it"
