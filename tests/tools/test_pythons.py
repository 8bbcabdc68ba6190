"""tools/suite/pythons.py: which Pythons it finds, with small programs in their place."""

from __future__ import annotations

import os
from pathlib import Path

from tools.suite import pythons


def python(path: Path, version: str, status: int = 0) -> str:
    """A program that says what a Python of this version would say; status 1 in a virtual environment."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\necho {version}\nexit {status}\n")
    path.chmod(0o755)
    return str(path)


def test_one_of_each_version_the_path_first_and_pyenv_from_the_newest(tmp_path: Path) -> None:
    on_path = python(tmp_path / "bin" / "python3.12", "3.12")
    for patch in (9, 10):
        python(tmp_path / "pyenv" / "versions" / f"3.13.{patch}" / "bin" / "python3", "3.13")
    python(tmp_path / "pyenv" / "versions" / "3.12.1" / "bin" / "python3", "3.12")
    path = os.pathsep.join([str(tmp_path / "nothing"), str(tmp_path / "bin")])
    assert pythons.found(pythons.candidates(path, tmp_path / "pyenv")) == {
        "3.12": on_path,
        "3.13": str(tmp_path / "pyenv" / "versions" / "3.13.10" / "bin" / "python3"),
    }


def test_what_does_not_run_is_too_old_or_a_virtual_environment_is_left_out(tmp_path: Path) -> None:
    others = [
        python(tmp_path / "shim", "3.12", status=127),
        python(tmp_path / "old", "3.10"),
        python(tmp_path / "venv", "3.13", status=1),
        str(tmp_path / "missing"),
    ]
    (tmp_path / "text").write_text("not a program")
    assert pythons.found([*others, str(tmp_path / "text")]) == {}


def test_each_has_an_environment_of_its_own() -> None:
    assert pythons.command("3.12", "/usr/bin/python3.12", "unit")[-3:] == [
        "PYTHON=/usr/bin/python3.12",
        "VENV=.venv-3.12",
        "unit",
    ]
