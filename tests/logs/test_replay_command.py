"""`canfb log replay` and docs/monitor.md: text, JSON, files and a page; one line for what cannot be."""

from __future__ import annotations

import csv
import importlib
import json
import re
import shlex
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from canfb.cli.main import main
from canfb.device.storage.storage import MemoryStore
from canfb.hosting.state_files import StateFiles
from canfb.objects import StatusBit
from canfb.replay.findings import COLUMNS
from canfb.sdo.tables import as_yaml
from canfb.signal.conditioning import IDENTITY
from canfb.signal.correction import Correction
from html_page import Page
from replay_kit import NODE_ID, TABLE, adc, contents, live, sdo_write, session, write_log

SAMPLES = 300


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A session with a bad sample and a missed one."""
    plan = session(SAMPLES)
    plan[400] = (plan[400][0], adc(0.1, 3000.0))
    del plan[302]  # the sample, its SYNC is there
    return write_log(tmp_path / "bus.log", live(plan)[0])


def figures(capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def test_json(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["log", "replay", str(log), "--json", "--drift"]) == 0
    found = figures(capsys)
    (module,) = found["modules"]
    assert module["node_id"] == NODE_ID
    assert module["faults"]["missed"] == {"times": 1, "samples": 1}
    assert module["faults"]["amplitude"]["times"] == 1
    assert module["compared"]["1A0h"]["different"] == 0
    assert 0.0 < module["margins"]["residual"]["value"] <= 0.5
    assert module["margins"]["amplitude_high"]["margin"] < 0.0, "3000 of 2560 counts"
    assert module["drift"]["reason"]


def test_files_have_all_samples(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("pyarrow")
    parquet = importlib.import_module("pyarrow.parquet")

    for suffix in ("csv", "npz", "parquet"):
        assert main(["log", "replay", str(log), "--out", str(tmp_path / f"out.{suffix}")]) == 0
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


def test_a_page_with_pictures(log: Path, tmp_path: Path) -> None:
    path = tmp_path / "replay.html"
    assert main(["log", "replay", str(log), "--report", str(path)]) == 0
    text = path.read_text(encoding="utf-8")
    page = Page(text)
    assert text.count("<svg ") == 5
    assert "Replay of bus.log" in page.text
    assert not any(name in ("src", "href") for name, _ in page.attributes)
    assert "missed, 1 interval" in page.text


def test_a_table_and_other_settings_are_tried(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "table.yaml"
    file.write_text(as_yaml(Correction(TABLE, IDENTITY), {}))
    words = ["log", "replay", str(log), "--json", "--table", str(file), "--set", "amplitude_high_counts=4000"]
    assert main(words) == 0
    (module,) = figures(capsys)["modules"]
    assert module["table_crc32"] == f"{TABLE.crc32:08X}"
    assert module["faults"]["amplitude"]["times"] == 0
    assert module["compared"]["1A0h"]["different"] > 100


def test_saved_parameters_are_read_and_stay(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
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
    words = ["--json", "--state", str(state), "--frames", str(tmp_path / "sent.log")]
    assert main(["log", "replay", str(log), *words]) == 0
    (module,) = figures(capsys)["modules"]
    assert module["margins"]["amplitude_high"]["limit"] == 4000.0
    again = list(can.LogReader(tmp_path / "sent.log"))
    assert [(one.arbitration_id, bytes(one.data).hex()) for one in again] == contents(sent)
    assert {path.name: path.read_bytes() for path in state.iterdir()} == before


def test_several_modules_of_one_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = live(session())[0]
    log = write_log(tmp_path / "bus.log", frames)
    config = tmp_path / "two.yaml"
    config.write_text("modules: [{node_id: 32}, {node_id: 33}]\n")
    assert main(["log", "replay", str(log), "--config", str(config), "--json"]) == 0
    one, other = figures(capsys)["modules"]
    assert (one["node_id"], other["node_id"]) == (32, 33)
    assert one["samples"] == other["samples"] == SAMPLES
    assert one["compared"]
    assert other["compared"] == {}, "the log has none of its frames"
    assert main(["log", "replay", str(log), "--config", str(config), "--out", str(tmp_path / "x.csv")]) == 2


def test_damaged_lines_are_left_out_and_counted(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = log.read_text().splitlines(keepends=True)
    lines[100:100] = ["(1700000000.1) can0 19\n", "\n", "garbage \x00\n", "# oiled\n"]
    lines.insert(50, "(1700000000.060000) can0 12345678#00\n")
    lines.insert(51, "(1700000000.060000) can0 20000080#0000000000000000\n")
    lines.insert(52, "(1700000000.060000) can1 080#\n")
    lines.insert(53, "(1700000000.060000) can0 123##100\n")
    log.write_text("".join(lines))
    assert main(["log", "replay", str(log), "--channel", "can0"]) == 0
    text = capsys.readouterr().out
    lost = ("2 damaged lines left out, the first is line 105", "2 empty lines and comments left out")
    assert all(words in text for words in lost)
    assert "1 error frames left out" in text
    assert "2 frames with 29-bit identifiers or CAN FD left out" in text
    assert text.splitlines()[0].split(None, 1)[1] == (
        "1 frames of channel can1 left out: --channel takes those of can0 alone"
    )
    assert "faults: 1 × missed" in text
    for words in (["monitor", "--frames", "0x20"], ["monitor", "--json"]):
        assert main([*words, "--log", str(log)]) == 0
        assert capsys.readouterr().err.splitlines() == [f"canfb: {log}: {words}" for words in lost]


def by_sender(log: Path) -> Path:
    """The same log with a channel name for each sender, as udp_multicast has them."""
    names = {"080": "a", "190": "b", "000": "a"}
    lines = log.read_text().splitlines()
    words = [line.split(" ") for line in lines]
    senders = [f"{time} {names.get(frame[:3], 'c')} {frame}" for time, _, frame, *_ in words]
    log.write_text("\n".join(senders) + "\n")
    return log


def test_all_channels_are_taken_unless_one_is_chosen(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["log", "replay", str(log), "--json"]) == 0
    one_name = figures(capsys)
    assert one_name["left_out"] == {}
    assert main(["log", "replay", str(by_sender(log)), "--json"]) == 0
    assert figures(capsys) == one_name | {"channels": ["a", "b", "c"]}
    assert main(["log", "replay", str(log)]) == 0
    assert capsys.readouterr().out.splitlines()[0].split(None, 1)[1] == (
        "channels a, b, c are taken as one bus; if they are several, --channel takes one"
    )


def test_what_is_left_out_is_said_first_and_no_page_is_green(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_log(tmp_path / "good.log", live(session(SAMPLES))[0])
    page = tmp_path / "page.html"
    command = ["log", "replay", str(path), "--report", str(page)]
    assert main(command) == 0
    assert 'class="verdict"' in page.read_text()
    by_sender(path)
    path.write_text(path.read_text().replace(" b 190", " a 190"))
    capsys.readouterr()
    assert main([*command, "--channel", "a"]) == 0
    text = capsys.readouterr().out
    left_out = sum(" c " in line for line in path.read_text().splitlines())
    assert left_out >= SAMPLES
    assert text.splitlines()[0].split(None, 1)[1] == (
        f"{left_out} frames of channel c left out: --channel takes those of a alone"
    )
    missing = f"faults: none in what was taken; {left_out} frames with CAN-IDs of this module were left out"
    assert missing in text
    assert missing in page.read_text()
    assert 'class="verdict bad"' in page.read_text()
    assert main([*command, "--channel", "a", "--json"]) == 0
    found = figures(capsys)
    assert (found["left_out"], found["channels"]) == ({"c": left_out}, ["a"])
    assert found["modules"][0]["left_out"] == left_out


def test_a_log_that_is_cut_off_is_used_up_to_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_log(tmp_path / "bus.blf", live(session(3000))[0])
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 2 // 3])
    assert main(["log", "replay", str(path), "--json"]) == 1
    assert 100 < figures(capsys)["modules"][0]["samples"] < 3000
    for words in (
        ["log", "replay", str(path)],
        ["monitor", "--frames", "0x20", "--log", str(path)],
        ["monitor", "--log", str(path), "--json"],
    ):
        assert main(words) == 1
        captured = capsys.readouterr()
        first = captured.out.splitlines()[0] if words[0] == "log" else captured.err
        assert "bus.blf: damaged or incomplete: nothing can be read behind frame" in first
        assert len(captured.err.splitlines()) <= 1


WRONG = [
    (["nowhere.log"], 1, "nowhere.log: cannot be read: No such file or directory"),
    (["bus.xyz"], 2, "unknown suffix '.xyz'; bus logs end with .asc, "),
    (["empty.log"], 1, "there is no frame with an 11-bit identifier in it"),
    (["bus.log", "--channel", "can7"], 1, "there is no frame of channel can7; there are can0"),
    (["bus.log", "--out", "x.txt"], 2, "--out x.txt: the name must end with .csv, .npz, .parquet"),
    (["bus.log", "--out", "none/x.csv"], 2, "--out none/x.csv: there is no folder none"),
    (["bus.log", "--table", "words.asc"], 1, "this is not a correction table"),
    (["bus.log", "--config", "source.yaml"], 2, "module 32 has a source of its own"),
    (["bus.log", "--workers", "2"], 2, "--workers: is for a folder of logs"),
]


@pytest.mark.parametrize(("words", "code", "said"), WRONG, ids=[" ".join(words) for words, _, _ in WRONG])
def test_what_cannot_be_is_one_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: list[str],
    code: int,
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    write_log(Path("bus.log"), live(session(20))[0])
    Path("empty.log").touch()
    Path("words.asc").write_text("no log\nat all\n")
    Path("source.yaml").write_text("modules: [{node_id: 32, source: {kind: motion}}]\n")
    before = sorted(Path().iterdir())
    assert main(["log", "replay", *words]) == code
    errors = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("...")]
    assert len(errors) == 1, errors
    assert said in errors[0]
    assert sorted(Path().iterdir()) == before, "nothing half written"


ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "monitor.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^    canfb (log .*)$", PAGE, re.M)


def test_its_commands_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pyarrow")
    monkeypatch.chdir(tmp_path)
    Path("feedback.yaml").write_text(
        "bus: {interface: virtual, channel: page}\nmodules: [{node_id: 32, encoder_interface: 16}]\n"
    )
    record, replay, folder = COMMANDS
    assert main(shlex.split(record.replace("--seconds 10", "--seconds 0.05"))) == 0
    write_log(Path("bus.log"), live(session(200))[0])
    assert main(shlex.split(replay)) == 0
    Path("month").mkdir()
    Path("bus.log").rename("month/bus.log")
    assert main(shlex.split(folder.replace("--workers 2", "--workers 1"))) == 0
    assert {path.name for path in Path().iterdir()} == {
        "feedback.yaml",
        "month",
        "month.parquet",
        "replay.html",
        "samples.csv",
    }
    assert "200 samples; faults: none" in capsys.readouterr().out
