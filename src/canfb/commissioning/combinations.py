"""Options of ``canfb calibrate`` that do nothing beside others: refused, not ignored.

Times are not: a script may give the same ones to a dry run and to the measurement after it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from canfb.commissioning.choices import Choices

Refuse = Callable[[Iterable[str], str], None]
"""Raises ConfigError if one of these options is given: names, and why it would do nothing."""

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
    "wait",
)
_OF_CSV = ("columns", "mid_scale", "time_column")
_OF_THE_FILE = (*_OF_CSV, "table", "cycles_per_revolution")


def refuse_combinations(choices: Choices, refuse: Refuse, bus_words: Sequence[str]) -> None:
    """ConfigError for an option that would do nothing; ``bus_words`` are the options of the bus itself."""
    if choices.samples is not None:
        words = (*_OF_THE_BUS, *bus_words)
        refuse(words, "not with --samples, which needs no bus and writes to no module")
        if choices.samples.suffix == ".npz":
            refuse(_OF_CSV, f"only for CSV, not for {choices.samples.name}")
    else:
        refuse(["table"], "only with --samples; over the bus the table is read from the module")
        refuse(_OF_THE_FILE, "only with --samples, which it describes")
    if choices.check:
        refuse(("dry_run", "no_save"), "not with --check, which writes nothing")
    elif choices.dry_run:
        refuse(["no_save"], "not with --dry-run, which writes nothing")
    if choices.samples_from != "recording":
        refuse(["recorder"], "only with --source recording")
    if choices.speeds is None:
        refuse(("delay", "wait"), "only with --speeds")
    else:
        refuse(("check", "method", "source", "conditioning"), "not with --speeds, which measures by motion")
