"""`canfb commission` behind a low-pass: the corner, and limits of the amplitude that hold at every speed."""

from __future__ import annotations

import json
import math

import pytest
from test_commission_on_a_bus import commission

from canfb.calibration.path_fit import LowPass
from canfb.commission.limit_choice import corner_choice
from canfb.master.all_or_nothing import put_in_force
from canfb.master.session import read_corners
from canfb.master.supervision_limits import AMPLITUDES, CORNER, SupervisionLimits, write_limits
from canfb.signal.harmonics import Corners
from canfb.simulation.encoder import IDEAL_PATH, AnalogPath, Encoder
from commissioning_kit import Bench
from folding import each
from machine_kit import correction_of, duty

CORNER_HZ = 125e3
LOW_PASS = AnalogPath(sine_corner_hz=CORNER_HZ, cosine_corner_hz=CORNER_HZ)


def bench_behind(path: AnalogPath) -> Bench:
    """Up to 3000 rpm and back, with the table of standstill."""
    ideal = Encoder(amplitude_counts=1400.0, noise_lsb=0.6)
    made = Bench(Encoder(amplitude_counts=1400.0, noise_lsb=0.6, path=path), motion=duty(3000, 1.5))
    put_in_force(made.access, correction_of(ideal))
    made.bus.run_until(0.1)
    return made


def test_the_corner_is_found_and_the_limits_become_narrow(capsys: pytest.CaptureFixture[str]) -> None:
    made = bench_behind(LOW_PASS)
    assert commission(made, "--seconds", "5", "--write", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["corner_hz"] == pytest.approx(CORNER_HZ, rel=0.01)
    assert found["delay_estimate_s"] == pytest.approx(1.0 / (2.0 * math.pi * CORNER_HZ), rel=0.01)
    assert 0.0 < found["delay_estimate_uncertainty_s"] < 5e-8
    corners = read_corners(made.access)
    assert corners.corner_hz == pytest.approx(CORNER_HZ, rel=0.01)
    assert corners.cosine_corner_hz == 0.0
    assert made.value(0x2002, 7) == 0.0, "nobody asked for it"
    proposed = {one["object"]: one["proposed"] for one in found["limits"]}
    assert proposed["2001:03"] == pytest.approx(0.8 * 1400.0, rel=0.01)
    assert proposed["2001:04"] == pytest.approx(1.2 * 1400.0, rel=0.01)
    made.bus.run_until(made.bus.now + 3.0)
    assert made.value(0x2012, 3) == 0, "no amplitude is flagged"
    assert commission(made, "--seconds", "5", "--json") == 0
    again = json.loads(capsys.readouterr().out)
    assert not next(one for one in again["limits"] if one["object"] == "2001:05")["changes"]
    assert again["corner_hz"] == pytest.approx(CORNER_HZ, rel=0.01), "without what is corrected"


def test_the_amplitude_is_within_its_limits_at_every_write() -> None:
    """On the way up the upper limit comes first, on the way back the lower one."""
    made = Bench(sync=False)
    low, high = AMPLITUDES
    before, after = {low: 500, high: 1300, CORNER.place: 0.0}, {low: 1100, high: 1700, CORNER.place: 125e3}
    write_limits(made.access, before)
    for wanted, order in ((after, [4, 5, 3]), (before, [3, 5, 4])):
        made.master.sent.clear()
        write_limits(made.access, wanted)
        written = [one.data[3] for one in made.master.sent if one.data[0] >> 5 == 1]
        assert written == order
        assert {place: made.value(*place) for place in wanted} == wanted


@each(
    "low_pass, before, words, changes",
    [
        (None, 0.0, None, False),
        (LowPass(0.0, 0.0, 1e5, 1.0, 0.0, True, 1e6), 0.0, None, False),
        (LowPass(0.0, 0.0, 1e5, 1.0, 0.0, True, 1e6), 125e3, "does not fall", False),
        (LowPass(8e-6, 1e-8, 1e5, 0.78, 0.02, True), 0.0, "by one pole", False),
        (LowPass(8e-6, 1e-8, 1e5, 0.78, 0.0, False), 0.0, "by one pole", False),
        (LowPass(8e-6, 1e-8, 1e5, 0.78, 0.0, True), 0.0, "125 ± 0.2 kHz", True),
        (LowPass(8e-6, 1e-8, 1e5, 0.78, 0.0, True), 130e3, "125 ± 0.2 kHz", False),
        (LowPass(8e-6, 1e-8, 1e5, 0.78, 0.0, True), 250e3, "125 ± 0.2 kHz", True),
    ],
)
def test_when_the_corner_is_proposed(
    low_pass: LowPass | None, before: float, words: str | None, changes: bool
) -> None:
    limits = SupervisionLimits({CORNER.place: before}, 2048, 2500, 3)
    found = corner_choice(low_pass, limits)
    assert (found is None) == (words is None)
    if found is not None and words is not None:
        assert words in found.why
        assert found.changes == changes
        assert found.value == (125e3 if changes else before)


def test_without_a_low_pass_there_is_nothing_to_set(capsys: pytest.CaptureFixture[str]) -> None:
    made = bench_behind(IDEAL_PATH)
    assert commission(made, "--seconds", "5", "--write") == 0
    out = capsys.readouterr().out
    assert "none is seen up to" in out
    assert "2001:05" not in out
    assert read_corners(made.access) == Corners()
