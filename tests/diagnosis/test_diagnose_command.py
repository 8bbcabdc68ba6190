"""`canfb why --bundle`: what is in its file, also where something is wrong; and docs/monitor.md."""

from __future__ import annotations

import contextlib
import json
import re
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from canfb.cia301.frame import Frame
from canfb.cli import node_options
from canfb.cli.main import main
from canfb.errors import BusError
from canfb.hosting import self_diagnosis
from commissioning_kit import INTERFACE_ID, MODULE_ID, Bench
from documentation import page
from node_commands import Commands, abort, between, place_of

PAGE = page("monitor").partition("\n## One file")[2]
SECONDS = "--seconds=0.01"


@pytest.fixture
def canfb(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Commands:
    monkeypatch.chdir(tmp_path)
    return Commands(monkeypatch, capsys)


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "left.yaml"
    path.write_text(
        "bus: {interface: virtual, channel: x, password: apple}\n"
        f"modules: [{{node_id: {MODULE_ID}, encoder_interface: {INTERFACE_ID}}}]\n"
    )
    return path


def written(folder: Path) -> dict[str, Any]:
    (path,) = folder.glob("canfb-diagnose-*.json")
    text = path.read_text(encoding="utf-8")
    assert "apple" not in text
    found: dict[str, Any] = json.loads(text)
    return found


def test_all_objects_of_the_configured_nodes_are_in_the_file(
    canfb: Commands, config: Path, tmp_path: Path
) -> None:
    out = canfb(Bench(sync=False), "why", "--bundle", config, SECONDS)[0]
    found = written(tmp_path)
    assert list(found)[:4] == ["canfb_diagnosis", "made", "made_by", "versions"]
    assert set(re.findall(r"^\| `(\w+)` \|", PAGE, re.M)) == set(list(found)[3:])
    interface, module = found["nodes"]
    assert (interface["node_id"], module["node_id"]) == (INTERFACE_ID, MODULE_ID)
    assert (interface["objects"]["1000:00"], module["objects"]["2010:01"]) == (0x00040191, 21845)
    assert module["objects"]["1008:00"] == "canfb drive feedback module"
    assert "2020:01" not in module["objects"], "no tables"
    assert "2020:03" not in module["objects"], "write only"
    assert found["configuration"]["bus"] == {"interface": "virtual", "channel": "x", "password": "(left out)"}
    assert re.search(rf"^node {MODULE_ID} \(20h\): \d+ objects$", out, re.M)
    assert re.search(r"^written  canfb-diagnose-\d{8}-\d{6}\.json$", out, re.M)


def test_named_nodes_and_frames_that_are_heard(canfb: Commands, tmp_path: Path) -> None:
    path = tmp_path / "machine.json"
    canfb(Bench(), "why", "--bundle", MODULE_ID, "--out", path, "--seconds=0.2", "-i", "virtual", "-c", "x")
    found = json.loads(path.read_text(encoding="utf-8"))
    assert [node["node_id"] for node in found["nodes"]] == [MODULE_ID]
    assert found["bus"]["seconds"] == 0.2
    assert found["bus"]["frames"]["080"] > 10
    assert stat.S_ISREG(path.stat().st_mode)


def test_without_nodes_all_that_answer_are_read(canfb: Commands, tmp_path: Path) -> None:
    canfb(Bench(sync=False), "why", "--bundle", SECONDS, "-i", "virtual", "-c", "x")
    found = written(tmp_path)
    assert {one["node"] for one in found["bus"]["found"]} >= {INTERFACE_ID, MODULE_ID}
    assert {one["node_id"] for one in found["nodes"]} >= {INTERFACE_ID, MODULE_ID}


def test_a_refused_object_has_the_reason_in_its_place(canfb: Commands, tmp_path: Path) -> None:
    bench = Bench(sync=False)

    def spoil(frame: Frame) -> list[Frame] | None:
        return abort(frame, 0x08000022) if place_of(frame) == (0x2010, 2) else None

    between(bench, spoil)
    canfb(bench, "why", "--bundle", MODULE_ID, SECONDS, "-i", "virtual", "-c", "x")
    (node,) = written(tmp_path)["nodes"]
    assert node["objects"]["2010:02"] == "refused: 08000022h"
    assert node["objects"]["2010:03"] == 3


def test_a_node_that_is_silent_is_told_and_the_others_are_read(canfb: Commands, tmp_path: Path) -> None:
    out, err = canfb(
        Bench(sync=False), "why", "--bundle", 5, MODULE_ID, SECONDS, "-i", "virtual", "-c", "x", code=1
    )
    assert ".json is incomplete: node 5 (05h): " in err
    silent, module = written(tmp_path)["nodes"]
    assert silent["node_id"] == 5
    assert "no answer" in silent["error"]
    assert module["objects"]
    assert "node 5 (05h): 0 objects\n" in out


def test_a_bus_that_is_down_and_a_wrong_configuration_are_in_the_file(
    canfb: Commands, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    del canfb

    @contextlib.contextmanager
    def master_of(options: Any) -> Iterator[Any]:
        raise BusError("cannot open the bus virtual x: gone")
        yield

    monkeypatch.setattr(node_options, "master_of", master_of)
    path = tmp_path / "wrong.yaml"
    path.write_text("modules: [{node_id: 300}]\n")
    assert main(["why", "--bundle", str(path)]) == 1
    found = written(tmp_path)
    assert "node_id must be a whole number 1..127, not 300" in found["configuration_error"]
    assert found["bus"]["error"] == "cannot open the bus virtual x: gone"
    assert "nodes" not in found
    assert capsys.readouterr().err.count(" is incomplete: ") == 1


def test_the_journal_is_that_of_the_services_of_the_configuration(
    canfb: Commands, config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[list[str]] = []

    def said(command: list[str]) -> list[str]:
        asked.append(command)
        return ["a line"]

    monkeypatch.setattr(self_diagnosis, "_said", said)
    canfb(Bench(sync=False), "why", "--bundle", config, SECONDS)
    assert written(tmp_path)["log"] == ["a line"]
    assert asked[0][:5] == ["journalctl", "-u", "canfb@left", "-u", "canfb-interface@left"]
    assert {"--no-hostname", "--no-pager"} <= set(asked[0])


def test_a_command_that_is_not_there_is_a_line() -> None:
    assert self_diagnosis._said(["no-such-command"]) == ["no-such-command is not there"]
    assert self_diagnosis._said(["false"]) == []


def test_the_commands_of_the_page_are_those_of_the_parser() -> None:
    assert f"last {self_diagnosis.MOST_LINES} lines" in PAGE
    assert all(f"`{unit}@NAME`" in PAGE for unit in self_diagnosis.UNITS)
