"""``canfb monitor [NODE...]``: feedback modules live, from a bus or a log, as a page, lines or JSON."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from canfb.bus.opening import open_bus
from canfb.bus.runner import ending_on_signals
from canfb.bus.shared_bus import SharedBus
from canfb.cli.options import (
    PORTS,
    READY_FILE,
    Commands,
    add_bus_options,
    add_command,
    bus_options,
    checked,
    given_bus,
    group,
    named_config,
    nodes,
    option,
    positive,
)
from canfb.cli.printing import say
from canfb.errors import CanfbError, ConfigError
from canfb.hosting.readiness import Readiness
from canfb.monitoring.bus_model import BusModel
from canfb.monitoring.layout import ModuleReading, NodeLayout, known_layouts
from canfb.monitoring.lines import MachineUnits, plain_lines
from canfb.monitoring.snapshot import BusSnapshot
from canfb.monitoring.watching import MessageReader, Show, Watching

if TYPE_CHECKING:
    from canfb.scope.page_server import LivePage

IDLE = (
    (["frames"], "web", False, "not with --web"),
    (["pdo", "listen"], "frames", True, "only with --frames"),
    (["port", "ready_file"], "web", True, "only with --web"),
    (["updates", "plain"], "frames", False, "not with --frames"),
    (["updates", "plain", "seconds", "json"], "web", False, "not with --web"),
    (["sdo"], "frames", False, "not with --frames, which reads the mapping at its start"),
    (["per_revolution"], "frames", False, "not with --frames"),
    (["speed"], "frames", False, "not with --frames, which does not wait"),
    (["speed"], "log", True, "goes with --log"),
    (["sdo", "listen"], "log", False, "a log answers no SDO"),
    (["interface", "channel"], "log", False, "not with --log, which is read in place of a bus"),
)
FASTEST_HZ, RATE_HZ, LINES_RATE_HZ = 50.0, 5.0, 1.0


units = checked(
    MachineUnits.parse, lambda _: True, "is not a distance per revolution such as '5 mm' or '360 deg'"
)


def register(commands: Commands) -> None:
    add_command(
        commands,
        "monitor",
        monitor,
        nodes("node-IDs such as 32 or 0x20; or CONFIG.yaml, as with --config"),
        option("--log", metavar="FILE", type=Path, help="a log in a format of python-can, instead of a bus"),
        option("--speed", metavar="X", type=positive, help="speed of the log; 1: real time"),
        option("--updates", metavar="HZ", type=positive, help="updates per second (5; 1 for lines)"),
        option("--seconds", metavar="S", type=positive, help="end after this time"),
        option("--sdo", action="store_true", help="read mapping and counters by SDO"),
        option(
            "--per-revolution",
            metavar="'5 mm'",
            type=units,
            default=MachineUnits(),
            help="travel per revolution: shows the unit of the machine",
        ),
        option("--plain", action="store_true", help="print lines, also on a terminal"),
        option("--json", action="store_true", help="print one JSON object per update or frame"),
        group(
            "a line for each frame",
            option("--frames", action="store_true", help="show frames, with decoded PDOs of modules"),
            option("--pdo", action="store_true", help="only the PDOs of these modules"),
            option("--listen", action="store_true", help="send nothing: mapping from configuration and EDS"),
        ),
        group(
            "a page in the browser",
            option("--web", action="store_true", help="serve the page on this computer"),
            option("--port", metavar="N", type=int, default=0, within=PORTS, help="default: any free port"),
            READY_FILE,
        ),
        add_bus_options,
        idle=IDLE,
        opened=lambda address: say(f"open {address}"),
    )


def monitor(options: argparse.Namespace) -> int:
    if options.frames:
        from canfb.cli.frames import show_frames  # imported here because only --frames needs it

        return show_frames(options)
    config = named_config(options)
    words = config.bus | given_bus(options) if options.log else bus_options(options, config.bus)
    layouts = known_layouts(config, options.nodes)
    if options.sdo and not layouts:
        raise ConfigError("--sdo: name the nodes that may be asked, or give --config")
    model = BusModel(layouts, words.get("bitrate"), only_known=bool(options.nodes))
    page = _live_page(options) if options.web else None
    with contextlib.ExitStack() as held:
        show, rate_hz = held.enter_context(output(options, page))
        reader = MessageReader(options.seconds)
        watching = Watching(model, show, min(options.updates or rate_hz, FASTEST_HZ), reader)
        held.enter_context(ending_on_signals(reader.stopped.set))
        bus = None if options.log else held.enter_context(SharedBus(open_bus(words)))
        if options.sdo and bus is not None:
            held.enter_context(_reading(bus, layouts, watching, page))
        readiness = held.enter_context(Readiness(options.ready_file))
        if page is not None:
            options.opened(page.server.address)
        readiness.ready()
        if bus is not None:
            watching.opened(bus)
            return 0
        watching.log(options.log, options.speed or (None if options.json or options.plain else 1.0))
        if page is not None:
            reader.stopped.wait()
    return 0


def _live_page(options: argparse.Namespace) -> LivePage:
    from canfb.scope.page_server import LivePage  # imported here because only the page needs it

    return LivePage(options.port, options.per_revolution)


def _reading(
    bus: SharedBus, layouts: Sequence[NodeLayout], watching: Watching, page: LivePage | None
) -> contextlib.AbstractContextManager[None]:
    from canfb.monitoring.sdo_reading import ModuleReader, reading_beside  # here: only --sdo needs canopen

    def take(reading: ModuleReading) -> None:
        watching.put(reading)
        if page is not None:
            page.know(reading)

    readers = [ModuleReader(layout.node_id, with_table=page is not None) for layout in layouts]
    wanted = page.server.is_seen if page is not None else lambda: True
    return reading_beside(bus, readers, lambda: watching.latest, take, wanted, watching.stop)


@contextlib.contextmanager
def output(options: argparse.Namespace, page: LivePage | None) -> Iterator[tuple[Show, float]]:
    """The function that shows a snapshot, and its default rate, Hz."""
    if page is not None:
        with page.server:
            yield page.show, RATE_HZ
    elif options.json:
        yield lambda snapshot: print(json.dumps(snapshot.to_json(), ensure_ascii=False), flush=True), RATE_HZ
    elif options.plain or not sys.stdout.isatty() or os.environ.get("TERM") in ("dumb", "unknown"):
        yield lambda snapshot: _say_lines(snapshot, options), LINES_RATE_HZ
    else:
        with _page(options) as show:
            yield show, RATE_HZ


def _say_lines(snapshot: BusSnapshot, options: argparse.Namespace) -> None:
    for line in plain_lines(snapshot, options.per_revolution):
        print(line, flush=True)


@contextlib.contextmanager
def _page(options: argparse.Namespace) -> Iterator[Show]:
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
            live.update(Page(snapshot, options.per_revolution, "canfb monitor", plain=plain), refresh=True)

        yield show
    if last is not None:  # print the last state, because the alternate screen disappears
        _say_lines(last, options)
