"""Sample times against their witnesses: what is right, what is refused; nothing refused is learned."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.timing.interface_clock import (
    ANOTHER,
    RECEPTION_S,
    REFUSED,
    TICKS,
    InterfaceClock,
)
from canfb.timing.sync_clock import JITTER, LEAST_JITTER

PERIOD_S = 1e-3
PERIOD_TICKS = 10_000


class Interface:
    """Sample times one period apart, from a tick of choice; receptions with noise, or none."""

    def __init__(self, first: int = 0, received: bool = True, noise_s: float = 20e-6) -> None:
        self.clock, self.first, self.received = InterfaceClock(), first, received
        self.number = 0
        self._noise_s, self._rng = noise_s, np.random.default_rng(3)
        self.clock.begin(first % TICKS, 0.0 if received else None)
        self.clock.choose_unit((first + PERIOD_TICKS) % TICKS, PERIOD_S, 1)

    def next(self, off_ticks: int = 0, missed: int = 0) -> bool:
        """Whether the next time is right, ``off_ticks`` beside the truth."""
        self.number += 1 + missed
        tick = (self.first + self.number * PERIOD_TICKS + off_ticks) % TICKS
        synced_s = None
        if self.received:
            synced_s = self.number * PERIOD_S + float(self._rng.uniform(0.0, self._noise_s))
        if self.clock.usual(tick, synced_s):
            return True
        took_s = self.clock.took_s(tick)
        right = self.clock.is_right(took_s, PERIOD_S, synced_s, False)
        if right:
            self.clock.take(tick, took_s, synced_s)
        return right


@given(st.integers(0, TICKS - 1), st.booleans())
def test_right_times_are_taken_over_the_wrap(first: int, received: bool) -> None:
    interface = Interface(first, received)
    assert all(interface.next(missed=n % 3) for n in range(60))


@pytest.mark.parametrize("received", [True, False])
@pytest.mark.parametrize("before", [3, 31, 400])
def test_the_same_error_is_refused_again_and_again(received: bool, before: int) -> None:
    interface = Interface(received=received)
    off_ticks = 1500 if received else 4700
    assert all(interface.next() for _ in range(before))
    for pause in (1, 30, 600):
        limits = interface.clock.limit_s, interface.clock.grid.jitter
        assert not interface.next(off_ticks)
        assert (interface.clock.limit_s, interface.clock.grid.jitter) == limits
        assert all(interface.next() for _ in range(pause))


def test_the_sharper_witness_decides_and_limits_shrink_with_what_is_measured() -> None:
    grid = Interface(received=False)
    assert grid.clock.grid.jitter == JITTER
    assert all(grid.next() for _ in range(600))
    assert grid.clock.grid.jitter == LEAST_JITTER
    assert not grid.next(400)
    noisy = Interface(noise_s=80e-6)
    assert noisy.clock.limit_s == RECEPTION_S
    assert all(noisy.next() for _ in range(600))
    assert not noisy.next(900)


def test_whole_periods_are_refused_by_receptions_alone() -> None:
    interface = Interface()
    assert all(interface.next() for _ in range(40))
    assert not interface.next(3 * PERIOD_TICKS)


def test_a_clock_that_was_set_goes_on_from_there() -> None:
    clock = InterfaceClock()
    clock.begin(0, None)
    ticks = [123_456_789 + n * PERIOD_TICKS for n in range(ANOTHER)]
    results = [clock.refuse(tick, float(n), PERIOD_S) for n, tick in enumerate(ticks, 1)]
    assert results == [False] * (ANOTHER - 1) + [True]
    assert clock.last == ticks[-1]


def test_times_that_fit_nothing_begin_again_with_what_is_declared() -> None:
    rng = np.random.default_rng(4)
    interface = Interface(received=False)
    assert all(interface.next() for _ in range(200))
    clock = interface.clock
    results = [clock.refuse(int(rng.integers(TICKS)), float(n), PERIOD_S) for n in range(1, REFUSED + 1)]
    assert results == [False] * (REFUSED - 1) + [True]
    assert clock.grid.jitter == JITTER
