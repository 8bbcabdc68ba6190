"""``canfb replay LOG|FOLDER``: recorded frames through the same module."""

from __future__ import annotations

import argparse
import contextlib
from pathlib import Path

from canfb.cli.node_options import say_result
from canfb.cli.options import Commands, add_command
from canfb.cli.progress import Progress
from canfb.cli.replay_folder import replay_folder
from canfb.cli.replay_options import add_options, settings_of
from canfb.errors import ConfigError
from canfb.logs.bus_log import SentLog
from canfb.logs.log_replay import LogReplayed, ReplayOptions, replay_log
from canfb.logs.published_files import PublishedFile, check_place
from canfb.logs.replay_page import write_page
from canfb.replay import summary_of_replay as summary
from canfb.replay.overview import Overview
from canfb.replay.summary_of_replay import log_facts
from canfb.rows import Result, as_figures, as_lines


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
    written = [path for path in (options.out, options.frames, options.report) if path is not None]
    return say_result(options, _result(replayed, written))


def _result(replayed: LogReplayed, written: list[Path]) -> Result:
    log = replayed.log
    about, modules = log_facts(log.counters, log.trouble), []
    lines = as_lines(about)
    for one, drift in zip(replayed.replays, replayed.drifts, strict=True):
        node_id, seconds = one.module.node.node_id, one.counters.last_s - one.counters.first_s
        left_out = replayed.left_out(one)
        modules.append(summary.figures(one, drift, left_out))
        lines.append(f"module {node_id} ({node_id:02X}h): {one.counters.frames} frames, {seconds:.3f} s")
        lines += summary.lines(one, drift, left_out)
    figures = {"log": str(log.path), **as_figures(about), "modules": modules}
    return Result(figures, [*lines, *(f"written  {path}" for path in written)])
