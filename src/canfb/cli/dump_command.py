"""``canfb dump [NODE...]``: the frames of a bus or of a log, a line each, PDOs of modules decoded."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from typing import Any

from canfb.bus.bus_master import BusMaster
from canfb.bus.opening import open_bus
from canfb.bus.runner import ending_on_signals
from canfb.cia301.frame import Frame
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
from canfb.cli.watch_options import add_watched
from canfb.diagnosis.frame_words import FrameWords, read_by_sdo
from canfb.eds_files import eds_path
from canfb.master.access import NodeAccess
from canfb.monitoring.layout import known_objects
from canfb.monitoring.watching import MessageReader, classic
from canfb.sdo.object_description import ObjectDescriptions
from canfb.view.pdo_map import Read

ANSWER_S = 0.2


def register(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(commands, "dump", dump)
    add_watched(parser, "modules,", speed=False)
    parser.add_argument("--pdo", action="store_true", help="the PDOs of these modules alone")
    parser.add_argument(
        "--listen", action="store_true", help="send nothing: mapping by configuration and EDS, not by SDO"
    )
    parser.add_argument("--seconds", metavar="S", type=positive, help="end after so long")
    parser.add_argument("--json", action="store_true", help="print one JSON object a line, for programs")
    add_bus_options(parser)


def dump(options: argparse.Namespace) -> int:
    """Show frames until Ctrl-C, the end of the log, or --seconds."""
    take_yaml(options)
    config = named_config(options)
    if options.log is not None:
        refuse_idle(options, ["listen"], "a log answers no SDO anyway")
    modules = known_objects(config, options.nodes)
    reader = MessageReader(options.seconds)
    with ending_on_signals(reader.stop):
        if options.log is not None:
            _show(options, modules, classic(reader.log(options.log)))
            return 0
        words = bus_options(options, config.bus)
        if not options.listen and modules:
            modules |= _read_now(words, list(modules))
        with open_bus(words) as bus:
            _show(options, modules, classic(reader.bus(bus)))
    return 0


def _read_now(words: dict[str, Any], nodes: list[int]) -> dict[int, Read]:
    """What the modules that answer hold: their mapping is read at once, before frames are shown."""
    found = {}
    with BusMaster(open_bus(words), ANSWER_S) as master:
        for node in nodes:
            read = read_by_sdo(NodeAccess(master, node, "module"))
            if read is not None:
                found[node] = read
    return found


def _show(
    options: argparse.Namespace, modules: dict[int, Read], frames: Iterator[tuple[float, Frame]]
) -> None:
    described = ObjectDescriptions(eds_path("canfb-module"), 1)
    decode = FrameWords(described, modules.items()).decode
    for time_s, frame in frames:
        decoded = decode(frame)
        if options.pdo and not decoded.is_pdo:
            continue
        say(json.dumps(decoded.figures(time_s)) if options.json else decoded.line(time_s))
