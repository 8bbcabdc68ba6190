"""`canfb calibrate`: options that cannot be, samples of files, tables of files, a bus that is not there."""

import io
import signal
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from canfb import BusError, CorrectionTable
from canfb.bus import opening
from canfb.calibrate.calibration_run import CalibrationRun
from canfb.cli.printing import CLEAR, Progress
from commands import Command
from commissioning_kit import random_encoder

ENCODER = random_encoder(3)


def tracks(n: int = 2400, speed: float = 3.37, seed: int = 1) -> tuple[Any, Any]:
    """Counts at about ``speed`` cycles a sample, with a wandering speed."""
    k = np.arange(n)
    position = speed * k + 20.0 * np.sin(k / 300.0)
    return ENCODER.sample(position, np.random.default_rng(seed))


@pytest.fixture(scope="module")
def npz(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("samples") / "tracks.npz"
    sine, cosine = tracks()
    np.savez(path, sine=sine, cosine=cosine, rate_hz=1000.0)
    return str(path)


def test_who_produces_the_sync_has_to_hear_it(monkeypatch: pytest.MonkeyPatch, command: Command) -> None:
    opened: list[dict[str, object]] = []

    def refuse(words: dict[str, object]) -> None:
        opened.append(words)
        raise BusError("no")

    monkeypatch.setattr(opening, "open_bus", refuse)
    for line in ("calibrate -i virtual -c x --rate 100", "calibrate -i virtual -c x"):
        command(line, code=1)
    plain = {"interface": "virtual", "channel": "x"}
    assert opened == [plain | {"receive_own_messages": True}, plain, plain]


def test_ctrl_c_is_exit_code_130_and_one_line(monkeypatch: pytest.MonkeyPatch, command: Command) -> None:
    monkeypatch.setattr(CalibrationRun, "over_bus", lambda *rest: signal.raise_signal(signal.SIGINT))
    said = command("calibrate -i virtual -c interrupted", code=130)
    assert said.err == "canfb: interrupted; nothing more is written to the module\n"


def test_samples_of_a_file_give_table_and_report(npz: str, tmp_path: Path, command: Command) -> None:
    out = tmp_path / "out"
    said = command(f"calibrate --samples {npz} --out {out} --json --entries 128")
    assert said.err == ""
    figures = said.json
    assert figures["accepted"]
    assert not figures["active"]
    assert figures["module"] is None
    assert figures["canfb"] == version("canfb")
    assert figures["command"].startswith(f"canfb calibrate --samples {npz} ")
    assert datetime.fromisoformat(f"{figures['date']} {figures['time']}").tzinfo is not None
    assert figures["sample_rate_hz"] == 1000.0
    assert figures["before_rms_cycles"] > 30 * figures["residual_rms_cycles"]
    table = CorrectionTable.from_bytes((out / "table.bin").read_bytes())
    assert len(table) == figures["entries"] == 128
    names = ("table.yaml", "table.bin", "samples.npz", "report.html")
    assert figures["files"] == [str(out / name) for name in names]
    again = command(f"calibrate --samples {out}/samples.npz --entries 128 --json").json
    assert again["crc32"] == figures["crc32"], "the samples are kept as they were"


def test_a_csv_file_with_gaps_and_an_offset(tmp_path: Path, command: Command) -> None:
    sine, cosine = tracks()
    times = np.arange(2400) * 0.001
    times[1200:] += 5.0
    rows = [f"{t:.4f},{c + 2048},{s + 2048}" for t, s, c in zip(times, sine, cosine, strict=True)]
    path = tmp_path / "scope.csv"
    path.write_text("t,b,a\n" + "\n".join(rows) + "\n")
    options = "--columns a,b --mid-scale 2048 --time-column t --sample-rate 1000 --json"
    figures = command(f"calibrate {options} --samples", path).json
    assert figures["samples_missed"] == 20
    assert figures["uncertainty_peak_cycles"] < 1e-4


def test_drift_of_a_file_against_a_table_of_a_file(npz: str, tmp_path: Path, command: Command) -> None:
    made = command(f"calibrate --samples {npz} --out", tmp_path)
    assert "dry run" not in made.out, "there is no module to be spared"
    check = f"calibrate --check --table {tmp_path}/table.yaml --json --samples"
    same = command(check, npz).json
    assert same["drift_rms_cycles"] < 1e-5
    assert not same["drift_seen"]
    sine, cosine = tracks(seed=3)
    moved = tmp_path / "moved.npz"
    np.savez(moved, sine=sine + 10, cosine=cosine)
    out = tmp_path / "today"
    found = command(check, moved, "--out", out).json
    assert [path.name for path in out.iterdir()] == ["samples.npz"]
    assert "has table.yaml of another measurement" in command(check, npz, "--out", tmp_path, code=2).err
    for maker, kind, said in (("commission", "", "command"), ("calibrate", "--check ", "measurement")):
        (out / "report.html").write_text(f"Made by canfb {maker}.")
        err = command(f"calibrate {kind}--samples {npz} --out", out, code=2).err
        assert f"has report.html of another {said}: give another folder" in err
    assert "has report.html of another" in command("commission --out", out, code=2).err
    (out / "speeds").mkdir()
    assert "has speeds of another" in command(f"calibrate --samples {npz} --out", out, code=2).err
    want = 10 / ENCODER.amplitude_counts / (2 * np.pi * np.sqrt(2))
    assert found["drift_rms_cycles"] == pytest.approx(want, rel=0.1)
    assert found["drift_seen"]


def test_a_refused_file_for_programs(tmp_path: Path, command: Command) -> None:
    path = tmp_path / "still.npz"
    np.savez(path, sine=np.full(1000, 700), cosine=np.full(1000, -1200))
    said = command("calibrate --json --samples", path, code=1)
    assert said.json["reason"] == "coverage"
    assert said.err.count("\n") == 1


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_without_a_terminal_a_long_step_says_how_far_it_is_every_five_seconds() -> None:
    clock, plain, quiet = [100.0], io.StringIO(), io.StringIO()
    for stream in (plain, quiet):
        clock[0] = 100.0
        progress = Progress(stream is quiet, stream, now=lambda: clock[0])
        progress.step("collecting")
        for second in range(1, 21):
            clock[0] = 100.0 + second
            progress.part(second / 20.0)
        progress.step("next")
        clock[0] += 4.0
        progress.part(0.5)
        progress.clear()
    assert quiet.getvalue() == ""
    assert plain.getvalue().splitlines() == [
        "... collecting",
        "    25 %, 15 s left",
        "    50 %, 10 s left",
        "    75 %, 5 s left",
        "... next",
    ]


def test_the_remaining_time_is_that_of_the_step_so_far() -> None:
    clock, terminal = [100.0], Terminal()
    progress = Progress(stream=terminal, now=lambda: clock[0])
    progress.part(0.1)
    clock[0] += 500.0
    progress.step("two")
    for passed_s, part in ((1.0, 0.01), (3.0, 0.01), (6.0, 0.25), (6.5, 0.25), (8.0, 0.0), (9.0, 2.0)):
        clock[0] = 600.0 + passed_s
        progress.part(part)
    progress.step("three")
    progress.clear()
    _, _, shown = terminal.getvalue().partition("two\n")
    assert shown.endswith(f"{CLEAR}... three\n")
    shown = shown.removesuffix("... three\n")
    assert [bar.rpartition("]")[2].strip() for bar in shown.split(CLEAR) if bar] == [
        *("1 %", "1 %, 4 min 57 s left", "25 %, 18 s left", "25 %, 20 s left", "0 %", "100 %")
    ]


def test_a_bus_that_has_a_sync_gets_no_second_one(command: Command) -> None:
    with can.Bus(interface="virtual", channel="two-syncs") as bus:
        bus.send_periodic(can.Message(arbitration_id=0x80, is_extended_id=False), 0.02)
        said = command("calibrate 0x20 --rate 1000 -i virtual -c two-syncs", code=2)
    assert said.err == "canfb: --rate: another node sends SYNC already; leave --rate out\n"
