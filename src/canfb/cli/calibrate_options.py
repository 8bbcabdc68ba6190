"""The options of ``canfb calibrate``."""

from __future__ import annotations

import argparse
from dataclasses import fields
from functools import partial
from pathlib import Path

from canfb.calibrate.choices import (
    LEAST_SAMPLES,
    MODULE,
    PDO,
    RECORDING,
    CalibrateOptions,
    refuse_combinations,
)
from canfb.calibrate.measurement import MOTION, ZERO_CROSSINGS
from canfb.cli.calibrate_input import add_file, add_speeds
from canfb.cli.options import BUS_WORDS, add_bus_options, refuse_idle, whole_number


def add_options(parser: argparse.ArgumentParser) -> None:
    """All options of the command."""
    parser.add_argument(
        "config",
        metavar="CONFIG.yaml",
        nargs="?",
        help="take the bus and the node-IDs of the first module from this file",
    )
    parser.add_argument("--module", type=whole_number, metavar="ID", help="node-ID of the module (32)")
    parser.add_argument(
        "--encoder-interface",
        type=whole_number,
        metavar="ID",
        help="node-ID of the encoder interface (default: the node that sends the samples to the module)",
    )
    parser.add_argument("--dry-run", action="store_true", help="measure only, write nothing to the module")
    parser.add_argument(
        "--check", action="store_true", help="only measure how far the encoder has drifted from its table"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for table, samples and report")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    parser.add_argument("--no-save", action="store_true", help="do not save (1010h): lost at a restart")
    _add_measurement(parser)
    add_speeds(parser)
    add_file(parser)
    add_bus_options(parser)


def _add_measurement(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("measurement")
    group.add_argument(
        "--method",
        choices=(MOTION, ZERO_CROSSINGS),
        default=MOTION,
        help="motion (default): any speed, one sample per SYNC; zero-crossings: slow, many samples per cycle",
    )
    group.add_argument(
        "--source",
        choices=(PDO, RECORDING, MODULE),
        help="pdo: the ADC PDO on the bus (default); recording: object 2050h (default of zero-crossings); "
        "module: the module calibrates itself (2030h)",
    )
    group.add_argument(
        "--recorder",
        choices=("interface", "module"),
        default="interface",
        help="node whose object 2050h records (default: interface)",
    )
    group.add_argument(
        "--seconds",
        type=float,
        metavar="S",
        help="duration of the measurement (20; 4 for a recording, 10 for a speed)",
    )
    group.add_argument(
        "--least-samples",
        type=int,
        default=LEAST_SAMPLES,
        metavar="N",
        help=f"minimum number of samples; measure up to six times longer to reach it ({LEAST_SAMPLES})",
    )
    group.add_argument(
        "--verify", type=float, metavar="S", help="duration of the verification (4; 1 for a recording)"
    )
    group.add_argument(
        "--conditioning",
        choices=("fit", "none"),
        default="fit",
        help="fit offset, gain and phase error of the tracks first (default), or correct all by the table",
    )
    group.add_argument("--entries", type=int, default=1024, metavar="N", help="length of the table (1024)")
    group.add_argument("--adc-bits", type=int, metavar="N", help="bits of the converter (from 2001:02)")
    group.add_argument("--rate", type=float, metavar="HZ", help="samples per second, if not known otherwise")
    group.add_argument("--sync", type=float, metavar="HZ", help="produce the SYNC, on a bus without one")
    group.add_argument("--encoder", default="", metavar="NAME", help="name or serial number of the encoder")
    group.add_argument("--answer-within", type=float, default=1.0, metavar="S", help="SDO time-out (1)")


def choices_of(options: argparse.Namespace) -> CalibrateOptions:
    """The options, checked. ConfigError for those that cannot be, alone or together."""
    names = [field.name for field in fields(CalibrateOptions) if hasattr(options, field.name)]
    choices = CalibrateOptions(**{name: getattr(options, name) for name in names})
    refuse_combinations(choices, partial(refuse_idle, options), (*BUS_WORDS, "bus_kwargs"))
    choices.refuse_impossible()
    return choices
