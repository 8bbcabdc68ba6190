"""What a long command says of its progress, on standard error."""

from __future__ import annotations

import sys
from typing import TextIO

WIDTH = 30
CLEAR = "\r\x1b[K"


class Progress:
    """One line a step; on a terminal it is a bar while the step lasts. Says nothing if ``quiet``.

    It never fails: a terminal that has gone must not end the work, nor what puts things right.
    """

    def __init__(self, quiet: bool = False, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stderr
        self._quiet = quiet
        self._bar = self._stream.isatty()
        self._text = ""
        self._shown = -1

    def step(self, text: str) -> None:
        """A new step begins."""
        if self._quiet:
            return
        self.clear()
        self._text = text
        self._print(f"... {text}\n")

    def part(self, part: float, note: str = "") -> None:
        """So much of the step is done, 0..1; the ``note`` stands behind it."""
        percent = int(100.0 * min(max(part, 0.0), 1.0))
        if self._quiet or not self._bar or percent == self._shown:
            return
        self._shown = percent
        full = round(WIDTH * percent / 100)
        bar = f"{'#' * full}{'.' * (WIDTH - full)}"
        self._print(f"{CLEAR}    [{bar}] {percent:3d} %{note and f'  {note}'}")

    def clear(self) -> None:
        """Take the bar away: somebody else has something to say."""
        if self._shown >= 0:
            self._shown = -1
            self._print(CLEAR)

    def _print(self, text: str) -> None:
        try:
            print(text, end="", file=self._stream, flush=True)
        except OSError:
            self._quiet = True
