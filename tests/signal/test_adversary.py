"""An adversary moves both sensors as a machine may, and the bus as a bus may; then it breaks something.

The motion is its own: random accelerations, reversals, standstills; the shaft twists with the acceleration
and has backlash; values are lost, late, doubled and repeated. Without a fault nobody notices the second
sensor. With one that the tracks cannot show, it is reported within a stated number of cycles.

Then a machine with coarse track, zero pulse and second position in any combination, whose tracks die.
"""

import math
import random
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import witness_kit
from test_second_position import DISAGREES, FINE, INCREMENTS, LOST, VALID, N, wrapped
from witness_kit import at

from canfb import ChainConfig, Feedback, Sample, SecondSensor, SignalChain, StatusBit
from canfb.signal.witness.witness import DISAGREEING
from folding import each

Rng = np.random.Generator
TOLERANCE = 0.01  # revolutions
TOLERANCE_CYCLES = TOLERANCE * N
TWIST_CYCLES, BACKLASH_CYCLES = 0.3 * TOLERANCE_CYCLES, 0.5 * TOLERANCE_CYCLES
INCREMENT_CYCLES = N / INCREMENTS
MOST_ACCELERATION = 0.15  # cycles per interval squared
TOP = 90.0  # cycles per interval


def motion(rng: Rng, intervals: int, still: int = 30) -> Iterator[tuple[float, float]]:
    """Position and acceleration of the encoder, cycles: standstill, then whatever comes."""
    position, speed, acceleration = float(rng.uniform(0, N)), 0.0, 0.0
    left = 0
    for k in range(intervals):
        if k >= still:
            if left == 0:
                left = int(rng.integers(5, 120))
                acceleration = float(rng.choice([-1, 0, 1]) * rng.uniform(0, MOST_ACCELERATION))
                if rng.random() < 0.2 and abs(speed) < 15.0:  # to a standstill, exactly
                    left = max(1, math.ceil(abs(speed) / MOST_ACCELERATION))
                    acceleration = -speed / left
            if abs(speed + acceleration) > TOP:
                acceleration = 0.0
            left -= 1
            speed += acceleration
        position += speed
        yield position, acceleration


class Shaft:
    """Between the two sensors: twist by the torque, and backlash that is passed when it reverses."""

    def __init__(self, start: float) -> None:
        self._last, self._side = start, 0.0

    def other(self, position: float, acceleration: float) -> float:
        speed, self._last = position - self._last, position
        if abs(speed) > 0.01:
            self._side += max(-0.05, min(0.05, math.copysign(1.0, speed) - self._side))
        return position + BACKLASH_CYCLES / 2.0 * self._side + TWIST_CYCLES * acceleration / MOST_ACCELERATION


class Bus:
    """Delivers the values of each interval: one, unless it is in one of its moods."""

    def __init__(self, rng: Rng, moody: float) -> None:
        self._rng, self._moody = rng, moody
        self._queue: list[int] = []
        self._mood, self._left = "usual", 0
        self._shown = 0

    def interval(self, value: int) -> list[int]:
        if self._left == 0 and self._rng.random() < self._moody:
            self._mood = str(self._rng.choice(["lost", "late", "doubled", "repeated"]))
            self._left = int(self._rng.integers(1, 3 if self._mood == "late" else 40))
        if self._left == 0:
            self._shown = value
            values, self._queue = [*self._queue, value], []
            return values
        self._left -= 1
        if self._mood == "late":
            self._queue.append(value)
            return []
        if self._mood == "repeated":
            return [self._shown]
        return [] if self._mood == "lost" else [value, value]


class Axis:
    """A chain with the second sensor and one without, on the same tracks."""

    def __init__(self, rng: Rng, moody: float, **config: object) -> None:
        self.chain, self.without = (SignalChain(ChainConfig(cycles_per_revolution=N, **config)) for _ in "ab")  # type: ignore[arg-type]
        self.chain.use_second(SecondSensor(increments=INCREMENTS, tolerance_revolutions=TOLERANCE))
        self._bus = Bus(rng, moody)
        self._origin = int(rng.integers(-(2**31), 2**31))
        self._last_bit = 0  # a sensor of 20 bits is never still

    def step(self, sample: Sample, other: float) -> tuple[Feedback, Feedback]:
        got = self.chain.step(sample), self.without.step(sample)
        self._last_bit ^= 1
        increments = self._origin + math.floor(other / INCREMENT_CYCLES) + self._last_bit
        values = self._bus.interval(wrapped(increments))
        self.chain.hear_second(len(values), values[-1] if values else 0)
        return got


def test_a_machine_that_is_well_is_never_contradicted() -> None:
    """Whatever the bus does to the values: the position, its status word, everything is as without them."""
    for seed in range(25):
        rng = np.random.default_rng((seed, 2))
        axis, shaft = Axis(rng, 0.02), None
        for k, (position, acceleration) in enumerate(motion(rng, 1000)):
            shaft = shaft or Shaft(position)
            got, without = axis.step(at(position), shaft.other(position, acceleration))
            if k > 10:
                assert got == without, (seed, k)


@each("kind", ["slip forward", "slip backward", "swapped tracks", "frozen tracks", "broken shaft"])
def test_what_the_tracks_cannot_show_is_reported(kind: str) -> None:
    """A valid position is further from the other sensor than the tolerance for three samples, no longer."""
    reported = 0
    for seed in range(40):
        rng = np.random.default_rng((seed, 99))
        axis, apart, over = Axis(rng, 0.0), 0.0, 0
        positions = list(motion(rng, 900))
        begin = int(rng.integers(100, 300))
        shaft = Shaft(positions[0][0])
        slip_speed = float(rng.uniform(0.05, 20.0))
        broken_at, slip = positions[begin][0], 0.0
        for k, (position, acceleration) in enumerate(positions):
            other, shown = shaft.other(position, acceleration), position
            if k > begin and kind.startswith("slip"):
                slip += slip_speed if kind == "slip forward" else -slip_speed
            elif k > begin and kind == "broken shaft":  # the motor runs on at its own speed
                slip += slip_speed * math.sin(0.01 * (k - begin))
            elif k > begin:
                shown = broken_at if kind == "frozen tracks" else 2.0 * broken_at - position
            got, _ = axis.step(at(shown), other + slip)
            if k == 20:  # at standstill
                start = other - (got.cycles + got.phase)
            if got.status & (DISAGREES | LOST):
                assert k > begin
                reported += 1
                break
            if k > 20:
                apart = (other + slip) - (got.cycles + got.phase) - start
            beyond = abs(apart) > TOLERANCE_CYCLES + 3.0 * INCREMENT_CYCLES
            over = over + 1 if beyond and got.status & VALID else 0  # coasting is a report of its own
            assert over <= DISAGREEING, (seed, k)
    assert reported >= 38  # the others turn on at the one speed at which dead tracks look alive


# Samples are missed or flagged, the bus pauses, the edges of the pulse are a cycle apart by direction, the
# coarse track has an error. A valid position is right, or was lost before and is whole revolutions off.


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
            self.chain.use_second(SecondSensor(increments=FINE, tolerance_revolutions=self.tolerance))
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
            increments = math.floor((self.position + twist) / self.n * FINE)
            self.chain.hear_second(draw.random() < 0.98, increments)
        return got


@pytest.mark.parametrize("seed", [*range(30), 6151])
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
