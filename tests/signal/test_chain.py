from __future__ import annotations

import math
import random
from typing import Any

import pytest

from canfb.objects import LossCause, StatusBit
from canfb.signal.chain import SignalChain
from canfb.signal.chain_config import ChainConfig
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import Correction
from canfb.signal.feedback import Feedback
from canfb.signal.sample import Sample
from canfb.signal.second_position import SecondSensor
from canfb.signal.speeds import STILL_SAMPLES

AMPLITUDE = 1500.0


def sample_at(position: float, **rest: Any) -> Sample:
    angle = 2 * math.pi * position
    return Sample(AMPLITUDE * math.sin(angle), AMPLITUDE * math.cos(angle), **rest)


def ramp_up(chain: SignalChain, speed: float) -> float:
    """Drive the chain from standstill to ``speed`` (cycles per sample), and a bit on; where it is then."""
    position, now = 0.0, 0.0
    chain.step(sample_at(position))
    ramp = math.ceil(speed / 0.25)
    for _ in range(ramp + 20):
        now = min(speed, now + 0.25)
        position += now
        assert chain.step(sample_at(position)).valid
    return position


def flags(feedback: Feedback) -> StatusBit:
    return StatusBit(feedback.status)


def test_a_gap_that_the_caller_counted_is_stepped_over_and_flagged() -> None:
    chain = SignalChain(ChainConfig())
    position = ramp_up(chain, 20.4) + 3 * 20.4
    got = chain.step(sample_at(position, elapsed=3.0))
    assert got.cycles == math.floor(position)
    assert StatusBit.MISSED in flags(got)
    assert got.valid
    too_long = chain.step(sample_at(position, elapsed=9.0))
    assert StatusBit.LOST in flags(too_long)


def test_the_amplitude_is_checked_after_conditioning() -> None:
    chain = SignalChain(ChainConfig(amplitude_low_counts=1200))
    offset = Sample(AMPLITUDE * 0.4, -AMPLITUDE + AMPLITUDE * 0.4)
    assert StatusBit.AMPLITUDE in flags(chain.step(offset))
    offsets = Conditioning(sine_offset_counts=AMPLITUDE * 0.4, cosine_offset_counts=AMPLITUDE * 0.4)
    chain.activate(Correction(None, offsets))
    assert chain.step(offset).valid


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("cycles_per_revolution", 0), ("cycles_per_revolution", 1048577), ("cycles_per_revolution", 2.5),
        ("adc_bits", 3), ("adc_bits", 17), ("adc_bits", True), ("residual_limit", 0.6), ("coast_samples", -1),
        ("coast_samples", 256), ("amplitude_low_counts", -1), ("amplitude_low_counts", 5000),
        ("conditioning", 3),
    ],
)  # fmt: skip
def test_a_bad_parameter_raises_at_once_and_is_named(field: str, value: Any) -> None:
    with pytest.raises(ValueError, match=field):
        ChainConfig(**{field: value})


@pytest.mark.parametrize("bad", [{"sine_gain": 0.0}, {"cosine_gain": math.nan}, {"phase_error_rad": 1.1}])
def test_conditioning_refuses_nonsense(bad: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(bad))):
        Conditioning(**bad)


def test_after_a_pause_at_standstill_the_count_goes_on_from_the_nearest_cycle() -> None:
    chain = SignalChain(ChainConfig())
    position = stopped(chain, ramp_up(chain, 3.0), 3.0)
    chain.resume(100_000.0)
    got = chain.step(sample_at(position + 0.3))
    assert (got.valid, got.cycles) == (True, math.floor(position + 0.3))
    stand(chain, position + 0.3)
    for _ in range(5):
        chain.miss()
    assert chain.lost
    stand(chain, position + 0.3)
    chain.resume()
    assert not chain.lost, "it stood before, and since"
    assert chain.step(sample_at(0.5)).cycles == 0


@pytest.mark.parametrize("missed", [1, 2])
def test_a_valid_position_in_doubt_goes_on_after_a_pause(missed: int) -> None:
    """Behind missing samples it is valid at once, and the samples after it still decide."""
    chain = SignalChain(ChainConfig())
    position = stopped(chain, ramp_up(chain, 3.0), 3.0)
    for _ in range(missed):
        chain.miss()
    assert chain.step(sample_at(position)).valid
    assert chain.stages.estimator.in_doubt
    chain.resume(100.0)
    for _ in range(5):
        got = chain.step(sample_at(position + 0.3))
        assert (got.valid, got.cycles) == (True, math.floor(position + 0.3))


def test_a_position_that_is_not_valid_at_a_pause_is_lost() -> None:
    """It began again at cycle count 0, and no status word said that the old count is gone."""
    chain = SignalChain(ChainConfig())
    position = stopped(chain, ramp_up(chain, 3.0), 3.0)
    assert not chain.miss().valid
    chain.resume(100.0)
    assert flags(chain.step(sample_at(position))) & (StatusBit.LOST | StatusBit.VALID) == StatusBit.LOST
    stand(chain, position)
    chain.reset()
    chain.resume(100.0)
    assert chain.step(sample_at(position)).cycles == 0


def stand(chain: SignalChain, position: float) -> None:
    """As long as it takes until a position that is lost can start at standstill."""
    for _ in range(STILL_SAMPLES):
        chain.step(sample_at(position))


def stopped(chain: SignalChain, position: float, speed: float) -> float:
    """The machine brakes from ``speed``, and stands; the position there, cycles."""
    while speed > 0.0:
        speed = max(0.0, speed - 0.125)
        position += speed
        assert chain.step(sample_at(position)).valid
    for _ in range(20):
        assert chain.step(sample_at(position)).valid
    return position


def turning(speed: float, config: ChainConfig | None = None) -> tuple[SignalChain, float]:
    """A valid chain at this speed, and its position."""
    chain, position, now = SignalChain(config or ChainConfig()), 0.0, 0.0
    for _ in range(round(abs(speed) / 0.1) + 60):
        now += max(-0.1, min(0.1, speed - now))
        position += now
        assert chain.step(sample_at(position)).valid
    return chain, position


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
    chain, position = turning(speed, ChainConfig(**declared))  # type: ignore[arg-type]
    if lost_before:
        chain.lose()
    for _ in range(resets):
        chain.reset()
    for _ in range(3 if lost_before else 1):
        chain.resume(intervals)
        assert chain.lost is lost
        got = chain.step(sample_at(position))
        assert got.valid is not lost
    if not lost:
        assert got.cycles == (0 if resets else math.floor(position))
        return
    assert chain.loss_cause is LossCause.PAUSE
    for step in (speed, round(speed)):  # of whole cycles per interval the phases are equal, too
        for _ in range(2 * STILL_SAMPLES if abs(step) >= 0.1 else 0):
            position += step
            assert chain.step(sample_at(position)).status & StatusBit.LOST
        chain.resume(intervals)
        assert chain.step(sample_at(position)).status & StatusBit.LOST
    stand(chain, position)
    chain.reset()
    chain.resume(intervals)
    assert chain.step(sample_at(position)).valid
    assert chain.step(sample_at(position)).cycles == 0


@pytest.mark.parametrize("size", [0.03, 0.1])
def test_a_machine_that_swings_at_a_pause_did_not_stand_still(size: float) -> None:
    """Over the last 16 samples it has not moved on average."""
    chain = SignalChain(ChainConfig(max_acceleration_cycles=0.02))
    for k in range(-30, 46):
        got = chain.step(sample_at(0.3 + size * math.sin(2.0 * math.pi * max(k, 0) / 15.0)))
        assert got.valid
    chain.resume(100.0)
    assert chain.lost


def test_uneven_times_do_not_bring_back_what_was_lost_before_the_pause() -> None:
    chain, position = turning(12.7, ChainConfig(max_acceleration_cycles=0.25))
    for _ in range(40):
        chain.miss()
        position += 12.7
    chain.resume(1.0)
    draw = random.Random(3)
    for _ in range(200):
        elapsed = 1.0 + draw.gauss(0.0, 0.08)
        position += 12.7 * elapsed
        assert not chain.step(sample_at(position)._replace(elapsed=elapsed)).valid
    assert chain.lost


def test_standstill_is_no_slow_motion() -> None:
    """0.001 cycle per interval goes by 0.02 within 256 samples, noise of that size does not."""
    for speed, noise, lost in ((0.001, 0.0, True), (0.0, 0.009, False)):
        chain, position = turning(3.0)
        chain.lose()
        for n in range(2 * STILL_SAMPLES):
            position += speed
            chain.step(sample_at(position + noise * (-1) ** n))
        chain.reset()
        chain.resume(1.0)
        assert chain.lost is lost


@pytest.mark.parametrize(
    ("speed", "intervals", "lost"), [(0.3, 0.4, False), (0.3, 1.0, True), (0.0, 1e9, False)]
)
def test_intervals_that_nobody_counted_lose_a_machine_that_moves(
    speed: float, intervals: float, lost: bool
) -> None:
    chain = SignalChain(ChainConfig())
    assert chain.uncertain(intervals) is None  # nothing to lose yet
    for k in range(30):
        chain.step(sample_at(speed * k))
    got = chain.uncertain(intervals)
    assert chain.lost is lost
    assert (got is not None) is lost
    if got is not None:
        assert got.status & StatusBit.LOST
        assert not got.valid
        assert chain.uncertain(intervals) is None  # lost once


@pytest.mark.parametrize("declared", [0.0, 0.2])
@pytest.mark.parametrize(("acceleration", "speed"), [(0.12, 0.36), (-0.15, -0.3), (0.2, 0.4)])
def test_a_short_pause_while_a_slow_machine_accelerates(
    acceleration: float, speed: float, declared: float
) -> None:
    """It is half a cycle away, or as fast, at the next sample: eq. 9 would start a cycle off."""
    chain = SignalChain(ChainConfig(max_acceleration_cycles=declared))
    position = now = 0.0
    for _ in range(20):
        chain.step(sample_at(position))
    while abs(now) < abs(speed) - 1e-9:
        now += acceleration
        position += now
        assert chain.step(sample_at(position)).valid
    chain.resume(1.0)
    now += acceleration
    position += now
    for _ in range(20):
        now += acceleration
        position += now
        got = chain.step(sample_at(position))
        assert not got.valid or abs(got.cycles + got.phase - position) < 0.1


@pytest.mark.parametrize("valid_before", [True, False])
@pytest.mark.parametrize("coarse", [True, False])
def test_a_pause_in_motion_ends_the_position_for_good(coarse: bool, valid_before: bool) -> None:
    """Coarse track and second position find its speed again, but not the revolutions meanwhile."""
    chain, n, position, speed = SignalChain(ChainConfig()), 2500, 0.3, 0.0
    other = SecondSensor(increments=1 << 16, tolerance_revolutions=0.01)
    if not coarse:
        chain.use_second(other)

    def step() -> bool:
        nonlocal position
        position += speed
        sample, angle = sample_at(position), 2.0 * math.pi * position / n
        if coarse:
            sample = sample._replace(coarse_sine=1500 * math.sin(angle), coarse_cosine=1500 * math.cos(angle))
        feedback = chain.step(sample)
        if not coarse:
            chain.hear_second(1, math.floor(position * (1 << 16) / n))
        return feedback.valid

    while speed < 3.0:
        step()
        speed += 0.1
    assert [step() for _ in range(20)][-1]
    for _ in range(2):
        if not valid_before:  # in doubt it is lost at once
            chain.lose()
            assert not any(step() for _ in range(400))
        chain.resume(20.0)
        position += 20.0 * speed
        assert not any(step() for _ in range(1200))
