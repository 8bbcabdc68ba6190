"""Stamps of the time of day on the clock of the runner: steps, other clocks, a processor that was away."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.bus.clocks import LARGEST_STEP_S, LEARNED_FRAMES, LONGEST_DELAY_S, OtherClock, ReceiveTimes
from canfb.bus.raw_can_bus import LONGEST_LATENCY_S

RESOLUTION_S = 1e-6  # of a float that holds a time of day
STEPS = [-3600.0, -1.0, -0.01, -0.001, 0.001, 0.01, 1.0, 3600.0]


class Clocks:
    """A monotonic clock, and a time of day that is set now and then."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.ahead_s = 1.8e9
        self.away_s: list[float] = []  # how long the processor is away before each look at the time of day

    def wall(self) -> float:
        if self.away_s:
            self.now += self.away_s.pop(0)
        return self.now + self.ahead_s

    def stamp(self, ago_s: float = 0.0) -> float:
        """Of a frame that came so long ago, by the time of day as it is."""
        return self.now - ago_s + self.ahead_s

    def times(self) -> ReceiveTimes:
        return ReceiveTimes(lambda: self.now, self.wall)


@pytest.fixture
def clocks() -> Clocks:
    return Clocks()


@given(st.lists(st.tuples(st.floats(0.0, 10.0), st.floats(0.0, 59.9)), min_size=1, max_size=30))
def test_it_is_when_the_frame_came(frames: list[tuple[float, float]]) -> None:
    clocks = Clocks()
    times = clocks.times()
    for passed_s, ago_s in frames:
        clocks.now += passed_s
        got = times.received(clocks.stamp(ago_s), clocks.now)
        assert got == pytest.approx(clocks.now - ago_s, abs=RESOLUTION_S)
        assert got is not None
        assert got <= clocks.now


@given(st.lists(st.floats(-4e-5, 4e-5), min_size=1, max_size=200))
def test_a_time_of_day_that_is_slewed_is_followed(drifts_s: list[float]) -> None:
    """NTP slews by 500 ppm at most: 50 us in 0.1 s; that is no step."""
    clocks = Clocks()
    times = clocks.times()
    for drift_s in drifts_s:
        clocks.now += 0.1
        clocks.ahead_s += drift_s
        got = times.received(clocks.stamp(0.002), clocks.now)
        assert got == pytest.approx(clocks.now - 0.002, abs=RESOLUTION_S)


@pytest.mark.parametrize("step_s", STEPS)
def test_frames_that_wait_over_a_step_have_no_time(clocks: Clocks, step_s: float) -> None:
    """Before and after the step alike: nobody knows which clock stamped them."""
    times = clocks.times()
    before = clocks.stamp(0.003)
    clocks.ahead_s += step_s
    after = clocks.stamp(0.001)
    assert times.received(before, clocks.now) is None
    assert times.received(after, clocks.now) is None
    clocks.now += 0.5
    assert times.received(clocks.stamp(), clocks.now) is None, "the queue was not empty yet"
    times.emptied()
    clocks.now += 0.5
    assert times.received(clocks.stamp(0.004), clocks.now) == pytest.approx(
        clocks.now - 0.004, abs=RESOLUTION_S
    )


@given(st.sampled_from(STEPS), st.sampled_from(STEPS), st.floats(0.0, 0.5))
def test_no_frame_gets_a_time_of_the_wrong_clock(first_s: float, second_s: float, ago_s: float) -> None:
    clocks = Clocks()
    times = clocks.times()
    came = [(clocks.now - ago_s, clocks.stamp(ago_s))]
    for step_s in (first_s, second_s):
        clocks.ahead_s += step_s
        came.append((clocks.now - ago_s, clocks.stamp(ago_s)))
        for true_s, stamp_s in came:
            got = times.received(stamp_s, clocks.now)
            assert got is None or got == pytest.approx(true_s, abs=2 * LARGEST_STEP_S)


@pytest.mark.parametrize(
    "stamp_s", [0.0, 77.0, 1.7e9, 1.9e9, -1.0, float("nan"), float("inf"), float("-inf")]
)
def test_stamps_of_another_clock_that_stands_still_are_not_used(clocks: Clocks, stamp_s: float) -> None:
    times = clocks.times()
    for _ in range(5 * LEARNED_FRAMES):
        assert times.received(stamp_s, clocks.now) is None
        clocks.now += 1e-3
    assert times.received(clocks.stamp(), clocks.now) is not None, "and cost nothing"


@pytest.mark.parametrize(
    ("ago_s", "used"),
    [(LONGEST_DELAY_S - 0.01, True), (LONGEST_DELAY_S + 0.01, False), (-4e-4, True), (-6e-4, False)],
)
def test_how_far_a_stamp_may_be_off(clocks: Clocks, ago_s: float, used: bool) -> None:
    got = clocks.times().received(clocks.stamp(ago_s), clocks.now)
    assert (got is not None) is used
    assert got is None or got <= clocks.now, "nothing comes later than now"


@pytest.mark.parametrize("away_s", [2e-5, 6e-5, 3e-4, 0.001, 0.05, 2.0])
def test_a_processor_that_is_away_between_two_looks_makes_no_step(clocks: Clocks, away_s: float) -> None:
    """Nor does a frame seem to come earlier: 60 us are enough to take an ADC PDO for one of another SYNC."""
    times = clocks.times()
    now = clocks.now
    stamp = clocks.stamp(0.002)
    clocks.away_s = [away_s]  # between the clock of the runner and the time of day
    got = times.received(stamp, now)
    assert got == pytest.approx(now - 0.002, abs=RESOLUTION_S)
    clocks.now += 0.01
    assert times.received(clocks.stamp(), clocks.now) == pytest.approx(clocks.now, abs=RESOLUTION_S)


class Adapter:
    """Frames of a USB adapter that stamps them by a clock of its own, which drifts."""

    def __init__(self, starts_s: float = 77.0, drift: float = 1e-4, seed: int = 1) -> None:
        self.clocks, self.rng = Clocks(), random.Random(seed)
        self.times = self.clocks.times()
        self.starts_s, self.rate, self.came_s = starts_s, 1.0 + drift, self.clocks.now
        self.errors_s: list[float] = []

    def frame(self, late_s: float = 0.0, after_s: float = 1e-3) -> float | None:
        """One frame, taken so late beyond a delay of 0.1 to 0.2 ms; by how much its time is off."""
        self.came_s += after_s
        taken_s = self.came_s + 1e-4 + self.rng.uniform(0.0, 1e-4) + late_s
        self.clocks.now = max(self.clocks.now, taken_s)
        got = self.times.received(self.starts_s + (self.came_s - 1000.0) * self.rate, self.clocks.now)
        if got is None:
            return None
        assert got <= self.clocks.now
        self.errors_s.append(got - self.came_s)
        return got - self.came_s

    def learned(self, frames: int = 3 * LEARNED_FRAMES) -> Adapter:
        for _ in range(frames):
            self.frame()
        return self


@pytest.mark.parametrize("drift", [-1e-4, 0.0, 1e-4])
def test_the_clock_of_an_adapter_is_mapped(drift: float) -> None:
    """Its stamps have no jitter; what is left is the drift between two frames that were taken soonest."""
    adapter = Adapter(drift=drift).learned(5000)
    assert len(adapter.errors_s) == 5000 - LEARNED_FRAMES
    assert min(adapter.errors_s) > 0.9e-4  # the least delay stays in
    assert max(adapter.errors_s) < 1.4e-4


@pytest.mark.parametrize("late_s", [1e-3, 0.02, 0.5])
def test_a_host_that_stalls_does_not_move_it(late_s: float) -> None:
    adapter = Adapter().learned()
    for left in range(20, 0, -1):
        error_s = adapter.frame(late_s * left / 20)
        assert error_s is not None
        assert 0.9e-4 < error_s < 1.4e-4 + 2e-4 * late_s
    assert adapter.frame() is not None


@pytest.mark.parametrize("step_s", [-1e4, -5.0, -0.01, 0.002, 0.01, 5.0, 1e4])
def test_a_clock_that_was_set_is_learned_again(step_s: float) -> None:
    """No frame has a time that is wrong by the step, but those that a stalled host would give as well."""
    adapter = Adapter().learned()
    adapter.starts_s += step_s
    got = [adapter.frame() for _ in range(3 * LEARNED_FRAMES)]
    wrong = [one for one in got if one is not None and abs(one - 1.2e-4) > LARGEST_STEP_S]
    assert not wrong or (step_s < 0.0 and len(wrong) <= 2 * LEARNED_FRAMES)
    last = got[-1]
    assert last is not None
    assert abs(last - 1.2e-4) < 5e-5


@given(st.lists(st.floats(-1e6, 1e10) | st.sampled_from([0.0, math.nan, math.inf, -math.inf]), max_size=300))
def test_any_stamps_give_no_time_after_now(stamps: list[float]) -> None:
    clocks = Clocks()
    times = clocks.times()
    for stamp in stamps:
        clocks.now += 1e-3
        got = times.received(stamp, clocks.now)
        assert got is None or got <= clocks.now


@given(st.floats(-100e-6, 100e-6), st.lists(st.floats(0.0, 2e-3), min_size=300, max_size=400))
def test_the_jitter_of_a_controllers_delay_is_taken_off(drift: float, delays_s: list[float]) -> None:
    """One frame of five is on time: the rest follow its delay, and the drift since then."""
    clock = OtherClock(LONGEST_LATENCY_S)
    for number, delay_s in enumerate(delays_s):
        true_s = number * 1e-3
        taken_s = 1.8e9 + true_s + 2e-5 + (delay_s if number % 5 else 0.0)
        got = clock.received(77.0 + true_s * (1.0 + drift), taken_s)
        assert (got is None) is (number < LEARNED_FRAMES)
        assert got is None or got <= taken_s
        assert got is None or got - 1.8e9 - true_s == pytest.approx(2e-5, abs=5e-3 * 3e-4 + RESOLUTION_S)


@pytest.mark.parametrize("step_s", [-3600.0, -0.02, 0.02, 1.0, 3600.0])
def test_a_clock_of_a_controller_that_is_set_gives_no_time_until_it_is_learned(step_s: float) -> None:
    """Nothing is later than its latency: either clock may be set, forwards or back."""
    clock = OtherClock(LONGEST_LATENCY_S)
    got = [clock.received(77.0 + n * 1e-3 + step_s * (n >= 200), 1.8e9 + n * 1e-3) for n in range(400)]
    assert got[200 : 200 + LEARNED_FRAMES] == [None] * LEARNED_FRAMES
    assert got[-1] == pytest.approx(1.8e9 + 0.399, abs=RESOLUTION_S)
