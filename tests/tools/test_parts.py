"""tools/suite/parts.py: every part runs and has its own verdict."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TOOL = (sys.executable, "-m", "tools.suite.parts")
FOREVER = "import time; print('ready', flush=True); time.sleep(1000)"


def parts(*arguments: str) -> tuple[int, list[str]]:
    done = subprocess.run([*TOOL, *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout.splitlines()


def test_a_failure_hides_neither_the_parts_after_it_nor_the_one_beside() -> None:
    status, lines = parts(
        "--beside", "d=sh -c 'echo beside; exit 5'", "a=sh -c 'echo one; exit 3'", "b=echo two"
    )
    assert status == 3
    assert lines == [
        *("one", "two", "--- d", "beside"),
        *("a: FAILED, exit status 3", "b: passed", "d: FAILED, exit status 5"),
    ]


@pytest.mark.parametrize(
    ("beside", "other", "expected"),
    [("true", "true", 0), ("false", "true", 1), ("true", "sh -c 'exit 4'", 4)],
)
def test_the_status_is_zero_only_if_all_have_passed(beside: str, other: str, expected: int) -> None:
    assert parts("--beside", f"x={beside}", f"y={other}")[0] == expected
    assert parts(f"x={beside}", f"y={other}")[0] == expected


def test_a_part_that_a_signal_ends_has_failed() -> None:
    status, lines = parts("a=sh -c 'kill -9 $$'")
    assert (status, lines[-1]) == (1, "a: FAILED, exit status -9")


def test_what_is_no_part_is_one_line_of_usage() -> None:
    assert parts("nothing")[0] == 2


def test_a_signal_ends_the_part_beside_too(tmp_path: Path) -> None:
    written = tmp_path / "pid"
    beside = f"x={sys.executable} -c \"import os; open('{written}', 'w').write(str(os.getpid())); {FOREVER}\""
    command = [*TOOL, "--beside", beside, f'y={sys.executable} -c "{FOREVER}"']
    child = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, start_new_session=True)
    assert child.stdout is not None
    with child.stdout:
        assert child.stdout.readline() == "ready\n"
        while not (written.exists() and written.read_text()):
            pass
        os.killpg(child.pid, signal.SIGTERM)
        assert child.wait() == 128 + signal.SIGTERM
    with pytest.raises(ProcessLookupError):
        os.kill(int(written.read_text()), 0)
