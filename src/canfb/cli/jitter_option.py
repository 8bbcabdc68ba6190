"""``--jitter``, of commands that produce the SYNC: uneven on purpose (docs/time.md)."""

from __future__ import annotations

import argparse
from dataclasses import replace

from canfb.cli.options import refuse_idle
from canfb.configuration import Config
from canfb.errors import ConfigError
from canfb.simulation.set_up import with_jitter
from canfb.simulation.sync_timing import LARGEST_PART


def add_jitter(parser: argparse.ArgumentParser) -> None:
    """The option."""
    parser.add_argument(
        "--jitter",
        type=float,
        metavar="PART",
        help="have the SYNC jitter on purpose, uniformly within +- this part of its period, 0 to 0.45",
    )


def jittered(config: Config, options: argparse.Namespace) -> Config:
    """With a SYNC at ``--rate`` that jitters so. ConfigError for a bad one, or without a rate."""
    part = options.jitter
    if part is None:
        return config
    if options.rate is None:
        refuse_idle(options, ("jitter",), "only with --rate: the SYNC is that of the bus")
    if not 0.0 <= part <= LARGEST_PART:
        raise ConfigError(f"--jitter {part:g}: must be 0 to {LARGEST_PART:g}, as part of the period")
    return replace(config, simulation=with_jitter(config.simulation, part, options.rate))
