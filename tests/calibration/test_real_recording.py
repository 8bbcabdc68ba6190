"""The recording of a real encoder: a home-made optical one in a hobby servo, uneven sample times.

The file is not part of the repository; where it is absent, these tests are skipped.
"""

from pathlib import Path

import numpy as np
import pytest

from canfb import CalibrationError, calibrate_from_motion
from canfb.calibration.ellipse import angle_cycles, fit_ellipse
from canfb.signal.phase import FloatArray, raw_phases

FILE = Path(__file__).resolve().parents[3] / "shared" / "data" / "servoproject_optical_encoder.csv"
MID_SCALE = 8192
BLOCK = 16

pytestmark = pytest.mark.skipif(not FILE.exists(), reason="the recording of a real encoder is not here")


@pytest.fixture(scope="module")
def samples() -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Times, both tracks, and the segment of each sample; -1 for the last one before a gap."""
    columns = np.genfromtxt(FILE, delimiter=",", skip_header=1)
    time = columns[:, 0]
    gap = np.diff(time, append=np.inf) > 0.1
    segment: FloatArray = np.cumsum(gap) - gap
    return time, columns[:, 1] - MID_SCALE, columns[:, 2] - MID_SCALE, np.where(gap, -1, segment)


def _deviation(phase: FloatArray, time: FloatArray, segment: FloatArray, of: list[int]) -> float:
    """Rms deviation from cubics of time through blocks of 16 samples in which the encoder moves."""
    squares = []
    for one in of:
        at = np.flatnonzero(segment == one)
        position = np.unwrap(phase[at], period=1.0)
        for start in range(0, len(at) - BLOCK + 1, BLOCK):
            part = slice(start, start + BLOCK)
            x = time[at[part]]
            if abs(position[part][-1] - position[part][0]) > 0.5:
                line = np.polynomial.Polynomial.fit(x, position[part], 3)
                squares.append((position[part] - line(x)) ** 2)
    return float(np.sqrt(np.mean(squares) * BLOCK / (BLOCK - 4)))


@pytest.mark.parametrize("parity", [0, 1])
def test_table_of_every_second_segment_serves_the_others(samples, parity):
    time, sine, cosine, segment = samples
    train = (segment >= 0) & (segment % 2 == parity)
    result = calibrate_from_motion(sine, cosine, "fit", time_s=time, valid=train)
    others = [k for k in range(int(segment.max()) + 1) if k % 2 != parity]
    ellipse = _deviation(angle_cycles(result.conditioning, sine, cosine), time, segment, others)
    raw = raw_phases(*result.conditioning.apply(sine, cosine))
    table = _deviation(result.table(raw), time, segment, others)
    # At least 7 times better than the ellipse alone; here it is some 20 times.
    assert 14.0 < ellipse / table < 30.0
    assert 4e-4 < table < 1.2e-3
    # What it says of itself, from its own half of the data.
    assert result.residual_rms == pytest.approx(table, rel=0.3)
    assert result.coverage == 1.0
    assert 700 < result.cycles_used < 1100
    assert result.harmonics[0].amplitude_cycles < 0.05


def test_segments_of_one_direction_give_one_table(samples):
    time, sine, cosine, segment = samples
    conditioning = fit_ellipse(sine, cosine, segment >= 0)
    # Segments go forwards and backwards in turn. Opposite directions differ by 0.15 % of a cycle:
    # the two tracks are not read at the same instant.
    tables = [
        calibrate_from_motion(
            sine, cosine, conditioning, time_s=time, valid=(segment < 20) & (segment % 4 == part)
        )
        for part in (1, 3)
    ]
    difference = tables[0].table.entries - tables[1].table.entries
    expected = np.hypot(tables[0].uncertainty_rms, tables[1].uncertainty_rms)
    assert np.std(difference) < 3.0 * expected  # which has the change in time, alike in both
    assert 1e-4 < np.std(difference) < 5e-4


def test_without_the_ellipse_it_is_refused(samples):
    time, sine, cosine, segment = samples
    with pytest.raises(CalibrationError) as refused:
        calibrate_from_motion(sine, cosine, time_s=time, valid=(segment >= 0) & (segment < 8))
    assert refused.value.reason == "monotonic"
