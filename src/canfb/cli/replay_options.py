"""The options of ``canfb replay``."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from canfb.cli.options import chosen_module, refuse_idle, whole_number
from canfb.configuration import changed_module, load_config
from canfb.errors import ConfigError
from canfb.logs.log_replay import ReplayOptions
from canfb.module.module_config import ModuleConfig
from canfb.replay.start_rule import Begin
from canfb.tables.table_file import read_table

DEFAULT_MODULE = 0x20
OF_A_FILE = ("frames", "report", "json")
OF_A_FOLDER = ("scheduler", "workers")


def add_options(parser: argparse.ArgumentParser) -> None:
    """All options of the command."""
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
