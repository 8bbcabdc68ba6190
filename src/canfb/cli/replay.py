"""``canfb replay LOG|FOLDER``: recorded frames through the same module; a folder of logs on Dask."""

from __future__ import annotations

import argparse
import contextlib
from dataclasses import replace
from pathlib import Path

from canfb.cli.node_options import say_result
from canfb.cli.options import Commands, add_command, chosen_module, refuse_idle, whole_number
from canfb.cli.progress import Progress, shown_progress
from canfb.configuration import changed_module, load_config
from canfb.errors import ConfigError
from canfb.logs.bus_log import SentLog
from canfb.logs.folder_replay import LOCAL, DaskPool, InThisProcess, Pool, check_table, do_work, work_of
from canfb.logs.log_replay import LogReplayed, ReplayOptions, replay_log
from canfb.logs.published_files import PublishedFile, check_place
from canfb.logs.replay_page import write_page
from canfb.module.module_config import ModuleConfig
from canfb.replay import summary_of_replay as summary
from canfb.replay.findings import KINDS, Overview
from canfb.replay.module_replay import Begin
from canfb.replay.summary_of_replay import log_facts
from canfb.rows import Result, as_figures, as_lines
from canfb.sdo.table_file import read_table

DEFAULT_MODULE = 0x20
OF_A_FILE = ("frames", "report", "json")
OF_A_FOLDER = ("scheduler", "workers")
NONE = "none"


def register(commands: Commands) -> None:
    """Add the command."""
    _add_options(add_command(commands, "replay", replay))


def replay(options: argparse.Namespace) -> int:
    """Replay a log, or a folder of them; 0 also if there were faults."""
    settings = settings_of(options)
    if len(settings.modules) > 1 and (options.out or options.report) and not options.log.is_dir():
        raise ConfigError("--out, --report: are for one module; choose it by --module")
    if options.report is not None:
        check_place("--report", options.report)
    replay_what = _folder if options.log.is_dir() else _one_log
    with shown_progress(quiet=options.json) as progress:
        return replay_what(options, settings, progress)


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


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("log", metavar="LOG|FOLDER", type=Path, help="what canfb record or candump -L wrote")
    module = parser.add_argument_group("module")
    module.add_argument(
        "--config", metavar="CONFIG.yaml", help="the modules; default: one with the node-ID 32"
    )
    module.add_argument("--module", type=whole_number, metavar="ID", help="only the module with this node-ID")
    module.add_argument("--encoder-interface", type=whole_number, metavar="ID", help="sends the ADC counts")
    module.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="another value of a key of the module"
    )
    module.add_argument("--table", metavar="FILE", help="correction table to try in place of the saved one")
    module.add_argument("--state", type=Path, metavar="DIR", help="state_dir of the module; only read")
    log = parser.add_argument_group("log")
    log.add_argument(
        "--begin",
        choices=[one.value for one in Begin if one is not Begin.BOOT_UP],
        default=Begin.AUTO.value,
        help="NMT state of the module at the beginning; auto: as the first frames show",
    )
    log.add_argument("--channel", metavar="NAME", help="of a log of several buses (default: all, as one bus)")
    out = parser.add_argument_group("results")
    out.add_argument("--out", type=Path, metavar="FILE", help="the samples: .csv, .npz, .parquet")
    out.add_argument("--frames", type=Path, metavar="FILE", help="what the module sends, as a bus log")
    out.add_argument("--report", type=Path, metavar="FILE.html", help="a page with pictures")
    out.add_argument("--json", action="store_true", help="the figures, for programs")
    out.add_argument(
        "--drift",
        action=argparse.BooleanOptionalAction,
        help="how far the encoder has moved away from its table: takes seconds (default: of a folder)",
    )
    folder = parser.add_argument_group("folder of logs")
    folder.add_argument(
        "--scheduler",
        metavar="local|ADDRESS|none",
        help="Dask: processes of this machine (default), or a cluster; none: this process alone",
    )
    folder.add_argument("--workers", type=int, metavar="N", help="processes of this machine (one per CPU)")


def settings_of(options: argparse.Namespace) -> ReplayOptions:
    """What the options say. ConfigError, in one line, for what cannot be."""
    folder = options.log.is_dir()
    if folder:
        refuse_idle(options, OF_A_FILE, "is for one log, not for a folder")
    else:
        refuse_idle(options, OF_A_FOLDER, "is for a folder of logs")
    modules = _modules(options)
    return ReplayOptions(
        modules=tuple(modules),
        correction=None if options.table is None else read_table(options.table),
        state_dir=options.state,
        begin=Begin(options.begin),
        channel=options.channel,
        drift=folder if options.drift is None else options.drift,
    )


def _modules(options: argparse.Namespace) -> list[ModuleConfig]:
    interface = options.encoder_interface
    try:
        if options.config:
            config = load_config(options.config)
            modules = config.modules if options.module is None else [chosen_module(options, config)]
        else:
            node_id = DEFAULT_MODULE if options.module is None else options.module
            modules = [
                ModuleConfig(
                    node_id=node_id, **({} if interface is None else {"encoder_interface": interface})
                )
            ]
        if interface is not None:
            modules = [replace(module, encoder_interface=interface) for module in modules]
    except ValueError as error:
        raise ConfigError(f"--module, --encoder-interface: {error}") from None
    return [changed_module(module, options.set) for module in modules]


def _folder(options: argparse.Namespace, settings: ReplayOptions, progress: Progress) -> int:
    """Do what is not done yet; 0 when it is: table and lines say which logs could not be done, and why.

    In this process (``--scheduler none``) a table is not required: each log is a line then.
    """
    in_this_process = options.scheduler == NONE
    out = None if in_this_process and options.out is None else check_table(options.out)
    if in_this_process and options.workers is not None:
        raise ConfigError("--workers: there are none with --scheduler none")
    dask = None if in_this_process else DaskPool(options.scheduler or LOCAL, options.workers)
    work = work_of(options.log, settings, out)
    progress.step(f"{len(work.jobs)} logs to replay, {work.skipped} are done")
    with contextlib.ExitStack() as opened:
        pool: Pool = InThisProcess() if dask is None or not work.jobs else opened.enter_context(dask)
        rows = do_work(work, settings, out, pool, progress.part)
    progress.clear()
    bad = [row for row in rows if row["error"] is not None]
    for row in bad:
        print(f"not done  {row['log']}, module {row['module']}: {row['error']}")
    for row in rows:
        if row.get("left_out"):
            print(
                f"left out  {row['log']}, module {row['module']}: {row['left_out']} frames with its CAN-IDs "
                "(--channel)"
            )
    if out is None:
        for row in rows:
            if row["error"] is None:
                faults = ", ".join(f"{kind} {row[kind]}" for kind in KINDS if row[kind]) or "no faults"
                print(f"{row['log']}, module {row['module']}: {row['samples']} samples, {faults}")
    samples = sum(row["samples"] or 0 for row in rows)
    print(f"{len(rows)} rows, {samples} samples; {len(bad)} not done")
    if out is not None:
        print(f"written  {out}")
    return 0
