"""The jitter of a SYNC producer: as large as it is said to be, and no larger."""

from __future__ import annotations

import math
import statistics

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.simulation.sync_producer import Drive, SyncDeviation, SyncProducer, SyncTiming

PERIOD_S = 1e-3
COUNT = 4000


def deviations_us(timing: SyncTiming, seed: int = 1, period_s: float = PERIOD_S) -> list[float]:
    deviation = SyncDeviation(timing, period_s, seed)
    return [1e6 * deviation.next_s() for _ in range(COUNT)]


def test_without_a_word_a_sync_is_on_time() -> None:
    assert set(deviations_us(SyncTiming())) == {0.0}
    assert SyncDeviation(SyncTiming(), PERIOD_S).period_s == PERIOD_S


@pytest.mark.parametrize("jitter_us", [1.0, 100.0])
def test_uniform_jitter_fills_its_range_and_keeps_to_it(jitter_us: float) -> None:
    off = deviations_us(SyncTiming(sync_jitter_us=jitter_us))
    assert -jitter_us <= min(off) < -0.99 * jitter_us
    assert 0.99 * jitter_us < max(off) <= jitter_us
    assert statistics.pstdev(off) == pytest.approx(jitter_us / math.sqrt(3), rel=0.05)


def test_normal_jitter_has_its_rms_and_ends_at_four_times_that() -> None:
    off = deviations_us(SyncTiming(sync_jitter_rms_us=50.0))
    assert statistics.pstdev(off) == pytest.approx(50.0, rel=0.05)
    assert 130 < max(map(abs, off)) <= 200.0


@pytest.mark.parametrize(("load", "bit_rate"), [(0.3, 1_000_000), (0.7, 250_000)])
def test_a_blocked_sync_waits_for_a_frame_at_most(load: float, bit_rate: int) -> None:
    off = deviations_us(SyncTiming(bus_load=load, bus_bit_rate=bit_rate))
    longest = min(135e6 / bit_rate, 450.0)  # and never more than 0.45 of the period
    assert min(off) == 0.0
    assert 0.98 * longest < max(off) <= longest + 1e-9
    assert sum(late > 0 for late in off) / COUNT == pytest.approx(load, abs=0.03)


@given(st.floats(0, 1e6), st.floats(0, 1e6), st.floats(1e-5, 1.0), st.integers(0, 1000))
def test_syncs_keep_their_order_whatever_the_jitter(
    jitter: float, rms: float, period_s: float, seed: int
) -> None:
    timing = SyncTiming(sync_jitter_us=jitter, sync_jitter_rms_us=rms, bus_load=1.0)
    deviation = SyncDeviation(timing, period_s, seed)
    times = [n * period_s + deviation.next_s() for n in range(50)]
    assert times == sorted(times)


def producer_times(timing: SyncTiming, seed: int = 1) -> list[float]:
    producer, times = SyncProducer(PERIOD_S, timing, seed), list[float]()
    producer.start(0.0)
    while (at := producer.deadline() or 0.0) < 2.0:
        assert len(producer.tick(at)) == 1
        times.append(at)
    return times


def drive_times(timing: SyncTiming, seed: int = 1) -> list[float]:
    drive, times = Drive(PERIOD_S, 0x1A0, 1000, timing, seed), list[float]()
    drive.start_sync(0.0)
    while (at := drive.deadline() or 0.0) < 2.0:
        assert len(drive.tick(at)) == 1
        times.append(at)
    return times


@pytest.mark.parametrize("times", [producer_times, drive_times])
def test_jitter_does_not_add_up_and_drift_does(times: object) -> None:
    assert callable(times)
    steady = times(SyncTiming(sync_jitter_us=100.0))
    assert abs(len(steady) - 2000) <= 1
    first = round(steady[0] / PERIOD_S)
    assert all(abs(at - (first + n) * PERIOD_S) <= 100.001e-6 for n, at in enumerate(steady))
    fast = times(SyncTiming(sync_drift_ppm=1000.0))
    assert fast[-1] - fast[0] == pytest.approx((len(fast) - 1) * PERIOD_S / 1.001, rel=1e-9)
    assert len(fast) - len(steady) in (1, 2, 3)


def test_the_same_seed_gives_the_same_syncs_again() -> None:
    timing = SyncTiming(sync_jitter_us=100.0)
    assert producer_times(timing, 5) == producer_times(timing, 5)
    assert producer_times(timing, 5) != producer_times(timing, 6)


@pytest.mark.parametrize(
    "wrong",
    [
        {"sync_jitter_us": -1.0},
        {"sync_jitter_rms_us": math.nan},
        {"sync_drift_ppm": 10_001},
        {"bus_load": 1.1},
        {"bus_bit_rate": 9_999},
    ],
)
def test_what_cannot_be_is_refused_by_its_name(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        SyncTiming(**wrong)  # type: ignore[arg-type]
