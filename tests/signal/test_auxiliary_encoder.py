"""A second position through the chain: start, loss, disagreement, and what costs nothing but the opinion."""

from __future__ import annotations

import math

import pytest
from second_kit import N, TwoSensors
from supervision_kit import DEAD, at, has

from canfb.objects import StatusBit
from canfb.signal.chain import SignalChain
from canfb.signal.chain_config import ChainConfig
from canfb.signal.second_position import SecondSensor
from canfb.signal.witness.second import LONGEST_GAP
from folding import each

DISAGREES, VALID, LOST = StatusBit.SECOND_POSITION, StatusBit.VALID, StatusBit.LOST
EXACT = 0.3 / N  # revolutions: less than half a cycle
FINE = 1 << 22  # increments: 0.0006 cycle each


def standing(tolerance: float = 0.01, **config: object) -> TwoSensors:
    """A machine at rest whose offset is learned."""
    machine = TwoSensors(tolerance, **config)  # type: ignore[arg-type]
    assert machine.run(30)[-1].valid
    return machine


@each("speed", [0.0, 0.2, -83.2, 83.5, 0.5, 41.99, -7.25])
@each("tolerance", [EXACT, 0.001])
def test_a_start_on_a_turning_machine(speed: float, tolerance: float) -> None:
    machine = TwoSensors(tolerance)
    got = machine.run(250, speed)
    first = has(got, VALID).index(True)
    assert all(feedback.valid for feedback in got[first:])
    assert got[-1].speed_cycles == pytest.approx(speed, abs=0.05)
    counted = got[-1].cycles - got[first].cycles + got[-1].phase - got[first].phase
    assert counted == pytest.approx(speed * (249 - first), abs=0.05)
    at_rest = 3  # three values agree
    assert first <= (at_rest if abs(speed) < 0.1 else 16.0 * (tolerance * N + 2.0))


@each("speed", [0.0, 83.2, -40.7])
@each("dead", [8, 40])
def test_a_lost_count_is_set_right(speed: float, dead: int) -> None:
    """Announced by its jump, and valid with the next sample; the machine changed its speed meanwhile."""
    machine = standing(EXACT, increments=FINE)
    machine.ramp(0.0, speed)
    before = machine.error(machine.step(speed))
    machine.spoil = lambda sample: DEAD
    assert machine.run(dead, speed + 3.3)[-1].status & LOST
    machine.spoil = lambda sample: sample
    got = machine.run(90, speed + 1.7)
    first = has(got, VALID).index(True)
    assert machine.error(got[-1]) == pytest.approx(before, abs=0.02)
    assert got[first - 1].jump_cycles == got[first].cycles - got[first - 1].cycles - math.floor(
        got[first].speed_cycles + got[first - 1].phase
    )
    assert not any(has(got, DISAGREES))
    assert machine.chain.reference.recovered == 1


def test_a_drive_that_restarts_counts_from_elsewhere() -> None:
    machine = standing()
    machine.ramp(0.0, 20.0)
    machine.on_bus = lambda value: []
    machine.run(LONGEST_GAP + 5, 20.0)
    machine.on_bus = lambda value: [value]
    machine.origin += 987654
    got = machine.run(100, 20.0)
    assert not any(has(got, DISAGREES))
    machine.other += 60.0  # it is compared again, by twice the tolerance until it stands still
    assert has(machine.run(6, 20.0), DISAGREES)[-1]


def test_without_a_pause_another_origin_is_a_disagreement() -> None:
    machine = standing()
    machine.origin += 987654
    got = machine.run(20)
    assert has(got, DISAGREES) == [False] * 3 + [True] * 17
    assert all(feedback.valid for feedback in got)
    machine.chain.use_second(machine.sensor)  # a write to 2014h
    assert not any(has(machine.run(20), DISAGREES))


def test_it_ends_well_within_the_tolerance() -> None:
    machine = standing()
    machine.other += 0.0104 * N
    assert has(machine.run(5), DISAGREES)[-1]
    machine.other -= 0.0014 * N
    assert has(machine.run(5), DISAGREES)[-1]
    machine.other -= 0.002 * N
    assert not has(machine.run(5), DISAGREES)[-1]


def test_values_that_are_late_for_good() -> None:
    """After a SYNC without a value each may be that of the one before; at standstill that does not matter."""
    machine = standing()
    machine.ramp(0.0, 60.0)
    queue: list[int] = []

    def late(value: int) -> list[int]:
        queue.append(value)
        return [queue.pop(0)] if len(queue) > 1 else []

    machine.on_bus = late
    assert not any(has(machine.run(200, 60.0), DISAGREES))
    machine.ramp(60.0, 0.0)
    machine.run(20)
    machine.other += 0.011 * N
    assert has(machine.run(6), DISAGREES)[-1]


@each("slip", [0.0, 40.0])
def test_after_a_pause_the_offset_is_that_of_before(slip: float) -> None:
    machine = standing()
    machine.chain.resume(1000.0)
    machine.other += slip
    got = machine.run(30)
    assert got[-1].valid
    assert has(got, DISAGREES)[-1] == bool(slip)


def test_a_machine_that_turns_after_a_pause_did_not_stand_still() -> None:
    machine = standing()
    machine.chain.resume(1000.0)
    got = machine.run(400, 83.2)
    assert got[-1].status & LOST
    assert not any(has(got, VALID))


def test_it_must_be_a_sensor() -> None:
    chain = SignalChain(ChainConfig())
    with pytest.raises(TypeError, match="SecondSensor"):
        chain.use_second({})  # type: ignore[arg-type]
    chain.hear_second(1, 5)  # without one nothing happens
    chain.use_second(SecondSensor(tolerance_revolutions=0.1))
    chain.step(at(0.0))
    chain.hear_second(-1, 7)
    chain.use_second(None)
    assert chain.second is None
