"""``canfb monitor --frames [NODE...]``: frames, one line each, with decoded PDOs of modules."""

from __future__ import annotations

import argparse
import contextlib
import json
from collections.abc import Iterator

from canfb.bus.bus_master import BusMaster
from canfb.bus.opening import open_bus
from canfb.bus.runner import ending_on_signals
from canfb.cia301.frame import Frame
from canfb.cli.options import bus_options, named_config
from canfb.diagnosis.nodes_and_frames import FrameWords, learn_by_sdo
from canfb.eds_files import eds_path
from canfb.monitoring.layout import Recognition, assumed_objects, known_objects
from canfb.monitoring.watching import MessageReader, classic, recognised
from canfb.sdo.object_description import ObjectDescriptions

ANSWER_S = 0.2


def show_frames(options: argparse.Namespace) -> int:
    """Show frames until Ctrl-C, the end of the log, or --seconds."""
    config = named_config(options)
    words = FrameWords(ObjectDescriptions(eds_path("canfb-module"), 1))
    known, read = known_objects(config, options.nodes), set[int]()
    modules = {node: one for node, (one, _) in known.items()}
    reader = MessageReader(options.seconds)
    with contextlib.ExitStack() as held:
        held.enter_context(ending_on_signals(reader.stopped.set))
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
        if decoded.is_pdo or not options.pdo:
            print(json.dumps(decoded.figures(time_s)) if options.json else decoded.line(time_s), flush=True)
