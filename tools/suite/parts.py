"""Run parts of the checks, each with its own verdict; a failure of one never hides another.

    python -m tools.suite.parts [--beside NAME=COMMAND] NAME=COMMAND...

The parts run one after the other, all of them, whatever fails. The one of --beside runs at the same time;
what it says is kept, and follows when the others have ended. The last lines say how each part ended. Exit
status: 0 when all passed, else that of the first part that failed.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NoReturn

LOOK_S = 0.2


def split(text: str) -> tuple[str, list[str]]:
    """Name and words of NAME=COMMAND."""
    name, _, command = text.partition("=")
    words = shlex.split(command)
    if not name or not words:
        raise argparse.ArgumentTypeError(f"{text!r}: write NAME=COMMAND")
    return name, words


class Beside:
    """A command that runs beside the others, its output in a file."""

    def __init__(self, command: Sequence[str], folder: Path) -> None:
        self._output = folder / "output"
        self._output.touch()
        with self._output.open("wb") as sink:
            self._child = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=sink,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def finish(self) -> int:
        """Its output from the beginning, as it comes, until it ends; its exit status."""
        with self._output.open("rb") as source:
            while True:
                over = self._child.poll() is not None  # asked first: what was written until then is copied
                while chunk := source.read(1 << 16):
                    sys.stdout.buffer.write(chunk)
                    sys.stdout.buffer.flush()
                if over:
                    return self._child.returncode
                time.sleep(LOOK_S)

    def end(self) -> None:
        """Nothing of it is left."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._child.pid, signal.SIGTERM)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._child.wait(10)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._child.pid, signal.SIGKILL)
        self._child.wait()


@contextlib.contextmanager
def running_beside(command: Sequence[str]) -> Iterator[Beside]:
    """Start a command beside what follows; it has ended afterwards."""
    with tempfile.TemporaryDirectory(prefix="parts-") as folder:
        beside = Beside(command, Path(folder))
        try:
            yield beside
        finally:
            beside.end()


def run(parts: Sequence[tuple[str, Sequence[str]]], beside: tuple[str, Sequence[str]] | None) -> int:
    """Run all parts and say how each ended; the exit status."""
    ended: dict[str, int] = {}

    def one_by_one() -> None:
        for name, command in parts:
            ended[name] = subprocess.run(command, stdin=subprocess.DEVNULL, check=False).returncode

    if beside is None:
        one_by_one()
    else:
        with running_beside(beside[1]) as other:
            one_by_one()
            print(f"--- {beside[0]}", flush=True)
            ended[beside[0]] = other.finish()
    for name, status in ended.items():
        print(f"{name}: {'passed' if status == 0 else f'FAILED, exit status {status}'}", flush=True)
    failed = next((status for status in ended.values() if status != 0), 0)
    return failed if 0 <= failed < 126 else 1


def _end(number: int, _frame: object) -> NoReturn:
    raise SystemExit(128 + number)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.suite.parts", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--beside", type=split, metavar="NAME=COMMAND", help="runs at the same time")
    parser.add_argument("parts", type=split, nargs="+", metavar="NAME=COMMAND")
    options = parser.parse_args(arguments)
    try:
        return run(options.parts, options.beside)
    except KeyboardInterrupt:
        return 128 + signal.SIGINT


if __name__ == "__main__":
    for ending in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(ending, _end)
    sys.exit(main())
