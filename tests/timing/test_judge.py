"""The judge on a bus whose truth is known: the true intervals are always among those that it gives."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from judged_bus import Bus, Result, Slot

from canfb.timing.interface_clock import RECEPTION_S
from canfb.timing.judge import USUAL, Judge, Passed, Refusal
from canfb.timing.sync_clock import JITTER
from canfb.timing.sync_judge import MEMORY, ON_TIME, RELOCK

FAULT = 70
WITNESSES = [
    (proved, overflow, timed) for proved in (False, True) for overflow in (0, 10, 240) for timed in (0, 1)
]
Change = Callable[[Bus, np.random.Generator], None]


def healthy(bus: Bus, rng: np.random.Generator) -> None:
    pass


def pdo_lost(bus: Bus, rng: np.random.Generator) -> None:
    for slot in bus.slots[FAULT : FAULT + int(rng.integers(1, 5))]:
        slot.pdo_lost = True


def deaf(bus: Bus, rng: np.random.Generator) -> None:
    for slot in bus.slots[FAULT : FAULT + int(rng.integers(1, 31))]:
        slot.to_module, slot.pdo_lost = False, True


def sync_lost(bus: Bus, rng: np.random.Generator) -> None:
    bus.slots[FAULT].to_module = False


def interface_deaf(bus: Bus, rng: np.random.Generator) -> None:
    bus.slots[FAULT].to_interface = False


def sync_twice(bus: Bus, rng: np.random.Generator) -> None:
    bus.slots[FAULT].again = float(rng.choice((rng.uniform(0.05, 0.12), rng.uniform(0.25, 0.7))))


def second_producer(bus: Bus, rng: np.random.Generator) -> None:
    for slot in bus.slots[FAULT:]:
        slot.again = 0.5


def stall(bus: Bus, rng: np.random.Generator) -> None:
    bus.stalls = [(FAULT + 0.3, FAULT + 0.3 + float(rng.uniform(1.0, 40.0)))]


def stall_with_loss(bus: Bus, rng: np.random.Generator) -> None:
    long = float(rng.uniform(3.0, 30.0))
    bus.stalls = [(FAULT + 0.3, FAULT + 0.3 + long)]
    first = FAULT + int(rng.integers(1, max(2, int(long))))
    for slot in bus.slots[first : first + int(rng.integers(1, 4))]:
        slot.to_module, slot.pdo_lost = False, True


def producer_shifts(bus: Bus, rng: np.random.Generator) -> None:
    shift = float(rng.uniform(-0.45, 0.45))
    for slot in bus.slots[FAULT:]:
        slot.late = shift


def another_rate(bus: Bus, rng: np.random.Generator) -> None:
    rate = float(rng.choice((-0.4, -0.2, 0.1, 0.2, 0.4)))
    for n, slot in enumerate(bus.slots[FAULT:], 1):
        slot.late = n * rate


def pdo_late(bus: Bus, rng: np.random.Generator) -> None:
    """Not by one period: that is the usual delay of the next SYNC (docs/wire-faults.md, P7)."""
    bus.slots[FAULT].pdo_late = float(rng.choice((0.3, 0.5, 0.7, 0.9, 1.15, 1.3, 1.4)))


def bad_times(bus: Bus, rng: np.random.Generator) -> None:
    """The same error again, beyond what the witness of each can be off by."""
    least = 1.4 * RECEPTION_S / bus.period_s + 0.02 if bus.proved else 0.47
    size = float(rng.uniform(least, 0.9))
    for at in (FAULT, FAULT + 30):
        bus.slots[at].stamp_off = size * float(rng.choice((-1.0, 1.0)))


def clock_set(bus: Bus, rng: np.random.Generator) -> None:
    step = float(rng.choice((rng.uniform(0.5, 1000.0), -rng.uniform(0.5, 30.0))))
    for slot in bus.slots[FAULT:]:
        slot.stamp_off = step


def everything_stalls(bus: Bus, rng: np.random.Generator) -> None:
    for slot in bus.slots[FAULT : FAULT + 2]:
        slot.produced = False
    bus.slots[FAULT + 2].late = late = float(rng.uniform(0.1, 0.7))
    bus.stalls = [(FAULT + 0.9, FAULT + 3.0 + late)]


CHANGES: tuple[Change, ...] = (
    healthy, pdo_lost, deaf, sync_lost, interface_deaf, sync_twice, second_producer, stall, stall_with_loss,
    producer_shifts, another_rate, pdo_late, bad_times, clock_set, everything_stalls,
)  # fmt: skip


def played(
    change: Change, proved: bool, overflow: int, timed: int, seed: int = 1, **options: float
) -> Result:
    bus = Bus([Slot() for _ in range(120)], proved=proved, overflow=overflow, timed=bool(timed), seed=seed)
    for name, value in options.items():
        setattr(bus, name, value)
    change(bus, np.random.default_rng(seed))
    return bus.play()


@pytest.mark.parametrize("change", CHANGES, ids=lambda change: change.__name__)
@pytest.mark.parametrize(("proved", "overflow", "timed"), WITNESSES)
def test_the_true_intervals_are_among_those_given(
    change: Change, proved: bool, overflow: int, timed: int
) -> None:
    if change is second_producer and not (proved or timed):
        return  # another rate
    for seed in range(6):
        result = played(change, proved, overflow, timed, seed)
        assert result.wrong == [], f"seed {seed}"


@given(
    st.sampled_from(CHANGES),
    st.sampled_from(WITNESSES),
    st.integers(0, 1 << 30),
    st.sampled_from((2.5e-4, 1e-3, 1e-2)),
    st.floats(-2e-4, 2e-4),
    st.sampled_from((0.0, 0.01, 0.04)),
)
def test_so_they_are_at_any_rate_drift_and_jitter(
    change: Change,
    witnesses: tuple[bool, int, int],
    seed: int,
    period_s: float,
    drift: float,
    jitter: float,
) -> None:
    if change is second_producer and not (witnesses[0] or witnesses[2]):
        return  # another rate
    result = played(change, *witnesses, seed, period_s=period_s, drift=drift, jitter=jitter)
    assert result.wrong == []


@pytest.mark.parametrize(("proved", "overflow", "timed"), WITNESSES)
def test_a_healthy_bus_needs_no_doubt_and_loses_no_sample(proved: bool, overflow: int, timed: int) -> None:
    result = played(healthy, proved, overflow, timed)
    assert result.used == list(range(120))
    assert (result.sets, result.doubts, result.errors) == (0, [], {})


@pytest.mark.parametrize("overflow", [10, 240])
def test_a_counter_says_what_was_missed_in_a_stall(overflow: int) -> None:
    for seed in range(20):
        result = played(stall, False, 240, 0, seed)
        assert (result.sets, result.doubts) == (0, [])
        assert result.used == list(range(120))


@pytest.mark.parametrize(("proved", "timed"), [(True, 0), (True, 1), (False, 1)])
def test_receive_or_sample_times_say_what_was_missed(proved: bool, timed: int) -> None:
    for change in (deaf, stall, stall_with_loss):
        for seed in range(10):
            result = played(change, proved, 0, timed, seed)
            assert (result.sets, result.doubts if not timed else []) == (0, []), (change.__name__, seed)


def test_a_burst_is_not_fed_into_the_period() -> None:
    for seed in range(20):
        for overflow in (0, 240):
            result = played(stall, False, overflow, 0, seed)
            assert result.judge.clock.period_s == pytest.approx(1e-3, rel=2e-3)


def test_one_sync_lost_without_any_witness_is_a_set_and_is_confirmed() -> None:
    def change(bus: Bus, rng: np.random.Generator) -> None:
        bus.slots[FAULT].to_module, bus.slots[FAULT].pdo_lost = False, True

    result = played(change, False, 0, 0)
    assert result.passed[FAULT + 1] == Passed((1.0, 2.0))
    verdict = result.verdicts[FAULT + 3]
    assert verdict.confirmed == 2.0  # type: ignore[attr-defined]
    assert result.doubts == []
    assert result.passed[FAULT + 4] is USUAL


def test_a_late_host_confirms_what_was_counted() -> None:
    def change(bus: Bus, rng: np.random.Generator) -> None:
        bus.stalls = [(FAULT + 0.9, FAULT + 3.3)]

    result = played(change, False, 0, 0)
    assert result.passed[FAULT].elapsed == (1.0, 2.0, 3.0)
    assert not result.passed[FAULT + 1].certain
    assert result.verdicts[FAULT + 2].confirmed == 1.0  # type: ignore[attr-defined]
    assert result.passed[FAULT + 2] is USUAL


@pytest.mark.parametrize("overflow", [0, 240])
def test_a_shifted_producer_puts_the_instants_in_doubt_by_as_much(overflow: int) -> None:
    def change(bus: Bus, rng: np.random.Generator) -> None:
        for slot in bus.slots[FAULT:]:
            slot.late = 0.3

    result = played(change, True, overflow, 0)
    affected = range(FAULT, FAULT + MEMORY)
    assert all(result.errors[n] == pytest.approx(0.3, abs=0.06) for n in affected)
    assert FAULT - 1 not in result.errors
    assert 119 not in result.errors, "the clock is set again"


def test_the_same_wrong_time_is_refused_each_time_and_forgotten_with_a_reset() -> None:
    for proved in (False, True):
        result = played(bad_times, proved, 0, 1, seed=3)
        assert sorted(result.errors) == [FAULT, FAULT + 30]
        judge = result.judge
        judge.forget()
        fresh = Judge()
        assert judge.interface.limit_s == fresh.interface.limit_s == RECEPTION_S
        assert judge.interface.grid.jitter == JITTER
        assert judge.clock.jitter == JITTER


def test_a_wrong_time_within_the_first_samples_is_refused() -> None:
    def change(bus: Bus, rng: np.random.Generator) -> None:
        for slot in bus.slots[12:13]:
            slot.stamp_off = 0.2

    assert 12 in played(change, True, 0, 1).errors


def test_a_wrong_1006h_is_not_believed() -> None:
    for factor in (0.1, 0.5, 0.9, 1.5, 2.0, 10.0):
        for timed in (0, 1):
            result = played(pdo_lost, True, 0, timed, nominal_s=1e-3 * factor)
            assert result.wrong == []
            assert result.judge.clock.period_s == pytest.approx(1e-3, rel=3e-3)
    exact = played(healthy, True, 0, 0, nominal_s=1e-3)
    assert exact.judge.clock.period_s == pytest.approx(1e-3, rel=1e-4)


def test_another_rate_is_found_and_each_sync_counts_for_canopen() -> None:
    for proved in (False, True):
        for rate in (-0.6, -0.4, -0.2):

            def change(bus: Bus, rng: np.random.Generator, rate: float = rate) -> None:
                for n, slot in enumerate(bus.slots[FAULT:], 1):
                    slot.late = n * rate

            result = played(change, proved, 0, 0, jitter=0.0)
            assert result.judge.clock.period_s == pytest.approx(1e-3 * (1.0 + rate), rel=0.02)
            assert min(result.doubts) <= FAULT + RELOCK
            assert not any(one.repeated for one in result.verdicts.values())  # type: ignore[attr-defined]


def test_a_repeated_counter_is_the_same_sync() -> None:
    judge = Judge()
    judge.overflow = 10
    for n in range(40):
        verdict = judge.sync(n * 1e-3, True, n % 10 + 1)
        judge.answer(n * 1e-3 + 2e-4, True)
    assert verdict is ON_TIME
    again = judge.sync(39.1e-3, True, 39 % 10 + 1)
    assert (again.repeated, again.extra) == (True, True)
    assert judge.sync(40e-3, True, 1) is ON_TIME


def test_the_usual_way_gives_the_same_two_objects() -> None:
    judge = Judge()
    for n in range(200):
        verdict = judge.sync(n * 1e-3, True, None)
        passed = judge.answer(n * 1e-3 + 2e-4, True)
    assert verdict is ON_TIME
    assert passed is USUAL


def test_an_outage_is_counted_by_the_deadline() -> None:
    judge = Judge()
    for n in range(40):
        judge.sync(n * 1e-3, True, None)
        judge.answer(n * 1e-3 + 2e-4, True)
    assert judge.until == pytest.approx(41e-3)
    assert judge.overdue(judge.until) == 1
    assert judge.overdue(judge.until) == 1
    verdict = judge.sync(45e-3, True, None)
    assert verdict.missed == 3
    assert judge.answer(45.2e-3, True) == Passed(6.0)


def test_an_incomplete_sample_is_missed() -> None:
    judge = Judge()
    for n in range(40):
        verdict = judge.sync(n * 1e-3, True, None)
        judge.answer(n * 1e-3 + 2e-4, True)
        if n == 38:
            judge.drop()
    assert verdict.missed == 1
    assert judge.sync(40e-3, True, None) is ON_TIME


times = st.floats(-1e6, 1e6) | st.sampled_from((float("inf"), float("-inf"), float("nan")))
steps = st.lists(
    st.tuples(
        st.sampled_from(("sync", "answer", "stamped", "overdue", "drop", "pause", "forget", "free")),
        st.floats(-0.01, 0.05) | times,
        st.booleans(),
        st.none() | st.integers(0, 255),
        st.integers(0, (1 << 32) - 1),
    ),
    max_size=80,
)


@given(steps, st.integers(0, 240), st.floats(0.0, 1.0))
def test_nothing_raises_for_any_input(
    calls: list[tuple[str, float, bool, int | None, int]], overflow: int, nominal_s: float
) -> None:
    judge = Judge()
    judge.overflow, judge.clock.nominal_s = overflow, nominal_s
    now = 0.0
    for what, step, proved, counter, tick in calls:
        now = now + step if abs(step) < 1.0 else step
        if what == "sync":
            judge.sync(now, proved, counter)
        elif what in ("answer", "free"):
            _is_possible(getattr(judge, what)(now, proved))
        elif what == "stamped":
            _is_possible(judge.stamped(tick, now, proved))
        elif what == "overdue":
            assert judge.overdue(now) >= 0
        else:
            getattr(judge, what)()


def _is_possible(passed: Passed | Refusal) -> None:
    if isinstance(passed, Passed):
        options = passed.elapsed if isinstance(passed.elapsed, tuple) else (passed.elapsed,)
        assert options
        assert all(one > 0.0 for one in options)
        assert passed.instant_error >= 0.0
