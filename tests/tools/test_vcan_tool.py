"""Programs that are started: parts of tools/vcan without user-mode Linux, and the processes of the tests."""

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest

from processes import Started
from tools.vcan import __main__ as vcan, uml


@pytest.mark.parametrize(
    ("flags", "release", "needed"),
    [("fpu sse2 avx512f amx_tile", "6.12.1-rc1", True), ("fpu sse2 avx512f amx_tile", "6.13", False)],
)
def test_registers_are_filled_up_only_where_needed(flags: str, release: str, needed: bool) -> None:
    cpuinfo = f"processor\t: 0\nmodel name\t: any\nflags\t\t: {flags}\n"
    assert uml.needs_preload(cpuinfo, release) is needed


def test_command_gets_its_words_folder_and_environment_unchanged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "with space"
    folder.mkdir()
    output, errors = tmp_path / "out put", tmp_path / "errors"
    monkeypatch.chdir(folder)
    given = {"PATH": os.defpath, "ODD": "a'b\nc $d", "dots.in.name": "1"}
    script = 'printf "%s|" "$@"; pwd; env >&2'
    with monkeypatch.context() as patch:
        patch.setattr(os, "environ", given)
        line = uml.run_line(["sh", "-c", script, "sh", "one two", "it's", "*"], output, errors)
    monkeypatch.chdir(tmp_path)
    subprocess.run(["sh", "-c", line], env={"LEAK": "1", "PATH": os.environ["PATH"]}, check=True)
    assert output.read_text() == f"one two|it's|*|{folder}\n"
    assert "ODD=a'b\nc $d\n" in errors.read_text()
    assert "LEAK" not in errors.read_text()


def beside_a_kernel(command: list[str], timeout_s: float = 60.0) -> int:
    return vcan.run_in_kernel(vcan.Kernel("test", ("env",)), command, timeout_s)


def test_exit_status_is_the_commands() -> None:
    assert beside_a_kernel(["sh", "-c", "exit 7"]) == 7
    assert beside_a_kernel(["sh", "-c", "kill -TERM $$"]) == 143


def test_a_command_that_hangs_is_ended_with_all_it_started(tmp_path: Path) -> None:
    pid = tmp_path / "pid"
    with pytest.raises(uml.TimedOutError, match="after 1 s"):
        beside_a_kernel(["sh", "-c", f"sleep 1000 & echo $! >{pid}; wait"], 1.0)
    deadline = time.monotonic() + 10.0
    while not has_ended(int(pid.read_text())):
        assert time.monotonic() < deadline


def has_ended(pid: int) -> bool:
    """Whether a process is gone, or only waits for its parent to be told."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return True
    return state in "ZX"


def test_no_vcan_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(vcan, "find_kernel", lambda: None)
    monkeypatch.setattr(uml, "which", lambda _program: None)
    assert vcan.main(["check"]) == 1
    assert vcan.main(["run", "--", "true"]) == vcan.FAILED
    told = capsys.readouterr()
    assert told.out.startswith("none: ")
    assert "apt-get install user-mode-linux" in told.out
    assert "apt-get install user-mode-linux" in told.err


def test_a_process_left_behind_is_found(started: Started) -> None:
    process = started("sh", "-c", "sleep 1000 >/dev/null 2>&1 & echo ready")
    process.wait_for("ready")
    with pytest.raises(pytest.fail.Exception, match="has ended, a process that it started has not"):
        process.stop()


def test_a_line_that_does_not_come_fails_and_shows_what_was_said(started: Started) -> None:
    process = started("sh", "-c", "echo something; exec sleep 1000")
    process.wait_for("something")
    process.patience_s = 0.0
    with pytest.raises(pytest.fail.Exception, match="something"):
        process.wait_for("else")
    process.patience_s = 60.0
    process.send(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
