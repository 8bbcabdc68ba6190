"""Sample times of the encoder interface: which are taken, and which are held against the count of SYNCs."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canfb.signal.chain import SignalChain
from canfb.signal.chain_config import ChainConfig
from canfb.signal.feedback import Feedback
from canfb.signal.sample import TICKS, Sample
from canfb.signal.sample_times import (
    CLOSEST,
    CROWDED,
    EARLIER_TIMES,
    OLDEST,
    REPEATED,
    RESTARTED,
    SPARE_AFTER,
    SPARE_BEFORE,
    SUSPECT,
    SampleTimes,
)

PERIOD_TICKS = 10_000  # 1 ms
OLDEST_WHOLE = int(OLDEST)
drifts = st.floats(-2e-4, 2e-4)  # two crystals of 100 ppm
starts = st.integers(0, TICKS - 1)
gaps = st.lists(st.integers(1, 8), min_size=1, max_size=60)
units = st.sampled_from([0.0, 1e-3])


def begun(start: int = 0, interval_s: float = 1e-3) -> SampleTimes:
    times = SampleTimes()
    times.sync_interval_s = interval_s
    assert times.elapsed(start % TICKS, 1.0) == 1.0
    return times


def settled(start: int, interval_s: float) -> SampleTimes:
    """With two samples: the interval is known."""
    times = begun(start, interval_s)
    assert times.elapsed((start + PERIOD_TICKS) % TICKS, 1.0) == pytest.approx(1.0)
    return times


@given(starts, drifts, gaps, units, st.data())
def test_any_drift_wrap_and_jitter_is_measured(
    start: int, drift: float, counted: list[int], unit_s: float, data: st.DataObject
) -> None:
    times = begun(start, unit_s)
    last = start
    at = 0
    for gap in [1, *counted]:
        at += gap
        jitter = data.draw(st.integers(-2000, 2000) if unit_s else st.integers(-150, 150))
        here = start + round(at * PERIOD_TICKS * (1.0 + drift)) + jitter
        got = times.elapsed(here % TICKS, float(gap))
        assert got * times.unit_s == pytest.approx(1e-7 * (here - last))
        last = here


@pytest.mark.parametrize("interval_s", [0.0, 1e-3])
@given(starts, st.integers(0, TICKS - 1), st.integers(1, 40))
def test_one_bad_stamp_costs_one_sample(interval_s: float, start: int, wrong: int, before: int) -> None:
    times = settled(start, interval_s)
    now = start + PERIOD_TICKS
    for _ in range(before):
        now += PERIOD_TICKS
        assert times.elapsed(now % TICKS, 1.0) == pytest.approx(1.0)
    now += PERIOD_TICKS
    got = times.elapsed(wrong, 1.0)
    off = (wrong - now + TICKS // 2) % TICKS - TICKS // 2  # ticks
    if abs(off) < 0.5 * PERIOD_TICKS:
        return  # it may be that of a sample with jitter
    assert got < 0.0 or -0.75 * PERIOD_TICKS <= off <= SPARE_AFTER * PERIOD_TICKS
    if got < 0.0:
        now += PERIOD_TICKS
        assert times.elapsed(now % TICKS, 2.0) == pytest.approx(2.0), "from the last good one"


@given(starts, st.integers(0, OLDEST_WHOLE - 1))
def test_late_stamps_are_repeated(start: int, back: int) -> None:
    times = begun(start)
    now = start
    for _ in range(80):
        now += PERIOD_TICKS
        times.elapsed(now % TICKS, 1.0)
    assert times.elapsed((now - back * PERIOD_TICKS) % TICKS, 1.0) == REPEATED
    assert times.elapsed((now + PERIOD_TICKS) % TICKS, 1.0) == pytest.approx(1.0), "and nothing has changed"


@pytest.mark.parametrize("interval_s", [0.0, 1e-3])
@given(starts, starts)
@example(start=630001, restarted=0)
def test_a_clock_that_was_restarted_is_known_by_the_second_time(
    interval_s: float, start: int, restarted: int
) -> None:
    times = settled(start, interval_s)
    last = start + PERIOD_TICKS
    jump = (restarted - last + TICKS // 2) % TICKS - TICKS // 2
    got = times.elapsed(restarted, 1.0)
    if -OLDEST <= jump / PERIOD_TICKS < 1.0 + SPARE_AFTER:
        assert got != SUSPECT  # it looks like a sample, or like an earlier one
        return
    assert got == SUSPECT
    got = times.elapsed((restarted + PERIOD_TICKS) % TICKS, 2.0)
    behind = jump / PERIOD_TICKS + 1.0
    k = 2
    while got == REPEATED and -OLDEST <= behind < 0.0 and k < 3 + EARLIER_TIMES:  # just within OLDEST again
        got = times.elapsed((restarted + k * PERIOD_TICKS) % TICKS, k + 1.0)
        k += 1
    assert got == RESTARTED or (0.0 < behind <= OLDEST and got == pytest.approx(behind))
    for later in range(k, k + 4):
        assert times.elapsed((restarted + later * PERIOD_TICKS) % TICKS, 1.0) == pytest.approx(1.0)


@pytest.mark.parametrize("interval_s", [0.0, 1e-3])
@pytest.mark.parametrize("back", [1, 2, 10, 60])
def test_a_clock_that_was_set_back_is_not_earlier_for_ever(back: int, interval_s: float) -> None:
    times = settled(0, interval_s)
    now = (1 - back) * PERIOD_TICKS
    for k in range(1, EARLIER_TIMES + 1):
        assert times.elapsed((now + k * PERIOD_TICKS) % TICKS, float(k)) == REPEATED
    now += (EARLIER_TIMES + 1) * PERIOD_TICKS
    assert times.elapsed(now % TICKS, EARLIER_TIMES + 1.0) == RESTARTED
    assert times.elapsed((now + PERIOD_TICKS) % TICKS, 1.0) == pytest.approx(1.0)


@pytest.mark.parametrize("spurious", [1, 2, 5])
def test_a_count_that_is_too_high_is_not_held_against_the_clock_for_ever(spurious: int) -> None:
    """Intervals that were counted and did not pass: how many, nobody knows."""
    times = settled(0, 1e-3)
    got = [times.elapsed((1 + k) * PERIOD_TICKS, float(k + spurious)) for k in range(1, EARLIER_TIMES + 2)]
    assert got == [REPEATED] * EARLIER_TIMES + [RESTARTED]


@given(st.lists(st.integers(-OLDEST_WHOLE, 0), max_size=40))
def test_earlier_samples_that_come_in_a_burst_restart_nothing(late: list[int]) -> None:
    """Between two SYNCs, in any order."""
    times = settled(0, 1e-3)
    now, counted = 100 * PERIOD_TICKS, 99.0
    assert times.elapsed(now, counted) == pytest.approx(99.0)
    for back in late:
        assert times.elapsed(now + back * PERIOD_TICKS, 1.0) == REPEATED
    assert times.elapsed(now + PERIOD_TICKS, 1.0) == pytest.approx(1.0)


@pytest.mark.parametrize("lost", [1, 2, 10, 60])
def test_intervals_that_nobody_heard_need_two_times_that_agree(lost: int) -> None:
    times = begun(0)
    now = (lost + 1) * PERIOD_TICKS
    assert times.elapsed(now, 1.0) == SUSPECT
    assert times.elapsed(now + PERIOD_TICKS, 2.0) in (RESTARTED, pytest.approx(lost + 2))
    assert times.elapsed(now + 2 * PERIOD_TICKS, 1.0) == pytest.approx(1.0)


def test_two_bad_stamps_that_do_not_agree_restart_nothing() -> None:
    times = begun(0)
    assert times.elapsed(500 * PERIOD_TICKS, 1.0) == SUSPECT
    assert times.elapsed(900 * PERIOD_TICKS, 2.0) == SUSPECT
    assert times.elapsed(3 * PERIOD_TICKS, 3.0) == pytest.approx(3.0)


def test_a_suspect_is_forgotten_after_a_good_one() -> None:
    times = begun(0)
    assert times.elapsed(500 * PERIOD_TICKS, 1.0) == SUSPECT
    assert times.elapsed(2 * PERIOD_TICKS, 2.0) == pytest.approx(2.0)
    assert times.elapsed(501 * PERIOD_TICKS, 1.0) == SUSPECT


@pytest.mark.parametrize(
    ("intervals", "counted", "taken"),
    [
        (CLOSEST - 0.01, 1.0, False),
        (CLOSEST + 0.01, 1.0, True),
        (1.0 + SPARE_AFTER - 0.01, 1.0, True),
        (1.0 + SPARE_AFTER + 0.01, 1.0, False),
        (2.0 - SPARE_BEFORE - 0.01, 2.0, False),
        (2.0 - SPARE_BEFORE + 0.01, 2.0, True),
        (2.0 + SPARE_AFTER + 0.01, 2.0, False),
    ],
)
def test_how_far_a_time_may_be_from_the_count(intervals: float, counted: float, taken: bool) -> None:
    got = begun(0).elapsed(round(intervals * PERIOD_TICKS), counted)
    assert (got > 0.0) is taken
    if taken:
        assert got == pytest.approx(intervals, abs=1e-4)


@pytest.mark.parametrize("ticks", [0, -1, -PERIOD_TICKS])
def test_without_a_unit_the_first_interval_is_ahead(ticks: int) -> None:
    times = begun(50_000, 0.0)
    assert times.elapsed(50_000 + ticks, 1.0) == REPEATED
    assert times.unit_s == 0.0
    assert times.elapsed(50_000 + PERIOD_TICKS, 1.0) == 1.0
    assert times.unit_s == pytest.approx(1e-3)


def test_without_a_unit_missed_samples_do_not_stretch_it() -> None:
    times = begun(0, 0.0)
    assert times.elapsed(3 * PERIOD_TICKS, 3.0) == pytest.approx(3.0)
    assert times.unit_s == pytest.approx(1e-3)


def test_the_interval_of_the_module_takes_the_place_of_the_first_one() -> None:
    times = settled(0, 0.0)
    times.sync_interval_s = 2e-3
    assert times.unit_s == 2e-3
    times.forget()
    assert times.unit_s == 2e-3
    times.sync_interval_s = 0.0
    times.reset()
    assert times.unit_s == 0.0


@pytest.mark.parametrize(("speed", "unheard", "lost"), [(0.1, 36, True), (0.01, 36, True), (0.0, 36, False)])
def test_periods_that_only_the_times_show_count_for_a_machine_that_creeps(
    speed: float, unheard: int, lost: bool
) -> None:
    chain = SignalChain(ChainConfig())
    chain.sync_interval_s = 1e-3

    def step(at: int) -> Feedback:
        angle = 2.0 * math.pi * speed * at
        return chain.step(Sample(1500 * math.sin(angle), 1500 * math.cos(angle), time_100ns=at * 10_000))

    assert all(step(at).valid for at in range(40))
    after = [step(40 + unheard + at) for at in range(20)]
    assert chain.lost is lost
    assert all(not one.valid or abs(one.cycles + one.phase) < 0.01 for one in after)


@pytest.mark.parametrize("late_s", [0.0005, 0.0145, 0.4])
def test_an_exact_time_is_right_however_late_its_sync_was_received(late_s: float) -> None:
    """From the first samples on, fast as the machine may be: a host that is late does not make it wrong."""
    times = begun()
    times.elapsed(0, 1.0, 0.0, 0.0)
    received_s = 0.0
    for number in range(1, 5):
        received_s += 1e-3 + (late_s if number == 3 else 0.0)
        assert times.elapsed(number * PERIOD_TICKS, 1.0, received_s, received_s, 125.0) == 1.0


def test_a_time_off_the_grid_needs_a_sync_that_was_as_late() -> None:
    for syncs_late_s in (0.0, 0.2e-3):
        times = begun()
        times.elapsed(0, 1.0, 0.0, 0.0)
        times.elapsed(PERIOD_TICKS, 1.0, 1e-3, 1e-3, 125.0)
        synced_s = 2e-3 + syncs_late_s
        elapsed = times.elapsed(2 * PERIOD_TICKS + 2000, 1.0, synced_s, synced_s, 125.0)
        assert elapsed == (pytest.approx(1.2) if syncs_late_s else SUSPECT)


@pytest.mark.parametrize("stamped", [True, False])
def test_extra_syncs_do_not_change_the_pace(stamped: bool) -> None:
    """Samples that answer SYNCs of a second producer, between the others, are none of their line."""
    generator = random.Random(11)
    for extra in (8, 20, 30, 60):
        times, at = SampleTimes(), 0
        for number in range(60 + 2 * extra + 60):
            between = 60 <= number < 60 + 2 * extra and not number % 2
            grid = at - at % PERIOD_TICKS
            at = grid + (round(PERIOD_TICKS * generator.uniform(0.25, 0.45)) if between else PERIOD_TICKS)
            synced_s = None if between else at * 1e-7  # which SYNC it answers is open
            times.elapsed(at, 1.0, at * 1e-7 if stamped else None, synced_s, 0.0, between)
            assert number < 2 or times.unit_s == pytest.approx(1e-3), extra


@pytest.mark.parametrize(("late_ticks", "sync_late_s", "taken"), [(1500, 0.0, False), (1500, 1.5e-4, True)])
def test_no_host_takes_a_sync_before_it_comes(late_ticks: int, sync_late_s: float, taken: bool) -> None:
    """SYNCs are up to 135 us late, the host takes them within 70 us: a time beyond that is a wrong one.

    Without receive times; and it is right if its SYNC was as late.
    """
    generator = random.Random(5)
    times, bad = SampleTimes(), 200
    for number in range(bad + 1):
        late_s = generator.uniform(0.0, 135e-6) if number < bad else sync_late_s
        at_s = number * 1e-3 + late_s
        ticks = round(at_s * 1e7) + (late_ticks if number == bad and not sync_late_s else 0)
        taken_s = at_s + generator.uniform(0.0, 70e-6)
        elapsed = times.elapsed(ticks, 1.0, None, taken_s, 20.0 if number == bad else 0.0)
    assert (elapsed > 0.0) is taken


def test_samples_after_a_sync_that_was_late_and_taken_late_are_no_earlier_ones() -> None:
    times = SampleTimes()
    for n in range(80):
        at = n * PERIOD_TICKS + 500 * (n % 3 - 1) + 500
        times.elapsed(at, 1.0, None, at * 1e-7 + 3e-5 * (n % 2))
    # The SYNC of the next one is 0.8 ms late, and taken 0.2 ms later.
    assert times.elapsed(808_000, 1.0, None, 0.0808 + 2e-4) == pytest.approx(1.75, abs=0.01)
    assert times.elapsed(810_000, 1.0, None, 0.081) == CROWDED, "a new one, and too near to it"
    assert times.elapsed(820_000, 2.0, None, 0.082) == pytest.approx(1.2, abs=0.01)
    assert times.elapsed(830_000, 1.0, None, 0.083) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(("off_ticks", "late_s", "taken"), [(700, 4.5e-5, False), (4000, 4e-4, True)])
def test_a_host_that_is_later_than_ever_by_a_little_is_no_witness(
    off_ticks: int, late_s: float, taken: bool
) -> None:
    """It was late by up to 40 us. A time off by 70 us is wrong, one off by 0.4 ms is that of a late SYNC."""
    times = SampleTimes()
    for n in range(80):
        times.elapsed(n * PERIOD_TICKS, 1.0, None, n * 1e-3 + 4e-5 * (n % 2), speed_cycles=10.0)
    got = times.elapsed(80 * PERIOD_TICKS + off_ticks, 1.0, None, 0.08 + late_s, speed_cycles=10.0)
    assert (got > 0.0) is taken
