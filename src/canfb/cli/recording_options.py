"""The options of commands that read a CSV file of samples: which columns, and what their numbers mean."""

from __future__ import annotations

import argparse

from canfb.cli.options import add_options, option


def add_columns(group: argparse._ActionsContainer) -> None:
    """Add them; :func:`canfb.sources.recording_source.chosen_layout` checks them."""
    add_options(
        group,
        option(
            "--columns",
            default="sine,cosine",
            metavar="SINE,COSINE",
            help="names or numbers (from 0) of the two columns",
        ),
        option(
            "--mid-scale", type=float, default=0.0, metavar="READING", help="reading of a zero signal (0)"
        ),
        option(
            "--scale",
            type=float,
            default=1.0,
            metavar="COUNTS",
            help="ADC counts for each volt of the file (1)",
        ),
        option(
            "--time-column", metavar="NAME", help="column of times in seconds; gaps become missed samples"
        ),
    )
