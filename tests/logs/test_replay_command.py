"""`canfb log replay` and docs/monitor.md: text, JSON, files and a page; one line for what cannot be."""

from __future__ import annotations

import csv
import importlib
import re
from pathlib import Path

import can
import numpy as np
import pytest

from canfb.device.storage.storage import MemoryStore
from canfb.hosting.state_files import StateFiles
from canfb.objects import StatusBit
from canfb.replay.findings import COLUMNS
from canfb.sdo.tables import as_yaml
from canfb.signal.conditioning import IDENTITY
from canfb.signal.correction import Correction
from commands import Command
from commissioning_kit import TABLE
from html_page import Page
from replay_kit import NODE_ID, adc, contents, live, sdo_write, session, write_log

SAMPLES = 300


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A session with a bad sample and a missed one."""
    plan = session(SAMPLES)
    plan[400] = (plan[400][0], adc(0.1, 3000.0))
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
    file = tmp_path / "table.yaml"
    file.write_text(as_yaml(Correction(TABLE, IDENTITY), {}))
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
    plan[400] = (plan[400][0], adc(0.1, 3000.0))
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
    frames = live(session())[0]
    log = write_log(tmp_path / "bus.log", frames)
    config = tmp_path / "two.yaml"
    config.write_text("modules: [{node_id: 32}, {node_id: 33}]\n")
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
        "1 frames of channel can1 left out: --channel takes those of can0 alone"
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
        f"{left_out} frames of channel c left out: --channel takes those of a alone"
    )
    missing = f"faults: none in what was taken; {left_out} frames with CAN-IDs of this module were left out"
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
        assert "bus.blf: damaged or incomplete: nothing can be read behind frame" in first
        assert len(said.err.splitlines()) <= 1


WRONG = [
    ("nowhere.log", 1, "nowhere.log: cannot be read: No such file or directory"),
    ("bus.xyz", 2, "unknown suffix '.xyz'; bus logs end with .asc, "),
    ("empty.log", 1, "there is no frame with an 11-bit identifier in it"),
    ("bus.log --channel can7", 1, "there is no frame of channel can7; there are can0"),
    ("bus.log --out x.txt", 2, "--out x.txt: the name must end with .csv, .npz, .parquet"),
    ("bus.log --out none/x.csv", 2, "--out none/x.csv: there is no folder none"),
    ("bus.log --table words.asc", 1, "this is not a correction table"),
    ("bus.log --config source.yaml", 2, "module 32 has a source of its own"),
    ("bus.log --workers 2", 2, "--workers: is for a folder of logs"),
]


@pytest.mark.parametrize(("line", "code", "said"), WRONG)
def test_what_cannot_be_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Command, line: str, code: int, said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    write_log(Path("bus.log"), live(session(20))[0])
    Path("empty.log").touch()
    Path("words.asc").write_text("no log\nat all\n")
    Path("source.yaml").write_text("modules: [{node_id: 32, source: {kind: motion}}]\n")
    before = sorted(Path().iterdir())
    lines = command(f"log replay {line}", code=code).err.splitlines()
    errors = [one for one in lines if not one.startswith("...")]
    assert len(errors) == 1, errors
    assert said in errors[0]
    assert sorted(Path().iterdir()) == before, "nothing half written"


ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "monitor.md").read_text(encoding="utf-8")
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
