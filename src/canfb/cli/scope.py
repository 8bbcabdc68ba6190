"""``canfb scope``: feedback modules on a local web page, for commissioning."""

from __future__ import annotations

import argparse
import contextlib

from canfb.bus.opening import open_bus
from canfb.bus.runner import ending_on_signals
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
from canfb.cli.printing import announce_page
from canfb.cli.watch_options import add_machine_unit, add_watched
from canfb.errors import CanfbError, ConfigError
from canfb.hosting.readiness import Readiness
from canfb.monitoring.layout import known_layouts
from canfb.scope.scoping import send_rule

ANY_PORT = 0
LIBRARIES = ("bokeh", "tornado", "jinja2")


def register(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(commands, "scope", scope)
    add_watched(parser)
    parser.add_argument("--demo", action="store_true", help="a simulated module, without a bus")
    parser.add_argument(
        "--sdo", action="store_true", help="read mapping, counters and table by SDO; without it, only listen"
    )
    parser.add_argument(
        "--write", action="store_true", help="allow the tasks that change a module; includes --sdo"
    )
    parser.add_argument("--port", metavar="N", type=int, default=ANY_PORT, help="of the page (any free one)")
    add_machine_unit(parser)
    add_ready_file(parser)
    add_bus_options(parser)
    parser.set_defaults(opened=announce_page)


def scope(options: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C, SIGTERM or SIGHUP."""
    _check(options)
    try:
        from canfb.bus.shared_bus import SharedBus
        from canfb.cli.scope_parts import ScopeParts
        from canfb.hosting.trying import ScopeDemo
        from canfb.scope.scope_server import ScopeServer
        from canfb.scope.scoping import refusal_of
    except ImportError as error:
        if (error.name or "").partition(".")[0] not in LIBRARIES:
            raise
        raise CanfbError("the page needs Bokeh: pip install 'canfb[scope]'") from None
    take_yaml(options)
    config = named_config(options)
    with contextlib.ExitStack() as held:
        words = bus_options(options, config.bus) if not options.demo else {}
        if options.demo:
            demo = held.enter_context(ScopeDemo())
            config, words = demo.config, demo.words
        layouts = known_layouts(config, options.nodes)
        asks = options.sdo or options.write
        if asks and not layouts:
            raise ConfigError("--sdo, --write: name the nodes that may be asked, or give --config")
        bus = None
        if options.log is None:
            refusal = refusal_of(send_rule(asks=asks, writes=options.write))
            bus = held.enter_context(SharedBus(open_bus(words), refusal))
        parts = ScopeParts(options, config, words, bus, layouts)
        server = held.enter_context(ScopeServer(parts.fill, options.port, parts.page))
        readiness = held.enter_context(Readiness(options.ready_file))
        held.enter_context(ending_on_signals(server.stop))
        held.enter_context(parts.running(server))
        options.opened(server.gate.address, parts.code)
        readiness.ready()
        server.run()
    return 0


def _check(options: argparse.Namespace) -> None:
    """ConfigError for what cannot be."""
    if options.log is None:
        refuse_idle(options, ["speed"], "goes with --log")
    else:
        refuse_idle(options, ["sdo", "write", "demo"], "a log answers no SDO")
    if options.demo:
        refuse_idle(options, ["config", "nodes"], "--demo has a module of its own")
    if not 0 <= options.port <= 65535:
        raise ConfigError(f"--port {options.port}: must be 0 to 65535")
