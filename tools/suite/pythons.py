"""Run a target of the Makefile with every Python that is there, each in a virtual environment of its own.

    python -m tools.suite.pythons [TARGET]

Pythons are python3.11 and newer, on the PATH and among the versions of pyenv; of each minor version one. The
environments are .venv-3.12 and so on; the target is `unit` unless another is named. Each Python has its own
verdict in the last lines, and the exit status is 0 only if all have passed.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

from tools.suite import parts

MINORS = range(11, 20)
SAYS_ITS_VERSION = (
    "import sys; print('%d.%d' % sys.version_info[:2]); sys.exit(sys.prefix != sys.base_prefix)"
)


def candidates(path: str, pyenv: Path) -> list[str]:
    """Where a Python may be, the names of the PATH first; of pyenv's versions the newest first."""
    on_path = [str(Path(folder) / f"python3.{n}") for folder in path.split(os.pathsep) for n in MINORS]
    of_pyenv = sorted(pyenv.glob("versions/3.*/bin/python3"), key=_numbers, reverse=True)
    return [*on_path, *map(str, of_pyenv)]


def _numbers(python: Path) -> list[int]:
    return [int(word) if word.isdigit() else -1 for word in python.parts[-3].split(".")]


def version_of(python: str) -> str | None:
    """`3.12` of a Python that runs, and is not of a virtual environment; None for anything else."""
    try:
        done = subprocess.run(
            [python, "-c", SAYS_ITS_VERSION],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )
    except OSError:
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def found(pythons: Iterable[str]) -> dict[str, str]:
    """Version -> the first Python of it, in the order of the versions, from 3.11."""
    seen: dict[str, str] = {}
    for python in pythons:
        version = version_of(python) if Path(python).exists() else None
        if version is not None and int(version.partition(".")[2]) in MINORS:
            seen.setdefault(version, python)
    return dict(sorted(seen.items(), key=lambda item: int(item[0].partition(".")[2])))


def command(version: str, python: str, target: str) -> list[str]:
    """The target in the environment of this Python."""
    return ["make", "--no-print-directory", f"PYTHON={python}", f"VENV=.venv-{version}", target]


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.suite.pythons", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("target", nargs="?", default="unit")
    target = parser.parse_args(arguments).target
    pyenv = Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv")
    pythons = found(candidates(os.environ.get("PATH", os.defpath), pyenv))
    print(*(f"Python {version}: {python}" for version, python in pythons.items()), sep="\n", flush=True)
    return parts.run(
        [(f"Python {version}", command(version, python, target)) for version, python in pythons.items()], None
    )


if __name__ == "__main__":
    sys.exit(main())
