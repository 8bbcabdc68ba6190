"""`canfb log replay` of a log or of a folder, and docs/monitor.md: text, JSON, files and a page."""

import csv
import importlib
import math
import os
import re
import signal
import sys
from collections.abc import Iterable
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from canfb import CanfbError, StateFiles, StatusBit
from canfb.device.storage.storage import MemoryStore
from canfb.logs import log_replay
from canfb.logs.log_replay import (
    COLUMNS as ROW_COLUMNS,
    LogJob,
    LogRow,
    ReplayOptions,
    do_work,
    rows_of,
    work_of,
)
from canfb.replay.findings import COLUMNS
from canfb.sdo.tables import as_yaml
from canfb.signal.conditioning import IDENTITY
from canfb.signal.correction import Correction
from commands import Command, yaml_file
from commissioning_kit import TABLE
from html_page import Page
from ideal_tracks import adc_pdo
from replay_kit import NODE_ID, Planned, config, contents, live, sdo_write, session, write_log

SAMPLES = 300


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A session with a bad sample and a missed one."""
    plan = session(SAMPLES)
    plan[400] = (plan[400][0], adc_pdo(0.1, 3000.0))
    del plan[302]  # the sample, its SYNC is there
    return write_log(tmp_path / "bus.log", live(plan)[0])


def test_json(log: Path, command: Command) -> None:
    (module,) = command("log replay --json --drift", log).json["modules"]
    assert module["node_id"] == NODE_ID
    assert module["faults"]["missed"] == {"times": 1, "samples": 1}
    assert module["faults"]["amplitude"]["times"] == 1
    assert module["compared"]["1A0h"]["different"] == 0
    assert 0.0 < module["margins"]["residual"]["value"] <= 0.5
    assert module["margins"]["amplitude_high"]["margin"] < 0.0, "3000 of 2560 counts"
    assert module["drift"]["reason"]
    (module,) = command("log replay --json --set max_acceleration_rad_s2=8", log).json["modules"]
    assert [name for name, one in module["margins"].items() if one["margin"] < 0.0] == ["amplitude_high"]


def test_a_sample_without_any_amplitude_has_no_margin(tmp_path: Path, command: Command) -> None:
    plan = session(SAMPLES)
    plan[400] = (plan[400][0], adc_pdo(0.1, 0.0))
    log = write_log(tmp_path / "bus.log", live(plan)[0])
    (line,) = (one for one in command("log replay", log).lines if one.startswith("lowest amplitude"))
    assert re.fullmatch(r"lowest amplitude +0 of 410 counts at \d\.\d{3} s", line)


def test_files_have_all_samples(log: Path, tmp_path: Path, command: Command) -> None:
    pytest.importorskip("pyarrow")
    parquet = importlib.import_module("pyarrow.parquet")

    for suffix in ("csv", "npz", "parquet"):
        command("log replay", log, "--out", tmp_path / f"out.{suffix}")
    with (tmp_path / "out.csv").open() as file:
        rows = list(csv.DictReader(file))
    arrays = np.load(tmp_path / "out.npz")
    table = parquet.read_table(tmp_path / "out.parquet")
    assert list(rows[0]) == list(arrays) == table.column_names == list(COLUMNS)
    assert len(rows) == table.num_rows == SAMPLES
    for name in COLUMNS:
        np.testing.assert_array_equal(arrays[name], table[name].to_numpy())
        np.testing.assert_array_equal(arrays[name], np.array([float(row[name]) for row in rows]))
    assert np.count_nonzero(arrays["status"] & StatusBit.MISSED) == 1
    assert sorted(path.name for path in tmp_path.iterdir() if "part" in path.name) == []


def test_a_page_with_pictures(log: Path, tmp_path: Path, command: Command) -> None:
    path = tmp_path / "replay.html"
    command("log replay", log, "--report", path)
    text = path.read_text(encoding="utf-8")
    page = Page(text)
    assert text.count("<svg ") == 5
    assert "Replay of bus.log" in page.text
    assert not any(name in ("src", "href") for name, _ in page.attributes)
    assert "missed, 1 interval" in page.text


def test_a_table_and_other_settings_are_tried(log: Path, tmp_path: Path, command: Command) -> None:
    file = yaml_file(tmp_path, as_yaml(Correction(TABLE, IDENTITY), {}), "table.yaml")
    tried = command("log replay --json --set amplitude_high_counts=4000", log, "--table", file).json
    (module,) = tried["modules"]
    assert module["table_crc32"] == f"{TABLE.crc32:08X}"
    assert module["faults"]["amplitude"]["times"] == 0
    assert module["compared"]["1A0h"]["different"] > 100


def test_saved_parameters_are_read_and_stay(tmp_path: Path, command: Command) -> None:
    store = MemoryStore()
    plan = [(0.01, sdo_write(0x2001, 4, b"\xa0\x0f")), (0.02, sdo_write(0x1010, 1, b"save"))]
    live(plan, store)
    state = tmp_path / "state"
    with StateFiles(state) as files:
        files.save(dict(store.images))
    before = {path.name: path.read_bytes() for path in state.iterdir()}
    plan = session(SAMPLES)
    plan[400] = (plan[400][0], adc_pdo(0.1, 3000.0))
    frames, sent = live(plan, store)
    log = write_log(tmp_path / "bus.log", frames)
    sent_again = tmp_path / "sent.log"
    words = "--state", state, "--frames", sent_again
    (module,) = command("log replay --json", log, *words).json["modules"]
    assert module["margins"]["amplitude_high"]["limit"] == 4000.0
    again = list(can.LogReader(sent_again))
    assert [(one.arbitration_id, bytes(one.data).hex()) for one in again] == contents(sent)
    assert {path.name: path.read_bytes() for path in state.iterdir()} == before


def test_several_modules_of_one_log(tmp_path: Path, command: Command) -> None:
    log = write_log(tmp_path / "bus.log", live(session())[0])
    config = yaml_file(tmp_path, "modules: [{node_id: 32}, {node_id: 33}]\n")
    one, other = command("log replay --json", log, "--config", config).json["modules"]
    assert (one["node_id"], other["node_id"]) == (32, 33)
    assert one["samples"] == other["samples"] == SAMPLES
    assert one["compared"]
    assert other["compared"] == {}, "the log has none of its frames"
    command("log replay", log, "--config", config, "--out", tmp_path / "x.csv", code=2)


def test_damaged_lines_are_left_out_and_counted(log: Path, command: Command) -> None:
    lines = log.read_text().splitlines(keepends=True)
    lines[100:100] = ["(1700000000.1) can0 19\n", "\n", "garbage \x00\n", "# oiled\n"]
    lines.insert(50, "(1700000000.060000) can0 12345678#00\n")
    lines.insert(51, "(1700000000.060000) can0 20000080#0000000000000000\n")
    lines.insert(52, "(1700000000.060000) can1 080#\n")
    lines.insert(53, "(1700000000.060000) can0 123##100\n")
    log.write_text("".join(lines))
    text = command("log replay --channel can0", log).out
    lost = ("2 damaged lines left out, the first is line 105", "2 empty lines and comments left out")
    assert all(words in text for words in lost)
    assert "1 error frames left out" in text
    assert "2 frames with 29-bit identifiers or CAN FD left out" in text
    assert text.splitlines()[0].split(None, 1)[1] == (
        "1 frames of channel can1 left out: --channel selects can0"
    )
    assert "faults: 1 × missed" in text
    for line in ("monitor --frames 0x20", "monitor --json"):
        assert command(line, "--log", log).err.splitlines() == [f"canfb: {log}: {words}" for words in lost]


def by_sender(log: Path) -> Path:
    """The same log with a channel name for each sender, as udp_multicast has them."""
    names = {"080": "a", "190": "b", "000": "a"}
    lines = log.read_text().splitlines()
    words = [line.split(" ") for line in lines]
    senders = [f"{time} {names.get(frame[:3], 'c')} {frame}" for time, _, frame, *_ in words]
    log.write_text("\n".join(senders) + "\n")
    return log


def test_all_channels_are_taken_unless_one_is_chosen(log: Path, command: Command) -> None:
    one_name = command("log replay --json", log).json
    assert one_name["left_out"] == {}
    assert command("log replay --json", by_sender(log)).json == one_name | {"channels": ["a", "b", "c"]}
    assert command("log replay", log).lines[0].split(None, 1)[1] == (
        "channels a, b, c are taken as one bus; if they are several, --channel takes one"
    )


def test_what_is_left_out_is_said_first_and_no_page_is_green(tmp_path: Path, command: Command) -> None:
    path = write_log(tmp_path / "good.log", live(session(SAMPLES))[0])
    page = tmp_path / "page.html"
    words = path, "--report", page
    command("log replay", *words)
    assert 'class="verdict"' in page.read_text()
    by_sender(path)
    path.write_text(path.read_text().replace(" b 190", " a 190"))
    text = command("log replay --channel a", *words).out
    left_out = sum(" c " in line for line in path.read_text().splitlines())
    assert left_out >= SAMPLES
    assert text.splitlines()[0].split(None, 1)[1] == (
        f"{left_out} frames of channel c left out: --channel selects a"
    )
    missing = f"faults: none in the samples used; {left_out} frames with CAN-IDs of this module were left out"
    assert missing in text
    assert missing in page.read_text()
    assert 'class="verdict bad"' in page.read_text()
    found = command("log replay --channel a --json", *words).json
    assert (found["left_out"], found["channels"]) == ({"c": left_out}, ["a"])
    assert found["modules"][0]["left_out"] == left_out


def test_a_log_that_is_cut_off_is_used_up_to_there(tmp_path: Path, command: Command) -> None:
    path = write_log(tmp_path / "bus.blf", live(session(3000))[0])
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 2 // 3])
    assert 100 < command("log replay --json", path, code=1).json["modules"][0]["samples"] < 3000
    for line in ("log replay", "monitor --frames 0x20 --log", "monitor --json --log"):
        said = command(line, path, code=1)
        first = said.lines[0] if line == "log replay" else said.err
        assert "bus.blf: damaged or incomplete: nothing can be read after frame" in first
        assert len(said.err.splitlines()) <= 1


def refusal(command: Command, line: str, code: int) -> str:
    said = command(f"log replay {line}", code=code).err
    (error,) = (one for one in said.splitlines() if not one.startswith("..."))
    return error


@pytest.mark.parametrize(("line", "code", "said"), [
    ("nowhere.log", 1, "nowhere.log: cannot be read: No such file or directory"),
    ("bus.xyz", 2, "unknown suffix '.xyz'; bus logs end with .asc, "),
    ("empty.log", 1, "there is no classic frame with an 11-bit identifier in it"),
    ("bus.log --channel can7", 1, "there is no classic frame of channel can7 in it; there are can0"),
    ("bus.log --out x.txt", 2, "--out x.txt: the name must end with .csv, .npz, .parquet"),
    ("bus.log --out none/x.csv", 2, "--out none/x.csv: there is no folder none"),
    ("bus.log --table words.asc", 1, "this is not a correction table"),
    ("bus.log --config source.yaml", 2, "module 32 has a source of its own"),
    ("bus.log --workers 2", 2, "--workers: is for a folder of logs"),
    ("bus.log --report ./bus.log", 2, "--out, --frames, --report: must differ, also from the log"),
    ("bus.log --set 'adapt={ofset: 1}'", 2, "unknown key 'ofset' in adapt; did you mean 'offset'?"),
    ("bus.log --out x.csv --report x.csv", 2, "--out, --frames, --report: must differ, also from the log"),
    ("samples.csv", 1, "the first is line 1; are these samples? (calibrate --samples)"),
    ("empty.log --frames words.asc", 1, "there is no classic frame with an 11-bit identifier in it"),
])  # fmt: skip
def test_what_cannot_be_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Command, line: str, code: int, said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    write_log(Path("bus.log"), live(session(20))[0])
    Path("empty.log").touch()
    Path("samples.csv").write_text("sine,cosine\n1,2\n")
    Path("words.asc").write_text("no log\nat all\n")
    Path("source.yaml").write_text("modules: [{node_id: 32, source: {kind: motion}}]\n")
    before = {path: path.read_bytes() for path in Path().iterdir()}
    assert said in refusal(command, line, code)
    assert {path: path.read_bytes() for path in Path().iterdir()} == before, "nothing half written"


PAGE = (Path(__file__).parents[2] / "docs" / "monitor.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^    canfb (log .*)$", PAGE, re.M)


def test_its_commands_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Command) -> None:
    pytest.importorskip("pyarrow")
    monkeypatch.chdir(tmp_path)
    Path("feedback.yaml").write_text(
        "bus: {interface: virtual, channel: page}\nmodules: [{node_id: 32, encoder_interface: 16}]\n"
    )
    record, replay, folder = COMMANDS
    command(record.replace("--seconds 10", "--seconds 0.05"))
    write_log(Path("bus.log"), live(session(200))[0])
    assert "200 samples; faults: none" in command(replay).out
    Path("month").mkdir()
    Path("bus.log").rename("month/bus.log")
    command(folder.replace("--workers 2", "--workers 1"))
    made = {"month.parquet", "replay.html", "samples.csv"}
    assert {path.name for path in Path().iterdir()} == {"feedback.yaml", "month", *made}


SETTINGS = ReplayOptions((config(),))
GOOD = 4


def faulty(samples: int, bad: int) -> list[Planned]:
    plan = session(samples)
    for n in range(bad):
        place = 40 + 40 * n  # a sample
        plan[place] = (plan[place][0], adc_pdo(0.1, 3000.0))
    return plan


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Good logs in two folders, one that is no log, and files that are none."""
    pytest.importorskip("pyarrow")
    root = tmp_path / "month"
    (root / "monday").mkdir(parents=True)
    for n in range(GOOD):
        suffix = (".log", ".blf")[n % 2]
        write_log(root / f"{'monday/' if n > 1 else ''}{n}{suffix}", live(faulty(100 + 10 * n, n))[0])
    (root / "bad.log").write_text("no log\n")
    (root / "notes.csv").write_text("when,what\n")
    (root / "readme.txt").write_text("mine")
    return root


def comparable(rows: Iterable[LogRow]) -> list[list[Any]]:
    return [
        [
            None if isinstance(row[name], float) and math.isnan(row[name]) else row[name]
            for name in ROW_COLUMNS
        ]
        for row in rows
    ]


def test_each_log_has_its_row_and_a_second_run_does_what_has_changed(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "month.parquet"
    parts: list[float] = []
    rows = do_work(*work_of(folder, SETTINGS, out), SETTINGS, out, 1, progress=parts.append)
    assert comparable(importlib.import_module("pyarrow.parquet").read_table(out).to_pylist()) == comparable(
        rows
    )
    by_name = {Path(row["log"]).stem: row for row in rows}
    assert by_name.pop("bad")["error"].endswith("line 1; record it with candump -L (UTF-8)")
    for n in range(GOOD):
        row = by_name[str(n)]
        assert (row["error"], row["samples"], row["amplitude_times"]) == (None, 100 + 10 * n, n)
        assert row["compared_different"] == row["compared_missing"] == 0
        assert (row["highest_amplitude_counts_margin"] < 0.0) == (n > 0)
    assert parts == sorted(parts)
    assert parts[-1] == 1.0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["month", "month.parquet"]

    work = work_of(folder, SETTINGS, out)
    assert (work[0], comparable(work[1])) == ([], comparable(rows)), "a bad one is not done again either"
    (folder / "1.blf").unlink()
    write_log(folder / "0.log", live(session(50))[0])
    work = work_of(folder, SETTINGS, out)
    assert [job.name for job in work[0]] == ["0.log"]
    assert {row["log"] for row in do_work(*work, SETTINGS, out, 1)} == {
        "0.log", "bad.log", "monday/2.log", "monday/3.blf"
    }  # fmt: skip
    for other in (
        ReplayOptions((config(coast_samples=5),)),
        ReplayOptions((config(),), channel="can0"),
        ReplayOptions((config(),), drift=True),
    ):
        assert work_of(folder, other, out)[1] == []


class InTurn(Executor):
    """An executor of another kind: it works when it is asked."""

    def submit(self, fn: Any, /, *words: Any, **named: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(fn(*words, **named))
        return future


def test_another_executor_and_an_interruption(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "x.parquet"
    whole = do_work(*work_of(folder, SETTINGS, None), SETTINGS, None, executor=InTurn())

    def interrupt(part: float) -> None:
        if part > 0.4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        do_work(*work_of(folder, SETTINGS, out), SETTINGS, out, 1, progress=interrupt)
    work = work_of(folder, SETTINGS, out)
    assert 0 < len(work[1]) < GOOD
    assert comparable(do_work(*work, SETTINGS, out, 1)) == comparable(whole)


def kill_first(job: LogJob, settings: ReplayOptions) -> list[LogRow]:
    """Like an end for lack of memory: the largest log ends its process whenever it is tried."""
    if job.name.endswith("3.blf"):
        os.kill(os.getpid(), signal.SIGKILL)
    return rows_of(job, settings)


def test_of_two_processes_the_one_that_is_killed_costs_its_log(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = do_work(*work_of(folder, SETTINGS, None), SETTINGS, None, 1)
    monkeypatch.setattr(log_replay, "rows_of", kill_first)
    rows = do_work(*work_of(folder, SETTINGS, None), SETTINGS, None, 2)
    lost = [row for row in rows if row["log"] == "monday/3.blf"]
    assert [row["error"] for row in lost] == ["its process was ended repeatedly"]
    assert comparable(row for row in rows if row not in lost) == comparable(
        row for row in expected if row["log"] != "monday/3.blf"
    )


def test_what_cannot_be_of_a_folder_is_one_line(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Command
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "no.parquet").write_text("mine")
    for line, code, said in (
        ("empty", 1, "there is no bus log in this folder"),
        ("month --out x.csv", 2, "needs a table, such as --out month.parquet"),
        ("month --out none/x.parquet", 2, "there is no folder"),
        ("month --out no.parquet", 1, "exists, and is not a table"),
        ("month --report x.html", 2, "--report: is for one log, not for a folder"),
        ("month --workers 0", 2, "--workers 0: must be 1 at least"),
    ):
        assert said in refusal(command, line, code)
    assert (tmp_path / "no.parquet").read_text() == "mine"
    with pytest.raises(CanfbError, match="choose it by NODE"):
        ReplayOptions((config(), config()), state_dir=Path())


def test_the_command_says_which_log_is_bad_or_incomplete(
    folder: Path, tmp_path: Path, command: Command
) -> None:
    line = "log replay --workers 1 --no-drift"
    captured = command(line, folder, code=1)
    assert "not done  bad.log, module 32: " in captured.out
    assert "0.log, module 32: 100 samples, no faults\n" in captured.out
    assert f"{GOOD + 1} rows, " in captured.out
    assert captured.err == f"... {GOOD + 1} logs to replay, 0 are done\n"
    # Names of files are bytes on Linux.
    path = folder / os.fsdecode(b"1\xff.blf" if sys.platform == "linux" else b"1.blf")
    path.write_bytes((folder / "1.blf").read_bytes()[:-200])
    for _ in range(2):
        captured = command(line, folder, "--out", tmp_path / "x.parquet", code=1)
        assert "damaged or incomplete" in captured.out
    assert captured.err.startswith("... 0 logs to replay, ")
