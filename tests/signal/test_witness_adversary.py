"""Coarse track, zero pulse and second position in any combination, on a machine that does what it likes.

Tracks die, samples are missed or flagged, the bus pauses, the edges of the pulse are a cycle apart by
direction, the coarse track has an error, the shaft twists. A valid position is right, or was
lost before and is whole revolutions off.
"""

from __future__ import annotations

import math
import random
from typing import Any

import pytest
import witness_kit

from canfb.objects import StatusBit
from canfb.signal.sample import Feedback
from canfb.signal.second_position import SecondSensor

INCREMENTS = 1 << 22


class Machine(witness_kit.Machine):
    """What it has and declares is drawn."""

    def __init__(self, draw: random.Random) -> None:
        self.draw, n = draw, draw.choice([16, 100, 400, 2500])
        coarse, pulse, self.second = (draw.random() < part for part in (0.6, 0.6, 0.4))
        limit = draw.choice([1 / 128, 1 / 32, 0.3 / n, 0.45 / n, 0.9 / n])
        declared = draw.choice([0.0, 0.02, 0.1])
        super().__init__(
            position=draw.uniform(-1000, 1000),
            coarse=limit * draw.uniform(0.0, 0.45) if coarse else None,
            mark=draw.uniform(0, n) if pulse else None,
            width=draw.choice([0.0, 0.4, 0.6, 0.8, 1.0]),
            cycles_per_revolution=n,
            coarse_limit_revolutions=limit,
            max_acceleration_cycles=declared,
            coast_samples=draw.choice([3, 8]),
        )
        self.tolerance = draw.choice([0.3 / n, 0.001, 0.01])
        if self.second:
            self.chain.use_second(SecondSensor(increments=INCREMENTS, tolerance_revolutions=self.tolerance))
        self.acceleration = declared * draw.uniform(0.2, 1.0) or draw.choice([0.02, 0.05])
        self.top, self.wanted = min(draw.choice([0.4, 3.0, 40.0]), n / 5), 0.0
        self.bad = self.samples = 0

    def pause(self) -> None:
        intervals = self.draw.choice([2, 20, 200])
        self.position += self.speed * intervals
        self.chain.resume(intervals)

    def step(self, **rest: Any) -> Feedback:
        draw = self.draw
        self.samples += 1
        if self.samples > 40 and draw.random() < 0.01:
            self.wanted = draw.choice([0, 1, -1]) * draw.uniform(0.0, self.top)
        self.speed += max(-self.acceleration, min(self.acceleration, self.wanted - self.speed))
        self.bad = draw.randint(1, 12) if draw.random() < 0.004 else max(0, self.bad - 1)
        kind = draw.choice(["dead", "missed", "flagged"]) if self.bad else "good"
        sample = self.sample(invalid=kind == "flagged")
        if kind == "dead":
            sample = sample._replace(sine=0.0, cosine=0.0)
        got = self.chain.miss() if kind == "missed" else self.chain.step(sample)
        if self.second:
            twist = 0.9 * self.tolerance * self.n * math.sin(0.003 * self.samples)
            increments = math.floor((self.position + twist) / self.n * INCREMENTS)
            self.chain.hear_second(draw.random() < 0.98, increments)
        return got


@pytest.mark.parametrize("seed", range(30))
def test_a_valid_position_is_right_or_was_lost_before(seed: int) -> None:
    machine = Machine(random.Random(seed))
    offset, lost = math.nan, False
    for _ in range(1500):
        got = machine.step()
        lost |= bool(got.status & StatusBit.LOST)
        if got.valid:
            away = machine.error(got) - offset
            turns = round(away / machine.n) * machine.n if lost and away == away else 0
            assert not abs(away - turns) > 0.4
            offset, lost = machine.error(got), False
        if machine.draw.random() < 0.001:
            machine.pause()
            offset = offset if machine.chain.begun else math.nan  # it was lost at rest, and starts again


def test_most_losses_end_where_a_witness_is_exact() -> None:
    found = losses = 0
    for seed in range(40):
        machine = Machine(random.Random(seed))
        if machine.coarse is None or machine.chain.reference.coarse.limit_cycles > 0.5:
            continue
        was = False
        for _ in range(1500):
            lost = bool(machine.step().status & StatusBit.LOST)
            losses, found, was = losses + (lost > was), found + (was > lost), lost
    assert found > 0.7 * losses > 10
