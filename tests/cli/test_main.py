"""The command line as a whole: exit codes, one line for an error, --debug; a reader that stops or goes."""

import contextlib
import json
import logging
import os
import pty
import select
import signal
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path

import pytest

from canfb.cli import run as run_command
from canfb.cli.printing import PRINTING, printed_log, printed_without_waiting
from canfb.errors import BusError
from canfb.hosting import serving
from commands import Command, yaml_file
from processes import Started, python


@pytest.fixture
def config(tmp_path: Path) -> str:
    good = "bus: {interface: virtual, channel: canfb-cli}\nmodules: [{node_id: 32}]\n"
    return str(yaml_file(tmp_path, good))


def one_line(text: str) -> str:
    assert text.endswith("\n")
    (line,) = text.splitlines()
    return line


CANFB = ("-W", "error", "-m", "canfb")


@pytest.mark.parametrize(("stream", "words", "code"), [(1, "example", 0), (2, "check nothing.yaml", 2)])
def test_without_a_stream_it_does_the_rest(stream: int, words: str, code: int) -> None:
    called = [sys.executable, *CANFB, "config", *words.split()]
    done = python("-c", f"import os; os.close({stream}); os.execv({sys.executable!r}, {called})")
    assert (done.returncode, done.stdout, done.stderr) == (code, "", "")


def test_version_and_help_are_done(command: Command) -> None:
    assert command("--version").out == f"canfb {version('canfb')}\n"
    for line in ("", "--help"):
        out, err = command(line)
        assert all(f"\n    {name}" in out for name in ("try", "run", "simulate", "config"))
        assert err == ""


def test_in_a_process_of_its_own_an_error_is_the_only_line(config: str) -> None:
    """Nothing that python-can logs or that Python warns of stands beside it."""
    done = python(*CANFB, "run", config, "-i", "udp_multicast", "-c", "127.0.0.1")
    assert (done.returncode, done.stdout) == (1, "")
    assert one_line(done.stderr).startswith("canfb: cannot open the bus udp_multicast 127.0.0.1: ")


def test_debug_shows_the_traceback_wherever_it_stands_and_keeps_the_exit_code(
    config: str, command: Command
) -> None:
    for line in ("--debug run -i socketcan -c nothing77", "run --debug -i socketcan -c nothing77"):
        err = command(line, config, code=1).err
        assert "canfb.errors.BusError: cannot open the bus socketcan nothing77" in err
    done = python(*CANFB, "--debug", "config", "check", "nothing.yaml")
    assert done.returncode == 2
    assert "Traceback (most recent call last):" in done.stderr
    *_, error, line = done.stderr.splitlines()
    assert error.startswith("canfb.errors.ConfigError: nothing.yaml: cannot be read")
    assert line.startswith("canfb: nothing.yaml: cannot be read")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
@pytest.mark.parametrize(
    "arguments",
    [["config", "example"], ["--help"], ["--version"], ["config", "example", "--debug"]],
    ids=" ".join,
)
def test_an_output_that_is_full_is_one_line(arguments: list[str]) -> None:
    with Path("/dev/full").open("wb") as full:
        done = python(*CANFB, *arguments, stdout=full)
    assert done.returncode == 1
    want = "canfb: cannot write the output: No space left on device"
    assert done.stderr.splitlines()[-1] == want
    assert ("--debug" in arguments) or one_line(done.stderr) == want


def test_the_bus_options_replace_the_words_of_the_configuration(
    monkeypatch: pytest.MonkeyPatch, config: str, command: Command
) -> None:
    opened: list[dict[str, object]] = []

    def refuse(options: dict[str, object]) -> None:
        opened.append(options)
        raise BusError("no")

    monkeypatch.setattr(serving, "open_device_bus", refuse)
    for more in ("", "-c can3 -b 500000", "-i socketcan --bus-kwargs local_loopback=False port=7"):
        command(f"run {config} {more}", code=1)
    assert opened == [
        {"interface": "virtual", "channel": "canfb-cli"},
        {"interface": "virtual", "channel": "can3", "bitrate": 500000},
        {"interface": "socketcan", "channel": "canfb-cli", "local_loopback": False, "port": 7},
    ]


def test_ctrl_c_before_the_bus_is_open_is_exit_code_130_without_a_traceback(
    monkeypatch: pytest.MonkeyPatch, config: str, command: Command
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(run_command, "load_config", interrupted)
    assert command("run", config, code=130).err == ""


@pytest.mark.parametrize("name", ["logging", "canfb.cli.command_line", "canfb.cli.options"])
def test_so_it_is_while_the_command_line_is_loaded(name: str) -> None:
    interrupts = f"import sys\ndef interrupts(event, words):\n if words[:1] == ({name!r},):\n"
    interrupts += "  raise KeyboardInterrupt\nsys.addaudithook(interrupts)\n"
    done = python("-c", f"{interrupts}from canfb.cli.main import main\nsys.exit(main(['--help']))")
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


def test_a_reader_that_goes_away_is_no_traceback() -> None:
    """As in `canfb config example | head -0`: the pipe is closed before anything is written."""
    read_end, write_end = os.pipe()
    os.close(read_end)
    with os.fdopen(write_end, "wb") as pipe:
        done = python("-u", "-m", "canfb", "config", "example", stdout=pipe)
    assert (done.returncode, done.stderr) == (1, "")


@pytest.mark.parametrize(
    ("command", "number", "last"),
    [("run", signal.SIGINT, "node 32: 0 samples; "), ("simulate", signal.SIGTERM, "0 samples sent")],
)
def test_a_signal_ends_it_with_exit_code_0(
    command: str, number: signal.Signals, last: str, config: str, started: Started
) -> None:
    begins = {"run": "running node 32 (20h)", "simulate": "encoder interface: node 16 (10h)"}
    process = started(sys.executable, *CANFB, command, config)
    process.wait_for("end with Ctrl-C")
    process.send(number)
    assert process.wait() == 0
    waits = ", waits for NMT start (--autostart)" * (command == "simulate")
    assert process.lines[0] == f"{begins[command]} on virtual canfb-cli{waits}; end with Ctrl-C"
    assert process.lines[-1].startswith(last)


LIMIT_S = 60.0
CONFIG = """\
bus: {interface: virtual, channel: reader}
modules: [{node_id: 32, state_dir: state}]
"""


def wait_for(ready_file: Path) -> None:
    deadline = time.monotonic() + LIMIT_S
    while not ready_file.exists():
        assert time.monotonic() < deadline, "it waits for its reader"
        time.sleep(0.02)


def read_until(descriptor: int, words: bytes) -> None:
    said = b""
    while words not in said:
        assert select.select([descriptor], [], [], LIMIT_S)[0], f"no {words!r} in {said!r}"
        said += os.read(descriptor, 1 << 16).lstrip(b"\0")


def test_it_goes_on_and_ends(tmp_path: Path) -> None:
    (tmp_path / "feedback.yaml").write_text(CONFIG)
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writing, bytes(1 << 16))
    os.set_blocking(writing, True)  # as a command finds it
    arguments = [sys.executable, "-m", "canfb", "run", "feedback.yaml", "--ready-file", "ready"]
    process = subprocess.Popen(arguments, cwd=tmp_path, stdout=writing)
    os.close(writing)
    try:
        wait_for(tmp_path / "ready")
        read_until(reading, b"end with Ctrl-C\n")  # the reader goes on, and gets what was kept for it
        process.send_signal(signal.SIGTERM)
        assert process.wait(LIMIT_S) == 0
    finally:
        process.kill()
        process.wait()
        os.close(reading)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
def test_where_its_log_is_full_it_goes_on_and_says_so_at_the_end(tmp_path: Path) -> None:
    (tmp_path / "feedback.yaml").write_text(CONFIG)
    arguments = [sys.executable, "-m", "canfb", "run", "feedback.yaml", "--ready-file", "ready"]
    with Path("/dev/full").open("wb") as full:
        process = subprocess.Popen(arguments, cwd=tmp_path, stdout=full, stderr=subprocess.PIPE)
    try:
        wait_for(tmp_path / "ready")
        process.send_signal(signal.SIGTERM)
        said = process.communicate(timeout=LIMIT_S)[1]
    finally:
        process.kill()
        process.wait()
    assert (process.returncode, said) == (1, b"canfb: cannot write the output: No space left on device\n")


def test_lines_go_where_they_belong(capfd: pytest.CaptureFixture[str]) -> None:
    log = logging.getLogger("canfb.test")
    with printed_log(), printed_without_waiting():
        log.info("position valid")
        log.warning("the bus fails")
        PRINTING.as_json = True
        log.info("SYNC found")
    out, err = capfd.readouterr()
    text, values = out.splitlines()
    assert text == "position valid"
    assert json.loads(values) == {"event": "message", "level": "info", "text": "SYNC found"}
    assert err == "canfb: the bus fails\n"


# Its controlling terminal is the one on its standard input.
OWN_TERMINAL = """\
import fcntl, sys, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
from canfb.cli.main import main
sys.exit(main(sys.argv[1:]))
"""


def with_terminal(folder: Path, arguments: list[str]) -> tuple[subprocess.Popen[bytes], int]:
    """A command with a terminal of its own: the process, and the other end of the terminal."""
    ours, theirs = pty.openpty()
    try:
        process = subprocess.Popen(
            [sys.executable, "-c", OWN_TERMINAL, *arguments],
            cwd=folder,
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            start_new_session=True,
        )
    finally:
        os.close(theirs)
    return process, ours


@pytest.mark.parametrize("command", [["run"], ["simulate", "--rate", "100"]], ids=["run", "simulate"])
def test_without_its_terminal_it_ends_and_leaves_no_ready_file(tmp_path: Path, command: list[str]) -> None:
    (tmp_path / "feedback.yaml").write_text(CONFIG)
    arguments = [*command, "feedback.yaml", "--ready-file", "ready"]
    process, terminal = with_terminal(tmp_path, arguments)
    try:
        try:
            read_until(terminal, b"end with Ctrl-C")
            wait_for(tmp_path / "ready")
        finally:
            os.close(terminal)  # what a dropped connection does
        assert process.wait(LIMIT_S) == 0
    finally:
        process.kill()
        process.wait()
    assert not (tmp_path / "ready").exists()
    if command == ["run"]:
        assert any((tmp_path / "state").iterdir()), "the operating time was saved at the end"
