"""Progress of a long command, on standard error."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from typing import TextIO

from canfb.bus.clocks import now_s
from canfb.cli.printing import report

WIDTH = 30
CLEAR = "\r\x1b[K"
SOONEST_S = 2.0
"""A rest is estimated from what has taken at least so long."""
LINE_EVERY_S = 5.0
"""Without a terminal a step that takes longer says so often how far it is."""


@contextlib.contextmanager
def shown_progress(*, quiet: bool, interrupted: str = "") -> Iterator[Progress]:
    """Progress, taken away at the end; ``interrupted`` says what became of the work."""
    progress = Progress(quiet)
    try:
        yield progress
    except KeyboardInterrupt:
        progress.clear()
        if interrupted:
            report(f"interrupted; {interrupted}")
        raise
    finally:
        progress.clear()


class Progress:
    """One line a step; on a terminal a bar, else a line now and then. It never fails."""

    def __init__(
        self, quiet: bool = False, stream: TextIO | None = None, now: Callable[[], float] = now_s
    ) -> None:
        self._stream = stream or sys.stderr
        self._quiet = quiet
        self._bar = self._stream.isatty()
        self._now = now
        self._began_s = self._said_s = now()
        self._shown = ""

    def step(self, text: str) -> None:
        if self._quiet:
            return
        self.clear()
        self._began_s = self._said_s = self._now()
        self._print(f"... {text}\n")

    def part(self, part: float) -> None:
        if self._quiet:
            return
        part = min(max(part, 0.0), 1.0)
        percent = int(100.0 * part)
        if not self._bar:
            if part < 1.0 and self._now() - self._said_s >= LINE_EVERY_S:
                self._said_s = self._now()
                self._print(f"    {percent} %{self._rest(part)}\n")
            return
        full = round(WIDTH * percent / 100)
        text = f"    [{'#' * full}{'.' * (WIDTH - full)}] {percent:3d} %{self._rest(part)}"
        if text != self._shown:
            self._shown = text
            self._print(f"{CLEAR}{text}")

    def clear(self) -> None:
        if self._shown:
            self._shown = ""
            self._print(CLEAR)

    def _rest(self, part: float) -> str:
        """ "" while it is a guess."""
        passed_s = self._now() - self._began_s
        if passed_s < SOONEST_S or not 0.0 < part < 1.0:
            return ""
        minutes, seconds = divmod(round(passed_s * (1.0 - part) / part), 60)
        return f", {minutes} min {seconds:02d} s left" if minutes else f", {seconds} s left"

    def _print(self, text: str) -> None:
        try:
            print(text, end="", file=self._stream, flush=True)
        except OSError:
            self._quiet = True
