"""The options of ``canfb simulate``, checked, and what they make of the configuration."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace

from canfb.calibrate.choices import check_mid_scale, two_columns
from canfb.cli.jitter_option import add_jitter, jittered
from canfb.cli.options import add_bus_options, add_ready_file, chosen_module, refuse_idle, whole_number
from canfb.configuration import Config
from canfb.errors import ConfigError
from canfb.hosting.simulating import fed_module
from canfb.simulation.fed_module import FedModule
from canfb.simulation.scenario import PACES, SimulationConfig
from canfb.simulation.set_up import Play
from canfb.sources.recording_source import RecordingLayout

TIMES = ("time_column", "gap", "gap_samples")


def add_options(parser: argparse.ArgumentParser) -> None:
    """All options of the command."""
    parser.add_argument("config", metavar="CONFIG.yaml")
    parser.add_argument(
        "--rate",
        type=float,
        metavar="HZ",
        help="produce the SYNC at this rate; without it, follow the SYNC of the bus",
    )
    add_jitter(parser)
    parser.add_argument(
        "--pace",
        choices=PACES,
        help="the machine turns in real time (time), or by one interval per SYNC, however late (sync)",
    )
    parser.add_argument(
        "--module",
        type=whole_number,
        metavar="ID",
        help="node-ID of the module to serve (the first)",
    )
    parser.add_argument("--rpm", type=float, help="speed after the ramp, instead of the configuration's")
    parser.add_argument("--autostart", action="store_true", help="enter OPERATIONAL without a master")
    parser.add_argument("--seconds", type=float, metavar="S", help="end after this machine time")
    parser.add_argument(
        "--record",
        metavar="FILE",
        help="write the samples to a CSV or NPZ file, to play them back (--samples) or to calibrate",
    )
    add_ready_file(parser)
    play = parser.add_argument_group("playing a recording")
    play.add_argument(
        "--samples",
        metavar="FILE",
        help="CSV file with a header line, one row for each SYNC, or an NPZ file of canfb",
    )
    play.add_argument(
        "--columns",
        default="sine,cosine",
        metavar="SINE,COSINE",
        help="names or numbers (from 0) of the two columns",
    )
    play.add_argument(
        "--mid-scale", type=float, default=0.0, metavar="COUNTS", help="ADC reading of a zero signal"
    )
    play.add_argument(
        "--time-column", metavar="NAME", help="column of times in seconds; gaps in it become lost samples"
    )
    play.add_argument("--gap", type=float, default=0.1, metavar="S", help="a longer time step is a gap (0.1)")
    play.add_argument(
        "--gap-samples", type=int, default=20, metavar="N", help="samples lost at each gap (20)"
    )
    add_bus_options(parser)


def chosen(options: argparse.Namespace, config: Config) -> tuple[SimulationConfig, FedModule, Play]:
    """What is simulated: the configuration, with what the options change. ConfigError for bad ones."""
    module = chosen_module(options, config)
    if options.samples is None:
        refuse_idle(options, ("columns", "mid_scale", *TIMES), "only with --samples, which it describes")
    else:
        refuse_idle(options, ("rpm",), "not with --samples: a recording has its own motion")
    if options.rate is not None and not 0.1 <= options.rate <= 100_000:
        raise ConfigError(f"--rate {options.rate:g}: must be 0.1 to 100000 Hz")
    if options.seconds is not None and not 0.0 < options.seconds <= 1e6:
        raise ConfigError(f"--seconds {options.seconds:g}: must be more than 0, at most 1e6")
    simulation = jittered(config, options).simulation
    for option in ("samples", "rpm") if simulation.drive is not None else ():
        if getattr(options, option) is not None:
            raise ConfigError(
                f"--{option}: the drive of the configuration moves the encoder; omit one of the two"
            )
    if options.rpm is not None:
        try:
            simulation = replace(simulation, motion=replace(simulation.motion, rpm=options.rpm))
        except ValueError as error:
            raise ConfigError(f"--rpm {options.rpm:g}: {error}") from None
    play = Play(
        rate_hz=options.rate,
        autostart=options.autostart,
        recorded=options.record is not None or options.seconds is not None,
        file=options.samples,
        layout=_layout(options),
    )
    return replace(simulation, pace=options.pace or simulation.pace), fed_module(module), play


def _layout(options: argparse.Namespace) -> RecordingLayout:
    columns = two_columns(options.columns)
    check_mid_scale(options.mid_scale)
    if not 0.0 < options.gap < math.inf:
        raise ConfigError(f"--gap {options.gap:g}: must be more than 0 seconds")
    if options.gap_samples < 1:
        raise ConfigError(f"--gap-samples {options.gap_samples}: must be 1 or more")
    if options.time_column is None:
        refuse_idle(options, TIMES, "only with --time-column, which contains the gaps")
    return RecordingLayout(columns, options.mid_scale, options.time_column, options.gap, options.gap_samples)
