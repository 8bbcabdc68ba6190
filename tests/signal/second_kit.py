"""A machine with two sensors: the encoder of the chain, and another one that counts increments."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from supervision_kit import at

from canfb.signal.chain import SignalChain
from canfb.signal.chain_config import ChainConfig
from canfb.signal.feedback import Feedback
from canfb.signal.sample import Sample
from canfb.signal.second_position import SecondSensor

N = 2500
INCREMENTS = 1 << 20


def wrapped(increments: int) -> int:
    """As INTEGER32."""
    return (increments + (1 << 31)) % (1 << 32) - (1 << 31)


class TwoSensors:
    """Truth: ``position`` of the encoder and ``other`` of the other sensor, both in cycles of the encoder.

    The other follows the encoder, unless ``slip`` moves it. ``value`` makes its increments of ``other``.
    """

    def __init__(
        self, tolerance: float = 0.01, increments: int = INCREMENTS, origin: int = 12345, **config: Any
    ) -> None:
        sensor = {k: config.pop(k) for k in ("revolutions", "reversed", "invalidates") if k in config}
        self.sensor = SecondSensor(increments=increments, tolerance_revolutions=tolerance, **sensor)
        self.chain = SignalChain(ChainConfig(cycles_per_revolution=N, **config))
        self.chain.use_second(self.sensor)
        self.position = self.other = 0.37
        self.origin = origin
        self.spoil: Callable[[Sample], Sample] = lambda sample: sample
        self.on_bus: Callable[[int], list[int]] = lambda value: [value]

    @property
    def value(self) -> int:
        per_cycle = self.sensor.increments / (N * self.sensor.revolutions)
        sign = -1 if self.sensor.reversed else 1
        return wrapped(self.origin + sign * math.floor(self.other * per_cycle))

    def step(self, speed: float, slip: float = 0.0, **rest: Any) -> Feedback:
        """One interval further: the sample, and then what comes of the other sensor."""
        self.position += speed
        self.other += speed + slip
        feedback = self.chain.step(self.spoil(at(self.position, **rest)))
        values = self.on_bus(self.value)
        self.chain.hear_second(len(values), values[-1] if values else 0)
        return feedback

    def run(self, samples: int, speed: float = 0.0, **rest: Any) -> list[Feedback]:
        return [self.step(speed, **rest) for _ in range(samples)]

    def ramp(self, speed: float, to: float, by: float = 0.1) -> list[Feedback]:
        got = []
        while speed != to:
            speed += max(-by, min(by, to - speed))
            got.append(self.step(speed))
        return got

    def error(self, feedback: Feedback) -> float:
        """Cycles by which the last position is off."""
        return feedback.cycles - self.position + feedback.phase
