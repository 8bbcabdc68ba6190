"""What the tests of the supervision share: exact samples, a chain in motion, status words as lists."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from canfb.objects import StatusBit
from canfb.signal.chain import SignalChain
from canfb.signal.chain_config import ChainConfig
from canfb.signal.feedback import Feedback
from canfb.signal.sample import Sample

AMPLITUDE = 1500.0
DEAD = Sample(0.0, 0.0)


def below(value: float) -> float:
    return math.nextafter(value, -math.inf)


def above(value: float) -> float:
    return math.nextafter(value, math.inf)


def at(position: float, **rest: Any) -> Sample:
    """Ideal tracks without rounding, so that no two samples of a moving machine are equal."""
    angle = 2 * math.pi * position
    return Sample(AMPLITUDE * math.sin(angle), AMPLITUDE * math.cos(angle), **rest)


def flags(feedback: Feedback) -> StatusBit:
    return StatusBit(feedback.status)


def has(got: Iterable[Feedback], bit: StatusBit) -> list[bool]:
    return [bool(feedback.status & bit) for feedback in got]


class Drive:
    """A chain that follows a machine; the truth is ``position``, cycles, and starts at standstill."""

    def __init__(self, speed: float = 0.0, **config: Any) -> None:
        self.chain = SignalChain(ChainConfig(**config))
        self.position = self.speed = 0.0
        self.step()
        while self.speed != speed:
            self.speed += max(-0.1, min(0.1, speed - self.speed))
            assert self.step().valid
        for _ in range(9):
            assert self.step().valid

    def step(self, **rest: Any) -> Feedback:
        self.position += self.speed
        return self.chain.step(at(self.position, **rest))

    def spoil(self, sample: Sample = DEAD) -> Feedback:
        """The machine moves on, but this is what the converter gives."""
        self.position += self.speed
        return self.chain.step(sample)

    def converter_dies(self) -> Sample:
        """One more good sample, which is what :meth:`spoil` is to repeat."""
        # At whole cycles per interval rounding would decide whether it equals the one before.
        self.position += self.speed + 1e-4
        last = at(self.position)
        self.chain.step(last)
        return last

    def miss(self) -> Feedback:
        self.position += self.speed
        return self.chain.miss()

    def run(self, samples: int) -> list[Feedback]:
        return [self.step() for _ in range(samples)]

    def error(self, feedback: Feedback) -> float:
        """Cycles by which a position, just given, is off."""
        return feedback.cycles - self.position + feedback.phase
