"""Which SYNCs are taken, dropped as duplicates, or show that others were not heard."""

from __future__ import annotations

import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canfb.device.od.dictionary import Dictionary
from canfb.eds_files import eds_path
from canfb.module.interval import IntervalEstimate
from canfb.module.timeline import (
    CONFIRMING_SYNCS,
    DUPLICATE,
    FASTER_SYNCS,
    ON_TIME,
    Timeline,
    Verdict,
)

PERIOD_S = 1e-3
BOTH = pytest.mark.parametrize("proved", [True, False], ids=["stamped", "unstamped"])
PERIODS = 2  # default of 2010:06


class Wire:
    """SYNCs at times in periods, with or without a counter."""

    def __init__(self, proved: bool, overflow: int = 0, settled: int = 200) -> None:
        self.dictionary = Dictionary.load(eds_path("canfb-module"), 32)
        self.dictionary.entry(0x1006).value = 1000
        self.dictionary.entry(0x1019).value = overflow
        self.interval = IntervalEstimate(self.dictionary.entry(0x1006))
        self.timeline = Timeline(self.dictionary, self.interval)
        self.proved, self.overflow = proved, overflow
        self.at = 0.0  # the last SYNC, periods
        self.number = 0
        for _ in range(settled):
            assert self.next() == ON_TIME

    def next(self, lost: int = 0, late: float = 0.0) -> Verdict:
        """The next SYNC after ``lost`` that are not heard, heard ``late`` periods after its time."""
        self.at += 1 + lost
        self.number += 1 + lost
        return self.hear(self.at + late, self.number)

    def hear(self, at: float, number: int) -> Verdict:
        time_s = at * PERIOD_S
        counter = (number - 1) % self.overflow + 1 if self.overflow else None
        verdict = self.timeline.sync(time_s, self.proved, counter)
        if not verdict.duplicate:
            self.interval.event(time_s)
        return verdict


@pytest.fixture(params=[0, 2, 20, 240], ids=lambda overflow: f"counter{overflow}")
def overflow(request: pytest.FixtureRequest) -> int:
    return int(request.param)


@BOTH
def test_syncs_on_time_are_taken(proved: bool, overflow: int) -> None:
    wire = Wire(proved, overflow)
    for _ in range(500):
        assert wire.next() == ON_TIME
    assert wire.timeline.synced_s == pytest.approx(wire.at * PERIOD_S)
    assert wire.timeline.until == pytest.approx((wire.at + PERIODS) * PERIOD_S)
    assert wire.timeline.jitter_s < 1e-6


@given(
    st.booleans(),
    st.sampled_from([0, 20]),
    st.floats(-2e-4, 2e-4),
    # From one SYNC to the next less than LEAST_EARLY: more is a duplicate while the jitter is not known.
    st.lists(st.floats(-0.07, 0.07), max_size=200),
)
def test_jitter_and_drift_are_followed(proved: bool, overflow: int, drift: float, late: list[float]) -> None:
    wire = Wire(proved, overflow)
    for one in late:
        wire.at += drift
        assert wire.next(late=one) == ON_TIME
    assert wire.interval.settled_s == pytest.approx(PERIOD_S, rel=0.02)


@BOTH
@pytest.mark.parametrize("after", [0.0, 0.001, 0.1, 0.5, 0.8])
def test_a_duplicate_is_dropped(after: float, proved: bool, overflow: int) -> None:
    wire = Wire(proved, overflow)
    for _ in range(20):
        assert wire.hear(wire.at + after, wire.number) == DUPLICATE
        assert wire.hear(wire.at + after, wire.number) == DUPLICATE
        assert wire.next() == ON_TIME


@BOTH
@pytest.mark.parametrize("at", [0.3, 0.7])
def test_a_second_sync_in_the_period_is_dropped_where_nothing_counts_them(at: float, proved: bool) -> None:
    wire = Wire(proved)
    for _ in range(20):
        assert wire.hear(wire.at + at, 0) == DUPLICATE
        assert wire.next() == ON_TIME


@pytest.mark.parametrize("lost", [1, 2, 5, 19, 20, 21, 40, 57, 100])
def test_stamped_every_sync_that_was_not_heard_is_known(lost: int, overflow: int) -> None:
    """Whole turns of the counter, too."""
    wire = Wire(True, overflow)
    assert wire.next(lost) == Verdict(unheard=lost)
    assert not wire.timeline.withheld
    for _ in range(50):
        assert wire.next() == ON_TIME


@pytest.mark.parametrize("lost", [1, 2, 5, 18])
def test_unstamped_the_counter_knows_how_many(lost: int) -> None:
    wire = Wire(False, 20)
    assert wire.next(lost) == Verdict(unheard=lost)
    assert wire.next() == ON_TIME


@pytest.mark.parametrize("lost", [1, 2, 5, 18])
def test_unstamped_without_a_counter_the_position_is_withheld(lost: int) -> None:
    """They were lost, or the host was late: never an unheard SYNC that is not certain, never silence."""
    wire = Wire(False)
    got = wire.next(lost)
    assert got.late
    assert not got.unheard
    assert wire.timeline.withheld
    for _ in range(CONFIRMING_SYNCS):
        assert wire.timeline.withheld
        wire.next()


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_unstamped_whole_turns_of_the_counter_are_not_silent(turns: int) -> None:
    wire = Wire(False, 20)
    got = wire.next(lost=20 * turns)
    assert got.late or got.doubt
    assert wire.timeline.withheld or got.doubt


@pytest.mark.parametrize(
    ("waiting", "overflow"),
    [(2, 0), (3, 0), (5, 0), (10, 0), (2, 20), (3, 20), (5, 20), (10, 20)],
)
def test_a_host_that_was_away_finds_its_place_again(waiting: int, overflow: int) -> None:
    """It hears a burst of SYNCs at once, without receive times; none was lost, none is one too many."""
    wire = Wire(False, overflow)
    come = wire.at + waiting + 0.3
    taken = 0
    for n in range(waiting):
        wire.at, wire.number = wire.at + 1, wire.number + 1
        got = wire.hear(come + n * 0.01, wire.number)
        assert not got.unheard
        taken += not got.duplicate
    assert taken == waiting
    for _ in range(20):
        got = wire.next()
        assert got == ON_TIME or got.late
    assert got == ON_TIME
    assert not wire.timeline.withheld


@pytest.mark.parametrize("waiting", [2, 3, 5, 10])
def test_with_receive_times_a_burst_is_as_if_the_host_had_been_there(waiting: int, overflow: int) -> None:
    wire = Wire(True, overflow)
    for _ in range(waiting):
        assert wire.next() == ON_TIME


@BOTH
@pytest.mark.parametrize(
    "factor",
    [0.1, *(factor for factor in (0.23, 0.25, 0.4, 0.5))],
)
def test_a_faster_rate_is_learned(factor: float, proved: bool) -> None:
    wire = Wire(proved)
    wire.dictionary.entry(0x1006).value = 0
    verdicts = []
    for _ in range(FASTER_SYNCS + 60):
        wire.at += factor
        verdicts.append(wire.hear(wire.at, 0))
    assert any(verdict.doubt for verdict in verdicts), "how many intervals passed is not known"
    assert verdicts[-20:] == [ON_TIME] * 20
    assert wire.interval.settled_s == pytest.approx(factor * PERIOD_S, rel=0.02)


@BOTH
@pytest.mark.parametrize("factor", [2.0, 4.0, 10.0])
def test_a_slower_rate_is_learned(factor: float, proved: bool) -> None:
    wire = Wire(proved)
    wire.dictionary.entry(0x1006).value = 0
    verdicts = []
    for _ in range(150):
        wire.at += factor
        verdicts.append(wire.hear(wire.at, 0))
    assert verdicts[0] != ON_TIME
    assert verdicts[-20:] == [ON_TIME] * 20
    assert wire.interval.settled_s == pytest.approx(factor * PERIOD_S, rel=0.02)


@pytest.mark.parametrize("step", [3, 7, 11])
def test_a_counter_that_time_contradicts_is_doubted(step: int) -> None:
    """Another producer, or one that began again: stamped, one period after the last SYNC."""
    wire = Wire(True, 20)
    wire.number += step
    got = wire.next()
    assert got.doubt
    assert wire.next() == ON_TIME


@BOTH
def test_the_first_sync_after_a_pause_begins(proved: bool) -> None:
    wire = Wire(proved, 20)
    wire.timeline.pause()
    assert wire.timeline.until == math.inf
    assert not wire.timeline.begun
    assert wire.hear(wire.at + 377.77, 4711) == ON_TIME
    assert wire.timeline.begun


@BOTH
def test_without_a_period_nothing_is_judged_but_the_counter(proved: bool) -> None:
    wire = Wire(proved, 20, settled=0)
    wire.dictionary.entry(0x1006).value = 0
    assert wire.hear(1.0, 1) == ON_TIME
    assert wire.hear(1.5, 1) == DUPLICATE
    assert wire.hear(4.0, 4) == Verdict(unheard=2)


@pytest.mark.parametrize(("passed", "intervals"), [(2.0, 1), (2.9, 1), (3.0, 2), (7.5, 6), (100.0, 99)])
def test_overdue_goes_on_with_what_has_passed(passed: float, intervals: int) -> None:
    wire = Wire(True)
    assert wire.timeline.overdue((wire.at + passed) * PERIOD_S) == intervals
    assert wire.timeline.synced_s == pytest.approx((wire.at + intervals) * PERIOD_S)
    assert wire.timeline.until == pytest.approx((wire.at + intervals + 2) * PERIOD_S)
    assert wire.next(lost=intervals) == ON_TIME


def test_overdue_keeps_the_counter_along(overflow: int) -> None:
    wire = Wire(True, overflow)
    assert wire.timeline.overdue((wire.at + 30.2) * PERIOD_S) == 29
    wire.at, wire.number = wire.at + 29, wire.number + 29
    assert wire.next(lost=2) == Verdict(unheard=2)


def test_without_a_period_overdue_says_only_that_the_deadline_has_passed() -> None:
    wire = Wire(True, settled=0)
    wire.dictionary.entry(0x1006).value = 0
    wire.hear(1.0, 1)
    assert wire.timeline.until < math.inf
    assert wire.timeline.overdue(10.0) == 0
    assert wire.timeline.until == math.inf


events = st.tuples(st.floats(0.0, 3.0), st.integers(0, 300), st.booleans())


@given(st.lists(events, max_size=60), st.sampled_from([0, 2, 20, 240]))
@example([(0.0, 0, True)] * 30, 20)
def test_no_sequence_of_syncs_breaks_it(heard: list[tuple[float, int, bool]], overflow: int) -> None:
    """Any distance, any counter, stamped or not: a verdict, and a deadline that lies ahead."""
    wire = Wire(True, overflow)
    at = wire.at
    for apart, number, proved in heard:
        at += apart
        counter = number if overflow else None
        verdict = wire.timeline.sync(at * PERIOD_S, proved, counter)
        assert verdict.unheard >= 0
        assert not (verdict.duplicate and (verdict.unheard or verdict.late or verdict.doubt))
        if not verdict.duplicate:
            assert wire.timeline.until > at * PERIOD_S
            wire.interval.event(at * PERIOD_S)
