"""A second position: its increments against exact fractions, and what it finds and costs in the chain."""

import math
from collections.abc import Callable
from fractions import Fraction

import pytest
from hypothesis import given, strategies as st
from witness_kit import Machine, at, has

from canfb import ChainConfig, Feedback, Sample, SignalChain, StatusBit
from canfb.signal.second_position import SecondSensor, step_increments
from canfb.signal.witness.second import LONGEST_GAP
from canfb.signal.witness.witness import Pair, SecondScale, counts_within
from folding import each

U32 = st.integers(1, 2**32 - 1)
FAR = st.integers(-(2**62), 2**62)
PHASES = st.floats(0.0, 1.0, exclude_max=True)


@given(U32, U32, st.booleans(), st.integers(1, 1048576), FAR, FAR, PHASES, PHASES)
def test_a_difference_is_the_nearest_float(
    increments: int, revolutions: int, reverse: bool, n: int, cycles: int, other: int, p: float, q: float
) -> None:
    scale = SecondScale(SecondSensor(increments=increments, revolutions=revolutions, reversed=reverse), n)
    per_increment = Fraction(n * revolutions, increments) * (-1 if reverse else 1)
    since, now = Pair(-7, p, 3, 0.0), Pair(cycles, q, other, 9.0)
    whole = float((other - 3) * per_increment - (cycles + 7))
    assert scale.difference_cycles(since, now) == whole - (q - p)
    assert scale.moved_cycles(since, now) == float((other - 3) * per_increment)
    assert scale.step_cycles == float(abs(per_increment))


@given(st.integers(-(2**31), 2**31 - 1), st.integers(-(2**31), 2**31 - 1))
def test_a_step_over_the_wrap_is_the_shorter_way(before: int, step: int) -> None:
    assert step_increments(before, wrapped(before + step)) == step


@given(st.fractions(-50, 50), st.fractions(0, 3))
def test_the_counts_within_the_limit_are_these(difference: Fraction, limit: Fraction) -> None:
    d, within = float(difference), float(limit)
    exact, most = Fraction(d), Fraction(within)
    fitting = [count for count in range(-60, 60) if abs(exact - count) <= most]
    near = any(abs(abs(exact - count) - most) < Fraction(1, 10**9) for count in range(-60, 60))
    if not near:  # a float may round the limit itself
        assert list(counts_within(d, within)) == fitting


DISAGREES, VALID, LOST = StatusBit.SECOND_POSITION, StatusBit.VALID, StatusBit.LOST
N = 2500
INCREMENTS = 1 << 20
EXACT = 0.3 / N  # revolutions: less than half a cycle
FINE = 1 << 22  # increments: 0.0006 cycle each


def wrapped(increments: int) -> int:
    """As INTEGER32."""
    return (increments + (1 << 31)) % (1 << 32) - (1 << 31)


class TwoSensors(Machine):
    """The other sensor is at ``other``, cycles; it follows the encoder."""

    def __init__(self, tolerance: float = 0.01, increments: int = INCREMENTS, speed: float = 0.0) -> None:
        super().__init__(speed, 0.37)
        self.sensor = SecondSensor(increments=increments, tolerance_revolutions=tolerance)
        self.chain.use_second(self.sensor)
        self.other, self.origin = 0.37, 12345
        self.on_bus: Callable[[int], list[int]] = lambda value: [value]

    def take(self, sample: Sample) -> Feedback:
        """Behind the sample comes what the bus makes of the other value."""
        feedback = super().take(sample)
        self.other += self.speed
        values = self.on_bus(self.value())
        self.chain.hear_second(len(values), values[-1] if values else 0)
        return feedback

    def value(self) -> int:
        return wrapped(self.origin + math.floor(self.other * self.sensor.increments / N))


def standing(tolerance: float = 0.01, increments: int = INCREMENTS) -> TwoSensors:
    """A machine at rest whose offset is learned."""
    machine = TwoSensors(tolerance, increments)
    assert machine.run(30)[-1].valid
    return machine


@each("speed", [0.0, 0.2, -83.2, 83.5, 0.5, 41.99, -7.25])
@each("tolerance", [EXACT, 0.001])
@each("values, quiet", [(1, 0), (1, 50), (0, 50)])
def test_a_start_on_a_turning_machine(speed: float, tolerance: float, values: int, quiet: int) -> None:
    """It stays open where the values end, or repeat themselves, once they have shown that it turns."""
    machine = TwoSensors(tolerance, speed=speed)
    machine.run(2)
    frozen = [machine.value()] * values
    machine.on_bus = lambda value: frozen
    assert abs(speed) <= 0.5 or not any(has(machine.run(quiet), VALID))
    machine.on_bus = lambda value: [value]
    got = machine.run(250)
    first = has(got, VALID).index(True)
    assert all(feedback.valid for feedback in got[first:])
    assert got[-1].speed_cycles == pytest.approx(speed, abs=0.05)
    counted = got[-1].cycles - got[first].cycles + got[-1].phase - got[first].phase
    assert counted == pytest.approx(speed * (249 - first), abs=0.05)
    at_rest = 3  # three values agree
    assert first <= (at_rest if abs(speed) < 0.1 else 16.0 * (tolerance * N + 2.0))


@each("speed", [0.2, 300.3, -83.2])
def test_a_zero_pulse_has_no_place_until_the_speed_of_a_start_is_known(speed: float) -> None:
    """By another speed pulses would contradict each other, and the position was never valid."""
    machine = TwoSensors(0.005, speed=speed)
    machine.mark = 0.5
    got = machine.run(400)
    first = has(got, VALID).index(True)
    assert all(feedback.valid for feedback in got[first:])
    assert bool(got[-1].status & StatusBit.REFERENCED) == (abs(speed) > 1.0)


@each("mark", range(0, N, 250))
def test_a_speed_that_two_zero_pulses_have_given_is_not_added_once_more(mark: int) -> None:
    machine = TwoSensors(0.001, speed=-298.6)
    machine.mark = float(mark)
    valid = [feedback.speed_cycles for feedback in machine.run(60) if feedback.valid]
    assert valid == pytest.approx([-298.6] * len(valid), abs=0.05)
    assert len(valid) > 30


@each("speed", [0.0, 83.2, -40.7])
@each("dead", [8, 40])
def test_a_lost_count_is_set_right(speed: float, dead: int) -> None:
    """Announced by its jump, and valid with the next sample; the machine changed its speed meanwhile."""
    machine = standing(EXACT, FINE)
    machine.reach(speed)
    before = machine.error(machine.step())
    machine.speed = speed + 3.3
    assert [machine.spoil() for _ in range(dead)][-1].status & LOST
    machine.speed = speed + 1.7
    got = machine.run(90)
    first = has(got, VALID).index(True)
    assert machine.error(got[-1]) == pytest.approx(before, abs=0.02)
    assert got[first - 1].jump_cycles == got[first].cycles - got[first - 1].cycles - math.floor(
        got[first].speed_cycles + got[first - 1].phase
    )
    assert not any(has(got, DISAGREES))
    assert machine.chain.reference.recovered == 1


def test_a_drive_that_restarts_counts_from_elsewhere() -> None:
    machine = standing()
    machine.reach(20.0)
    machine.on_bus = lambda value: []
    machine.run(LONGEST_GAP + 5)
    machine.on_bus = lambda value: [value]
    machine.origin += 987654
    assert not any(has(machine.run(100), DISAGREES))
    machine.other += 60.0  # it is compared again, by twice the tolerance until it stands still
    assert has(machine.run(6), DISAGREES)[-1]


def test_it_ends_well_within_the_tolerance() -> None:
    machine = standing()
    for revolutions, disagrees in ((0.0104, True), (-0.0014, True), (-0.002, False)):
        machine.other += revolutions * N
        assert has(machine.run(5), DISAGREES)[-1] is disagrees


def late_from_now_on() -> Callable[[int], list[int]]:
    """Each value comes with the next sample: there is none with the first."""
    queue: list[int] = []

    def late(value: int) -> list[int]:
        queue.append(value)
        return [queue.pop(0)] if len(queue) > 1 else []

    return late


@each("speed", [2.1, -0.9, 41.99, 2.5, 1.3, 0.4])
@each("tolerance, apart", [(EXACT, 0.0), (0.6 / N, 0.48)])
@each(
    "valid, samples, lost, kind",
    [(1, 0, 1, "late"), (0, 120, 1, "late"), (1, 0, 1, "twice"), (1, 100, 0, "frozen")],
)
def test_a_value_that_is_not_certain_sets_no_count_that_it_would_not_set_in_time(
    speed: float, tolerance: float, apart: float, valid: int, samples: int, lost: int, kind: str
) -> None:
    """Late behind values at rest, which fit either way; frozen, where the phase is as it was by chance."""
    machine = standing(tolerance, FINE)
    machine.other += apart
    machine.reach(speed * valid)
    before, frozen = machine.error(machine.step()), [machine.value()]
    machine.on_bus = late = (lambda value: frozen) if kind == "frozen" else late_from_now_on()
    machine.run(samples)
    machine.speed = speed * lost
    assert [machine.spoil() for _ in range(8)][-1].status & LOST
    machine.on_bus = lambda value: 2 * late(value)
    machine.run(kind == "twice")
    machine.on_bus = late
    off = [machine.error(one) for _ in range(90) if (one := machine.step()).valid]
    assert off == pytest.approx([before] * len(off), abs=0.02)


def test_values_that_are_late_for_good() -> None:
    """After a SYNC without a value each may be that of the one before; at standstill that does not matter."""
    machine = standing()
    machine.reach(60.0)
    machine.on_bus = late_from_now_on()
    assert not any(has(machine.run(200), DISAGREES))
    machine.reach(0.0)
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


@each("turned", [0.0, 5.3])
def test_a_machine_that_turns_in_or_after_a_pause_did_not_stand_still(turned: float) -> None:
    machine = standing(EXACT, FINE)
    machine.chain.resume(1000.0)
    machine.position, machine.other = machine.position + turned, machine.other + turned % 3.0  # restarted
    machine.speed = 0.0 if turned else 83.2
    got = machine.run(400)
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
