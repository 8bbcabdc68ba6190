"""``canfb config dcf``: the configuration of a module as a file that a CANopen master loads."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from canfb.bus.bus_master import BusMaster
from canfb.bus.clocks import file_date_and_time
from canfb.bus.opening import open_bus
from canfb.cli.options import add_bus_options, bus_options, chosen_module, refuse_idle, whole_number
from canfb.cli.printing import report
from canfb.configuration import Config, load_config
from canfb.device.od.dcf import Reals
from canfb.errors import ConfigError
from canfb.hosting.hosting import saved_configuration
from canfb.master.access import ModuleObjects
from canfb.module.configuration_files import ConfigurationFiles, place_names
from canfb.module.device_configuration import read_configuration
from canfb.module.module_config import ModuleConfig

INLINE, FILE = "inline", "file"


def add_options(parser: argparse.ArgumentParser) -> None:
    """All options of the command."""
    parser.add_argument(
        "config", metavar="CONFIG.yaml", nargs="?", help="configuration of the module; needs no bus"
    )
    parser.add_argument(
        "--module",
        type=whole_number,
        metavar="ID",
        help="node-ID of the module, if there are several",
    )
    parser.add_argument("--node", type=whole_number, metavar="ID", help="read this node on the bus instead")
    parser.add_argument("--out", type=Path, metavar="FILE", help="the DCF (module-20h.dcf), overwritten")
    parser.add_argument("--concise", type=Path, metavar="FILE", help="the concise form, for object 1F22h")
    parser.add_argument(
        "--table",
        choices=(INLINE, FILE),
        default=INLINE,
        help="the correction table: in the DCF and in a file (default), or in the file only",
    )
    parser.add_argument(
        "--reals",
        choices=[reals.value for reals in Reals],
        default=Reals.DECIMAL.value,
        help="format of REAL32: decimal (default), or the bits, as lely's tools read them",
    )
    parser.add_argument("--name", default="", help="NodeName of the DCF (module_20h)")
    parser.add_argument("--json", action="store_true", help="print the summary as JSON")
    parser.add_argument("--answer-within", type=float, default=1.0, metavar="S", help="SDO time-out (1)")
    add_bus_options(parser)


def write_dcf(options: argparse.Namespace) -> int:
    """Write the files; 0 when it is done."""
    _check(options)
    config = load_config(options.config) if options.config else Config()
    words = bus_options(options, config.bus)
    if options.node is None:
        configuration = saved_configuration(_chosen(config, options))
    else:
        with BusMaster(open_bus(words), options.answer_within) as master:
            configuration = read_configuration(ModuleObjects(master, options.node))
    inline, reals = options.table == INLINE, Reals(options.reals)
    files = ConfigurationFiles(
        configuration, options.out, options.concise, inline, reals, options.name, words
    )
    files.write(*file_date_and_time())
    if options.json:
        print(json.dumps(files.summary(), indent=2))
        return 0
    print("\n".join(files.lines()))
    refused = configuration.refused_in_index_order()
    if refused:
        report(
            f"note: a master that writes each object once, in the order of the indices, is refused at "
            f"{place_names(refused)}; give it the concise form (--concise)"
        )
    return 0


def _check(options: argparse.Namespace) -> None:
    """ConfigError for options that cannot be, alone or together."""
    if options.node is None and options.config is None:
        raise ConfigError(
            "CONFIG.yaml or --node ID is required: a module of a configuration, or one on a bus"
        )
    if options.node is not None and options.module is not None:
        raise ConfigError("--module: only without --node, which names the module")
    if options.node is not None and not 1 <= options.node <= 127:
        raise ConfigError(f"--node {options.node}: must be 1 to 127")
    if options.node is None:
        refuse_idle(options, ["answer_within"], "only with --node, which is read over the bus")
    if not 0.01 <= options.answer_within <= 60.0:
        raise ConfigError(f"--answer-within {options.answer_within:g}: must be 0.01 to 60")
    if not options.name.isascii() or not options.name.isprintable() or ";" in options.name:
        raise ConfigError(f"--name {options.name!r}: must be printable ASCII without ';'")
    if options.out is not None and options.out == options.concise:
        raise ConfigError(f"--concise {options.concise}: must differ from --out")


def _chosen(config: Config, options: argparse.Namespace) -> ModuleConfig:
    """The module of the configuration. ConfigError when it is not clear which."""
    if options.module is None and len(config.modules) > 1:
        there = ", ".join(f"{module.node_id} ({module.node_id:02X}h)" for module in config.modules)
        raise ConfigError(f"{options.config}: --module ID is required, as there are several: {there}")
    try:
        return chosen_module(options, config)
    except ConfigError as error:
        raise ConfigError(f"{options.config}: {error}") from None
