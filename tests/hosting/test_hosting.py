"""Modules of a configuration in a program of one's own: its log has what `canfb run` prints."""

import logging
import os
import signal
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from canfb import BusError, ConfigError, load_config
from canfb.hosting import serving
from canfb.hosting.hosting import Hosting
from canfb.hosting.readiness import Readiness
from commands import Command, yaml_file
from documentation import blocks, page


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """Two modules; the saved parameters of the first one are damaged."""
    state = tmp_path / "state"
    state.mkdir()
    (state / "manufacturer.bin").write_bytes(b"?")
    return yaml_file(
        tmp_path,
        "bus: {interface: virtual, channel: hosting}\n"
        f"modules: [{{node_id: 32, state_dir: {state}}}, {{node_id: 33, encoder_interface: 17}}]\n",
    )


def test_the_log_has_the_lines_of_the_command(
    config: Path, caplog: pytest.LogCaptureFixture, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    caplog.set_level(logging.INFO, "canfb")
    hosting = Hosting(load_config(config))
    with hosting:
        hosting.run(ready=hosting.stop)
    records = [record for record in caplog.records if record.name != "can.bus"]  # a bus of another test
    assert command.read() == ("", ""), "nothing but the log"
    events = [record for record in records if record.name == "canfb.hosting.event_log"]
    assert [record.event["event"] for record in events] == ["nmt", "nmt"]  # type: ignore[attr-defined]
    records = [record for record in records if record not in events]
    assert {record.name for record in records} == {"canfb.hosting.hosting"}
    caplog.clear()
    monkeypatch.setattr(Readiness, "ready", lambda readiness: signal.raise_signal(signal.SIGTERM))
    told = [record.getMessage() for record in records if record.levelno == logging.INFO]
    warned = [record.getMessage() for record in records if record.levelno == logging.WARNING]
    said = command("run --json", config)
    objects = {kind: [one for one in said.objects if one["event"] == kind] for kind in ("nmt", "message")}
    assert [(one["node"], one["state"]) for one in objects["nmt"]] == [
        (node, "PRE-OPERATIONAL") for node in (32, 33)
    ]
    assert [one["text"] for one in objects["message"]] == warned + told
    assert said.err == ""
    out, err = command("run", config)
    boots = [f"node {node}: boot-up, PRE-OPERATIONAL" for node in ("32 (20h)", "33 (21h)")]
    assert [line.split(" ", 2)[2] for line in out.splitlines()[2:4]] == boots
    assert out.splitlines()[:2] + out.splitlines()[4:] == told
    assert told[0] == "running node 32 (20h), 33 (21h) on virtual hosting; end with Ctrl-C"
    assert told[1].startswith(
        "node 32 (20h), 33 (21h): without sample times the jitter of SYNC limits the speed"
    )
    assert told[2:] == [
        f"node {node}: 0 samples; missed 0, residual 0, amplitude 0, coasted 0, lost 0" for node in (32, 33)
    ]
    assert err.splitlines() == [f"canfb: {text}" for text in warned]
    assert len(warned) == 1
    assert warned[0].startswith("node 32: stored manufacturer parameters in ")
    assert caplog.records == [], "printed, and not handed on"
    assert logging.getLogger("canfb").propagate, "as it was"


def test_what_was_saved_is_there_and_is_said(config: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "canfb")
    coast = (0x2010, 3)
    for found, said in ((3, False), (9, True)):
        with Hosting(load_config(config)) as hosting:
            hosting.run(ready=hosting.stop)
            module = hosting.modules[0]
            assert module.dictionary.entry(*coast).value == found
            module.dictionary.lookup(*coast).download(b"\x09")
            module.dictionary.lookup(0x1010, 1).download(b"save")
        line = "node 32 (20h): saved values take precedence over the configuration: 2010h:03"
        assert any(line in text for text in caplog.messages) is said


def test_it_is_used_as_a_context_manager(config: Path) -> None:
    with pytest.raises(RuntimeError, match="context manager"):
        Hosting(load_config(config)).run()


def test_what_it_opened_is_closed_when_something_is_wrong(config: Path) -> None:
    good = load_config(config)
    with pytest.raises(ConfigError, match="receive_own_messages"):
        Hosting(good, good.bus | {"receive_own_messages": True})
    for _ in range(2):  # the state_dir is free again
        with pytest.raises(BusError, match="cannot open the bus nowhere"):
            Hosting(good, {"interface": "nowhere"}).__enter__()


def test_the_program_of_the_page_runs(
    config: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    program = blocks(page("attach"), "python")[-1]
    run = Hosting.run
    monkeypatch.setattr(Hosting, "run", lambda hosting: run(hosting, hosting.stop))
    monkeypatch.setattr(logging, "basicConfig", lambda **keys: None)
    monkeypatch.chdir(config.parent)
    config.rename("axes.yaml")
    exec(compile(program, "attach.md", "exec"), {})
    assert capsys.readouterr() == ("", "")


@pytest.fixture
def running(config: Path) -> Iterator[Path]:
    """Both modules of the configuration, on their bus."""
    ready = threading.Event()
    with Hosting(load_config(config)) as hosting:
        thread = threading.Thread(target=hosting.run, args=(ready.set,))
        thread.start()
        assert ready.wait(60.0)
        yield config
        assert [module.counters.duplicate_frames for module in hosting.modules] == [0, 0]
        hosting.stop()
        thread.join()


@pytest.mark.parametrize("name", ["run", "simulate"])
def test_a_second_node_with_the_node_id_leaves_before_its_boot_up(
    running: Path, name: str, tmp_path: Path, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serving, "ANSWER_S", 60.0)  # the first has a thread of this process
    ready = tmp_path / "run.ready"
    ready.write_text(f"{os.getppid()}\n")
    module = "{node_id: 33}" if name == "run" else "{node_id: 40, encoder_interface: 33}"
    text = f"bus: {{interface: virtual, channel: hosting}}\nmodules: [{module}]\n"
    second = yaml_file(tmp_path, text, "second.yaml")
    assert command(f"{name} --ready-file {ready}", second, code=1) == (
        "",
        "canfb: node 33 (21h): another node on virtual hosting has this node-ID (5A1h received); "
        "stop it, or set another node_id\n",
    )
    assert ready.read_text() == f"{os.getppid()}\n", "that of the first"
