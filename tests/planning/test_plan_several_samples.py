"""A plan with several samples for each SYNC, and with a margin by the measured noise, at its own limits."""

from __future__ import annotations

import itertools
import math
from typing import Any

import pytest
from planning_kit import BIT_RATE, RATE_HZ, cycles, planned, play, up_to_speed

from canfb import objects as od
from canfb.hosting.hosting import saved_configuration
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.planning.budget import ResidualBudget
from canfb.planning.hints import changes_of
from canfb.planning.plan import Plan
from canfb.planning.planned_module import PlannedModule

HELD, FLAGGED = 0.95, 1.05
RPM = 2.0 * math.pi / 60.0
ALL = [(count, times) for count in (1, 2, 3, 4, 7) for times in (False, True)]


def delivered(count: int, times: bool) -> PlannedModule:
    config = ModuleConfig(node_id=0x20, samples_per_sync=count, times=times)
    return PlannedModule(node_id=0x20, values=saved_configuration(config).values(with_table=False))


def in_force(module: PlannedModule) -> dict[tuple[int, int], Any]:
    """COB-IDs and mappings of the RPDOs that are valid."""
    found: dict[tuple[int, int], Any] = {}
    for number in range(4):
        cob_id = module.values.get((od.RPDO + number, 1), 1 << 31)
        if cob_id < 1 << 31:
            mapping = od.RPDO_MAPPING + number
            used = range(module.values[mapping, 0] + 1)
            found |= {(od.RPDO + number, 1): cob_id}
            found |= {(mapping, place): module.values[mapping, place] for place in used}
    return found


@pytest.mark.parametrize(("count", "times"), ALL)
def test_the_pairs_are_counted_as_the_module_counts_them(count: int, times: bool) -> None:
    planned_one = delivered(count, times)
    assert planned_one.samples_per_sync == count
    assert planned_one.times is times
    assert planned_one.sample_bytes == 4 * count + 4 * times
    module = FeedbackModule(ModuleConfig(node_id=0x20, samples_per_sync=count, times=times))
    module.start(0.0)
    assert module.limits.samples_per_sync == count


def test_a_pair_that_no_rpdo_brings_ends_the_count() -> None:
    module = delivered(4, times=False)
    gap = {(od.RPDO_MAPPING + 1, 1): module.values[od.RPDO_MAPPING + 1, 3]}  # the sine of pair 2 is not there
    assert module.with_values(gap).samples_per_sync == 2
    off = {(od.RPDO + 1, 1): module.values[od.RPDO + 1, 1] | 1 << 31}
    assert module.with_values(off).samples_per_sync == 2


@pytest.mark.parametrize(("before", "after"), list(itertools.product(ALL, ALL)))
def test_another_layout_is_that_of_the_configuration(
    before: tuple[int, bool], after: tuple[int, bool]
) -> None:
    count, times = after
    changed = delivered(*before).with_samples(count)
    if times:
        changed = changed.with_times()
    if times or not before[1]:
        assert in_force(changed) == in_force(delivered(count, times))


def test_what_else_the_pdo_carries_stays() -> None:
    flags = {(od.RPDO_MAPPING, 0): 3, (od.RPDO_MAPPING, 3): od.SAMPLE_FLAGS.mapped(8)}
    module = delivered(1, times=False).with_values(flags).with_samples(2).with_times()
    second = [module.values[od.RPDO_MAPPING + 1, place] for place in (1, 2)]
    assert second == [od.SAMPLE_TIME.mapped(32), od.SAMPLE_FLAGS.mapped(8)]
    assert module.values[od.RPDO + 1, 1] == 0x290


def test_no_rpdo_is_left() -> None:
    others = {(od.RPDO + number, 1): 0x411 + number for number in (1, 2, 3)}
    with pytest.raises(ValueError, match="the samples need 2 RPDOs, and there are 1"):
        delivered(1, times=True).with_values(others).with_samples(2)


@pytest.mark.parametrize("part", [HELD, FLAGGED])
def test_acceleration_with_a_jitter_that_a_single_sample_would_not_survive(part: float) -> None:
    """The instants are those of the interface, so SYNC may jitter."""
    words = {"table": True, "samples_per_sync": 2, "jitter_us": 30.0, "rpm": 300.0}
    limit = planned(**words, acceleration_rad_s2=1.0).budgets[0].largest_acceleration_rad_s2
    assert limit > 3.9 * 800.0
    stated = part * limit
    assert planned(**words, acceleration_rad_s2=stated).holds is (part == HELD)
    one = planned(**{**words, "samples_per_sync": 1}, acceleration_rad_s2=100.0)
    assert not one.holds
    found = play(
        up_to_speed(cycles(300.0 * RPM), cycles(stated), start_s=0.2),
        0.4,
        table=True,
        samples_per_sync=2,
        off_s=lambda k: 30e-6 if k % 2 else -30e-6,
    )
    assert found.holds is (part == HELD), max(found.residuals)


def test_the_frames_are_those_on_the_wire() -> None:
    for count, times in ALL:
        plan = planned(samples_per_sync=count, times=times)
        found = play(lambda now: 0.0, 0.1, samples_per_sync=count, times=times)
        for message in plan.plan_input.bus.messages:
            if not message.on_error:
                syncs = message.rate_hz(RATE_HZ) * 0.1
                assert found.frames[message.can_id or 0] == pytest.approx(syncs, abs=2.0)
    assert planned(samples_per_sync=4, times=True).plan_input.bus.bit_rate == BIT_RATE


def texts(plan: Plan) -> list[str]:
    return [f"{one.for_what}: {one.text}" for one in changes_of(plan)]


def test_more_samples_where_the_bus_carries_no_faster_sync() -> None:
    (first, *_) = texts(planned(acceleration_rad_s2=6000.0))
    assert first == (
        "acceleration: send three samples for each SYNC (samples_per_sync: 3; "
        "8 bytes more for each SYNC, bus load +13.5 %): that holds this move"
    )


def test_four_samples_hold_the_move_of_a_servo() -> None:
    assert planned(acceleration_rad_s2=7850.0, table=True, samples_per_sync=4).holds
    assert not planned(acceleration_rad_s2=7850.0, table=True, samples_per_sync=2).holds


def test_sample_times_widen_the_limit_as_in_the_module() -> None:
    """By 4 v 50 ns, up to 2010:01."""
    rpm = 3000.0
    config = ModuleConfig(node_id=0x20, times=True, samples_per_sync=2, max_acceleration_rad_s2=30.0)
    module = FeedbackModule(config)
    module.dictionary.entry(*od.CYCLE_PERIOD).value = 1000
    module.start(0.0)
    plan = planned(rpm=rpm, times=True, samples_per_sync=2)
    known = plan.budgets[0].module.with_values({od.SUPERVISION_ACCELERATION: 30.0})
    speed = cycles(rpm * RPM) / (2.0 * RATE_HZ)  # cycles per sample
    limits = module.limits
    widened = limits.residual_limit + 4.0 * speed * limits.instant_error
    assert widened > 1.2 * limits.residual_limit
    assert ResidualBudget(plan.plan_input, known).limit_cycles == pytest.approx(widened, rel=1e-6)


def test_the_noise_margin_is_sharper_and_never_wider() -> None:
    def limit(**stated: Any) -> float:
        plan = planned(**stated)
        module = plan.plan_input.modules[0].with_values({od.SUPERVISION_ACCELERATION: 25.0})
        return ResidualBudget(plan.plan_input, module).limit_cycles

    assert limit(table=True, phase_error_cycles=0.0, noise_margin=6) == pytest.approx(0.0107, abs=5e-4)
    assert limit(table=True) == pytest.approx(0.06, abs=5e-4)
    assert limit(noise_margin=6) == limit(), "without a table the fixed margin is less"
    assert limit(table=True, noise_margin=255) == limit()
