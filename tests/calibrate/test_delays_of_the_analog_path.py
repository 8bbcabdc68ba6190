"""2002:06, 2002:07 and 2001:05 outlive a calibration, a table, a backup; a calibration knows of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibrating import PHASE_ERROR_RAD, calibrate, encoder, position_errors
from test_recordings_and_own_calibration import with_calculator

from canfb.calibration.over_speeds import sampled_together
from canfb.calibration.recording import recording
from canfb.master.access import CommissioningError
from canfb.master.all_or_nothing import put_in_force, read_active, read_conditioning
from canfb.master.samples import TrackSamples
from canfb.sdo.tables import as_yaml, read_table_file
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import Correction
from canfb.simulation.encoder import AnalogPath
from canfb.simulation.motion import Motion, Ramp, Ripple
from commissioning_kit import MODULE_ID, TABLE, Bench
from folding import each
from node_commands import Commands

NODE = hex(MODULE_ID)
DELAY_S, LAG_S, CORNER_HZ = 2.0**-20, 2.0**-19, 131072.0  # exact in REAL32
DELAYS: dict[str, Any] = {
    "conditioning": Conditioning(cosine_delay_s=DELAY_S, delay_s=LAG_S),
    "corner_hz": CORNER_HZ,
}
ENCODER = encoder(AnalogPath(cosine_delay_s=DELAY_S))


def bench_at(rpm: float, **config: Any) -> Bench:
    """Up to this speed from standstill, and steady but for a ripple: the module knows the speed."""
    motion = Motion((Ramp(0.3, 0.0), Ramp(2.0, rpm)), (Ripple(0.3, 0.31), Ripple(0.2, 1.7)))
    bench = Bench(ENCODER, motion=motion, config=DELAYS | {"corner_hz": 0.0} | config)
    bench.bus.run_until(3.0)
    return bench


def delays(bench: Bench) -> tuple[float, ...]:
    used = bench.module.chain.correction.conditioning
    return used.cosine_delay_s, used.delay_s, bench.module.limits.corners.corner_hz


@each("rpm", [61.0, 1503.0, 3001.0])
def test_a_calibration_at_any_speed_finds_the_encoder(rpm: float) -> None:
    """The phase error is that of the encoder: at 3000 rpm the samples show 0.75 rad more."""
    bench = bench_at(rpm)
    assert calibrate(bench) == 0
    assert delays(bench) == (DELAY_S, LAG_S, 0.0)
    assert bench.module.chain.correction.conditioning.phase_error_rad == pytest.approx(
        PHASE_ERROR_RAD, abs=3e-3
    )
    errors = position_errors(bench, 400)
    assert np.sqrt(np.mean(errors**2)) < 3e-4


@each("source", ["pdo", "module"])
def test_a_low_pass_of_the_cosine_alone_is_enough_for_that(source: str) -> None:
    """2001:06 alone was not looked at: the harmonics of 3000 rpm were taken for those at standstill."""
    config = {"conditioning": Conditioning(), "cosine_corner_hz": 2.0**20}  # 0.12 rad at 3000 rpm
    bench = bench_at(3001.0, **config)
    assert calibrate(with_calculator(bench) if source == "module" else bench, "--source", source) == 0
    assert not any(bench.module.chain.correction.conditioning.harmonics)


def test_a_check_sees_no_drift_at_another_speed(figures_of: Any) -> None:
    slow = bench_at(61.0)
    assert calibrate(slow) == 0
    fast = bench_at(3001.0)
    put_in_force(fast.access, slow.module.chain.correction)
    # The third harmonic is delayed, too, and that is no drift.
    assert figures_of(fast, "--check")["drift_rms_cycles"] < 2e-4


def test_the_delay_can_be_removed_behind_offset_and_gain_only() -> None:
    bench = bench_at(61.0)
    with pytest.raises(CommissioningError, match=r"2002:06 .* --conditioning fit"):
        calibrate(bench, "--conditioning", "none")


def test_without_a_valid_position_the_speed_is_not_known() -> None:
    bench = bench_at(61.0)
    bench.module.chain.lose()
    with pytest.raises(CommissioningError, match="position"):
        calibrate(bench)


def test_a_table_without_them_leaves_them(canfb: Commands, tmp_path: Path) -> None:
    path = tmp_path / "table.yaml"
    used = Correction(TABLE, Conditioning(1.0, 2.0, 1.0, 1.0, 0.125))
    lines = as_yaml(used, {}).splitlines()
    path.write_text("\n".join(line for line in lines if "delay_s" not in line))
    bench = Bench(sync=False, config=DELAYS)
    canfb(bench, "table", "write", NODE, path, "--activate")
    assert delays(bench) == (DELAY_S, LAG_S, CORNER_HZ)
    assert bench.module.chain.correction.conditioning.phase_error_rad == 0.125
    canfb(bench, "table", "read", NODE, path)
    assert read_table_file(path).used == bench.module.chain.correction
    other = Bench(sync=False)
    canfb(other, "table", "write", NODE, path, "--activate")
    assert delays(other) == (DELAY_S, LAG_S, 0.0)
    canfb(other, "table", "clear", NODE)
    assert delays(other) == (DELAY_S, LAG_S, 0.0)


def test_an_older_module_has_no_delays(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(sync=False)
    for subindex in (6, 7):
        entries = bench.module.dictionary
        monkeypatch.delitem(entries._entries, (0x2002, subindex))
    wanted = Correction(TABLE, Conditioning(1.0, 2.0, 1.0, 1.0, 0.125))
    put_in_force(bench.access, wanted)
    assert read_conditioning(bench.access) == wanted.conditioning
    assert read_active(bench.access) == wanted


# The arithmetic.


@each("hertz", [2541.0, 62_543.0, 125_041.0, -125_041.0])
def test_samples_as_if_taken_at_once(hertz: float) -> None:
    rng = np.random.default_rng(1)
    rate, n = 1000.0, 4000
    time = np.arange(n) / rate
    turned = hertz * time + 0.3 * np.sin(2.0 * time)
    speed = hertz + 0.6 * np.cos(2.0 * time)
    pure = replace(ENCODER, harmonics=())
    sine, cosine = pure.sample(turned, rng, speed)
    samples = TrackSamples.of(sine, cosine, rate, "a simulated machine")
    samples.sine[7] = samples.cosine[7] = np.nan
    together = samples.together(DELAY_S, hertz + 3.0)
    _, wanted = replace(pure, path=AnalogPath()).sample(turned)
    off = together.cosine - wanted
    assert np.isnan(off[7])
    assert np.nanstd(off) < 2.0, "half a count of noise in each track"
    assert np.array_equal(together.sine, samples.sine, equal_nan=True)
    assert samples.together(0.0, hertz) is samples


def test_a_clipped_cosine_stays_clipped() -> None:
    sine, cosine = ENCODER.sample(np.arange(1000) * 0.37)
    cosine[100] = 2047
    record = recording(sine, cosine, None, None, 12)
    assert sampled_together(record, np.full(1000, 0.3))[100] == 2047
