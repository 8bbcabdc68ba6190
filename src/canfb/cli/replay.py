"""``canfb replay LOG|FOLDER``: recorded frames through the same module."""

from __future__ import annotations

import argparse
import contextlib
import json

from canfb.cli.options import Commands, add_command
from canfb.cli.progress import Progress
from canfb.cli.replay_folder import replay_folder
from canfb.cli.replay_options import add_options, settings_of
from canfb.errors import ConfigError
from canfb.logs.bus_log import SentLog
from canfb.logs.log_replay import LogReplayed, ReplayOptions, replay_log
from canfb.logs.published_files import PublishedFile, check_place
from canfb.logs.replay_page import write_page
from canfb.replay.overview import Overview
from canfb.replay.summary_of_replay import as_json, lines_of, log_facts


def register(commands: Commands) -> None:
    """Add the command."""
    add_options(add_command(commands, "replay", "put a recorded bus log through the same module", replay))


def replay(options: argparse.Namespace) -> int:
    """Replay a log, or a folder of them; 0 also if there were faults."""
    settings = settings_of(options)
    if len(settings.modules) > 1 and (options.out or options.report) and not options.log.is_dir():
        raise ConfigError("--out, --report: are for one module; choose it by --module")
    if options.report is not None:
        check_place("--report", options.report)
    progress = Progress(quiet=options.json)
    try:
        if options.log.is_dir():
            return replay_folder(options, settings, progress)
        return _one_log(options, settings, progress)
    finally:
        progress.clear()


def _one_log(options: argparse.Namespace, settings: ReplayOptions, progress: Progress) -> int:
    with contextlib.ExitStack() as files:
        overview = Overview()
        takers = [] if options.report is None else [overview.take]
        takers += [] if options.out is None else [files.enter_context(PublishedFile(options.out)).take]
        sent = None if options.frames is None else files.enter_context(SentLog(options.frames)).take
        progress.step(f"replaying {options.log}")
        replayed = replay_log(options.log, settings, takers, sent, progress.part)
        if options.report is not None:
            write_page(options.report, replayed, overview)
    progress.clear()
    print(_json(replayed) if options.json else _text(replayed))
    if not options.json:
        for path in (options.out, options.frames, options.report):
            if path is not None:
                print(f"written  {path}")
    return 0


def _json(replayed: LogReplayed) -> str:
    log = replayed.log
    figures = {
        "log": str(log.path),
        "frames": log.counters.frames,
        "damaged_lines": log.counters.damaged_lines,
        "trouble": log.trouble,
        "channels": sorted(log.counters.channels),
        "left_out": {name: sum(one.values()) for name, one in sorted(log.counters.left_out.items())},
        "modules": [
            as_json(one, drift, replayed.left_out(one))
            for one, drift in zip(replayed.replays, replayed.drifts, strict=True)
        ],
    }
    return json.dumps(figures, indent=2)


def _text(replayed: LogReplayed) -> str:
    lines = [f"{name:24}{text}" for name, text in log_facts(replayed.log.counters, replayed.log.trouble)]
    for one, drift in zip(replayed.replays, replayed.drifts, strict=True):
        node_id, seconds = one.module.node.node_id, one.counters.last_s - one.counters.first_s
        lines.append(f"module {node_id} ({node_id:02X}h): {one.counters.frames} frames, {seconds:.3f} s")
        lines += lines_of(one, drift, replayed.left_out(one))
    return "\n".join(lines)
