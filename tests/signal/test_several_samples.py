"""Several samples in one interval of SYNC: the same bits as one after the other."""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from canfb import ChainConfig, SignalChain
from canfb.signal.sample import LEAST_APART, Feedback, Sample, in_order
from canfb.signal.supervision import LOST, MISSED, REFERENCED
from canfb.signal.witness.zero_pulse import Pulse, PulseVerdict
from folding import each
from ideal_tracks import counts_at
from servo_kit import IDEAL_TABLE, RATE_HZ, cycles_of, s_curve

AMPLITUDE = 1800.0
N = 2500


def chain(per_sync: int, acceleration: float | None = None) -> SignalChain:
    config = ChainConfig(cycles_per_revolution=N)
    made = SignalChain(config, IDEAL_TABLE)
    made.set_limits(replace(config.chain_limits, samples_per_sync=per_sync, acceleration=acceleration))
    return made


def group(positions: list[float], **parts: float | int | None) -> Sample:
    """One sample of these positions, oldest first."""
    *earlier, newest = (counts_at(one, AMPLITUDE) for one in positions)
    return Sample(*newest, earlier=tuple(reversed(earlier)), **parts)  # type: ignore[arg-type]


def all_of(made: SignalChain, sample: Sample) -> list[Feedback]:
    newest = made.step(sample)
    return [*made.between, newest]


steps = st.floats(-0.6, 0.6)
spoilt = st.sampled_from([None, None, None, None, None, (0.0, 0.0), (2047.0, 0.0), (900.0, -1500.0)])


@given(per_sync=st.integers(2, 8), data=st.data())
def test_groups_give_the_same_bits_as_samples_one_by_one(per_sync: int, data: st.DataObject) -> None:
    accelerations = data.draw(st.lists(steps, min_size=4 * per_sync, max_size=16 * per_sync))
    del accelerations[len(accelerations) // per_sync * per_sync :]
    position = speed = 0.0
    pairs: list[tuple[float, float]] = []
    for acceleration in accelerations:
        speed += acceleration
        position += speed
        pairs.append(data.draw(spoilt) or counts_at(position, AMPLITUDE))
    flat, grouped = chain(1), chain(per_sync)
    bad = grouped.stages.estimator.declared.bad_samples
    flat.set_limits(replace(ChainConfig().chain_limits, coast_samples=3 * per_sync, bad=bad))
    for start in range(0, len(pairs), per_sync):
        *earlier, newest = pairs[start : start + per_sync]
        expected = [flat.step(Sample(*pair)) for pair in pairs[start : start + per_sync]]
        got = all_of(grouped, Sample(*newest, earlier=tuple(reversed(earlier))))
        assert repr(got) == repr(expected)


@given(
    per_sync=st.integers(1, 8),
    pairs=st.integers(0, 3),
    passed=st.floats(0.01, 20.0),
    place=st.none() | st.floats(0.0, 1.0),
)
def test_all_are_in_order_and_fill_the_interval(
    per_sync: int, pairs: int, passed: float, place: float | None
) -> None:
    sample = Sample(0.0, 1.0, zero_pulse=place, earlier=tuple((float(j), 0.0) for j in range(1, pairs + 1)))
    got = in_order(sample, passed, per_sync)
    assert 1 <= len(got) <= per_sync
    assert [one.sine for one in got] == [float(j) for j in range(len(got) - 1, -1, -1)]
    assert sum(one.elapsed for one in got) == pytest.approx(passed)
    assert all(one.elapsed == 1.0 for one in got[1:-1])
    assert len(got) == 1 or min(one.elapsed for one in got) >= min(LEAST_APART, 1.0) - 1e-9
    pulses = [
        (sum(before.elapsed for before in got[:number]) + one.zero_pulse * one.elapsed) / passed
        for number, one in enumerate(got)
        if one.zero_pulse is not None
    ]
    assert pulses == pytest.approx([] if place is None else [place], abs=1e-9)


def move(per_sync: int, syncs: int = 150) -> Iterator[list[float]]:
    """0 to 3000 rpm in 50 ms with 7850 rad/s^2 and 785 000 rad/s^3, at 1 kHz."""
    times_s = np.arange(-20 * per_sync, syncs * per_sync) / per_sync / RATE_HZ
    positions = cycles_of(1.0) * s_curve(100.0 * math.pi, 7850.0, 785e3, times_s)
    yield from positions.reshape(-1, per_sync).tolist()


@pytest.mark.parametrize("per_sync", [1, 2])
def test_with_too_few_samples_it_is_lost_and_says_so(per_sync: int) -> None:
    made = chain(per_sync)
    for positions in move(per_sync):
        newest = all_of(made, group(positions))[-1]
        right = abs(newest.cycles + newest.phase - positions[-1]) < 0.5
        assert right or not newest.valid
    assert newest.status & LOST


@given(per_sync=st.integers(2, 8), speed=st.floats(-300.0, 300.0), timed=st.booleans())
def test_a_missed_interval_at_even_speed_keeps_the_count(per_sync: int, speed: float, timed: bool) -> None:
    """``timed``: sample times alone tell of it, while they do not yet say where in it the samples lie."""
    made = chain(per_sync, acceleration=0.01)  # up to four samples are missing
    made.restart(0, speed / per_sync)
    made.measures_intervals = not timed
    for sync in range(30):
        if sync == 12:
            assert timed or made.miss().status & MISSED
            assert made.between == () or timed
            continue
        times: Any = (sync * 1e-3 + 1e-4, sync * 1e-3) if timed else ()
        positions = [(sync * per_sync + k) * speed / per_sync for k in range(per_sync)]
        newest = made.step(group(positions, time_100ns=sync * 10_000 if timed else None), *times)
    assert newest.valid or timed  # a group that nobody can place is as good as another missed one
    off = newest.cycles + newest.phase - (29 * per_sync + per_sync - 1) * speed / per_sync
    assert abs(off) < 0.01 or not newest.valid


def turning(sync: int, per_sync: int, speed: float, *, pulse_from: float = 0.0) -> Sample:
    """At a constant speed in cycles per SYNC, with coarse track and zero pulse."""
    end = sync * speed
    positions = [end - speed * k / per_sync for k in range(per_sync - 1, -1, -1)]
    angle = 2.0 * math.pi * (end / N + 0.3)
    mark = math.floor(end / N) * N + pulse_from
    place = (mark - (end - speed)) / speed
    return group(
        positions,
        coarse_sine=1500.0 * math.sin(angle),
        coarse_cosine=1500.0 * math.cos(angle),
        zero_pulse=place if 0.0 < place <= 1.0 else None,
    )


@each("per_sync", [1, 2, 3, 4])
def test_coarse_track_and_zero_pulse_find_the_speed_of_a_turning_machine(per_sync: int) -> None:
    made, speed = chain(per_sync), 137.3
    for sync in range(1200):
        newest = made.step(turning(sync, per_sync, speed, pulse_from=40.25))
    assert newest.valid
    assert newest.status & REFERENCED
    assert newest.speed_cycles * per_sync == pytest.approx(speed, abs=0.1)
    before = newest.cycles + newest.phase
    newest = made.step(turning(1200, per_sync, speed, pulse_from=40.25))
    assert newest.cycles + newest.phase - before == pytest.approx(speed, abs=0.03)


def test_a_zero_pulse_under_acceleration_is_where_it_was() -> None:
    """Straight from SYNC to SYNC it would be a/8 beside it, half a cycle here; between samples a/128."""
    acceleration, made, seen = 4.0, chain(4), []
    weigh = made.reference.zero.weigh

    def spy(edge: Pulse) -> PulseVerdict:
        seen.append(edge.cycles + edge.phase)
        return weigh(edge)

    made.reference.zero.weigh = spy  # type: ignore[method-assign, assignment]
    for sync in range(-3, 30):
        positions = [acceleration / 2.0 * max(sync - k / 4.0, 0.0) ** 2 for k in range(3, -1, -1)]
        made.step(group(positions, zero_pulse=0.375 if sync == 20 else None))
    expected = acceleration / 2.0 * 19.375**2
    assert seen == [pytest.approx(expected, abs=0.01)]


@each("per_sync", [1, 2, 3, 4])
@each("place", [0.1, 0.5, 0.75])
def test_a_pulse_behind_a_missing_sample_contradicts_no_other(per_sync: int, place: float) -> None:
    """Where nobody heard a SYNC, it is given as a part of an interval that is twice as long."""
    made, speed, missing = chain(per_sync, 0.01), 137.3, 20
    made.restart(0, speed / per_sync)
    pulse_from = (missing - 1 + 2.0 * place) * speed - N
    for sync in range(100):
        if sync == missing:
            made.miss()
            continue
        sample = turning(sync, per_sync, speed, pulse_from=pulse_from)
        pulse = place if sync == missing + 1 else sample.zero_pulse if sync > missing else None
        newest = made.step(sample._replace(coarse_sine=None, coarse_cosine=None, zero_pulse=pulse))
        assert newest.valid or sync == missing + 1
    assert newest.status & REFERENCED
