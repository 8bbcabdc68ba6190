"""``canfb plan``: limits and margins of bit rate, SYNC rate, encoder and motion."""

from __future__ import annotations

import argparse
import json
from dataclasses import fields

from canfb.cli.options import JSON, Commands, add_command, jitter_of, jitter_s, option, whole_number
from canfb.configuration import load_config
from canfb.errors import ConfigError
from canfb.hosting.hosting import saved_configuration
from canfb.planning.hints import changes_of
from canfb.planning.plan_input import PlanOptions, modules_alike, numbered, plan_of
from canfb.planning.plan_rows import plan_figures, plan_lines
from canfb.simulation.set_up import sync_rate

# Numeric options: option, field of PlanOptions, metavar, help.
NUMBERS = (
    ("--rate", "rate_hz", "HZ", "SYNC rate (that of sync_period_us, 1000)"),
    ("--extra", "extra_load", "PART", "bus load of other nodes, 0 to 1"),
    ("--heartbeat", "heartbeat_ms", "MS", "heartbeat of each node without one"),
    ("--rpm", "rpm", "RPM", "largest speed"),
    ("--acceleration", "acceleration_rad_s2", "RAD/S2", "largest acceleration"),
    ("--noise", "noise_counts", "COUNTS", "rms noise of a track (noise_lsb, 0.5)"),
    (
        "--phase-error",
        "phase_error_cycles",
        "CYCLES",
        "largest phase error (0.0113; 0.001 with a table)",
    ),
    ("--residual-limit", "residual_limit", "CYCLES", "of every module (residual_limit, 1/3)"),
)


def register(commands: Commands) -> None:
    add_command(
        commands,
        "plan",
        plan,
        option("config", metavar="CONFIG.yaml", nargs="?", help="default: options alone"),
        option(
            "-b",
            "--bitrate",
            dest="bit_rate",
            type=whole_number,
            metavar="BIT/S",
            help="bit rate (that of bus, 1000000)",
        ),
        *(
            option(name, dest=field, type=float, metavar=word, help=text)
            for name, field, word, text in NUMBERS
        ),
        jitter_of("jitter of the SYNC at its producer"),
        option(
            "--cycles",
            dest="cycles_per_revolution",
            type=whole_number,
            metavar="N",
            help="cycles per revolution (2500)",
        ),
        option(
            "--samples-per-sync", type=whole_number, metavar="COUNT", help="1 to 8, of every interface (1)"
        ),
        option(
            "--noise-margin",
            type=whole_number,
            metavar="FACTOR",
            help="2010:09 of every module (0: fixed margin)",
        ),
        option("--times", action="store_true", help="the ADC PDO carries sample times"),
        option("--table", action="store_true", help="a correction table is in force"),
        option("--adc-bits", type=whole_number, metavar="BITS", help="of the converter (12)"),
        option(
            "--modules",
            type=whole_number,
            metavar="COUNT",
            help="number of equal modules, each with its interface (1)",
        ),
        option("--coverage", action="store_true", help="diagnostic coverage by fault (docs/evidence.md)"),
        JSON,
        idle=[(["adc_bits", "modules"], "config", False, "only without CONFIG.yaml, which has the modules")],
    )


def plan(options: argparse.Namespace) -> int:
    try:
        config = (
            modules_alike(options.modules, options.adc_bits)
            if options.config is None
            else numbered(load_config(options.config))
        )
        rate_hz = sync_rate(config.simulation, options.rate_hz)
        options.jitter_us = options.jitter and jitter_s(options, rate_hz) * 1e6
        overrides = PlanOptions(**{field.name: getattr(options, field.name) for field in fields(PlanOptions)})
        found = plan_of(config, [saved_configuration(one) for one in config.modules], overrides)
    except ValueError as error:
        raise ConfigError(_named(str(error), options.parser)) from None
    changes = changes_of(found)
    if options.json:
        print(json.dumps(plan_figures(found, changes), indent=2))
    else:
        print("\n".join(plan_lines(found, changes, coverage=options.coverage)))
    return int(not found.holds)


def _named(message: str, parser: argparse.ArgumentParser) -> str:
    first = message.split()[0]
    options = {action.dest: action.option_strings[-1] for action in parser._actions if action.option_strings}
    text = message.replace(first, {"jitter_us": "--jitter", **options}.get(first, first), 1)
    return f"{text} µs" if first == "jitter_us" else text  # the option accepts any unit
