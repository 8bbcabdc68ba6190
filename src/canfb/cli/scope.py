"""``canfb scope``: feedback modules on a page of this computer, in a browser."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING

from canfb.bus.opening import open_bus
from canfb.bus.runner import ending_on_signals
from canfb.bus.shared_bus import SharedBus
from canfb.cli.options import (
    Commands,
    add_bus_options,
    add_command,
    add_ready_file,
    bus_options,
    named_config,
    refuse_idle,
    take_yaml,
)
from canfb.cli.printing import report, say
from canfb.cli.watch_options import add_machine_unit, add_watched, bit_rate_of
from canfb.errors import ConfigError
from canfb.hosting.readiness import Readiness
from canfb.monitoring.bus_model import BusModel
from canfb.monitoring.layout import ModuleReading, NodeLayout, assumed_layout, known_layouts
from canfb.monitoring.watching import Watching

if TYPE_CHECKING:
    from canfb.scope.live_page import LivePage

ANY_PORT = 0
RATE_HZ = 5.0
ONLY_SHOWS = "--write: the page only shows; canfb calibrate and canfb table change a module"


def register(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(commands, "scope", scope)
    add_watched(parser)
    parser.add_argument("--demo", action="store_true", help="a simulated module, without a bus")
    parser.add_argument(
        "--sdo",
        action="store_true",
        help="read mapping, counters and table by SDO while a page is open; without it, only listen",
    )
    parser.add_argument("--write", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--port", metavar="N", type=int, default=ANY_PORT, help="of the page (any free one)")
    add_machine_unit(parser)
    add_ready_file(parser)
    add_bus_options(parser)
    parser.set_defaults(opened=lambda address: say(f"open {address}"))


def scope(options: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C, SIGTERM or SIGHUP."""
    from canfb.hosting.trying import ScopeDemo  # here: the simulation is for --demo alone
    from canfb.monitoring.sdo_reading import only_reads  # here: canopen is for --sdo alone
    from canfb.scope.live_page import LivePage  # here: the server is for the page alone

    _check(options)
    take_yaml(options)
    config = named_config(options)
    with contextlib.ExitStack() as held:
        words = bus_options(options, config.bus) if not options.demo else {}
        if options.demo:
            demo = held.enter_context(ScopeDemo())
            config, words = demo.config, demo.words
        layouts = known_layouts(config, options.nodes)
        if options.sdo and not layouts:
            raise ConfigError("--sdo: name the nodes that may be asked, or give --config")
        bus = None if options.log else held.enter_context(SharedBus(open_bus(words), only_reads))
        page = LivePage(options.port, options.per_revolution)
        model = BusModel(layouts, assumed_layout, bit_rate_of(words), only_known=bool(options.nodes))
        watching = Watching(model, page.show, RATE_HZ)
        server = held.enter_context(page.server)
        if options.sdo and bus is not None:
            held.enter_context(_reading(bus, layouts, watching, page))
        readiness = held.enter_context(Readiness(options.ready_file))
        held.enter_context(ending_on_signals(lambda: _stop(watching, page)))
        options.opened(server.address)
        readiness.ready()
        if bus is not None:
            watching.opened(bus)
        else:
            watching.log(options.log, options.speed or 1.0)
            server.wait()
    return 0


def _reading(
    bus: SharedBus, layouts: Sequence[NodeLayout], watching: Watching, page: LivePage
) -> AbstractContextManager[None]:
    """The modules are read by SDO while a page is open."""
    from canfb.monitoring.sdo_reading import ModuleReader, SdoThread  # here: as above

    def take(reading: ModuleReading) -> None:
        watching.put(reading)
        page.know(reading)

    readers = [ModuleReader(layout.node_id, with_table=True) for layout in layouts]
    asking = SdoThread(bus, readers, lambda: watching.latest, take, lambda: page.server.viewers > 0)
    return asking.running(watching.stop)


def _stop(watching: Watching, page: LivePage) -> None:
    watching.stop()
    page.server.stop()


def _check(options: argparse.Namespace) -> None:
    """ConfigError for what cannot be."""
    if options.write:
        report(ONLY_SHOWS)
    if options.log is None:
        refuse_idle(options, ["speed"], "goes with --log")
    else:
        refuse_idle(options, ["sdo", "demo"], "a log answers no SDO")
    if options.demo:
        refuse_idle(options, ["config", "nodes"], "--demo has a module of its own")
    if not 0 <= options.port <= 65535:
        raise ConfigError(f"--port {options.port}: must be 0 to 65535")
