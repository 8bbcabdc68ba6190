"""``canfb dump [NODE...]``: the frames of a bus or of a log, a line each, PDOs of modules decoded."""

from __future__ import annotations

import argparse
import contextlib
import json
from collections.abc import Iterator

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
from canfb.diagnosis.frame_words import FrameWords, learn_by_sdo
from canfb.eds_files import eds_path
from canfb.monitoring.layout import Recognition, assumed_objects, known_objects
from canfb.monitoring.watching import MessageReader, classic, recognised
from canfb.sdo.object_description import ObjectDescriptions

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
    words = FrameWords(ObjectDescriptions(eds_path("canfb-module"), 1))
    modules, read = known_objects(config, options.nodes), set[int]()
    reader = MessageReader(options.seconds)
    with contextlib.ExitStack() as held:
        held.enter_context(ending_on_signals(reader.stop))
        if options.log is not None:
            frames = classic(reader.log(options.log))
            modules = modules if options.nodes else recognised(options.log) | modules
        else:
            bus = bus_options(options, config.bus)
            if not options.listen:
                with BusMaster(open_bus(bus), ANSWER_S) as master:
                    read = learn_by_sdo(words, master, modules)
            frames = classic(reader.bus(held.enter_context(open_bus(bus))))
        for node in modules.keys() - read:
            words.learn(node, modules[node])
        _show(options, words, frames)
    return 0


def _show(options: argparse.Namespace, words: FrameWords, frames: Iterator[tuple[float, Frame]]) -> None:
    recognition = Recognition()
    for time_s, frame in frames:
        decoded = words.decode(frame)
        if not options.nodes and not decoded.is_pdo:
            node = recognition.found(frame.can_id, frame.data)
            if node is not None:
                words.learn(node, assumed_objects(node))
        if options.pdo and not decoded.is_pdo:
            continue
        say(json.dumps(decoded.figures(time_s)) if options.json else decoded.line(time_s))
