"""The judge on a bus whose truth is known: the true intervals are always among those that it gives."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from judged_bus import Bus, Result, Slot

from canfb.timing.deviations import JITTER
from canfb.timing.judge import USUAL, Judge, Passed, Refusal
from canfb.timing.sync_judge import LEAST_EARLY, RELOCK, SyncJudge
from canfb.timing.sync_verdict import NOTHING_TO_REPORT, SyncVerdict

FAULT = 70
WITNESSES = [(stamped, overflow) for stamped in (False, True) for overflow in (0, 10, 240)]
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
    """Where that is the usual delay of the next SYNC, it is P7 of tools/faults/wire/README.md."""
    bus.slots[FAULT].pdo_late = float(rng.choice((0.3, 0.5, 0.7, 0.9, 1.15, 1.3, 1.4)))


def all_together(bus: Bus, rng: np.random.Generator) -> None:
    """SYNCs that the module or the interface does not receive, PDOs late or lost: also several in a row."""
    for slot in bus.slots[FAULT:]:
        slot.to_module, slot.to_interface = bool(rng.uniform() > 0.08), bool(rng.uniform() > 0.08)
        slot.pdo_lost = bool(rng.uniform() < 0.08)
        slot.pdo_late = float(rng.uniform(0.3, 0.7)) if rng.uniform() < 0.3 else 0.0


def everything_stalls(bus: Bus, rng: np.random.Generator) -> None:
    for slot in bus.slots[FAULT : FAULT + 2]:
        slot.produced = False
    bus.slots[FAULT + 2].late = late = float(rng.uniform(0.1, 0.7))
    bus.stalls = [(FAULT + 0.9, FAULT + 3.0 + late)]


CHANGES: tuple[Change, ...] = (
    healthy, pdo_lost, deaf, sync_lost, interface_deaf, sync_twice, second_producer, stall, stall_with_loss,
    producer_shifts, another_rate, pdo_late, all_together, everything_stalls,
)  # fmt: skip


def played(change: Change, stamped: bool, overflow: int, seed: int = 1, **options: float) -> Result:
    bus = Bus([Slot() for _ in range(120)], stamped=stamped, overflow=overflow, seed=seed)
    for name, value in options.items():
        setattr(bus, name, value)
    change(bus, np.random.default_rng(seed))
    return bus.play()


@pytest.mark.parametrize("change", CHANGES, ids=lambda change: change.__name__)
@pytest.mark.parametrize(("stamped", "overflow"), WITNESSES)
def test_the_true_intervals_are_among_those_given(change: Change, stamped: bool, overflow: int) -> None:
    if change is second_producer and not stamped:
        return  # another rate
    if change is all_together and not (stamped or overflow):
        return  # nothing shows a SYNC that was not received (tools/faults/wire/README.md, P1)
    for seed in range(60 if change is all_together else 6):
        result = played(change, stamped, overflow, seed)
        assert result.wrong == [], f"seed {seed}"


@given(
    st.sampled_from(CHANGES),
    st.sampled_from(WITNESSES),
    st.integers(0, 1 << 30),
    st.sampled_from((2.5e-4, 1e-3, 1e-2)),
    st.sampled_from((0.0, 0.01, 0.04)),
)
def test_so_they_are_at_any_rate_and_jitter(
    change: Change,
    witnesses: tuple[bool, int],
    seed: int,
    period_s: float,
    jitter: float,
) -> None:
    if (change is second_producer and not witnesses[0]) or (
        change is all_together and witnesses == (False, 0)
    ):
        return  # another rate; nothing shows what was not received
    result = played(change, *witnesses, seed, period_s=period_s, jitter=jitter)
    assert result.wrong == []


@pytest.mark.parametrize("seed", [1012, 1024, 1036])
def test_a_host_that_waits_again_and_is_late_again_has_not_all(seed: int) -> None:
    """SYNCs that moved to shortly before their grid: one was extra, those after it nearly a period late."""
    for jitter in (0.0, 0.01, 0.04):
        assert played(producer_shifts, False, 0, seed, jitter=jitter).wrong == []


@pytest.mark.parametrize(("stamped", "overflow"), WITNESSES)
def test_a_healthy_bus_needs_no_doubt_and_loses_no_sample(stamped: bool, overflow: int) -> None:
    result = played(healthy, stamped, overflow)
    assert result.used == list(range(120))
    assert (result.sets, result.doubts, result.errors) == (0, [], {})


def test_a_counter_says_what_was_missed_in_a_stall() -> None:
    for seed in range(20):
        result = played(stall, False, 240, seed)
        assert (result.sets, result.doubts) == (0, [])
        assert result.used == list(range(120))


def test_receive_times_say_what_was_missed() -> None:
    for change in (deaf, stall, stall_with_loss):
        for seed in range(10):
            result = played(change, True, 0, seed)
            assert (result.sets, result.doubts) == (0, []), (change.__name__, seed)


def test_a_reset_forgets_the_clock() -> None:
    judge = played(healthy, True, 0).judge
    judge.forget()
    assert (judge.syncs.clock.period_s, judge.syncs.clock.jitter) == (0.0, JITTER)


def test_a_burst_is_not_fed_into_the_period() -> None:
    for seed in range(20):
        for overflow in (0, 240):
            result = played(stall, False, overflow, seed)
            assert result.judge.syncs.clock.period_s == pytest.approx(1e-3, rel=2e-3)


def test_one_sync_lost_without_any_witness_is_a_set_and_is_confirmed() -> None:
    def change(bus: Bus, rng: np.random.Generator) -> None:
        bus.slots[FAULT].to_module, bus.slots[FAULT].pdo_lost = False, True

    result = played(change, False, 0)
    assert result.passed[FAULT + 1] == Passed((1.0, 2.0))
    verdict = result.verdicts[FAULT + 3]
    assert verdict.confirmed == 2.0  # type: ignore[attr-defined]
    assert result.doubts == []
    assert result.passed[FAULT + 4] is USUAL


@pytest.mark.parametrize(
    "late", [(0.85, 0.88, 0.61), (0.63, 0.95, 0.96), (0.9, 0.95, 0.98), (1.02, 1.05, 1.08)]
)
def test_nothing_is_missing_for_certain_where_a_sync_would_be_early(late: tuple[float, ...]) -> None:
    """A host that is late again and again: its SYNCs would be those of a gap, but sooner than any before."""
    judge = followed(40, stamped=False, noise_s=0.2e-3)
    assert judge.syncs.clock.jitter > 0.4
    due_s = judge.syncs.clock.due_s
    for n, one in enumerate(late):
        verdict = judge.syncs.sync(due_s + (n + one) * 1e-3, False, None)
        judge.answer(due_s + (n + one) * 1e-3 + 1e-5, False)
    if min(late) > 1.0 - LEAST_EARLY:
        assert (verdict.confirmed, verdict.lost, verdict.doubt) == (2.0, 1, 0.0)
    else:
        assert (verdict.confirmed, verdict.doubt) == (None, 1.0)


def test_a_sync_that_is_missing_counts_once_where_its_answer_may_have_come() -> None:
    """No PDO for the last SYNC, then one where the next answer is due, and a SYNC a period late."""
    judge = followed(stamped=False)
    judge.syncs.sync(40e-3, False, None)
    assert judge.answer(41.2e-3, False) == Passed((1.0, 2.0))
    for n in (42, 43, 44):
        verdict = judge.syncs.sync(n * 1e-3, False, None)
        judge.answer((n + 0.2) * 1e-3, False)
    # Three intervals in all, of which the answer before may have taken one or two.
    assert (verdict.confirmed, verdict.lost, verdict.doubt) == (None, 1, 1.0)


def test_a_late_host_confirms_what_was_counted() -> None:
    def change(bus: Bus, rng: np.random.Generator) -> None:
        bus.stalls = [(FAULT + 0.9, FAULT + 3.3)]

    result = played(change, False, 0)
    assert result.passed[FAULT].elapsed == (1.0, 2.0, 3.0)
    assert not result.passed[FAULT + 1].certain
    assert result.verdicts[FAULT + 2].confirmed == 1.0  # type: ignore[attr-defined]
    assert result.passed[FAULT + 2] is USUAL


@pytest.mark.parametrize("overflow", [0, 240])
def test_a_shifted_producer_puts_the_instants_in_doubt_by_as_much(overflow: int) -> None:
    def change(bus: Bus, rng: np.random.Generator) -> None:
        for slot in bus.slots[FAULT:]:
            slot.late = 0.3

    result = played(change, True, overflow)
    affected = range(FAULT, FAULT + RELOCK - 1)
    assert all(result.errors[n] == pytest.approx(0.3, abs=0.06) for n in affected)
    assert set(result.errors) <= set(range(FAULT, FAULT + RELOCK))
    assert result.verdicts[FAULT + RELOCK - 1].doubt == pytest.approx(0.3, abs=0.06)  # type: ignore[attr-defined]


def test_a_wrong_1006h_is_not_believed() -> None:
    for factor in (0.1, 0.5, 0.9, 1.5, 2.0, 10.0):
        result = played(pdo_lost, True, 0, nominal_s=1e-3 * factor)
        assert result.wrong == []
        assert result.judge.syncs.clock.period_s == pytest.approx(1e-3, rel=3e-3)
    exact = played(healthy, True, 0, nominal_s=1e-3)
    assert exact.judge.syncs.clock.period_s == pytest.approx(1e-3, rel=1e-4)


def test_another_rate_is_found_and_each_sync_counts_for_canopen() -> None:
    for stamped in (False, True):
        for rate in (-0.6, -0.4, -0.2):

            def change(bus: Bus, rng: np.random.Generator, rate: float = rate) -> None:
                for n, slot in enumerate(bus.slots[FAULT:], 1):
                    slot.late = n * rate

            result = played(change, stamped, 0, jitter=0.0)
            assert result.judge.syncs.clock.period_s == pytest.approx(1e-3 * (1.0 + rate), rel=0.02)
            assert min(result.doubts) <= FAULT + RELOCK
            assert not any(one.repeated for one in result.verdicts.values())  # type: ignore[attr-defined]


def test_a_repeated_counter_is_the_same_sync() -> None:
    judge = Judge()
    judge.syncs.overflow = 10
    for n in range(40):
        verdict = judge.syncs.sync(n * 1e-3, True, n % 10 + 1)
        judge.answer(n * 1e-3 + 2e-4, True)
    assert verdict is NOTHING_TO_REPORT
    again = judge.syncs.sync(39.1e-3, True, 39 % 10 + 1)
    assert (again.repeated, again.extra) == (True, True)
    assert judge.syncs.sync(40e-3, True, 1) is NOTHING_TO_REPORT


def test_the_usual_way_gives_the_same_two_objects() -> None:
    judge = Judge()
    for n in range(200):
        verdict = judge.syncs.sync(n * 1e-3, True, None)
        passed = judge.answer(n * 1e-3 + 2e-4, True)
    assert verdict is NOTHING_TO_REPORT
    assert passed is USUAL


def test_an_outage_is_counted_by_the_deadline() -> None:
    judge = Judge()
    for n in range(40):
        judge.syncs.sync(n * 1e-3, True, None)
        judge.answer(n * 1e-3 + 2e-4, True)
    assert judge.syncs.until == pytest.approx(41e-3 + judge.syncs.clock.jitter * 1e-3)
    assert judge.syncs.overdue(judge.syncs.until) == 1
    assert judge.syncs.overdue(judge.syncs.until) == 1
    verdict = judge.syncs.sync(45e-3, True, None)
    assert verdict.missed == 3
    assert judge.answer(45.2e-3, True) == Passed(6.0)


def test_an_incomplete_sample_is_missed() -> None:
    judge = Judge()
    for n in range(40):
        verdict = judge.syncs.sync(n * 1e-3, True, None)
        judge.answer(n * 1e-3 + 2e-4, True)
        if n == 38:
            judge.drop()
    assert verdict.missed == 1
    assert judge.syncs.sync(40e-3, True, None) is NOTHING_TO_REPORT


def followed(syncs: int = 40, stamped: bool = True, noise_s: float = 0.0) -> Judge:
    """A judge of SYNCs 1 ms apart, each answered after 0.2 ms."""
    judge, rng = Judge(), np.random.default_rng(3)
    for n in range(syncs):
        at_s = n * 1e-3 + float(rng.uniform(-noise_s, noise_s)) * (n < syncs - 1)
        judge.syncs.sync(at_s, stamped, None)
        judge.answer(at_s + 2e-4, stamped)
    return judge


def test_nothing_is_sent_before_it_is_measured() -> None:
    """An answer before the grid, and sooner after it than any, is of a SYNC that was early by as much."""
    for early_s, error in ((0.36e-3, 0.30), (0.15e-3, 0.09), (0.05e-3, 0.0)):
        judge = followed(noise_s=0.12e-3)  # so much that the first SYNC is still one in time
        assert judge.syncs.clock.jitter > 0.44
        judge.syncs.sync(40e-3 - early_s, True, None)
        passed = judge.answer(40.2e-3 - early_s, True)
        assert isinstance(passed, Passed)
        assert passed.elapsed == 1.0
        assert passed.instant_error == pytest.approx(error, abs=0.05 if error else 0.0)
        judge.syncs.sync(41e-3 - early_s, True, None)  # at the usual distance, but from one that was not used
        passed = judge.answer(41.2e-3 - early_s, True)
        assert isinstance(passed, Passed)
        assert passed.instant_error == pytest.approx(error, abs=0.07 if error else 0.0)


def test_without_receive_times_only_what_was_early_is_usual() -> None:
    """A host that is late by any time makes no SYNC early: an extra one on it is off the grid by as much."""
    judge, rng = Judge(), np.random.default_rng(3)
    for n in range(100):
        at_s = n * 1e-3 + float(rng.uniform(0.04, 0.32)) * 1e-3
        judge.syncs.sync(at_s, False, None)
        judge.answer(at_s + 2e-4, False)
    assert judge.syncs.clock.jitter > 0.4
    judge.syncs.sync(99.75e-3, False, None)
    passed = judge.answer(100.1e-3, False)
    assert isinstance(passed, Passed)
    assert passed.instant_error == pytest.approx(0.3, abs=0.05)


def test_a_dropped_sample_leaves_no_interval_open() -> None:
    judge = followed()
    judge.syncs.sync(40e-3, True, None)
    judge.syncs.sync(41e-3, True, None)
    assert judge.answer(41.5e-3, True) == Passed((1.0, 2.0))  # to either of them
    judge.drop()
    judge.syncs.sync(42e-3, True, None)
    assert judge.answer(42.2e-3, True) == Passed(3.0)


def test_a_usual_sample_that_is_dropped_is_one_interval_after_a_gap_as_well() -> None:
    judge = followed()
    judge.syncs.sync(40e-3, True, None)
    judge.syncs.sync(41e-3, True, None)
    assert judge.answer(41.2e-3, True) == Passed(2.0)
    judge.syncs.sync(42e-3, True, None)
    judge.answer(42.2e-3, True)
    judge.syncs.sync(43e-3, True, None)
    assert judge.answer(43.2e-3, True) is USUAL
    judge.drop()
    judge.syncs.sync(44e-3, True, None)
    assert judge.answer(44.2e-3, True) == Passed(2.0)


def test_a_sync_that_was_answered_is_not_open_any_more() -> None:
    """An answer that is too soon cannot be that of the SYNC before, if that one was answered."""
    judge = followed(stamped=False)
    judge.syncs.sync(40e-3, False, None)
    judge.syncs.sync(41e-3, False, None)
    assert judge.answer(41.2e-3, False) == Passed(2.0)
    judge.syncs.sync(42e-3, False, None)
    judge.answer(42.02e-3, False)
    judge.syncs.sync(43e-3, False, None)
    assert judge.answer(43.2e-3, False) is USUAL


times = st.floats(-1e6, 1e6) | st.sampled_from((float("inf"), float("-inf"), float("nan")))
steps = st.lists(
    st.tuples(
        st.sampled_from(
            (
                "sync",
                "answer",
                "answered_last_sync",
                "give_up",
                "overdue",
                "drop",
                "pause",
                "forget",
                "free",
            )
        ),
        st.floats(-0.01, 0.05) | times,
        st.booleans(),
        st.none() | st.integers(0, 255),
    ),
    max_size=80,
)


@given(steps, st.integers(0, 240), st.floats(0.0, 1.0))
def test_nothing_raises_for_any_input(
    calls: list[tuple[str, float, bool, int | None]], overflow: int, nominal_s: float
) -> None:
    judge = Judge()
    judge.syncs.overflow, judge.syncs.clock.nominal_s = overflow, nominal_s
    now = 0.0
    for what, step, stamped, counter in calls:
        now = now + step if abs(step) < 1.0 else step
        if what == "sync":
            judge.syncs.sync(now, stamped, counter)
        elif what in ("answer", "free"):
            _is_possible(getattr(judge, what)(now, stamped))
        elif what == "overdue":
            assert judge.syncs.overdue(now) >= 0
        elif what == "give_up":
            judge.syncs.give_up()
        else:
            getattr(judge, what)()


def _is_possible(passed: Passed | Refusal) -> None:
    if isinstance(passed, Passed):
        options = passed.options
        assert options
        assert all(one > 0.0 for one in options)
        assert passed.instant_error >= 0.0


@pytest.mark.parametrize("delay_s", [0.0, 2e-4])
def test_a_usual_sync_is_not_judged_even_if_its_answer_is_in_the_same_call(
    delay_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither are early by what a float rounds: it made each cycle cost 2.7 times as much."""
    judge = Judge()
    judged: list[float] = []
    original = SyncJudge._judged

    def counted(syncs: SyncJudge, time_s: float, stamped: bool, counter: int | None) -> SyncVerdict:
        judged.append(time_s)
        return original(syncs, time_s, stamped, counter)

    monkeypatch.setattr(SyncJudge, "_judged", counted)
    now = 1000.0
    for _ in range(400):
        now += 1e-3
        judge.syncs.sync(now, False, None)
        assert isinstance(judge.answer(now + delay_s, False), Passed)
    assert len(judged) < 60


@pytest.mark.parametrize(("delay", "intervals"), [(0.913, (1.0,)), (1.2, (1.0,)), (1.4, (1.0, 2.0))])
def test_a_sync_that_is_not_due_yet_has_no_answer(delay: float, intervals: tuple[float, ...]) -> None:
    """An old PDO in place of a lost one, late in the interval, was held against two intervals as well."""
    judge, period_s = Judge(), 1e-3
    for n in range(100):
        judge.syncs.sync(n * period_s, True, n % 10 + 1)
        judge.answer((n + 0.37) * period_s, True)
    judge.syncs.sync(100 * period_s, True, 1)
    passed = judge.answer((100 + delay) * period_s, True)
    assert isinstance(passed, Passed)
    assert passed.options == intervals


def test_each_attribute_has_a_slot() -> None:
    """In a dict of more than 30 each access costs more, and nearly all of a SYNC are accesses."""
    judge = Judge()
    assert not any(hasattr(one, "__dict__") for one in (judge, judge.syncs, judge.syncs.count))
