"""The grid, whatever the jitter of its instants; SYNCs by it or by their order; which one a PDO answers."""

import itertools
import math
import random

import pytest
from hypothesis import example, given, strategies as st

from canfb.timing.answers import Answers
from canfb.timing.grid import CALLS, LARGEST_FIRST, ROW, UNDECLARED, Grid, is_regular
from canfb.timing.syncs import ON_TIME, Syncs, SyncVerdict
from folding import each

UNITS = st.sampled_from([1e-3, 0.01, 10_000.0])  # seconds, and ticks
SEEDS = st.integers(0, 2**32)


def locked(
    period: float, jitter: float, seed: int, count: int = 60, declared: float = 0.0
) -> tuple[Grid, float]:
    """A grid after so many instants of a uniform jitter, and the place of the last one."""
    grid, draw = Grid(jitter=declared), random.Random(seed)
    for n in range(count):
        instant = n * period + draw.uniform(-jitter, jitter)
        if grid.period:
            places, off = grid.nearest(instant)
            assert places == 1
            assert abs(off) <= grid.allowed
        grid.take(instant)
    return grid, (count - 1) * period


@given(
    period=UNITS, part=st.floats(1e-6, 0.1), seed=SEEDS, places=st.integers(0, 40), off=st.floats(-0.3, 0.3)
)
def test_an_instant_is_at_the_nearest_place(
    period: float, part: float, seed: int, places: int, off: float
) -> None:
    """The line is better than its instants, none of which is further off than declared."""
    grid, last = locked(period, part * period, seed, declared=part * period)
    assert grid.locked
    assert grid.period == pytest.approx(period, rel=1e-9 + 0.02 * part)
    at, late = grid.nearest(last + (places + off) * period)
    assert at == places
    assert late == pytest.approx(off * period, abs=(0.001 + 1.5 * part) * period)


@pytest.mark.parametrize("declared", [0.0, 1e-4, 10.0])
def test_how_far_off_is_declared_and_never_learned(declared: float) -> None:
    grid, _ = locked(1e-3, 2e-5, 1, 500, declared)
    most = UNDECLARED * grid.period
    expected = min(most, declared * (1.0 + 3.0 * math.sqrt(2.0 / 256))) if declared else most
    assert grid.allowed == pytest.approx(expected)


@given(period=UNITS, shift=st.floats(0.1, 0.9), rate=st.sampled_from([1.0, 0.1, 0.5, 1.3, 2.0, 10.0]))
def test_regular_instants_off_the_grid_are_the_grid(period: float, shift: float, rate: float) -> None:
    grid, last = locked(period, 0.0, 1)
    row = [last + (1.0 + shift + n * rate) * period for n in range(ROW)]
    assert [grid.refuse(one) for one in row] == [False] * (ROW - 1) + [True]
    assert grid.set_again(row) is (rate != 1.0)
    assert grid.period == pytest.approx(rate * period)
    assert grid.due == pytest.approx(row[-1] + rate * period)


@given(instants=st.lists(st.floats(0.0, 100.0), min_size=ROW, max_size=ROW, unique=True).map(sorted))
def test_what_is_regular_agrees_within_a_fifth(instants: list[float]) -> None:
    apart = [b - a for a, b in itertools.pairwise(instants)]
    if is_regular(instants):
        assert max(apart) <= 1.201 / 0.799 * min(apart)


def test_a_pause_keeps_the_period() -> None:
    grid, _ = locked(1e-3, 0.0, 1)
    grid.pause()
    assert math.isnan(grid.due)
    grid.begin(100.0)
    assert (grid.period, grid.due) == (pytest.approx(1e-3), pytest.approx(100.001))
    grid.forget()
    assert grid.period == 0.0


@given(seed=SEEDS, latest=st.floats(0.05, 3.0))
def test_the_line_below_late_calls_is_that_of_the_instants(seed: int, latest: float) -> None:
    grid, draw = Grid(), random.Random(seed)
    grid.begin(0.0)
    n, taken = 0, 0.0
    while not grid.period:
        n += 1
        taken = max(taken, n + draw.uniform(0.0, latest) ** 2 / latest)  # calls are in order
        grid.learn_earliest(taken)
    assert grid.period == pytest.approx(1.0, abs=0.03 + 0.08 * latest)


T = 1e-3
BEGIN = 1000.0
BOTH = pytest.mark.parametrize("stamped", [True, False], ids=["stamped", "unstamped"])
COUNTERS = pytest.mark.parametrize("overflow", [0, 10, 240])
TIMES = st.tuples(st.floats(allow_nan=True), st.booleans(), st.integers(0, 255) | st.none())


class Producer:
    """A locked :class:`Syncs`, and SYNCs at any place, periods since the beginning."""

    def __init__(self, stamped: bool = True, overflow: int = 0, jitter_s: float = 0.0) -> None:
        self.syncs, self.stamped = Syncs(), stamped
        self.syncs.overflow = overflow
        self.syncs.declare(jitter_s)
        assert {self.sync(n) for n in range(60)} == {ON_TIME}

    def sync(self, at: float, number: int | None = None) -> SyncVerdict:
        """The SYNC of this ``number`` of its producer, default: its place."""
        number = round(at) if number is None else number
        counter = number % self.syncs.overflow + 1 if self.syncs.overflow else None
        return self.syncs.sync(BEGIN + at * T, self.stamped, counter)


@each("stamped, overflow", [(True, 0), (True, 10), (True, 240), (False, 10), (False, 240)])
@given(missed=st.integers(0, 9), off=st.floats(-0.15, 0.15))
def test_places_left_out_were_not_received(stamped: bool, overflow: int, missed: int, off: float) -> None:
    producer = Producer(stamped, overflow)
    before = producer.syncs.place
    chance = abs(off) * (stamped and missed and not overflow)  # it may be the next one, of another rate
    seen = producer.sync(60 + missed + off, 60 + missed)
    assert seen == pytest.approx(SyncVerdict(missed, off=chance), abs=1e-6)
    assert producer.syncs.place == before + 1 + missed


@example(seed=410)
@example(seed=7330)
@given(seed=st.integers(0))
def test_a_line_of_few_syncs_that_jitter_counts_none_without_doubt(seed: int) -> None:
    syncs, draw, before, doubt = Syncs(), random.Random(seed), 0, 0.0
    syncs.declare(0.2 * T)
    for n in range(64):
        if n < LARGEST_FIRST or draw.random() > 0.1:
            verdict = syncs.sync(BEGIN + (n + draw.uniform(-0.2, 0.2)) * T, True, None)
            before = before if n >= LARGEST_FIRST else syncs.place - n
            doubt += verdict.doubt
            assert verdict.off or verdict.extra or doubt or syncs.place - n == before


@COUNTERS
@given(stall=st.integers(1, 60))
def test_a_late_host_loses_nothing_that_waited(overflow: int, stall: int) -> None:
    producer = Producer(stamped=False, overflow=overflow)
    before = producer.syncs.place
    got = [producer.sync(60 + stall + n * 1e-4, 60 + n) for n in range(stall + 1)]
    got += [producer.sync(n, n) for n in range(61 + stall, 75 + stall)]
    assert not any(one.lost or one.extra or one.doubt for one in got)
    assert producer.syncs.place == before + stall + 15
    assert (producer.syncs.late_s, producer.syncs.grid.period) == (0.0, pytest.approx(T, rel=1e-3))


@given(seed=st.integers(0, 10_000), mean=st.floats(0.5, 4.0))
def test_calls_that_waited_together_from_the_start_are_no_other_rate(seed: int, mean: float) -> None:
    late, syncs, now = random.Random(seed), Syncs(), 0.0
    syncs.expected_s = lambda: T
    for n in range(300):
        now = now + 0.05 if now > n else n + min(late.expovariate(1.0 / mean), 12.0)
        syncs.sync(BEGIN + now * T, False, None)
        assert not 0.0 < syncs.grid.period < 0.5 * T


@given(stall=st.integers(70, 1000))
def test_a_host_that_is_late_for_longer_than_its_syncs_were_known_is_doubt(stall: int) -> None:
    assert Producer(stamped=False).sync(60 + stall).doubt >= 1.0
    assert not Producer(stamped=False, overflow=10).sync(60 + stall, 60).doubt


@given(lost=st.integers(1, 30))
def test_syncs_that_stay_late_are_missing_and_nobody_knows_where(lost: int) -> None:
    producer = Producer(stamped=False)
    got = []
    for n in range(60 + lost, 70 + lost):
        got.append(producer.sync(n))
        assert producer.syncs.late_s or got[-1].doubt or len(got) >= CALLS
    (doubt,) = (one for one in got if one.doubt)
    assert (doubt.lost, doubt.doubt) == (lost, pytest.approx(lost, abs=0.2))


@BOTH
@COUNTERS
def test_a_second_one_at_a_place_brings_no_sample(stamped: bool, overflow: int) -> None:
    producer = Producer(stamped, overflow)
    producer.sync(60)
    again = producer.sync(60.3, 60)
    doubt = float(not stamped and not overflow)  # it may be the next one, on a line that is late
    assert (again.extra, again.repeated, again.doubt) == (True, bool(overflow), doubt)
    assert producer.sync(61) == pytest.approx(ON_TIME, abs=1e-6)


@given(off=st.floats(0.35, 0.65), chance=st.floats(-0.02, 0.02), declared=st.sampled_from([0.0, 1e-4]))
def test_off_the_grid_the_instant_is_bad_by_as_much(off: float, chance: float, declared: float) -> None:
    producer = Producer(jitter_s=declared)
    seen = [producer.sync(60 + at).off for at in (off, 3.0 + chance)]  # which another rate may hit
    assert seen == pytest.approx([min(off, 1.0 - off), abs(chance)], abs=1e-6)


@given(early=st.floats(0.22, 0.45))
def test_without_receive_times_one_that_is_early_brings_no_sample_in_motion(early: float) -> None:
    verdict = Producer(stamped=False, jitter_s=1e-4).sync(60 - early)
    assert verdict.extra or verdict.off == pytest.approx(early, abs=1e-6)
    assert Producer(stamped=False, overflow=10).sync(60 - early) == ON_TIME


@BOTH
@pytest.mark.parametrize("rate", [0.5, 0.7, 1.35, 2.0, 10.0])
def test_another_rate_is_followed_and_lost_in_motion(rate: float, stamped: bool) -> None:
    producer = Producer(stamped)
    got = [producer.sync(59 + rate * n) for n in range(1, 60)]
    assert any(one.doubt >= 1.0 for one in got)
    assert producer.syncs.grid.period == pytest.approx(rate * T, rel=0.02)
    assert set(got[-20:]) == {ON_TIME}


@BOTH
@given(rate=st.floats(1.9, 2.3), overflow=st.integers(80, 240))
def test_a_sync_that_is_overdue_and_comes_is_no_turn_of_the_counter(
    rate: float, overflow: int, stamped: bool
) -> None:
    producer, lost = Producer(stamped, overflow), 0
    syncs = producer.syncs
    for n in range(1, 60):
        if BEGIN + (59 + rate * n) * T > syncs.until:
            syncs.overdue(syncs.until)
        lost += producer.sync(59 + rate * n, 59 + n).lost
    assert lost == 0


@given(shift=st.floats(0.35, 0.65))
def test_another_phase_is_doubt_by_its_step(shift: float) -> None:
    producer = Producer()
    (doubt,) = (one.doubt for one in [producer.sync(60 + shift + n) for n in range(10)] if one.doubt)
    assert doubt == pytest.approx(min(shift, 1.0 - shift), abs=1e-6)


@BOTH
@given(overflow=st.integers(2, 240), data=st.data())
def test_a_counter_against_the_time_is_doubt(stamped: bool, overflow: int, data: st.DataObject) -> None:
    skipped = data.draw(st.integers(1, overflow - 1))
    assert Producer(stamped, overflow).sync(60, 60 + skipped).doubt >= 1.0


@given(frames=st.lists(TIMES, max_size=40))
def test_no_sync_raises(frames: list[tuple[float, bool, int | None]]) -> None:
    syncs = Syncs()
    syncs.overflow = 10
    for at, stamped, counter in frames:
        syncs.sync(at, stamped, counter)
        syncs.overdue(at)


@each("periods, until", [(1, 1.2), (2, 2.0), (5, 5.0)])
def test_validity_ends_without_sync(periods: int, until: float) -> None:
    producer = Producer()
    producer.syncs.declare(0.0, periods)
    producer.sync(60)
    assert producer.syncs.until - BEGIN - 60 * T == pytest.approx(until * T, rel=0.1)
    before = producer.syncs.place
    assert producer.syncs.overdue(producer.syncs.until + 3 * T)
    assert producer.syncs.place > before


def learned(delay_s: float) -> tuple[Answers, Syncs]:
    producer, answers = Producer(), Answers()
    for _ in range(200):
        assert answers.place(delay_s, producer.syncs) == 0
    return answers, producer.syncs


@given(delay=st.floats(0.05, 0.6), late=st.floats(0.0, 0.2), places=st.integers(0, 5))
def test_a_pdo_answers_the_sync_the_least_delay_before(delay: float, late: float, places: int) -> None:
    answers, syncs = learned(delay * T)
    assert answers.place((delay + places + late) * T, syncs) == places


@given(delay=st.floats(0.05, 0.5), late=st.floats(0.6, 0.75))
def test_a_pdo_that_fits_none_is_not_used_until_it_is_the_usual_one(delay: float, late: float) -> None:
    (answers, syncs), moved = learned(delay * T), []
    for n in range(60, 60 + ROW):
        syncs.sync(BEGIN + n * T, True, None)
        assert {answers.place((delay + late) * T, syncs) for _ in "copies"} == {None}
        moved.append(answers.has_moved(syncs.grid))
    assert moved == [False] * (ROW - 1) + [True]
    assert answers.place((delay + late) * T, syncs) == 0


@given(early=st.floats(0.15, 0.4))
def test_a_pdo_before_the_place_of_its_sync_is_not_that_of_a_timer(early: float) -> None:
    answers, syncs = learned(0.3 * T)
    syncs.declare(0.45 * T)
    assert syncs.sync(BEGIN + (60 - early) * T, True, None) == ON_TIME
    assert answers.is_early(0.3 * T, syncs.grid)
    assert not answers.is_early((early + 0.3) * T, syncs.grid)


@given(seed=SEEDS)
def test_a_timer_on_a_loaded_bus_is_not_early(seed: int) -> None:
    """Half of the SYNCs wait for a frame: the line runs through their mean, the timer stands before it."""
    draw, syncs, answers = random.Random(seed), Syncs(), Answers()
    for n in range(400):
        at = n * T + draw.uniform(-3e-5, 3e-5) + draw.choice((0.0, draw.uniform(0.0, 135e-6)))
        syncs.sync(at, True, None)
        delay_s = max(0.0, n * T - at) + 140e-6
        assert n < 256 or not answers.is_early(delay_s, syncs.grid)
        answers.place(delay_s, syncs)


@given(places=st.integers(1, 3), early=st.floats(0.02, 0.08))
def test_no_pdo_answers_a_sync_that_may_still_come(places: int, early: float) -> None:
    answers, syncs = learned(0.05 * T)
    assert answers.place((places - early) * T, syncs) is None
    assert answers.place((places + 0.05) * T, syncs) == places
