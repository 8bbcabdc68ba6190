"""``canfb commission``: limits of the supervision from the machine's own motion, proposed and set."""

from __future__ import annotations

import argparse

from canfb.bus.clocks import date_and_time
from canfb.calibrate.artefacts import prepare
from canfb.cli.commission_options import add_options, configuration_of, nodes_of_choices, wishes_of
from canfb.cli.node_options import say_result, sync_master
from canfb.cli.options import Commands, add_command, bus_options
from canfb.cli.printing import report
from canfb.cli.progress import Progress
from canfb.commission.commission_run import CommissionRun
from canfb.configuration import Config
from canfb.master.access import Master
from canfb.master.all_or_nothing import Guard


def register(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "commission",
        "propose the limits of the supervision from the machine's own motion, and set them",
        commission,
    )
    add_options(parser)


def commission(options: argparse.Namespace) -> int:
    """Listen, propose, and with ``--write`` set; 0 when that is done."""
    wishes, config = wishes_of(options), configuration_of(options)
    progress, guard = Progress(quiet=options.json), Guard()
    if wishes.out:
        prepare(wishes.out)
    nodes_of_choices(options, config)  # says what cannot be before there is a bus
    words = bus_options(options, config.bus)
    try:
        with sync_master(words, options.sync, options.answer_within, guard) as master:
            return over_bus(master, options, config, progress, guard, date_and_time())
    except KeyboardInterrupt:
        progress.clear()
        report("interrupted; the limits of the module are as they were")
        raise
    finally:
        progress.clear()


def over_bus(
    master: Master, options: argparse.Namespace, config: Config, progress: Progress, guard: Guard, date: str
) -> int:
    """The command on an open bus; the exit code. ``date`` is ISO 8601, the time of day behind a space."""
    run = CommissionRun(wishes_of(options), progress, date)
    result = run.over_bus(master, *nodes_of_choices(options, config), guard)
    progress.clear()
    return say_result(options, result)
