"""Options of the commands that speak to nodes over the bus, and the master for them."""

from __future__ import annotations

import argparse
import contextlib
import json
from collections.abc import Iterator

from canfb.bus.bus_master import BusMaster
from canfb.bus.opening import open_bus, open_sync_bus
from canfb.bus.runner import ending_on_signals
from canfb.cia301 import cob
from canfb.cli.options import JSON, TIMEOUT, add_bus_options, bus_options, chosen_bus, node_number, option
from canfb.cli.printing import Progress, shown_progress
from canfb.configuration import Config
from canfb.errors import ConfigError
from canfb.master.access import received
from canfb.master.all_or_nothing import Guard
from canfb.rows import Result

NODE = option("node", metavar="NODE", type=node_number, help="node-ID such as 32 or 0x20")
CONFIG = option("--config", metavar="CONFIG.yaml", help="take the bus from this configuration")
DEFAULT_MODULE = 0x20
ACCESS = JSON, CONFIG, TIMEOUT, add_bus_options


def master_of(options: argparse.Namespace) -> BusMaster:
    """A master on the bus of the options. ConfigError, BusError."""
    return BusMaster(open_bus(chosen_bus(options)), options.timeout)


@contextlib.contextmanager
def sync_master(options: argparse.Namespace, config: Config) -> Iterator[tuple[BusMaster, Guard]]:
    """A master that receives or produces SYNC (``--rate``); signals go to the guard."""
    bus = open_sync_bus(bus_options(options, config.bus), receives_own=options.rate is not None)
    guard = Guard()
    with BusMaster(bus, options.timeout) as master, ending_on_signals(guard.interrupt):
        if options.rate is not None:
            with received(master, cob.SYNC) as heard:
                master.wait(0.3)  # detects another SYNC of 5 Hz or more
            if heard:
                raise ConfigError("--rate: another node sends SYNC already; leave --rate out")
            master.produce_sync(options.rate)
        yield master, guard


@contextlib.contextmanager
def guarded_master(options: argparse.Namespace, stays: str = "") -> Iterator[tuple[BusMaster, Guard]]:
    """Context of changes to a node: a signal rolls back, except what ``stays``, and not once it is done."""
    guard, as_before = Guard(), f"an unfinished change is undone{stays}"
    with (
        shown_progress(quiet=True, interrupted=as_before),
        ending_on_signals(guard.interrupt),
        contextlib.ExitStack() as closing,
    ):
        yield closing.enter_context(master_of(options)), guard
        with guard.held():
            closing.close()


def say_result(options: argparse.Namespace, result: Result, progress: Progress | None = None) -> int:
    if progress is not None:
        progress.clear()
    print(json.dumps(result.figures, indent=2) if options.json else "\n".join(result.lines))
    return 0


def measured_nodes(options: argparse.Namespace, config: Config) -> tuple[int, int | None]:
    """Node-IDs of module and encoder interface (None: by the module). ConfigError if equal."""
    matching = (
        (one.node_id, None if one.source else one.encoder_interface)
        for one in config.modules
        if options.module in (None, one.node_id)
    )
    module, interface = next(matching, (DEFAULT_MODULE, None))
    module = module if options.module is None else options.module
    interface = interface if options.encoder_interface is None else options.encoder_interface
    if module == interface:
        raise ConfigError(f"--encoder-interface {interface}: must differ from the node-ID of the module")
    return module, interface
