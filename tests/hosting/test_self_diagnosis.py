"""A diagnosis of the running process: what is in it, that no frame waits for it, and SIGUSR1."""

import json
import logging
import os
import signal
import stat
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from canfb.configuration import parse_config
from canfb.hosting.hosting import Hosting
from canfb.hosting.self_diagnosis import KeptLines, SelfDiagnosis, diagnosing_on_signal, diagnosis_text, plain
from commands import Command, yaml_file

LIMIT_S = 60.0
BUS = "bus: {interface: virtual, channel: diagnosis, password: apple}\n"


def served(serving: Hosting, folder: Path, ask: Callable[[], None]) -> dict[str, Any]:
    """Serve until the diagnosis that ``ask`` requests is there."""
    path = folder / f"canfb-diagnose-{os.getpid()}.json"
    end = time.monotonic() + LIMIT_S

    def alive(now: float) -> None:
        if path.exists():
            serving.stop()
        assert time.monotonic() < end, "no diagnosis"

    with serving, diagnosing_on_signal(serving.diagnosis.request):
        serving.run(ask, alive)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    text = path.read_text(encoding="utf-8")
    assert "apple" not in text
    found: dict[str, Any] = json.loads(text)
    assert not [one for one in folder.iterdir() if one.name.startswith(".")]
    return found


@pytest.mark.parametrize("ending", [False, True])
def test_nodes_write_all_they_know_on_a_signal(
    ending: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "canfb")
    text = (
        f"{BUS}modules: [{{node_id: 32, state_dir: {tmp_path}, residual_limit: 0.25}}]\n"
        "interfaces: [{node_id: 16, source: {kind: motion}}]\n"
    )
    hosting = Hosting(parse_config(text), {"interface": "virtual", "channel": "diagnosis"})

    def ask() -> None:
        signal.raise_signal(signal.SIGUSR1)
        if ending:
            hosting.stop()

    found = served(hosting, tmp_path, ask)
    assert caplog.messages.count(f"diagnosis written: {tmp_path}/canfb-diagnose-{os.getpid()}.json") == 1
    assert " ".join(found) == "canfb_diagnosis made made_by versions configuration bus nodes log"
    assert {"canfb", "python-can", "canopen", "numpy", "PyYAML"} <= set(found["versions"]["packages"])
    assert found["configuration"]["modules"][0]["residual_limit"] == 0.25
    assert found["configuration"]["bus"]["password"] == "(left out)"
    assert found["bus"]["counters"]["send_failures"] == 0
    first, second = found["nodes"]
    assert (first["node_id"], first["state"], second["node_id"]) == (32, "PRE_OPERATIONAL", 16)
    assert first["objects"]["2010:01"] == 16384
    assert first["objects"]["1008:00"] == "canfb drive feedback module"
    assert "2020:01" not in first["objects"], "a table is not settings in words"
    assert "1017:00" in first["objects"]
    assert (second["objects"]["1000:00"], second["objects"]["6401:01"]) == (0x00040191, 0)
    assert first["counters"]["sdo_aborts"] == 0
    assert any("running node 32 (20h), encoder interface: node 16" in line for line in found["log"])


class Stepped:
    """A diagnosis that is stepped by hand."""

    def __init__(self, folder: Path) -> None:
        config = parse_config("modules: [{node_id: 32}]")
        hosting = Hosting(config, {"interface": "virtual", "channel": "stepped"})
        self.diagnosis = SelfDiagnosis(config, {}, hosting._entered, folder)
        with hosting:
            self.nodes = list(hosting.modules)

    def steps(self) -> int:
        """Steps until it is being written."""
        self.diagnosis.step(self.nodes)
        count = sum(thread is None for thread in self.diagnosis._working)
        self.diagnosis.finish(self.nodes)
        return count


def test_it_goes_on_in_many_small_steps(tmp_path: Path) -> None:
    stepped = Stepped(tmp_path)
    stepped.diagnosis.step(stepped.nodes)
    assert not list(tmp_path.iterdir()), "nobody has asked"
    stepped.diagnosis.request()
    assert stepped.steps() > 30
    (path,) = tmp_path.iterdir()
    first = json.loads(path.read_text(encoding="utf-8"))
    stepped.diagnosis.request()
    stepped.steps()
    assert [one.name for one in tmp_path.iterdir()] == [path.name], "it takes the place of the one before"
    assert json.loads(path.read_text(encoding="utf-8"))["nodes"] == first["nodes"]


def test_a_folder_that_cannot_be_written_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "canfb")
    stepped = Stepped(tmp_path / "gone")
    stepped.diagnosis.request()
    stepped.steps()
    told = f"no diagnosis in {tmp_path / 'gone'}: No such file or directory"
    assert [text for text in caplog.messages if "diagnosis" in text] == [told]
    stepped.diagnosis.request()
    for _ in range(2):
        stepped.diagnosis.step(stepped.nodes)
    stepped.diagnosis.request()  # while it works on the one before
    stepped.diagnosis.finish(stepped.nodes)
    assert caplog.messages.count(told) == 3


def test_a_signal_while_the_process_ends_does_not_kill_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Command
) -> None:
    left = list[Any]()
    monkeypatch.setattr(Hosting, "__enter__", lambda hosting: hosting)
    monkeypatch.setattr(Hosting, "run", lambda *_: None)
    monkeypatch.setattr(Hosting, "__exit__", lambda *_: left.append(signal.getsignal(signal.SIGUSR1)))
    command("run", yaml_file(tmp_path, "bus: {interface: virtual}\nmodules: [{node_id: 32}]\n"))
    assert left != [signal.SIG_DFL]


def test_secrets_are_left_out_and_whatever_an_object_holds_becomes_json() -> None:
    values = {"a": b"\x01\xff", "b": float("nan"), "c": (1, 2.5), "d": Path("x"), 4: None}
    secrets = {
        "channel": "tcp://me:apple@host:7",
        "key": 5,
        "api_key": "apple",
        "keys": [{"Password": "apple", "token": None}],
        "monkey": "banana",
    }
    assert plain(values | secrets) == {
        "a": "01ff",
        "b": None,
        "c": [1, 2.5],
        "d": "x",
        "4": None,
        "channel": "tcp://(left out)@host:7",
        "key": "(left out)",
        "api_key": "(left out)",
        "keys": [{"Password": "(left out)", "token": None}],
        "monkey": "banana",
    }
    assert json.loads(diagnosis_text("x", {"name": "\udcffµ"}).encode())["name"] == "\udcffµ"


def test_the_log_is_bounded() -> None:
    kept = KeptLines()
    for n in range(2000):
        kept.emit(logging.LogRecord("canfb", logging.INFO, "", 0, f"line {n}", None, None))
    assert len(kept.lines()) == 500
    assert kept.lines()[-1].endswith(" INFO line 1999")
