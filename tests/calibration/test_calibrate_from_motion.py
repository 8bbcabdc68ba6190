from __future__ import annotations

import numpy as np
import pytest
from measurements import PERCENT, extreme_encoder, random_encoder, table_error, wandering

from canfb.calibration.motion import calibrate_from_motion
from canfb.errors import CalibrationError
from canfb.simulation.encoder import Encoder

SPEEDS_RPM = (10.0, 60.0, 500.0, 2000.0, 3000.0)


@pytest.mark.parametrize("rpm", SPEEDS_RPM)
@pytest.mark.parametrize(("noise_lsb", "goal"), [(0.5, 0.002 * PERCENT), (1.2, 0.004 * PERCENT)])
@pytest.mark.parametrize("kind", [random_encoder, extreme_encoder])
def test_table_is_right_at_any_speed(kind, noise_lsb, goal, rpm):
    rng = np.random.default_rng([int(rpm), int(10 * noise_lsb)])
    encoder = kind(rng, noise_lsb)
    result = calibrate_from_motion(*encoder.sample(wandering(rpm, rng), rng))
    error = table_error(result.table, encoder)
    # Below a twentieth of the goal the noise would have been seen through: then the test is wrong.
    assert 0.02 * goal < np.abs(error).max() < goal
    assert result.accepted
    assert result.before_rms > 50.0 * result.residual_rms


def test_a_machine_at_standstill_is_refused():
    rng = np.random.default_rng(1)
    with pytest.raises(CalibrationError) as refused:
        calibrate_from_motion(*Encoder(noise_lsb=0.5).sample(np.full(5000, 0.3), rng))
    assert refused.value.reason in ("ellipse", "coverage")
