"""``canfb monitor [NODE...]``: feedback modules live, from a bus or a log, as a page, lines or JSON."""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from canfb.bus.opening import open_bus
from canfb.bus.runner import ending_on_signals
from canfb.bus.shared_bus import SharedBus
from canfb.cli.options import (
    Commands,
    add_bus_options,
    add_command,
    bus_options,
    named_config,
    positive,
    refuse_idle,
    take_yaml,
)
from canfb.cli.printing import say
from canfb.cli.watch_options import add_machine_unit, add_watched, bit_rate_of
from canfb.errors import CanfbError, ConfigError
from canfb.monitoring.bus_model import BusModel
from canfb.monitoring.layout import NodeLayout, assumed_layout, known_layouts
from canfb.monitoring.lines import plain_lines
from canfb.monitoring.snapshot import BusSnapshot
from canfb.monitoring.watching import MessageReader, Watching

FASTEST_HZ, RATE_HZ, LINES_RATE_HZ = 50.0, 5.0, 1.0
Show = Callable[[BusSnapshot], None]


def register(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(commands, "monitor", monitor)
    add_watched(parser)
    parser.add_argument("--rate", metavar="HZ", type=positive, help="updates per second (5; 1 for lines)")
    parser.add_argument("--seconds", metavar="S", type=positive, help="end after so long")
    parser.add_argument(
        "--sdo", action="store_true", help="read mapping and counters by SDO; without it, only listen"
    )
    add_machine_unit(parser)
    parser.add_argument("--plain", action="store_true", help="lines, also on a terminal")
    parser.add_argument("--json", action="store_true", help="print one JSON object per update")
    add_bus_options(parser)


def monitor(options: argparse.Namespace) -> int:
    """Show what there is to see until Ctrl-C, the end of the log, or --seconds."""
    take_yaml(options)
    config = named_config(options)
    words = bus_options(options, config.bus)
    if options.log is None:
        refuse_idle(options, ["speed"], "goes with --log")
    else:
        refuse_idle(options, ["sdo"], "a log answers no SDO")
    layouts = known_layouts(config, options.nodes)
    if options.sdo and not layouts:
        raise ConfigError("--sdo: name the nodes that may be asked, or give --config")
    model = BusModel(layouts, assumed_layout, bit_rate_of(words), only_known=bool(options.nodes))
    with output(options, "canfb monitor") as (show, rate_hz):
        reader = MessageReader(options.seconds)
        watching = Watching(model, show, min(options.rate or rate_hz, FASTEST_HZ), reader)
        with ending_on_signals(watching.stop):
            if options.log is not None:
                own_time = None if options.json or options.plain else 1.0
                watching.log(options.log, options.speed or own_time)
            elif not options.sdo:
                watching.bus(words)
            else:
                _with_sdo(words, layouts, watching)
    return 0


def _with_sdo(words: dict[str, Any], layouts: Sequence[NodeLayout], watching: Watching) -> None:
    from canfb.monitoring.sdo_reading import ModuleReader, SdoThread, only_reads  # here: canopen is for this

    with SharedBus(open_bus(words), only_reads) as bus:
        readers = [ModuleReader(layout.node_id) for layout in layouts]
        with SdoThread(bus, readers, lambda: watching.latest, watching.put).running(watching.stop):
            watching.opened(bus)


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
