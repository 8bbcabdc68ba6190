"""Options that several commands share."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

from canfb.cli.bus_help import shorten_bus_help
from canfb.cli.examples import examples_of
from canfb.errors import ConfigError

if TYPE_CHECKING:
    from canfb.configuration import Config
    from canfb.module.module_config import ModuleConfig

Commands = Any  # argparse's sub-parser action has no public name


def add_command(
    commands: Commands, name: str, summary: str, action: Callable[[argparse.Namespace], int]
) -> argparse.ArgumentParser:
    """Add a command that calls ``action``; its parser, for its own options."""
    parser: argparse.ArgumentParser = commands.add_parser(
        name, help=summary, description=summary, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.epilog = examples_of(parser.prog)
    parser.add_argument(
        "--debug", action="store_true", default=argparse.SUPPRESS, help="show the traceback of an error"
    )
    parser.set_defaults(action=action, parser=parser)
    return parser


def add_bus_options(parser: argparse.ArgumentParser) -> None:
    """The bus options of python-can: -i, -c, -b and so on."""
    import can.cli  # here: a command without a bus does not wait for python-can

    can.cli.add_bus_arguments(parser)
    shorten_bus_help(parser)


def whole_number(text: str) -> int:
    """A whole number, decimal or as 0x20: a type for argparse."""
    try:
        return int(text, 0)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None


def node_number(text: str) -> int:
    """A node-ID, decimal or as 0x20: a type for argparse."""
    try:
        node = int(text, 0)
    except ValueError:
        node = -1
    if not 1 <= node <= 127:
        raise argparse.ArgumentTypeError(f"{text!r} is not a node-ID (1 to 127, or 0x01 to 0x7F)")
    return node


def chosen_module(options: argparse.Namespace, config: Config) -> ModuleConfig:
    """The module of the configuration with the node-ID ``--module``, or the first.

    ConfigError where no module has this node-ID, or several have it: those that LSS is to give one.
    """
    node_id, modules = options.module, config.modules
    found = [module for module in modules if node_id in (None, module.node_id)]
    if len(found) == 1 or (found and node_id is None):
        return found[0]
    there = ", ".join(f"{module.node_id} ({module.node_id:02X}h)" for module in modules)
    which = "several modules have" if found else "no module has"
    raise ConfigError(f"--module {node_id}: {which} this node-ID; there are {there}")


def given(options: argparse.Namespace, names: Iterable[str]) -> list[str]:
    """Those options, of these names (``time_column``), that are not at their defaults."""
    parser: argparse.ArgumentParser = options.parser
    missing = object()
    return [
        name for name in names if getattr(options, name, missing) not in (missing, parser.get_default(name))
    ]


def refuse_idle(options: argparse.Namespace, names: Iterable[str], why: str) -> None:
    """ConfigError if one of these options is given, which would do nothing: ``why`` says so."""
    for name in given(options, names):
        option = "CONFIG.yaml" if name == "config" else f"--{name.replace('_', '-')}"
        raise ConfigError(f"{option}: {why}")


BUS_WORDS = ("interface", "channel", "bitrate", "fd", "data_bitrate", "timing")


def bus_options(options: argparse.Namespace, configured: dict[str, Any]) -> dict[str, Any]:
    """python-can's words: the configuration's, replaced by those of the command line.

    ConfigError for an interface that python-can does not have.
    """
    from canfb.bus.opening import check_interface

    merged = dict(configured)
    for word in BUS_WORDS:
        if hasattr(options, word):
            merged[word] = getattr(options, word)
    merged.update(getattr(options, "bus_kwargs", {}))
    check_interface(merged)
    return merged


def add_ready_file(parser: argparse.ArgumentParser) -> None:
    """``--ready-file``, for :class:`canfb.hosting.readiness.Readiness`."""
    parser.add_argument(
        "--ready-file", metavar="PATH", help="a file that exists while the program is on the bus"
    )
