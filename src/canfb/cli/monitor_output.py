"""Where the snapshots of ``canfb monitor`` go: a page of the terminal, plain lines, or JSON."""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
from collections.abc import Callable, Iterator

from canfb.cli.printing import say
from canfb.errors import CanfbError
from canfb.monitoring.lines import plain_lines
from canfb.monitoring.snapshot import BusSnapshot

Show = Callable[[BusSnapshot], None]
RATE_HZ, LINES_RATE_HZ = 5.0, 1.0


@contextlib.contextmanager
def output(options: argparse.Namespace, title: str) -> Iterator[tuple[Show, float]]:
    """The function that shows a snapshot, and the usual rate for it, updates per second."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # µ on a terminal that has none
    if options.json:
        yield lambda snapshot: say(json.dumps(snapshot.to_json(), ensure_ascii=False)), RATE_HZ
    elif options.plain or not sys.stdout.isatty():
        yield lambda snapshot: _say_lines(snapshot, options), LINES_RATE_HZ
    else:
        with _page(options, title) as show:
            yield show, RATE_HZ


def _say_lines(snapshot: BusSnapshot, options: argparse.Namespace) -> None:
    for line in plain_lines(snapshot, options.per_revolution):
        say(line)


@contextlib.contextmanager
def _page(options: argparse.Namespace, title: str) -> Iterator[Show]:
    try:
        from rich.console import Console
        from rich.live import Live

        from canfb.monitoring.panels import Page
    except ImportError:
        raise CanfbError(
            "the live page needs rich: pip install 'canfb[monitor]'; or use --plain or --json"
        ) from None
    console = Console()
    plain = not console.encoding.lower().startswith("utf")
    last: BusSnapshot | None = None
    with Live(console=console, screen=True, auto_refresh=False, vertical_overflow="crop") as live:

        def show(snapshot: BusSnapshot) -> None:
            nonlocal last
            last = snapshot
            live.update(Page(snapshot, options.per_revolution, title, plain=plain), refresh=True)

        yield show
    if last is not None:  # the page has gone with its screen
        _say_lines(last, options)
