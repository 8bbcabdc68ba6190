"""The analog path: `canfb calibrate --speeds` finds it; 2002:06, 2002:07, 2001:05 outlive what follows."""

import io
import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibrating import calibrate, command, position_errors
from test_recordings_and_own_calibration import with_calculator

from canfb import CalibrationError, Conditioning, ConfigError
from canfb.calibrate.calibration_summary import delay_words
from canfb.calibration.over_speeds import sampled_together
from canfb.calibration.path_fit import LowPass
from canfb.calibration.recording import recording
from canfb.cli.calibrate import calibrate as calibrate_files
from canfb.cli.commands import build_parser
from canfb.cli.printing import Progress
from canfb.device.storage.storage import MemoryStore
from canfb.master.access import CommissioningError
from canfb.master.all_or_nothing import put_in_force, read_active, read_conditioning
from canfb.master.machine_watch import Provenance
from canfb.master.session import read_corners
from canfb.sdo.tables import as_yaml, read_table
from canfb.signal.correction import NO_CORRECTION, Correction
from canfb.signal.front_end import NO_LOW_PASS
from canfb.simulation.encoder import AnalogPath, Encoder, Harmonic, Motion, Ramp, Ripple
from commissioning_kit import CYCLES, MODULE_ID, TABLE, Bench
from folding import each
from node_commands import Commands

NODE = hex(MODULE_ID)
DELAY_S, LAG_S, CORNER_HZ = 2.0**-20, 2.0**-19, 131072.0  # exact in REAL32
DELAYS: dict[str, Any] = {
    "conditioning": Conditioning(cosine_delay_s=DELAY_S, delay_s=LAG_S),
    "corner_hz": CORNER_HZ,
}
PHASE_ERROR_RAD = 0.05


def encoder(path: AnalogPath) -> Encoder:
    return Encoder(
        amplitude_counts=1500.0,
        sine_offset=0.01,
        cosine_amplitude=0.96,
        phase_error_rad=PHASE_ERROR_RAD,
        harmonics=(Harmonic(3, 0.01, 0.01),),
        noise_lsb=0.5,
        path=path,
    )


ENCODER = encoder(AnalogPath(cosine_delay_s=DELAY_S))
PATH = AnalogPath(sine_corner_hz=250e3, cosine_corner_hz=255e3, cosine_delay_s=1e-7)
MULTIPLEXER = AnalogPath(cosine_delay_s=1e-6)
STAY_S = 4.0
SHORT = ("--seconds", "2", "--least-samples", "2000", "--verify", "0.8", "--wait", "30")
ALL = "61,703,3001"


def bench(path: AnalogPath = PATH, rpm: tuple[float, ...] = (61.0, 703.0, 3001.0), **config: Any) -> Bench:
    """From standstill up to each of these speeds, where it stays for a while; then at the last one."""
    ramps: list[Ramp] = [Ramp(0.3, 0.0)]
    for one in rpm:
        ramps += [Ramp(2.0, one), Ramp(STAY_S, one)]
    made = Bench(
        encoder(path),
        motion=Motion(tuple(ramps), (Ripple(0.3, 0.31), Ripple(0.2, 1.7))),
        store=MemoryStore(),
        config=config,
    )
    made.bus.run_until(0.2)
    return made


def bench_at(rpm: float, **config: Any) -> Bench:
    """It has reached this speed, and is steady but for a ripple: the module knows the speed."""
    made = bench(ENCODER.path, (rpm,), **DELAYS | {"corner_hz": 0.0} | config)
    made.bus.run_until(3.0)
    return made


@cache
def calibrated_at(rpm: float) -> Bench:
    bench = bench_at(rpm)
    assert calibrate(bench) == 0
    return bench


def delays(bench: Bench) -> tuple[float, ...]:
    used = bench.module.chain.correction.conditioning
    return used.cosine_delay_s, used.delay_s, bench.module.limits.corners.corner_hz


@each("rpm", [61.0, 1503.0, 3001.0])
def test_a_calibration_at_any_speed_finds_the_encoder(rpm: float) -> None:
    """The phase error is that of the encoder: at 3000 rpm the samples show 0.75 rad more."""
    bench = calibrated_at(rpm)
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
    fast = bench_at(3001.0)
    put_in_force(fast.access, calibrated_at(61.0).module.chain.correction)
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
    assert read_table(path).used == bench.module.chain.correction
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


def test_a_clipped_cosine_stays_clipped() -> None:
    sine, cosine = ENCODER.sample(np.arange(1000) * 0.37)
    cosine[100] = 2047
    record = recording(sine, cosine, None, None, 12)
    assert sampled_together(record, np.full(1000, 0.3))[100] == 2047


def over_speeds(bench: Bench, *arguments: str, speeds: str = ALL, **words: Any) -> int:
    return command(bench.master, "--speeds", speeds, *SHORT, *arguments, **words)


def test_a_path_is_found_and_removed(figures_of: Any, tmp_path: Path) -> None:
    made, said = bench(), io.StringIO()
    words = ("--save", "--out", str(tmp_path))
    found = figures_of(made, *words, act=over_speeds, progress=Progress(stream=said))
    used = made.module.chain.correction.conditioning
    assert used.cosine_delay_s == pytest.approx(1e-7, abs=2e-9)
    assert used.delay_s == 0.0, "nobody asked for it"
    corners = read_corners(made.access)
    assert corners.corner_hz == pytest.approx(250e3, rel=0.01)
    assert corners.cosine_corner_hz == pytest.approx(255e3, rel=0.01)
    assert 2e-5 < np.sqrt(np.mean(position_errors(made, 400) ** 2)) < 3e-4
    assert found["saved"]
    assert found["delay_estimate_s"] == pytest.approx(1.0 / (2.0 * math.pi * 250e3), rel=0.01)
    assert 0.0 < found["delay_estimate_uncertainty_s"] < 2e-8
    assert [round(one["cycles_per_s"] * 60 / CYCLES) for one in found["speeds"]] == [61, 703, 3001]
    assert all(2e-5 < one["after_rms_cycles"] < 3e-4 for one in found["speeds"])
    assert all(one["before_rms_cycles"] > 5e-3 for one in found["speeds"])
    assert found["before_peak_cycles"] > found["before_rms_cycles"] > 5e-3 > found["residual_peak_cycles"]
    top = found["speeds"][-1]
    true = -math.atan(top["cycles_per_s"] / 250e3) / (2.0 * math.pi)
    assert top["after_mean_cycles"] == pytest.approx(true, abs=2e-3)
    assert "waiting for the machine to turn steadily at 61, 703 or 3001 rpm" in said.getvalue()
    assert "at 3001 rpm: collecting 2 s of samples" in said.getvalue()
    page = (tmp_path / "report.html").read_text()
    assert "Error over the speed" in page
    assert "cosine after the sine" in page
    # A check at this speed, of the encoder as it was, and of one that has changed.
    assert figures_of(made, "--check", act=at_this_speed)["drift_rms_cycles"] < 1e-4
    made.source.change = lambda counts: (counts[0] + 7.5, counts[1] * 1.01)
    drift = figures_of(made, "--check", act=at_this_speed)
    assert drift["drift_seen"]
    assert drift["changed"]["gain"] == pytest.approx(0.01, abs=1e-3)
    assert drift["changed"]["sine_offset"] == pytest.approx(7.5 / 1470.0, rel=0.1)
    assert abs(drift["changed"]["cosine_offset"]) < 5e-4
    assert abs(drift["changed"]["phase_rad"]) < 1e-3
    # The same from the files, without a bus.
    assert len(list((tmp_path / "speeds").glob("*.npz"))) == 3
    again = tmp_path / "again"
    files = figures_of(tmp_path / "speeds", "--speeds", "recorded", "--out", str(again), act=from_files)
    assert files["crc32"] == found["crc32"]
    assert files["conditioning"] == found["conditioning"]
    assert files["corner_hz"] == found["corner_hz"]
    assert (again / "table.yaml").exists()


def at_this_speed(bench: Bench, *arguments: str) -> int:
    return command(bench.master, *SHORT[:4], *arguments)


def from_files(folder: Path, *arguments: str) -> int:
    return calibrate_files(build_parser().parse_args(["calibrate", "--samples", str(folder), *arguments]))


def test_the_account_for_people(capsys: pytest.CaptureFixture[str]) -> None:
    """Any order of the speeds; the delay as estimated, because it was said."""
    made = bench(AnalogPath(sine_corner_hz=125e3, cosine_corner_hz=125e3), (3001.0, 1503.0, 61.0))
    assert over_speeds(made, "--delay", "estimate", speeds="61,1503,3001") == 0
    out = capsys.readouterr().out
    assert "3001 rpm, rms" in out
    assert "3001 rpm, mean" in out
    assert "77 %" not in out
    assert "71 % of the amplitude at 3001 rpm" in out
    assert "the amplitudes agree with that" in out
    assert "as estimated" in out
    assert "Accepted. The error within a cycle is at most" in out
    used = made.module.chain.correction.conditioning
    assert used.delay_s == pytest.approx(1.0 / (2.0 * math.pi * 125e3), rel=0.01)
    assert used.cosine_delay_s == 0.0
    assert read_corners(made.access).cosine_corner_hz == 0.0


def test_a_multiplexer(figures_of: Any) -> None:
    """A dry run writes nothing; the delay in time is the same, whichever way the machine turns."""
    made = bench(MULTIPLEXER, (61.0, -1503.0))
    found = figures_of(made, "--dry-run", act=over_speeds, speeds="61,1503")
    assert found["cosine_delay_s"] == pytest.approx(1e-6, abs=2e-9)
    assert found["corner_hz"] == 0.0
    assert found["delay_estimate_s"] is None
    assert found["speeds"][0]["after_mean_cycles"] == 0.0
    assert abs(found["speeds"][0]["before_mean_cycles"]) > 0.01
    assert not found["active"]
    assert read_active(made.access) == NO_CORRECTION
    assert read_corners(made.access) == NO_LOW_PASS


def test_a_speed_that_does_not_come() -> None:
    made = bench(rpm=(61.0, 703.0))
    with pytest.raises(CommissioningError, match=r"steadily at 3001 rpm within 10 s; it turns at 70"):
        over_speeds(made, "--wait", "10")


def test_limits_that_the_true_amplitude_exceeds_are_named() -> None:
    """Those that were chosen at 3000 rpm, where a third of the amplitude is missing."""
    low_pass = AnalogPath(sine_corner_hz=125e3, cosine_corner_hz=125e3)
    made = bench(low_pass, (61.0, 3001.0), amplitude_high_counts=1530)
    with pytest.raises(CommissioningError, match=r"1530 \(2001:03, 2001:04\)"):
        over_speeds(made, speeds="61,3001")
    assert read_active(made.access) == NO_CORRECTION
    assert read_corners(made.access) == NO_LOW_PASS


def test_speeds_too_close() -> None:
    made = bench(rpm=(701.0,))
    began = made.bus.now
    with pytest.raises(CalibrationError, match=r"too close to tell: .* ns, .* cycle rms"):
        over_speeds(made, speeds="701,790")
    assert made.bus.now - began < 1.0, "before anything is measured"


def test_files_without_speeds(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / f"{name}.csv").write_text("sine,cosine\n1,2\n")
    with pytest.raises(ConfigError, match="no speed is recorded"):
        from_files(tmp_path, "--speeds", "recorded")
    with pytest.raises(ConfigError, match="2 speeds are required"):
        from_files(tmp_path, "--speeds", "61,300,1000", "--cycles-per-revolution", "2500")


@each(
    "low_pass, words",
    [
        (LowPass(0.0, 0.0, 1e5, 0.0, True, 1e6), "none detected up to 2400 rpm"),
        (LowPass(0.0, 0.0, 1e5, 0.0, True, 1e6, rises=True), "the amplitude rises"),
        (LowPass(0.0, 0.0, 1e5, 0.0, False, 0.0), "equal in size"),
        (LowPass(8e-6, 2e-8, 1e5, 0.02, True), "away from that of one pole"),
        (LowPass(8e-6, 2e-8, 1e5, 0.0, True), "the amplitudes agree"),
    ],
)
def test_how_sure_the_delay_is(low_pass: LowPass, words: str) -> None:
    where = Provenance("", module=MODULE_ID, cycles_per_revolution=CYCLES)
    assert words in delay_words(low_pass, where)
