"""tools/suite/mutate.py on a module of a few lines: what it changes, what it reports, and its exit status."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tools.suite import mutate

ROOT = Path(__file__).parents[2]
KNOWN = ROOT / "tests" / "signal" / "known_survivors.txt"
MODULE = '''"""A docstring is not changed."""

LIMIT = 3


class Check:
    __slots__ = ("seen",)

    def over(self, value: int | None = None) -> bool:
        """Nor is this one."""
        self.seen = value
        return value is not None and value > LIMIT
'''
CHANGES = [
    "small : 3 -> 2",
    "small : 3 -> 4",
    "small : LIMIT = 3 -> pass",
    "small Check.over: return value is not None and value > LIMIT -> return None",
    "small Check.over: self.seen = value -> pass",
    "small Check.over: value > LIMIT -> value >= LIMIT",
    "small Check.over: value is not None -> value is None",
    "small Check.over: value is not None and value > LIMIT -> value is not None or value > LIMIT",
]


def names(tmp_path: Path, text: str) -> list[str]:
    path = tmp_path / "small.py"
    path.write_text(text)
    return sorted(mutant.name for mutant in mutate.mutants(path))


def test_every_place_is_changed_once_and_annotations_and_docstrings_are_not(tmp_path: Path) -> None:
    assert names(tmp_path, MODULE) == CHANGES


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A module of two changes, and tests that miss one of them: each change is a run of pytest."""
    module = "def over(value: int) -> bool:\n    return value > len('abc')\n"
    test = "from small import over\ndef test_it():\n    assert (over(2), over(4)) == (False, True)\n"
    (tmp_path / "src").mkdir()
    (tmp_path / "src" / "small.py").write_text(module)
    (tmp_path / "test_small.py").write_text(test)
    return tmp_path


def run(project: Path, *options: str) -> tuple[int, list[str]]:
    command = [sys.executable, "-m", "tools.suite.mutate", "src/small.py", *options, "--", "test_small.py"]
    done = subprocess.run(
        command,
        cwd=project,
        env=os.environ | {"PYTHONPATH": f"{ROOT}{os.pathsep}{project / 'src'}"},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    return done.returncode, done.stdout.splitlines()


def test_survivors_are_printed(project: Path) -> None:
    status, printed = run(project)
    missed = ["small over: value > len('abc') -> value >= len('abc')"]
    assert status == 1
    assert sorted(line.split(": ", 1)[1] for line in printed if line.startswith("src")) == missed
    assert printed[-1] == "2 changes, 1 survived, 1 of them not known to change nothing"


def test_each_known_survivor_is_a_change_and_has_a_reason() -> None:
    lines = [line.split("  # ") for line in KNOWN.read_text(encoding="utf-8").splitlines()]
    modules = {name.split(" ")[0] for name, _ in lines}
    paths = [path for path in (ROOT / "src" / "canfb" / "signal").rglob("*.py") if path.stem in modules]
    changes = {name for path in paths for name in mutate.names(path)}
    assert [name for name, _ in lines if name not in changes] == []
    assert all(reason for _, reason in lines)
    assert len({name for name, _ in lines}) == len(lines)
