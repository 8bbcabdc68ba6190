"""A chain on a machine with the witnesses it has: exact samples, the truth, status words as lists."""

import math
from collections.abc import Iterable
from typing import Any

from canfb import ChainConfig, Feedback, Sample, SignalChain, StatusBit

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


class Machine:
    """``position`` is the truth, cycles; it moves by ``speed`` before each sample.

    ``coarse`` is the error of its coarse track, revolutions, and ``mark`` where its zero pulse is, cycles;
    None: it has none. The pulse is ``width`` further when the machine turns backwards.
    """

    def __init__(
        self,
        speed: float = 0.0,
        position: float = 0.0,
        coarse: float | None = None,
        mark: float | None = None,
        width: float = 0.0,
        **config: Any,
    ) -> None:
        self.speed, self.position, self.coarse, self.mark, self.width = speed, position, coarse, mark, width
        self.chain = SignalChain(ChainConfig(**config))
        self.every = 1  # so many samples share a coarse track
        self.n = self.chain.reference.zero.cycles_per_revolution

    def sample(self, **rest: Any) -> Sample:
        before = self.position
        self.position += self.speed
        if self.coarse is not None and not self.chain.samples % self.every:
            turn = self.position / self.n
            angle = 2 * math.pi * (turn + self.coarse * math.sin(2 * math.pi * turn))
            rest |= {"coarse_sine": AMPLITUDE * math.sin(angle), "coarse_cosine": AMPLITUDE * math.cos(angle)}
        if self.mark is not None:
            edge = self.mark + (self.width if self.speed < 0.0 else 0.0)
            low, high = sorted((before, self.position))
            place = edge + math.floor((high - edge) / self.n) * self.n
            if low < place <= high:
                rest["zero_pulse"] = (place - before) / self.speed
        return at(self.position, **rest)

    def step(self, **rest: Any) -> Feedback:
        return self.take(self.sample(**rest))

    def take(self, sample: Sample) -> Feedback:
        return self.chain.step(sample)

    def spoil(self, sample: Sample = DEAD) -> Feedback:
        """The machine moves on, but this is what the converter gives."""
        self.position += self.speed
        return self.take(sample)

    def miss(self) -> Feedback:
        self.position += self.speed
        return self.chain.miss()

    def run(self, samples: int) -> list[Feedback]:
        return [self.step() for _ in range(samples)]

    def reach(self, speed: float, by: float = 0.1) -> None:
        """It accelerates, and is valid all the time."""
        while self.speed != speed:
            self.speed += max(-by, min(by, speed - self.speed))
            assert self.step().valid

    def error(self, feedback: Feedback) -> float:
        """Cycles by which a position, just given, is off."""
        return feedback.cycles - self.position + feedback.phase


def moving(speed: float, samples: int = 9, **words: Any) -> Machine:
    """It has started at standstill, and has turned at this speed for so many samples."""
    machine = Machine(**words)
    assert machine.run(40)[-1].valid
    machine.reach(speed)
    assert all(got.valid for got in machine.run(samples))
    return machine
