"""A plan at its own limits, in simulated time: 0.95 of each holds, 1.05 does not."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from planning_kit import (
    ADC_PDO,
    POSITION_PDO,
    PRECISE_PDO,
    RATE_HZ,
    SYNC,
    cycles,
    planned,
    play,
    up_to_speed,
)

from canfb.cia301.frame import Frame

HELD, FLAGGED = 0.95, 1.05
RPM = 2.0 * math.pi / 60.0
GENTLE = 30.0  # rad/s^2
LOUD = Frame(0x6E1, bytes(8))


def alternating(jitter_s: float) -> Callable[[int], float]:
    """The worst that a jitter of +- can do to eq. 9: 4 times its size in each residual."""
    return lambda k: jitter_s if k % 2 else -jitter_s


@pytest.mark.parametrize("table", [True, False])
@pytest.mark.parametrize("part", [HELD, FLAGGED])
def test_acceleration(part: float, table: bool) -> None:
    limit = planned(table=table, acceleration_rad_s2=1.0).budgets[0].largest_acceleration_rad_s2
    stated = part * limit
    assert planned(table=table, acceleration_rad_s2=stated).holds is (part == HELD)
    seconds = 0.5
    found = play(up_to_speed(cycles(stated * 0.35), cycles(stated)), seconds, table=table)
    assert found.holds is (part == HELD), max(found.residuals)


@pytest.mark.parametrize("part", [HELD, FLAGGED])
def test_acceleration_with_sample_times_and_a_jitter_that_stretches_the_intervals(part: float) -> None:
    words = {"times": True, "table": True, "jitter_us": 80.0, "rpm": 1500.0}
    limit = planned(acceleration_rad_s2=1.0, **words).budgets[0].largest_acceleration_rad_s2
    stated = part * limit
    assert planned(acceleration_rad_s2=stated, **words).holds is (part == HELD)
    off = (-80e-6, -80e-6, 80e-6)
    # The module knows each interval, and its limit grows with it; the plan keeps to the nominal limit.
    played = stated if part == HELD else 1.3 * limit
    motion = up_to_speed(cycles(1500 * RPM), cycles(played))
    found = play(motion, 0.6, table=True, times=True, off_s=lambda k: off[k % 3])
    assert found.holds is (part == HELD), max(found.residuals)


@pytest.mark.parametrize("table", [True, False])
@pytest.mark.parametrize("part", [HELD, FLAGGED])
def test_speed_under_jitter(part: float, table: bool) -> None:
    words = {"table": table, "jitter_us": 20.0, "acceleration_rad_s2": GENTLE}
    limit = planned(rpm=1.0, **words).budgets[0].largest_speed_rad_s
    stated = part * limit
    assert planned(rpm=stated / RPM, **words).holds is (part == HELD)
    seconds = stated / GENTLE + 0.5
    found = play(up_to_speed(cycles(stated), cycles(GENTLE)), seconds, table=table, off_s=alternating(20e-6))
    # Without a table the errors of the phases are a bound, which few of the phases that come by reach.
    assert found.holds is (part == HELD) or not table, max(found.residuals)
    assert found.holds or part == FLAGGED, max(found.residuals)


@pytest.mark.parametrize("part", [HELD, FLAGGED])
def test_jitter_at_a_speed(part: float) -> None:
    words = {"table": True, "rpm": 60.0, "acceleration_rad_s2": GENTLE}
    budget = planned(jitter_us=10.0, **words).budgets[0]
    limit_us = 10.0 * budget.largest_speed_rad_s / (60.0 * RPM)
    assert planned(jitter_us=part * limit_us, **words).holds is (part == HELD)
    motion = up_to_speed(cycles(60.0 * RPM), cycles(GENTLE))
    found = play(motion, 0.7, table=True, off_s=alternating(part * limit_us * 1e-6))
    assert found.holds is (part == HELD), max(found.residuals)


@pytest.mark.parametrize("part", [HELD, FLAGGED])
def test_speed_while_other_frames_are_in_the_way_of_the_sync(part: float) -> None:
    """An own jitter of 0: every second SYNC waits for a frame of 8 bytes that has just begun."""
    words = {"table": True, "extra_load": 0.1, "acceleration_rad_s2": GENTLE}
    limit = planned(rpm=1.0, **words).budgets[0].largest_speed_rad_s
    stated = part * limit
    assert planned(rpm=stated / RPM, **words).holds is (part == HELD)
    found = play(
        up_to_speed(cycles(stated), cycles(GENTLE)),
        0.6,
        table=True,
        between=lambda k: [(-0.5e-6, LOUD)] if k % 2 else [],
    )
    assert found.holds is (part == HELD), max(found.residuals)


@pytest.mark.parametrize("part", [HELD, FLAGGED])
def test_residual_limit(part: float) -> None:
    """A limit just above what the motion and the errors need, and one just below."""
    words = {"table": True, "acceleration_rad_s2": 300.0}
    needed = planned(**words).budgets[0].needed_cycles
    limit = needed / part
    assert planned(residual_limit=limit, **words).holds is (part == HELD)
    found = play(up_to_speed(cycles(90.0), cycles(300.0)), 0.5, table=True, residual_limit=limit)
    # The errors are bounds: the limit has to be below the acceleration alone to be exceeded for sure.
    assert found.holds or part == FLAGGED
    # What follows a sample that was refused is coasting, and the residuals grow with it.
    counted = found.residuals[: found.valid.index(False) + 1] if False in found.valid else found.residuals
    assert 0.9 * needed <= max(counted) <= needed


def test_the_limit_that_the_known_acceleration_gives() -> None:
    """2010:02 as the plan proposes it: the machine may do it, and a little more is not flagged at once."""
    found = play(up_to_speed(cycles(20.0), cycles(25.0)), 1.0, max_acceleration_rad_s2=25.0)
    assert found.holds
    more = play(up_to_speed(cycles(60.0), cycles(3.0 * 25.0 + 250.0)), 0.5, max_acceleration_rad_s2=25.0)
    assert not more.holds


@pytest.mark.parametrize("times", [False, True])
@pytest.mark.parametrize("part", [HELD, FLAGGED])
def test_the_sync_rate_that_the_wire_carries(part: float, times: bool) -> None:
    plan = planned(times=times, acceleration_rad_s2=GENTLE)
    rate_hz = part * plan.plan_input.bus.largest_sync_hz
    assert planned(times=times, rate_hz=rate_hz).holds is (part == HELD)
    seconds = 0.4
    found = play(up_to_speed(cycles(5.0), cycles(GENTLE)), seconds, rate_hz=rate_hz, times=times)
    syncs, frames = found.frames[SYNC], found.frames
    assert found.always_valid
    if part == HELD:
        assert syncs == int(seconds * rate_hz)
        assert found.holds
        assert {frames[can_id] for can_id in (ADC_PDO, POSITION_PDO, PRECISE_PDO)} <= {syncs, syncs - 1}
    else:
        assert frames[PRECISE_PDO] < 0.9 * syncs, "the lowest priority falls behind for ever"


def test_what_goes_over_the_wire_is_what_the_table_says() -> None:
    """But for EMCY, which a healthy network does not send."""
    plan = planned(acceleration_rad_s2=GENTLE)
    seconds = 0.5
    found = play(up_to_speed(cycles(5.0), cycles(GENTLE)), seconds)
    for message in plan.plan_input.bus.messages:
        if not message.on_error:
            assert found.frames[message.can_id or 0] == pytest.approx(
                message.rate_hz(RATE_HZ) * seconds, abs=1.0
            )
