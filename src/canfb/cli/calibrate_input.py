"""Options of ``canfb calibrate`` for what it measures with: several speeds, or samples of a file."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_speeds(parser: argparse.ArgumentParser) -> None:
    """Several speeds."""
    group = parser.add_argument_group("several speeds (the analog path)")
    group.add_argument(
        "--speeds",
        metavar="RPM,RPM,...",
        help="measure at each of these speeds, in any order, as soon as the machine turns steadily at it; "
        'with --samples DIR: the speeds of its files in their order, or "recorded"',
    )
    group.add_argument(
        "--delay",
        metavar="estimate|S",
        help="write the delay of the analog path (2002:07): as estimated, or so many seconds (as it is)",
    )
    group.add_argument(
        "--wait",
        type=float,
        default=120.0,
        metavar="S",
        help="how long to wait for the machine to turn at the next speed (120)",
    )


def add_file(parser: argparse.ArgumentParser) -> None:
    """Samples of a file, and the table that is active with them."""
    group = parser.add_argument_group("samples of a file (no bus is used)")
    group.add_argument(
        "--samples",
        type=Path,
        metavar="FILE",
        help="NPZ file, or CSV with a header line; with --speeds a folder of them",
    )
    group.add_argument(
        "--columns", default="sine,cosine", metavar="SINE,COSINE", help="names or numbers of the two columns"
    )
    group.add_argument(
        "--mid-scale", type=float, default=0.0, metavar="COUNTS", help="ADC reading of a zero signal"
    )
    group.add_argument(
        "--time-column", metavar="NAME", help="column of times in seconds; gaps become missed samples"
    )
    group.add_argument(
        "--table", type=Path, metavar="FILE", help="the active table, YAML or bytes of 2020:01"
    )
    group.add_argument(
        "--cycles-per-revolution", type=int, metavar="N", help="also give errors as angles of the shaft"
    )
