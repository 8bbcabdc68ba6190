"""The chain at gaps, bad parameters and pauses."""

import math
import random
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, strategies as st
from witness_kit import AMPLITUDE, Machine, at, flags, moving

from canfb import AdaptConfig, ChainConfig, Conditioning, Sample, SecondSensor, SignalChain, Tracker
from canfb.objects import LossCause, StatusBit
from canfb.signal.correction import Correction
from canfb.signal.speeds import STILL_SAMPLES
from folding import each


def test_a_gap_that_the_caller_counted_is_stepped_over_and_flagged() -> None:
    machine = moving(20.4)
    position = machine.position + 3 * 20.4
    got = machine.chain.step(at(position, elapsed=3.0))
    assert got.cycles == math.floor(position)
    assert StatusBit.MISSED in flags(got)
    assert got.valid
    too_long = machine.chain.step(at(position, elapsed=9.0))
    assert StatusBit.LOST in flags(too_long)


@each("kind", [np.float16, np.float32, np.int16])
@each("ticks", [None, np.uint32])
def test_numbers_of_numpy_give_the_bits_of_plain_ones(kind: Any, ticks: Any) -> None:
    ours, theirs, trackers = SignalChain(ChainConfig()), SignalChain(ChainConfig()), (Tracker(), Tracker())
    untyped: Any = np
    for chain in (ours, theirs):
        chain.use_second(SecondSensor(tolerance_revolutions=0.1))
    for n in range(40):
        sine, cosine = map(kind, at(0.003 * n * n)[:2])
        time = ticks and ticks(10_000 * n)
        got = theirs.step(Sample(sine, cosine, kind(1), False, kind(0), kind(1500), time_100ns=time))
        plain = (float(sine), float(cosine), 1.0, False, 0.0, 1500.0)
        wanted = ours.step(Sample(*plain, time_100ns=time and int(time)))
        assert (got, *map(type, got)) == (wanted, *map(type, wanted))
        ours.hear_second(1, n)
        theirs.hear_second(1, untyped.int32(n))
        phase = kind(wanted.phase % 0.999)
        assert repr(trackers[0].update(phase)) == repr(trackers[1].update(float(phase)))
    assert type(ChainConfig(residual_limit=untyped.float16(0.25)).residual_limit) is float
    theirs.restart(untyped.int64(7))
    assert type(theirs.step(at(0.0)).cycles) is int
    with pytest.raises(TypeError, match="integer"):
        theirs.restart(0.5)  # type: ignore[arg-type]


@each("speed", [0.0, 20.4])
@each("elapsed", [0.0, -1.0, math.nan, math.inf])
@each("ticks", [None, 12_345])
def test_an_interval_of_no_length_is_not_counted(speed: float, elapsed: float, ticks: int | None) -> None:
    machine = moving(speed)
    assert not machine.chain.step(at(machine.position, elapsed=elapsed, time_100ns=ticks)).valid
    assert machine.chain.lost is (speed > 0.0)


def test_the_amplitude_is_checked_after_conditioning() -> None:
    chain = SignalChain(ChainConfig(amplitude_low_counts=1200))
    offset = Sample(AMPLITUDE * 0.4, -AMPLITUDE + AMPLITUDE * 0.4)
    assert StatusBit.AMPLITUDE in flags(chain.step(offset))
    offsets = Conditioning(sine_offset_counts=AMPLITUDE * 0.4, cosine_offset_counts=AMPLITUDE * 0.4)
    chain.activate(Correction(None, offsets))
    assert chain.step(offset).valid


@each("kind, field, value", [
    *((ChainConfig, "cycles_per_revolution", value) for value in (0, 1048577, 2.5)),
    *((ChainConfig, "adc_bits", value) for value in (3, 17, True)),
    *((ChainConfig, "coast_samples", value) for value in (-1, 256)),
    *((ChainConfig, "amplitude_low_counts", value) for value in (-1, 5000)),
    (ChainConfig, "residual_limit", 0.6), (ChainConfig, "conditioning", 3),
    (Conditioning, "sine_gain", 0.0), (Conditioning, "cosine_gain", math.nan),
    *((Conditioning, "harmonic_3_forward_real", value) for value in (0.6, -0.6)),
    (Conditioning, "phase_error_rad", 1.1),
    *((Conditioning, name, value) for name in ("cosine_delay_s", "delay_s")
      for value in (0.011, -0.011, math.nan, math.inf, "1e-6")),
    (AdaptConfig, "offset", -0.1), (AdaptConfig, "offset", "a"), (AdaptConfig, "gain", 0.6),
    (AdaptConfig, "phase_rad", math.nan), (AdaptConfig, "rate_per_hour", 10.1),
    *((SecondSensor, "increments", value) for value in (0, 2**32, 1.0)),
    *((SecondSensor, "tolerance_revolutions", value) for value in (-0.1, 0.26, math.nan)),
    (SecondSensor, "revolutions", 0), (SecondSensor, "reversed", 1), (SecondSensor, "invalidates", "no"),
    *((Tracker, "residual_limit", value) for value in (0.0, -1.0, 0.51, math.nan)),
])  # fmt: skip
def test_a_bad_parameter_raises_at_once_and_is_named(kind: type, field: str, value: Any) -> None:
    with pytest.raises(ValueError, match=field):
        kind(**{field: value})


# Pauses.


def stopped(**config: Any) -> Machine:
    """It has turned, braked, and stands."""
    machine = moving(3.0, **config)
    machine.reach(0.0)
    assert all(got.valid for got in machine.run(20))
    return machine


def stand(machine: Machine) -> None:
    """As long as it takes until a position that is lost can start at standstill."""
    machine.speed = 0.0
    machine.run(STILL_SAMPLES)


@given(st.floats(-9.0, 9.0), st.sampled_from([(0.0, 0.0), (0.1, 0.0), (0.0, 0.002)]), st.integers(0, 2))
def test_lost_if_its_phase_moved_in_a_pause(moved: float, how: tuple[float, float], missed: int) -> None:
    machine, away = stopped(max_acceleration_cycles=how[0]), abs(math.remainder(moved, 1.0))
    assume(not (0.005 if how[1] else 0.031) < away < (0.25 if how[1] else 0.065))  # raw: pi/4 to pi/2 of it
    machine.speed = how[1]  # one that creeps has stopped, or gone on
    machine.run(20)
    for _ in range(missed):  # behind them it is valid at once, and the samples after it still decide
        machine.miss()
    assert (machine.step().valid, machine.chain.stages.estimator.in_doubt) == (True, missed > 0)
    machine.chain.resume(40.0 if how[1] else 100_000.0)
    machine.position, machine.speed = machine.position + moved + 40.0 * how[1], 0.0  # somebody turns it
    counts = {(got.valid, got.cycles - math.floor(machine.position)) for got in machine.run(20)}
    assert counts == {(True, -round(moved))} if away < 0.05 else not any(valid for valid, _ in counts)
    assert away < 0.05 or machine.chain.stages.estimator.loss_cause is LossCause.PAUSE


def test_a_position_lost_at_standstill_starts_again_after_a_pause() -> None:
    machine = stopped()
    for _ in range(5):
        machine.miss()
    assert machine.chain.lost
    stand(machine)
    machine.chain.resume()
    assert not machine.chain.lost, "it stood before, and since"
    assert machine.chain.step(at(0.5)).cycles == 0


def test_a_position_that_is_not_valid_at_a_pause_is_lost() -> None:
    """It began again at cycle count 0, and no status word said that the old count is gone."""
    machine = stopped()
    assert not machine.miss().valid
    machine.chain.resume(100.0)
    assert flags(machine.step()) & (StatusBit.LOST | StatusBit.VALID) == StatusBit.LOST
    stand(machine)
    machine.chain.reset()
    machine.chain.resume(100.0)
    assert machine.step().cycles == 0


DECLARED, NO_DOUBT = {"max_acceleration_cycles": 0.1}, {"doubt_acceleration_cycles": 0.0}
# Cycles per interval at the pause, resets in it, its intervals, what is declared, and whether it is lost.
PAUSES: list[tuple[float, int, float, dict[str, float], bool]] = [
    (0.0, 0, 1e6, {}, False), (0.0, 1, 1e6, DECLARED, False),
    (0.0005, 0, 1e6, {}, False), (0.0005, 1, 1e6, DECLARED, False),  # noise and a servo at rest show as much
    (0.002, 0, 50.0, {}, False), (0.002, 0, 1e6, {}, True), (-0.002, 0, 1e6, {}, True),
    (0.1, 0, 1.0, {}, False), (0.1, 0, 2.0, {}, True),
    (0.1, 1, 3.0, DECLARED, False), (0.1, 1, 5.0, DECLARED, True),
    # eq. 9 cannot start from standstill at more than half a cycle per interval
    (0.49, 0, 0.0, {}, False), (0.4, 1, 0.0, DECLARED, False),
    (0.51, 0, 0.0, {}, True), (-3.0, 0, 0.0, {}, True),
    *((speed, resets, pause, declared, True) for speed in (0.6, 1.0, 12.7, 125.0)
      for resets, pause in ((1, 3.0), (1, math.inf), (2, 1e6)) for declared in ({}, NO_DOUBT)),
]  # fmt: skip


@pytest.mark.parametrize(
    ("speed", "resets", "intervals", "declared", "lost", "lost_before"),
    [(*row, False) for row in PAUSES] + [(*row, True) for row in PAUSES if row[-1]],
)
def test_a_machine_that_turns_at_a_pause_loses_its_position(
    speed: float, resets: int, intervals: float, declared: dict[str, float], lost: bool, lost_before: bool
) -> None:
    """For good, until a reset at standstill. Reset, it must have stayed below 0.5 by what is declared."""
    machine = moving(speed, 60, **declared)
    chain, machine.speed = machine.chain, 0.0
    if lost_before:
        chain.lose()
    for _ in range(resets):
        chain.reset()
    for _ in range(3 if lost_before else 1):
        chain.resume(intervals)
        assert chain.lost is lost
        got = machine.step()
        assert got.valid is not lost
    if not lost:
        assert got.cycles == (0 if resets else math.floor(machine.position))
        return
    assert chain.loss_cause is LossCause.PAUSE
    for machine.speed in (speed, round(speed)):  # of whole cycles per interval the phases are equal, too
        samples = 2 * STILL_SAMPLES if abs(machine.speed) >= 0.1 else 0
        assert all(got.status & StatusBit.LOST for got in machine.run(samples))
        machine.speed = 0.0
        chain.resume(intervals)
        assert machine.step().status & StatusBit.LOST
    stand(machine)
    chain.reset()
    chain.resume(intervals)
    assert [(got.valid, got.cycles) for got in machine.run(2)] == [(True, 0)] * 2


@pytest.mark.parametrize("size", [0.03, 0.1])
def test_a_machine_that_swings_at_a_pause_did_not_stand_still(size: float) -> None:
    """Over the last 16 samples it has not moved on average."""
    chain = SignalChain(ChainConfig(max_acceleration_cycles=0.02))
    for k in range(-30, 46):
        got = chain.step(at(0.3 + size * math.sin(2.0 * math.pi * max(k, 0) / 15.0)))
        assert got.valid
    chain.resume(100.0)
    assert chain.lost


def test_uneven_times_do_not_bring_back_what_was_lost_before_the_pause() -> None:
    machine = moving(12.7, max_acceleration_cycles=0.25)
    for _ in range(40):
        machine.miss()
    machine.chain.resume(1.0)
    draw = random.Random(3)
    for _ in range(200):
        elapsed = 1.0 + draw.gauss(0.0, 0.08)
        machine.position += 12.7 * (elapsed - 1.0)
        assert not machine.step(elapsed=elapsed).valid
    assert machine.chain.lost


def test_standstill_is_no_slow_motion() -> None:
    """0.001 cycle per interval goes by 0.02 within 256 samples, noise of that size does not."""
    for speed, noise, lost in ((0.001, 0.0, True), (0.0, 0.009, False)):
        machine = moving(3.0, 60)
        machine.chain.lose()
        for n in range(2 * STILL_SAMPLES):
            machine.position += speed
            machine.chain.step(at(machine.position + noise * (-1) ** n))
        machine.chain.reset()
        machine.chain.resume(1.0)
        assert machine.chain.lost is lost


@each("speed, intervals, lost", [(0.3, 0.4, False), (0.3, 1.0, True), (0.0, 1e9, False)])
def test_intervals_that_nobody_counted_lose_a_machine_that_moves(
    speed: float, intervals: float, lost: bool
) -> None:
    machine = Machine(speed)
    assert machine.chain.uncertain(intervals) is None  # nothing to lose yet
    machine.run(30)
    got = machine.chain.uncertain(intervals)
    assert machine.chain.lost is lost
    assert (got is not None) is lost
    if got is not None:
        assert got.status & StatusBit.LOST
        assert not got.valid
        assert machine.chain.uncertain(intervals) is None  # lost once


@each("contradicts", [False, True])
def test_in_doubt_only_missing_samples_leave_a_machine_at_rest(contradicts: bool) -> None:
    """By a sample that contradicts it may have begun to move: no interval may pass uncounted then."""
    machine = Machine(0.0)
    machine.run(30)
    machine.chain.step(at(machine.position + 0.4)) if contradicts else machine.chain.miss()
    machine.chain.uncertain(1.0)
    assert machine.chain.lost is contradicts


@pytest.mark.parametrize("declared", [0.0, 0.2])
@pytest.mark.parametrize(("acceleration", "speed"), [(0.12, 0.36), (-0.15, -0.3), (0.2, 0.4)])
def test_a_short_pause_while_a_slow_machine_accelerates(
    acceleration: float, speed: float, declared: float
) -> None:
    """It is half a cycle away, or as fast, at the next sample: eq. 9 would start a cycle off."""
    machine = Machine(max_acceleration_cycles=declared)
    machine.run(20)
    while abs(machine.speed) < abs(speed) - 1e-9:
        machine.speed += acceleration
        assert machine.step().valid
    machine.chain.resume(1.0)
    machine.speed += acceleration
    machine.position += machine.speed
    for _ in range(20):
        machine.speed += acceleration
        got = machine.step()
        assert not got.valid or abs(machine.error(got)) < 0.1


@pytest.mark.parametrize("valid_before", [True, False])
@pytest.mark.parametrize("coarse", [True, False])
def test_a_pause_in_motion_ends_the_position_for_good(coarse: bool, valid_before: bool) -> None:
    """Coarse track and second position find its speed again, but not the revolutions meanwhile."""
    machine = Machine(position=0.3, coarse=0.0 if coarse else None)
    if not coarse:
        machine.chain.use_second(SecondSensor(increments=1 << 16, tolerance_revolutions=0.01))

    def run(samples: int) -> list[bool]:
        valid = []
        for _ in range(samples):
            valid.append(machine.step().valid)
            if not coarse:
                machine.chain.hear_second(1, math.floor(machine.position * (1 << 16) / machine.n))
        return valid

    while machine.speed < 3.0:
        run(1)
        machine.speed += 0.1
    assert run(20)[-1]
    for _ in range(2):
        if not valid_before:  # in doubt it is lost at once
            machine.chain.lose()
            assert not any(run(400))
        machine.chain.resume(20.0)
        machine.position += 20.0 * machine.speed
        assert not any(run(1200))
