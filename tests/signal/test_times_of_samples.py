"""Sample times of the encoder interface: which are taken, and by what they are judged."""

import random

import pytest
from hypothesis import given, strategies as st
from witness_kit import at

from canfb import ChainConfig, SignalChain
from canfb.signal.sample import TICKS, Feedback
from canfb.signal.sample_times import HEARD_S, OLDEST, REPEATED, RESTARTED, SUSPECT, SampleTimes
from canfb.timing.grid import ROW
from folding import each

T = 10_000  # ticks: 1 ms
FAST = 125.0  # cycles per interval
starts = st.integers(0, TICKS - 1)
knowledge = pytest.mark.parametrize("known", ["nothing", "calls", "receive times"])


class Clock:
    """An interface that answers each SYNC, and what a module knows of it."""

    def __init__(
        self, known: str, start: int = 0, interval_s: float = 0.0, samples: int = 40, apart: int = T
    ) -> None:
        self.times, self.known, self.start, self.apart = SampleTimes(), known, start, apart
        self.times.sync_interval_s = interval_s
        self.n, self.counted, self.set_ticks = 0, 1.0, 0
        for _ in range(samples):
            assert self.next(speed=0.0) == pytest.approx(1.0, abs=1e-3)

    def next(self, off: float = 0.0, late_s: float = 0.0, speed: float = FAST, skip: int = 0) -> float:
        """The sample after ``skip`` that did not come; its time is ``off`` ticks, its SYNC late."""
        self.n += 1 + skip
        at = self.n * self.apart + round(late_s * 1e7)
        synced_s = at * 1e-7 + random.Random(self.n).uniform(0.0, 3e-5)
        time = (self.start + self.set_ticks + at + round(off)) % TICKS
        received = {
            "nothing": (None, None),
            "calls": (None, synced_s),
            "receive times": (synced_s + 2e-4, synced_s),
        }
        got = self.times.elapsed(time, self.counted + skip, *received[self.known], speed)
        self.counted = self.counted + 1.0 + skip if got < 0.0 and got != RESTARTED else 1.0
        return got


def test_a_long_first_interval_is_not_the_pace() -> None:
    """Its producer stalled, and no receive time says so; the later ones are even."""
    times, counted = SampleTimes(), 1.0
    for tenths in (0, 28, 38, 48, 58, 68, 78, 88, 98):
        got = times.elapsed(1000 * tenths, counted, None, tenths * 1e-4)
        counted = 1.0 if got > 0.0 else counted + 1.0
    assert (got, times.grid.period) == pytest.approx((1.0, 1e4))


def test_the_first_syncs_of_a_paced_interface_may_come_at_any_time() -> None:
    """Its clock goes on by a period with each SYNC, as that of canfb simulate --pace sync."""
    times, heard_s = SampleTimes(), (0.0, 0.25, 0.5, 0.75, 0.76, 0.77, 0.78)
    got = [times.elapsed(100_000 * n, 1.0, at + 5e-4, at) for n, at in enumerate(heard_s)]
    assert got == pytest.approx([1.0] * len(heard_s))


@knowledge
@given(
    start=starts, drift=st.floats(-1e-4, 1e-4), gaps=st.lists(st.integers(0, 7), max_size=40), data=st.data()
)
def test_any_drift_wrap_and_jitter_is_measured(
    known: str, start: int, drift: float, gaps: list[int], data: st.DataObject
) -> None:
    clock = Clock(known, start)
    last = clock.n * T
    for gap in gaps:
        jitter = data.draw(st.integers(-2000, 2000))
        added = round((clock.n + 1 + gap) * T * drift)
        got = clock.next(off=added, late_s=jitter * 1e-7, skip=gap)
        here = clock.n * T + jitter + added
        assert got * clock.times.unit_s == pytest.approx(1e-7 * (here - last), abs=2e-7)
        last = here


@knowledge
@pytest.mark.parametrize("interval_s", [0.0, 1e-3])
@given(start=starts, wrong=starts, before=st.integers(0, 40))
def test_one_bad_time_costs_one_sample(
    known: str, interval_s: float, start: int, wrong: int, before: int
) -> None:
    clock = Clock(known, start, interval_s)
    for _ in range(before):
        clock.next()
    off = (wrong + TICKS // 2) % TICKS - TICKS // 2
    got = clock.next(off=off)
    limit = HEARD_S * 1e7 + 300 if known == "receive times" else 0.45 * T
    assert got < 0.0 or abs(off) <= limit
    if got < 0.0:
        assert clock.next() == pytest.approx(2.0, abs=1e-3), "from the last good one"


@pytest.mark.parametrize("apart", [T // 2, T, 10 * T, 100 * T])
@given(wrong=st.lists(st.integers(-5, 5).filter(bool), min_size=1, max_size=ROW - 1, unique=True))
def test_wrong_times_do_not_count_against_the_receive_times(apart: int, wrong: list[int]) -> None:
    """They are still the judge of the next one, which is off by more than they may be."""
    clock = Clock("receive times", apart=apart)
    for intervals in wrong:
        assert clock.next(off=intervals * apart) < 0.0
    assert clock.next(off=4 * HEARD_S * 1e7) < 0.0


@knowledge
@given(back=st.integers(0, int(OLDEST) - 2))
def test_earlier_samples_change_nothing(known: str, back: int) -> None:
    clock = Clock(known, samples=80)
    assert clock.next(off=-(back + 1) * T) == REPEATED
    assert clock.next() == pytest.approx(2.0, abs=1e-3)


@knowledge
@given(start=starts, ticks=st.integers(-TICKS // 2, TICKS // 2))
def test_a_clock_that_was_set_is_known_by_a_row_of_times(known: str, start: int, ticks: int) -> None:
    clock = Clock(known, start)
    clock.set_ticks = ticks
    got = [clock.next()]
    if got[0] < 0.0:  # else it looks like the next sample
        got += [clock.next() for _ in range(ROW - 1)]
        assert RESTARTED in got or got[-1] > 0.0
        assert all(clock.next() == pytest.approx(1.0, abs=0.05) for _ in range(4))


def test_syncs_that_were_not_sent_are_known_by_the_second_call() -> None:
    """The producer stalled: times and calls agree, and no frame waited."""
    clock = Clock("calls")
    clock.n += 3
    assert clock.next() == SUSPECT
    assert clock.next() == pytest.approx(5.0, abs=1e-3)


@each("known, off, late_s, passed", [
    ("receive times", 0, 6e-4, 1.6),
    ("calls", 0, 6e-4, SUSPECT),  # it may be a wrong time
    ("calls", 1500, 0.0, SUSPECT),  # no host takes a SYNC before it comes
    ("calls", -1500, 0.0, 0.85),  # it may have been late
])  # fmt: skip
def test_a_sync_off_the_grid(known: str, off: int, late_s: float, passed: float) -> None:
    assert Clock(known).next(off, late_s) == pytest.approx(passed, abs=0.01)


def test_a_timer_of_the_interface_is_known_by_its_line() -> None:
    """SYNC waits for other frames, the timer does not."""
    clock, draw = Clock("receive times"), random.Random(1)
    for _ in range(300):
        late = draw.choice([0.0, 0.0, 135e-6])
        assert clock.next(off=-round(late * 1e7), late_s=late, speed=2.0) == pytest.approx(1.0, abs=1e-3)
    got = [clock.next(off=-round(late * 1e7), late_s=late) for late in [135e-6, 0.0] * 20]
    assert got == pytest.approx([1.0] * 40, abs=1e-3)


def test_what_is_declared_is_the_limit_without_receive_times() -> None:
    clock = Clock("nothing", samples=300)
    clock.times.grid.declare(1000.0)
    assert clock.next(off=1200) == pytest.approx(1.12, abs=1e-3)
    assert clock.next(off=1400) == SUSPECT


@pytest.mark.parametrize("ticks", [0, -1, -T])
def test_without_a_unit_the_first_interval_is_ahead(ticks: int) -> None:
    times = SampleTimes()
    times.elapsed(50_000, 1.0)
    assert times.elapsed(50_000 + ticks, 1.0) == REPEATED
    assert times.elapsed(50_000 + 3 * T, 3.0) == pytest.approx(3.0), "missed samples do not stretch it"
    assert times.unit_s == pytest.approx(1e-3)
    times.sync_interval_s = 2e-3
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

    def step(number: int) -> Feedback:
        return chain.step(at(speed * number, time_100ns=number * T))

    assert all(step(number).valid for number in range(40))
    after = [step(40 + unheard + number) for number in range(20)]
    assert chain.lost is lost
    assert all(not one.valid or abs(one.cycles + one.phase) < 0.01 for one in after)


@pytest.mark.parametrize("stamped", [True, False])
def test_extra_syncs_do_not_change_the_pace(stamped: bool) -> None:
    """Samples that answer SYNCs of a second producer, between the others, are none of their line."""
    generator = random.Random(11)
    for extra in (8, 20, 30, 60):
        times, at = SampleTimes(), 0
        for number in range(60 + 2 * extra + 60):
            between = 60 <= number < 60 + 2 * extra and not number % 2
            grid = at - at % T
            at = grid + (round(T * generator.uniform(0.25, 0.45)) if between else T)
            synced_s = None if between else at * 1e-7  # which SYNC it answers is open
            times.elapsed(at, 1.0, at * 1e-7 if stamped else None, synced_s)
            assert number < 2 or times.unit_s == pytest.approx(1e-3), extra
