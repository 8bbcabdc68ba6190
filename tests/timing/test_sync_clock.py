"""One estimate of SYNC: it follows what is heard, in both kinds of time, and what it does not follow."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.timing.deviations import JITTER, LEAST_JITTER_S, TOGETHER
from canfb.timing.sync_clock import SyncClock, is_regular

PERIOD_S = 1e-3


def started(stamped: bool = True, nominal_s: float = 0.0, off: float = 0.0, late: float = 0.0) -> SyncClock:
    """A clock after its first SYNCs, jitter and lateness of the host in periods."""
    rng = np.random.default_rng(5)
    clock = SyncClock()
    clock.nominal_s = nominal_s
    clock.begin(0.0)
    for n in range(1, 60):
        wait = float(rng.uniform(0.0, late)) if late else 0.0
        if clock.start((n + float(rng.uniform(-off, off)) + wait) * PERIOD_S, stamped):
            return clock
    raise AssertionError("never known")


def follow(clock: SyncClock, first: int, groups: int, period_s: float, stamped: bool, late: float) -> None:
    rng = np.random.default_rng(6)
    for n in range(first, first + groups * TOGETHER):
        time_s = n * period_s + float(rng.exponential(late)) * PERIOD_S * (late > 0.0)
        clock.errors.append(time_s - clock.due_s)
        clock.due_s += clock.period_s
        if len(clock.errors) == TOGETHER:
            clock.learn(stamped)


@pytest.mark.parametrize(("stamped", "rel"), [(True, 0.02), (False, 0.02)])
def test_the_first_period_is_that_of_the_first_syncs(stamped: bool, rel: float) -> None:
    assert started(stamped, off=0.02).period_s == pytest.approx(PERIOD_S, rel=rel)


def test_a_host_that_is_late_moves_neither_period_nor_phase() -> None:
    clock = started(False, late=0.6)
    assert clock.period_s == pytest.approx(PERIOD_S, rel=0.03)
    first = round(clock.due_s / PERIOD_S)
    follow(clock, first, 60, PERIOD_S, False, 0.2)
    due = first + 60 * TOGETHER
    assert clock.period_s == pytest.approx(PERIOD_S, rel=1e-3)
    assert clock.due_s / PERIOD_S - due == pytest.approx(0.02, abs=0.05), "the earliest calls"


@pytest.mark.parametrize(("nominal", "taken"), [(1.0, True), (1.02, True), (0.9, False), (10.0, False)])
def test_1006h_is_taken_if_the_bus_agrees(nominal: float, taken: bool) -> None:
    clock = started(nominal_s=nominal * PERIOD_S)
    assert (clock.period_s == nominal * PERIOD_S) is taken


@given(st.floats(-2e-4, 2e-4), st.booleans())
def test_the_drift_of_two_crystals_is_followed(drift: float, stamped: bool) -> None:
    clock = started(stamped)
    period_s = PERIOD_S * (1.0 + drift)
    follow(clock, round(clock.due_s / PERIOD_S), 100, period_s, stamped, 0.0)
    assert clock.period_s == pytest.approx(period_s, rel=2e-5)
    assert clock.jitter == pytest.approx(LEAST_JITTER_S / PERIOD_S, rel=0.05)


def test_deviation_never_leaves_what_is_declared() -> None:
    clock = started()
    assert clock.jitter == JITTER
    for _ in range(50):
        clock.errors.extend([-5.0 * PERIOD_S, 5.0 * PERIOD_S] * 4)
        clock.learn(True)
    assert clock.jitter == JITTER
    clock.pause()
    assert (clock.jitter, clock.period_s > 0.0) == (JITTER, True)
    clock.forget()
    assert clock.period_s == 0.0


@given(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=40), st.booleans())
def test_any_times_may_come_first(times_s: list[float], stamped: bool) -> None:
    clock = SyncClock()
    clock.begin(times_s[0])
    for time_s in times_s[1:]:
        if clock.start(time_s, stamped):
            assert clock.period_s > 0.0
            break
    assert is_regular(times_s) in (True, False)
