"""The example configuration, played as the README has it: ten seconds later the position is still right."""

from __future__ import annotations

import numpy as np
import pytest
from first_session import Session

import canfb
from canfb.cli.config_file import EXAMPLE
from canfb.configuration import parse_config
from canfb.signal.limits import max_acceleration
from canfb.simulation.demand import of_motion
from canfb.simulation.motion import Motion


def test_it_asks_for_less_than_a_third_of_what_eq_10_allows_at_100_hz() -> None:
    config = parse_config(EXAMPLE)
    module = config.modules[0]
    demand = of_motion(config.simulation.motion, module, 100.0)
    assert 3.0 * demand.acceleration_rad_s2 < max_acceleration(module.cycles_per_revolution, 100.0, 1 / 3)
    assert demand.acceleration_rad_s2 > 1.0, "it moves"
    assert demand.warning() is None


@pytest.mark.parametrize("rate_hz", [100.0, 250.0])
def test_every_position_of_ten_seconds_is_valid_and_right(rate_hz: float) -> None:
    session = Session(rate_hz)
    session.run(10.0)
    assert len(session.statuses) >= 10.0 * rate_hz - 2
    assert all(session.valid)
    assert np.abs(session.errors).max() < 0.05, "no cycle is lost; the rest is the error of the tracks"
    assert session.source.position_cycles > 2500 * 7, "it has turned by more than seven revolutions"
    assert session.module.dictionary.entry(0x2012, 2).value == 0


def test_what_the_example_was_before_would_be_warned_of() -> None:
    """A ramp of 31.4 rad/s^2 at 100 Hz: the position is lost, and the warning has said so."""
    text = EXAMPLE.replace("ramp_s: 3, rpm: 61", "ramp_s: 2, rpm: 600")
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
