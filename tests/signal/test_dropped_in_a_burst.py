"""Frames wait for a host that stalls, and some are dropped: nobody says how long it was.

The machine turns by whole cycles in each period, so that its phases fit any number of periods: the sample
times may be those of a clock that was set meanwhile.
"""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.signal.chain import SignalChain
from canfb.signal.chain_config import ChainConfig
from canfb.signal.sample import TICK_S, TICKS, Feedback, Sample
from canfb.signal.supervision import LOST, VALID
from ideal_tracks import counts_at

PERIOD_S = 1e-3
AT_REST, RAMP, STEADY = 80, 400, 60  # periods; then it turns by SPEED
SPEED = 4.0  # cycles per period


def position(at: float) -> float:
    """Cycles, ``at`` periods."""
    moving = max(0.0, at - AT_REST)
    ramp = min(moving, float(RAMP))
    return 0.3 + SPEED / RAMP * ramp * ramp / 2.0 + SPEED * max(0.0, moving - RAMP)


class Interface:
    """Sample ``n`` is taken at n periods, by a clock that was set by ``set_periods``."""

    def __init__(self) -> None:
        self.chain = SignalChain(ChainConfig(max_acceleration_cycles=0.012, coast_samples=40), None)
        self.set_periods = 0
        self.n = 0

    def sample(self, taken_s: float | None = None) -> Feedback:
        """The next one, whose SYNC the host takes then."""
        self.n += 1
        at = float(self.n)
        time_100ns = round((self.n + self.set_periods) * PERIOD_S / TICK_S) % TICKS
        sample = Sample(*counts_at(position(at), 1800.0), time_100ns=time_100ns)
        jitter_s = 20e-6 * abs(math.sin(1.3 * self.n))
        synced_s = self.n * PERIOD_S + jitter_s if taken_s is None else taken_s
        usual, chain = self.chain.times.in_turn(time_100ns, None, synced_s), self.chain
        known = sample.sine, sample.cosine, usual, True
        return chain.stages.take(*known) if usual else chain.step(sample, None, synced_s)

    def error_cycles(self, feedback: Feedback) -> float:
        return abs(feedback.cycles + feedback.phase - position(self.n))

    def running(self) -> Interface:
        for _ in range(AT_REST + RAMP + STEADY):
            feedback = self.sample()
        assert feedback.status & VALID
        assert self.error_cycles(feedback) < 0.1
        return self


@given(st.integers(1, 20), st.integers(1, 8), st.integers(4, 20))
def test_frames_dropped_among_others_cost_the_position(waiting: int, dropped: int, behind: int) -> None:
    interface = Interface().running()
    end_s = (interface.n + waiting + dropped + behind + 1) * PERIOD_S + 1e-4
    for k in range(waiting):
        interface.sample(end_s + 16e-6 * k)
    interface.n += dropped
    got = [interface.sample(end_s + 16e-6 * (waiting + k)) for k in range(behind)]
    assert not any(one.status & VALID for one in got)
    assert got[-1].status & LOST


@given(st.integers(1, 20), st.integers(1, 20), st.integers(1, 20))
def test_a_clock_that_was_set_meanwhile_is_never_believed(waiting: int, behind: int, periods: int) -> None:
    interface = Interface().running()
    end_s = (interface.n + waiting + behind + 1) * PERIOD_S + 1e-4
    for k in range(waiting + behind):
        if k == waiting:
            interface.set_periods = periods
        feedback = interface.sample(end_s + 16e-6 * k)
        assert not feedback.status & VALID or interface.error_cycles(feedback) < 0.1
    assert not any(interface.sample().status & VALID for _ in range(40))


@pytest.mark.parametrize("periods", [1, 3, 9])
def test_a_time_that_is_wrong_once_in_a_burst_is_never_believed(periods: int) -> None:
    interface = Interface().running()
    end_s = (interface.n + 20) * PERIOD_S
    for k in range(18):
        interface.set_periods = periods if k == 5 else 0
        feedback = interface.sample(end_s + 16e-6 * k)
        assert not feedback.status & VALID or interface.error_cycles(feedback) < 0.1
    for _ in range(40):
        feedback = interface.sample()
        assert not feedback.status & VALID or interface.error_cycles(feedback) < 0.1
