"""The example configuration, played as the README has it: ten seconds later the position is still right."""

from __future__ import annotations

import numpy as np
import pytest
from first_session import Session

import canfb
from canfb.cli.config_file import EXAMPLE
from canfb.configuration import parse_config
from canfb.signal.limits import max_acceleration
from canfb.signal.starts import START_SAMPLES
from canfb.simulation.demand import of_motion
from canfb.simulation.motion import Motion


def test_its_machine_keeps_to_the_acceleration_that_it_declares() -> None:
    config = parse_config(EXAMPLE)
    declared = config.modules[0].max_acceleration_rad_s2
    demand = of_motion(config.simulation.motion, config.modules[0], 100.0)
    assert 0.8 * declared < demand.acceleration_rad_s2 < 0.95 * declared
    assert f"{demand.acceleration_rad_s2:.2f} rad/s^2: less than max_acceleration_rad_s2" in EXAMPLE
    assert demand.warning() is None
    motion, step_s = config.simulation.motion.motion(), 0.01
    position = motion.revolutions_at(np.arange(10_000) * step_s)
    measured = 2.0 * np.pi * np.abs(np.diff(position, 2)).max() / step_s**2
    assert 0.8 * declared < measured < 0.95 * declared, "between any three samples"


def test_the_reason_beside_the_acceleration_is_right() -> None:
    """With an encoder as good as the module assumes one trajectory fits, by docs/supervision.md."""
    config = parse_config(EXAMPLE)
    module = config.modules[0]
    half_a_cycle = max_acceleration(module.cycles_per_revolution, 100.0, 0.5)
    declared = 0.5 * module.max_acceleration_rad_s2 / half_a_cycle
    assert declared == pytest.approx(0.01, abs=1e-4)
    gap, phase_error = 9, 0.0125
    assert (gap + 1) ** 2 // 4 * 2.0 * declared + 4.0 * phase_error * (gap + 1) <= 1.0
    assert (
        f"At 100 Hz it is 0.01 cycle per\n    # interval^2: after a gap of up to {gap} intervals" in EXAMPLE
    )


@pytest.mark.parametrize("rate_hz", [100.0, 250.0])
def test_every_position_of_ten_seconds_is_valid_and_right(rate_hz: float) -> None:
    session = Session(rate_hz)
    session.run(10.0)
    assert len(session.statuses) >= 10.0 * rate_hz - 2
    assert all(session.valid[START_SAMPLES:]), "the sample times confirm the start first"
    assert np.abs(session.errors).max() < 0.05, "no cycle is lost; the rest is the error of the tracks"
    assert session.source.position_cycles > 2500 * 1.5, "it has turned by more than a revolution"
    assert session.module.dictionary.entry(0x2012, 2).value == 0


def test_what_the_example_was_before_would_be_warned_of() -> None:
    """A ramp of 31.4 rad/s^2 at 100 Hz: the position is lost, and the warning has said so."""
    text = EXAMPLE.replace("ramp_s: 30, rpm: 61", "ramp_s: 2, rpm: 600")
    assert text != EXAMPLE
    session = Session(100.0, text=text)
    demand = of_motion(session.config.simulation.motion, session.config.modules[0], 100.0)
    assert "will lose the position" in (demand.warning() or "")
    session.run(3.0)
    assert not session.valid[-1]


@pytest.mark.parametrize(("rate_hz", "rpm"), [(100.0, None), (1000.0, None), (500.0, 600.0)])
def test_its_ripple_shows_every_phase_to_a_reference_measurement(rate_hz: float, rpm: float | None) -> None:
    """600 rpm of 2500 cycles are a whole number of cycles per sample at 500 Hz."""
    config = parse_config(EXAMPLE)
    motion = config.simulation.motion
    settled = Motion((), motion.motion().ripples, motion.rpm if rpm is None else rpm)
    position = settled.revolutions_at(np.arange(5000) / rate_hz) * 2500
    encoder = config.simulation.encoder.encoder(12)
    sine, cosine = encoder.sample(position, np.random.default_rng(1))
    found = canfb.calibrate_from_motion(sine, cosine, "fit", adc_bits=12)
    assert found.accepted
    assert found.coverage == 1.0
    assert found.uncertainty_rms < 5e-5
