"""`canfb calibrate` as a whole on an in-process bus, with encoders drawn at random."""

import io
import json
import re
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibrating import calibrate, command, position_errors

import canfb
from canfb import CalibrationError, FeedbackModule, Frame
from canfb.calibration.recording import LARGEST_DENOMINATOR, away_from, find_lock
from canfb.cli.commands import build_parser
from canfb.cli.config_file import EXAMPLE
from canfb.cli.printing import Progress
from canfb.cli.simulate import chosen
from canfb.configuration import parse_config
from canfb.device.storage.storage import MemoryStore
from canfb.interface.encoder_interface import EncoderInterface
from canfb.master.access import CommissioningError
from canfb.master.all_or_nothing import read_active
from canfb.master.samples import TrackSamples
from canfb.signal.correction import NO_CORRECTION
from canfb.signal.supervision import TABLE_ACTIVE, VALID
from canfb.simulation.embedded_bus import EmbeddedBus, SyncProducer
from canfb.simulation.encoder import Motion, Ramp, Ripple
from canfb.simulation.set_up import source_of
from commissioning_kit import CYCLES, RATE_HZ, Bench, EmbeddedMaster, random_encoder, running
from folding import each


@pytest.mark.parametrize(("seed", "conditioning"), [(0, "fit"), (1, "none"), (2, "fit"), (3, "none")])
def test_the_position_of_the_module_becomes_right(seed: int, conditioning: str, figures_of: Any) -> None:
    rpm = float(np.random.default_rng(seed).uniform(30, 2000))
    bench = running(0.2, encoder=random_encoder(seed), rpm=rpm, store=MemoryStore())
    before = np.sqrt(np.mean(position_errors(bench, 400) ** 2))
    figures = figures_of(bench, "--save", "--conditioning", conditioning)
    after = np.sqrt(np.mean(position_errors(bench, 400) ** 2))
    noise = bench.encoder.noise_lsb / (2 * np.pi * bench.encoder.amplitude_counts)
    assert before > 0.004
    assert 0.7 * noise < after < 2.0 * noise + 5e-5, "noise of single samples, and no more"
    assert figures["crc32"] == f"{bench.value(0x2020, 4):08X}"
    assert figures["saved"]
    assert figures["residual_rms_cycles"] == pytest.approx(after, rel=0.3)
    assert bench.value(0x2011, 1) & TABLE_ACTIVE


def test_the_account_for_people(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    bench = Bench()
    said = io.StringIO()
    words = ("--out", str(tmp_path), "--encoder", "X1")
    with pytest.raises(CommissioningError, match=r"^--save: module 32 \(20h\) cannot save"):
        calibrate(bench, *words, "--save")
    assert calibrate(bench, *words, progress=Progress(stream=said)) == 0
    out = capsys.readouterr().out.splitlines()
    assert out[0].split() == ["before", "after"]
    assert any(line.startswith("deviation, rms") for line in out)
    assert any(line.startswith("Accepted. The error within a cycle falls from ") for line in out)
    assert any("not saved: the table is lost" in line for line in out)
    assert out[-1] == f"written  {tmp_path / 'report.html'}"
    assert max(map(len, out)) < 260
    assert said.getvalue().splitlines() == [
        "... reading the active table",
        "... collecting 1.5 s of samples, at least 1000",
        said.getvalue().splitlines()[2],
        "... activating the table",
        "... verifying on fresh samples",
        "... the table is in force",
    ]
    assert "X1" in (tmp_path / "report.html").read_text()
    assert (tmp_path / "table.bin").read_bytes() == bench.module.chain.correction.table.to_bytes()  # type: ignore[union-attr]


def test_a_table_that_is_worse_than_the_one_before_is_said_to_be(capsys: pytest.CaptureFixture[str]) -> None:
    bench = Bench(rpm=137.0)
    assert calibrate(bench) == 0
    assert "the rest is mostly noise of single samples." in capsys.readouterr().out
    assert calibrate(bench, "--entries", "32") == 0
    out = capsys.readouterr().out
    assert "Accepted. The previous table is better: " in out
    assert "mostly noise" not in out
    with pytest.raises(CalibrationError, match="the table of 16 entries would be uncertain by "):
        calibrate(bench, "--entries", "16")


def test_the_figures_are_those_of_the_module(figures_of: Any, capsys: pytest.CaptureFixture[str]) -> None:
    """Cycles from standstill on, missed samples by its counter, its identity; a dry run writes nothing."""
    motion = Motion((Ramp(0.2, 0.0), Ramp(2.0, 600.0)), (Ripple(10.0, 0.31),))
    bench = running(2.5, motion=motion, config={"serial_number": 77})
    rng = np.random.default_rng(2)
    bench.source.change = lambda counts: counts if rng.random() > 0.01 else None
    began, missed, asked = bench.bus.now, bench.value(0x2012, 1), bench.source.source.position_cycles
    found = figures_of(bench, "--dry-run")
    assert found["module_lost"] is False
    assert found["module_missed"] == bench.value(0x2012, 1) - missed
    assert found["samples_missed"] == pytest.approx(found["module_missed"], abs=2)
    assert found["samples_missed"] > 5
    assert found["intervals_without_sync"] == 0
    moved = bench.source.source.position_cycles - asked
    assert 1.5 * 9.0 * CYCLES < moved < 3.0 * 11.0 * CYCLES
    assert found["module_cycles"] == pytest.approx(moved, rel=0.05)
    assert found["mean_rate_hz"] == pytest.approx(found["sample_rate_hz"], rel=0.01)
    assert bench.bus.now - began < 3.0
    assert found["module_identity"] == [0, 1, 1, 77]
    assert found["encoder_interface_identity"] == [0, 2, 1, 0]
    assert (found["date"], found["time"]) == ("2026-03-01", None)
    bench.source.change = lambda counts: counts
    assert calibrate(bench, "--dry-run") == 0
    out = capsys.readouterr().out
    assert "dry run: nothing was written to the module" in out
    assert read_active(bench.access) == NO_CORRECTION
    assert {frame.data[0] >> 5 for frame in bench.master.sent if frame.can_id == 0x620} <= {2, 3, 5}, (
        "uploads only"
    )
    (line,) = [one for one in out.splitlines() if one.startswith("coverage")]
    found_cycles = int(line.split("at least ")[1].split()[0])
    assert found_cycles == pytest.approx(found["module_cycles"], rel=0.1)


@pytest.mark.parametrize(("from_s", "line"), [(2.5, 1), (3.2, 2)], ids=["before", "while it collects"])
def test_a_lost_position_is_said_at_once_and_in_the_account(
    from_s: float, line: int, figures_of: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    bench = Bench(motion=Motion((Ramp(0.2, 0.0), Ramp(2.0, 600.0)), (Ripple(10.0, 0.31),)))
    bench.source.change = lambda counts: (0, 0) if 0.0 < bench.bus.now - from_s < 0.1 else counts
    bench.bus.run_until(2.7)
    assert bool(bench.value(0x2011, 1) & 4) == (from_s < 2.7)
    said = io.StringIO()
    assert calibrate(bench, "--dry-run", progress=Progress(stream=said)) == 0
    lines = said.getvalue().splitlines()
    assert lines[line].startswith("... the position of module 32 (20h) is lost")
    assert lines[line].endswith(": canfb why 0x20 says why and what to do")
    assert sum("is lost" in one for one in lines) == 1
    assert "lost; a table does not bring it back (canfb why)" in capsys.readouterr().out
    found = figures_of(bench, "--dry-run")
    assert (found["module_lost"], found["module_cycles"]) == (True, None)


def test_a_restart_while_it_collects_is_said_and_its_counters_are_not_known(figures_of: Any) -> None:
    bench, said = Bench(), io.StringIO()
    resets = [Frame(0x000, b"\x81\x20")]
    bench.master.on_wait = lambda now: bench.bus.send(resets.pop()) if resets and now > 1.0 else None
    found = figures_of(bench, progress=Progress(stream=said))
    assert "... module 32 (20h) was restarted meanwhile (boot-up heard): the samples are" in said.getvalue()
    assert (found["active"], found["module_missed"]) == (True, None)


def test_drift_is_a_small_number_and_touches_nothing(
    figures_of: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    bench = Bench()
    calibrate(bench)
    active = read_active(bench.access)
    bench.master.sent.clear()
    none = figures_of(bench, "--check")
    assert not none["drift_seen"]
    assert none["drift_rms_cycles"] < 3e-5
    bench.source.change = lambda counts: (counts[0] + 12, counts[1])
    moved = figures_of(bench, "--check")
    # An offset of d moves the phase by d/A cos(x)/(2 pi): rms d/A/(2 pi sqrt(2)).
    want = 12 / bench.encoder.amplitude_counts / (2 * np.pi * np.sqrt(2))
    assert moved["drift_rms_cycles"] == pytest.approx(want, rel=0.15)
    assert moved["drift_peak_cycles"] == pytest.approx(want * np.sqrt(2), rel=0.2)
    assert moved["drift_seen"]
    assert {frame.data[0] >> 5 for frame in bench.master.sent if frame.can_id == 0x620} <= {2, 3, 5}
    assert read_active(bench.access) == active
    assert calibrate(bench, "--check") == 0
    assert "its error now, rms" in capsys.readouterr().out


REFUSED = {
    "standstill": (Motion(()), "coverage", "the tracks hardly change"),
    "locked": (Motion((), (), 60.0 * 1000.0 * 0.25 / CYCLES), None, "locked"),
    "clipped": (None, "clipped", "ends of the converter's range"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_bad_measurement_is_refused_and_nothing_changes(
    case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    motion, reason, words = REFUSED[case]
    bench = Bench(motion=motion)
    if case == "clipped":
        bench.source.change = lambda counts: (max(-2048, min(counts[0] * 2, 2047)), counts[1])
    with pytest.raises(CalibrationError, match=words) as error:
        calibrate(bench, "--json", "--out", str(tmp_path))
    figures = json.loads(capsys.readouterr().out)
    assert figures["accepted"] is False
    assert figures["reason"] == error.value.reason
    assert reason is None or figures["reason"] == reason
    assert read_active(bench.access) == NO_CORRECTION
    assert {path.name for path in tmp_path.iterdir()} == {"samples.npz", "report.html"}
    assert "Refused: " in (tmp_path / "report.html").read_text()
    assert not any(frame.data[0] >> 5 in (1, 6) for frame in bench.master.sent if frame.can_id == 0x620)


@pytest.mark.parametrize(
    ("change", "motion", "download", "words"),
    [
        (lambda pair: (pair[0] + 60, pair[1]), None, "", "on fresh samples the table leaves .* predicted"),
        (lambda pair: pair, Motion((), (Ripple(0.05, 8.0),), 0.8), "", "within two cycles: .* faster"),
        (lambda pair: (700, -1200), None, "", "at standstill"),
        (lambda pair: pair, None, "2320200300000000", "active table is 00000000h"),
    ],
    ids=["the encoder changes", "the machine is slow and ripples", "the machine stops", "another master"],
)
def test_what_does_not_keep_its_promise_is_taken_back(
    change: Any, motion: Motion | None, download: str, words: str
) -> None:
    bench = running(0.1, motion=motion)

    def happen(now: float) -> None:
        if bench.value(0x2020, 4):
            bench.source.change = change
            if download:
                bench.module.receive(Frame(0x620, bytes.fromhex(download)), now)

    bench.master.on_wait = happen
    with pytest.raises(CommissioningError, match=f"{words}.*; the previous table and conditioning"):
        calibrate(bench)
    assert read_active(bench.access) == NO_CORRECTION


SESSION_HZ = 100.0


@pytest.mark.parametrize(
    ("per_sync", "more", "within_s"), [(1, (), 110.0), (2, ("--least-samples", "3000"), 50.0)]
)
def test_it_is_measured_proven_and_active_and_still_right_ten_seconds_later(
    per_sync: int, more: tuple[str, ...], within_s: float, tmp_path: Path, figures_of: Any
) -> None:
    """After ten seconds of the first session; 8000 samples, and 1500 to prove it."""
    text = EXAMPLE.replace("    times: true", f"    samples_per_sync: {per_sync}\n    times: true", 1)
    config = parse_config(text)
    simulate = build_parser().parse_args(["simulate", "feedback.yaml", "--rate", str(SESSION_HZ)])
    bus, module = EmbeddedBus(), FeedbackModule(config.modules[0])
    interface = EncoderInterface(
        config.modules[0].encoder_interface,
        source_of(*chosen(simulate, config)),
        times=config.modules[0].times,
        samples_per_sync=config.modules[0].samples_per_sync,
    )
    master = EmbeddedMaster(bus)
    for device in (module, interface, SyncProducer(1.0 / SESSION_HZ)):
        bus.attach(device)
    bus.send(Frame(0x000, b"\x01\x00"))
    bus.run_until(10.0)
    words = ("feedback.yaml", "--out", str(tmp_path / "measured"), *more)
    figures = figures_of(master, *words, act=command, config=config)
    assert bus.now - 10.0 < within_s
    assert module.limits.samples_per_sync == per_sync
    assert figures["accepted"]
    assert figures["active"]
    assert figures["before_rms_cycles"] > 0.005
    assert figures["fresh_rms_cycles"] < 2e-4
    bus.run_until(bus.now + 10.0)
    status = module.dictionary.entry(0x2011, 1).value
    assert status & VALID
    assert status & TABLE_ACTIVE
    assert module.dictionary.entry(0x2012, 2).value == 0, "no residual was over its limit"
    assert (tmp_path / "measured" / "report.html").is_file()


RPM_OF_A_CYCLE = 60.0 * RATE_HZ / CYCLES  # per sample
N = 1000


def tracks(cycles_per_sample: float, n: int = N, lost: float = 0.0) -> TrackSamples:
    rng = np.random.default_rng(3)
    sine, cosine = random_encoder(1).sample(0.1 + cycles_per_sample * np.arange(n), rng)
    gone = rng.random(n) < lost
    return TrackSamples.of(np.where(gone, np.nan, sine), np.where(gone, np.nan, cosine), RATE_HZ, "simulated")


def lock_of(samples: TrackSamples) -> Fraction | None:
    return find_lock(samples.sine, samples.cosine)


@each("speed, lock", [
    (0.0, Fraction(0, 1)),
    (25.0, Fraction(0, 1)),
    (-25.0, Fraction(0, 1)),
    (12.5, Fraction(1, 2)),
    (83 + 1 / 3, Fraction(1, 3)),
    (-1 / 3, Fraction(2, 3)),
    (2 / 7, Fraction(2, 7)),
    (7 / 16, Fraction(7, 16)),
    (1.0005, Fraction(0, 1)),
    *((speed, None) for speed in (0.382, 25.41, 83.5 + 0.004, 1.003, 0.02, 83.34)),
])  # fmt: skip
def test_small_fractions_are_found_and_what_is_far_enough_from_them_is_no_lock(
    speed: float, lock: Fraction | None
) -> None:
    assert lock_of(tracks(speed)) == lock
    assert lock_of(tracks(speed, lost=0.03)) == lock


def test_too_few_samples_none_and_a_dead_track_say_nothing() -> None:
    """A dead track is the wiring, and the measurement says so. Nor does numpy warn where all are missed."""
    dead = tracks(0.382)
    dead.cosine[:] = 0.0
    assert lock_of(tracks(1.0, 255)) is lock_of(tracks(1.0, lost=1.0)) is lock_of(dead) is None


def test_the_step_that_is_named_leads_away_from_every_lock() -> None:
    for q in range(1, LARGEST_DENOMINATOR + 1):
        for p in range(q):
            assert lock_of(tracks(p / q + away_from(p / q))) is None


def refused(bench: Bench) -> tuple[CalibrationError, float]:
    """The refusal, and how long it took from the start of the command."""
    began = bench.bus.now
    with pytest.raises(CalibrationError) as error:
        command(bench.master)
    return error.value, bench.bus.now - began


@each("cycles, words", [(25.0, "a whole number"), (12.5, "n + 1/2"), (-12.5, "n + 1/2")])
def test_a_lock_is_refused_after_a_second_with_a_speed_that_does(cycles: float, words: str) -> None:
    bench = running(1.5, motion=Motion((Ramp(0.2, 0.0), Ramp(0.5, cycles * RPM_OF_A_CYCLE))))
    error, took_s = refused(bench)
    assert took_s < 2.0
    assert error.reason == "locked"
    assert words in str(error)
    named = re.search(r"for example at ([0-9.]+) rpm", str(error))
    assert named is not None
    rpm = float(named[1])
    assert abs(cycles) * RPM_OF_A_CYCLE < rpm < (abs(cycles) + 0.5) * RPM_OF_A_CYCLE
    moving = tracks(rpm / RPM_OF_A_CYCLE, 6000)
    assert canfb.calibrate_from_motion(moving.sine, moving.cosine, "fit", adc_bits=12).accepted


def test_standstill_gets_three_seconds_for_somebody_who_is_about_to_start() -> None:
    bench = Bench(motion=Motion(()))
    error, took_s = refused(bench)
    assert error.reason == "coverage"
    assert 3.0 <= took_s < 4.0
    assert str(error).startswith("the tracks hardly change: the machine is at standstill, or moves")
    assert str(error).endswith("Let it turn 9.17 rpm faster")


def test_a_machine_that_starts_within_them_is_measured(capsys: pytest.CaptureFixture[str]) -> None:
    bench = Bench(motion=Motion((Ramp(1.5, 0.0), Ramp(0.5, 61.0)), (Ripple(0.1, 0.3),)))
    words = ("--seconds", "4", "--least-samples", "3000", "--verify", "0.6", "--dry-run")
    assert command(bench.master, *words) == 0
    assert "Accepted." in capsys.readouterr().out
