"""``canfb log record`` records the bus; ``canfb log replay`` replays a log with the same module."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from canfb.bus.opening import describe, open_bus
from canfb.bus.runner import ending_on_signals
from canfb.cli.node_options import CONFIG, DEFAULT_MODULE, say_result
from canfb.cli.options import (
    JSON,
    READY_FILE,
    Commands,
    add_bus_options,
    add_command,
    add_group,
    chosen_bus,
    chosen_module,
    group,
    node_or_file,
    nodes,
    option,
    positive,
    refuse_idle,
    required_file,
    size,
    whole_number,
)
from canfb.cli.printing import Progress, say, shown_progress
from canfb.configuration import changed_module, load_config
from canfb.errors import ConfigError, saying
from canfb.files import check_writable
from canfb.hosting.readiness import Readiness
from canfb.logfile.bus_logs import BusLog, replacing_log
from canfb.logs.log_replay import ReplayOptions, do_work, published, replay_log, work_of, write_page
from canfb.module.module_config import ModuleConfig
from canfb.replay.findings import KINDS, Block, Overview
from canfb.replay.module_replay import Begin
from canfb.rows import Result, as_figures, as_lines, those
from canfb.sdo.tables import read_table

OF_A_FILE = ("frames", "report", "json"), "is for one log, not for a folder"
OF_A_FOLDER = ("workers",), "is for a folder of logs"


def register(commands: Commands) -> None:
    parts = add_group(commands, "log")
    text = "log of canfb log record, candump -L or others; and NODE, to replay only this module"
    add_command(
        parts,
        "replay",
        replay,
        nodes(text, least=1, most=1, kind=node_or_file, file="log", name="LOG|FOLDER"),
        group(
            "module",
            option(
                "--encoder-interface", type=whole_number, metavar="ID", help="node that sends the ADC counts"
            ),
            option(
                "--set",
                action="append",
                default=[],
                metavar="KEY=VALUE",
                help="override a key of the module",
            ),
            option("--table", metavar="FILE", help="correction table to try in place of the saved one"),
            option("--state", type=Path, metavar="DIR", help="state_dir of the module; only read"),
        ),
        group(
            "log",
            option(
                "--begin",
                choices=[one.value for one in Begin if one is not Begin.BOOT_UP],
                default=Begin.AUTO.value,
                help="NMT state of the module at the beginning; auto: from the first frames",
            ),
            option("--channel", metavar="NAME", help="one bus of several; .asc, .blf: from 0 (default: all)"),
        ),
        group(
            "results",
            option("--out", type=Path, metavar="FILE", help="the samples: .csv, .npz, .parquet"),
            option("--frames", type=Path, metavar="FILE", help="frames sent by the module, as a bus log"),
            option("--report", type=Path, metavar="FILE.html", help="a page with pictures"),
            JSON,
            option(
                "--drift",
                action=argparse.BooleanOptionalAction,
                help="measure the drift of the encoder from its table, some seconds (default: for a folder)",
            ),
        ),
        group(
            "folder of logs",
            option(
                "--workers",
                type=whole_number,
                within=(1, float("inf"), "1 at least"),
                metavar="N",
                help="processes (default: one per processor; 1: this one)",
            ),
        ),
        summary="replay a bus log through the same module",
    )
    add_command(
        parts,
        "record",
        record,
        option(
            "file",
            metavar="FILE",
            type=Path,
            help="log to write, format by suffix: .log (candump), .asc, .blf, ...",
        ),
        CONFIG,
        option("--seconds", type=positive, metavar="S", help="how long (default: until Ctrl-C)"),
        option(
            "--max-size",
            type=size,
            default=0,
            metavar="BYTES",
            help="begin another file at this size (500k, 100M, 2G); the full one is renamed",
        ),
        option("--force", action="store_true", help="overwrite an existing file"),
        READY_FILE,
        add_bus_options,
        summary="write a log of the bus",
    )


def record(options: argparse.Namespace) -> int:
    words = chosen_bus(options)
    bus_log = BusLog(options.file, options.max_size, options.force)
    with (
        Readiness(options.ready_file) as readiness,
        open_bus(words) as bus,
        bus_log,
        ending_on_signals(bus_log.stop),
    ):
        say(f"recording {describe(words)} to {options.file}; end with Ctrl-C")
        readiness.ready()
        bus_log.record(bus, options.seconds)
    errors = f", {bus_log.error_frames} of them error frames" if bus_log.error_frames else ""
    say(f"{bus_log.frames} frames{errors}")
    return 0


def replay(options: argparse.Namespace) -> int:
    options.log = required_file(options.log)
    folder = options.log.is_dir()
    refuse_idle(options, *(OF_A_FILE if folder else OF_A_FOLDER))
    settings = ReplayOptions(
        modules=tuple(_modules(options)),
        correction=None if options.table is None else read_table(Path(options.table)).used,
        state_dir=options.state,
        begin=Begin(options.begin),
        channel=options.channel,
        drift=folder if options.drift is None else options.drift,
    )
    several = len(settings.modules) > 1 and (options.out or options.report) and not folder
    files = [path.resolve() for path in (options.log, options.out, options.frames, options.report) if path]
    for said in those(
        (several, "--out, --report: are for one module; choose it by NODE"),
        (len(files) > len(set(files)), "--out, --frames, --report: must differ, also from the log"),
    ):
        raise ConfigError(said)
    if options.report is not None:
        check_writable(options.report, "--report")
    with shown_progress(quiet=options.json) as progress:
        return (_folder if folder else _one_log)(options, settings, progress)


def _one_log(options: argparse.Namespace, settings: ReplayOptions, progress: Progress) -> int:
    with contextlib.ExitStack() as files:
        overview = Overview()
        takers: list[Callable[[Block], None]] = [] if options.report is None else [overview.take]
        takers += [] if options.out is None else [files.enter_context(published(options.out))]
        sent = options.frames and files.enter_context(replacing_log(options.frames)).take
        progress.step(f"replaying {options.log}")
        log, results = replay_log(options.log, settings, takers, sent, progress.part)
        if options.report is not None:
            write_page(options.report, log, results[0], overview)
    about = log.counters.facts(log.trouble)
    figures = {"log": str(log.path), **as_figures(about), "modules": [one.figures() for one in results]}
    lines = [*as_lines(about), *(line for one in results for line in one.lines())]
    lines += [f"written  {path}" for path in (options.out, options.frames, options.report) if path]
    say_result(options, Result(figures, lines), progress)
    return int(log.trouble is not None)


def _modules(options: argparse.Namespace) -> list[ModuleConfig]:
    with saying(ConfigError, "NODE, --encoder-interface", ValueError):
        if options.config is not None:
            config = load_config(options.config)
            modules = config.modules if options.module is None else [chosen_module(options, config)]
        else:
            modules = [ModuleConfig(node_id=DEFAULT_MODULE if options.module is None else options.module)]
        given = {} if options.encoder_interface is None else {"encoder_interface": options.encoder_interface}
        modules = [replace(module, **given) for module in modules]
    return [changed_module(module, options.set) for module in modules]


def _folder(options: argparse.Namespace, settings: ReplayOptions, progress: Progress) -> int:
    jobs, done = work_of(options.log, settings, options.out)
    progress.step(f"{len(jobs)} logs to replay, {len({row['log'] for row in done})} are done")
    rows = do_work(jobs, done, settings, options.out, options.workers, progress=progress.part)
    progress.clear()
    lines: list[str] = []
    for row in rows:
        name, error = f"{row['log']}, module {row['module']}", row["error"]
        faults = ", ".join(f"{kind} {row[kind]}" for kind in KINDS if row[kind]) or "no faults"
        lines += those(
            (error is not None, f"not done  {name}: {error}"),
            (error is None and options.out is None, f"{name}: {row['samples']} samples, {faults}"),
            (row["trouble"], f"damaged   {row['trouble']}"),
            (row["left_out"], f"left out  {name}: {row['left_out']} frames with its CAN-IDs (--channel)"),
        )
    samples = sum(row["samples"] or 0 for row in rows)
    lines.append(
        f"{len(rows)} rows, {samples} samples; {sum(row['error'] is not None for row in rows)} not done"
    )
    print("\n".join([*lines, *those((options.out, f"written  {options.out}"))]))
    return int(any(row["trouble"] or row["error"] for row in rows))
