"""Options of ``canfb calibrate`` that do nothing beside others: refused, not ignored.

Times are not: a script may give the same ones to a dry run and to the measurement after it.
"""

from __future__ import annotations

import argparse

from canfb.cli.options import BUS_WORDS, refuse_idle

_OF_THE_BUS = (
    "config",
    "module",
    "encoder_interface",
    "source",
    "recorder",
    "seconds",
    "least_samples",
    "verify",
    "sync",
    "answer_within",
    "dry_run",
    "no_save",
    *BUS_WORDS,
    "bus_kwargs",
)
_OF_CSV = ("columns", "mid_scale", "time_column")
_OF_THE_FILE = (*_OF_CSV, "table", "cycles_per_revolution")


def refuse_combinations(options: argparse.Namespace) -> None:
    """ConfigError for an option that would do nothing."""
    if options.samples is not None:
        refuse_idle(options, _OF_THE_BUS, "not with --samples, which needs no bus and writes to no module")
        if options.samples.suffix == ".npz":
            refuse_idle(options, _OF_CSV, f"only for CSV; {options.samples.name} says it itself")
    else:
        refuse_idle(options, ["table"], "only with --samples; over the bus the module tells its table")
        refuse_idle(options, _OF_THE_FILE, "only with --samples, which it describes")
    if options.check:
        refuse_idle(options, ("dry_run", "no_save"), "not with --check, which writes nothing")
    elif options.dry_run:
        refuse_idle(options, ["no_save"], "not with --dry-run, which writes nothing")
    recording = options.source == "recording" or (options.source is None and options.method != "motion")
    if not recording:
        refuse_idle(options, ["recorder"], "only with --source recording")
