"""canfb commission judges by what the module has in force: 2010:07..09, samples per SYNC, sample times."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from canfb import objects as od
from canfb.calibrate.samples_through_chain import supervise
from canfb.commission.commission_summary import Commissioned, detection_rows, lines
from canfb.commission.limit_choice import choose
from canfb.commission.observation import observe
from canfb.master.access import CommissioningError, NodeAccess
from canfb.master.provenance import Provenance
from canfb.master.supervision_limits import LIMIT_UNITS, SupervisionLimits
from canfb.simulation.encoder import Encoder
from canfb.simulation.motion import Motion, Ramp, Ripple
from commissioning_kit import INTERFACE_ID, MODULE_ID, RATE_HZ, Bench
from machine_kit import N, SimulatedMachine, duty

STANDING_FIRST = Motion((Ramp(0.2, 0.0), Ramp(2.0, 300.0)), ())
SETTINGS: list[dict[str, Any]] = [
    {"max_acceleration_rad_s2": 80.0},
    {"max_acceleration_rad_s2": 80.0, "noise_margin": 6},
    {"prediction_order": 3, "max_jerk_rad_s3": 60_000.0},
    {"prediction_order": 3, "max_jerk_rad_s3": 60_000.0, "max_acceleration_rad_s2": 80.0, "noise_margin": 6},
    {"prediction_order": 3},
    {"samples_per_sync": 3, "max_acceleration_rad_s2": 300.0},
]


@pytest.mark.parametrize("settings", SETTINGS, ids=lambda one: ", ".join(map(str, one.items())))
def test_the_limits_are_those_that_the_module_has_in_force(settings: dict[str, Any]) -> None:
    bench = Bench(Encoder(noise_lsb=0.5), motion=STANDING_FIRST, config=settings)
    bench.bus.run_until(2.5)
    assert (bench.module.node.node_id, bench.interface.node.node_id) == (MODULE_ID, INTERFACE_ID)
    limits = SupervisionLimits.read(NodeAccess(bench.master, MODULE_ID, "module"))
    interval_s = 1.0 / RATE_HZ / settings.get("samples_per_sync", 1)
    ours, of_module = limits.chain_limits(interval_s), bench.module.limits
    # The module takes the largest noise of its last blocks, 2011:0B is that of the last.
    close = pytest.approx(of_module.residual_limit, rel=0.1 if "noise_margin" in settings else 1e-6)
    assert limits.residual_limit(interval_s) == close
    assert ours.residual_limit == close
    if settings != {"prediction_order": 3}:
        assert ours.residual_limit < 0.3
    for name in ("prediction_order", "acceleration", "jerk", "start_limit", "widest_limit", "sample"):
        theirs = getattr(of_module, name)
        if isinstance(theirs, float):
            assert getattr(ours, name) == pytest.approx(theirs, rel=0.1 if name == "start_limit" else 1e-6)
        else:
            assert getattr(ours, name) == theirs
    assert ours.coast_samples == of_module.coast_samples * of_module.samples_per_sync


def servo() -> SimulatedMachine:
    """±1500 rpm at 5 Hz: up to 2 cycles per interval^2, which eq. 9 loses, and 0.06 per interval^3."""
    machine = SimulatedMachine(Motion((), (Ripple(1500.0, 5.0),)), Encoder(noise_lsb=0.5))
    machine.start_s = 0.05  # where its acceleration is nothing
    return machine


def third_order(limits: SupervisionLimits) -> SupervisionLimits:
    order = replace(limits.motion, prediction_order=3)
    return replace(limits, motion=order).changed({od.SUPERVISION_JERK: 0.0})


def test_a_machine_that_only_third_order_follows_gets_limits_of_its_jerk() -> None:
    machine = servo()
    with pytest.raises(CommissioningError, match="position is lost in the samples"):
        machine.observed(6000)
    machine.start_s = 0.05
    before = third_order(machine.limits)
    observed = machine.observed(6000, before)
    motion, interval_s = observed.machine.motion, 1.0 / RATE_HZ
    true = machine.motion.revolutions_at(0.05 + np.arange(6000) / RATE_HZ) * N
    jerk = float(np.abs(np.diff(true, 3)).max())
    assert motion.acceleration == pytest.approx(np.abs(np.diff(true, 2)).max(), rel=0.02)
    assert motion.jerk == pytest.approx(jerk, rel=0.05)
    assert jerk < motion.residual_peak < jerk + 12.0 * motion.residual_noise
    choices = {one.place: one for one in choose(observed.machine, before, 2.0)}
    new = before.changed({place: one.value for place, one in choices.items()})
    limit = choices[od.SUPERVISION_RESIDUAL_LIMIT].value / LIMIT_UNITS
    assert 2.0 * jerk < limit < 2.0 * (jerk + 12.0 * motion.residual_noise)
    assert new.residual_limit(interval_s) == pytest.approx(limit, abs=1e-4)
    assert new.bounds(interval_s).jerk == pytest.approx(2.0 * motion.jerk, rel=0.02)
    assert new.bounds(interval_s).acceleration == pytest.approx(2.0 * motion.acceleration, rel=0.02)
    again = supervise(observed.samples, observed.used, new.chain_limits(interval_s), observed.start_speed)
    assert again.flagged == {}
    done = Commissioned(
        observed, before, new, [*choices.values()], {}, 2.0, False, False, None, Provenance("2026-03-01")
    )
    assert done.deviation(new) == pytest.approx(limit + 2.0 * motion.jerk, rel=0.02)
    assert done.without_harm(before) == 0
    assert done.without_harm(new) == (done.deviation(new) <= 0.25)
    text = "\n".join(lines(done))
    assert "L + j at most" in text
    assert "rad/s³ (" in text
    assert f"jerks up to {done.largest_motion:.3g} cycle per interval³" in text


def test_a_glitch_is_judged_by_the_prediction_that_the_module_has() -> None:
    """By eq. 9 the same limits would have promised two bad samples in a row."""
    machine = SimulatedMachine(duty(120, 0.5), Encoder(noise_lsb=0.5))
    before = third_order(machine.limits)
    observed = machine.observed(6000, before)
    new = before.changed({one.place: one.value for one in choose(observed.machine, before, 2.0)})
    done = Commissioned(observed, before, new, [], {}, 2.0, False, False, None, Provenance("2026-03-01"))
    assert done.without_harm(new) == 1
    assert [row.name for row in detection_rows(done)] == ["1", "2"]
    assert detection_rows(done)[1].words[1:] == ("not for sure", "not for sure")


def test_a_noise_margin_narrows_the_limit_that_is_judged() -> None:
    machine = SimulatedMachine(duty(120, 0.5), Encoder(noise_lsb=0.5))
    wide = machine.limits.changed({od.SUPERVISION_ACCELERATION: 20.0})
    narrow = replace(wide, motion=replace(wide.motion, noise_margin=6), noise_cycles=0.0005)
    interval_s = 1.0 / RATE_HZ
    acceleration = wide.acceleration_cycles(interval_s)
    assert wide.residual_limit(interval_s) == pytest.approx(acceleration + 4.0 * 819 / 65536)
    assert narrow.residual_limit(interval_s) == pytest.approx(acceleration + 6 * 0.0005)


@pytest.mark.parametrize("per_sync", [1, 3])
def test_a_pause_is_counted_in_periods_of_sync(per_sync: int) -> None:
    """2010:06 counts these: of several samples in each, one period without any is one period."""
    machine = SimulatedMachine(duty(120, 0.5), Encoder(noise_lsb=0.5))
    limits = replace(machine.limits, motion=replace(machine.limits.motion, samples_per_sync=per_sync))
    readings, samples = machine.readings(6000), machine.samples(6000)
    samples.sine[3000 : 3000 + per_sync] = samples.cosine[3000 : 3000 + per_sync] = np.nan
    observed = observe(samples, machine.used, limits, readings)
    assert observed.machine.longest_pause == pytest.approx(2.0)
    choices = {one.place: one.value for one in choose(observed.machine, limits, 2.0)}
    assert choices[od.SUPERVISION_PERIODS] == 3
