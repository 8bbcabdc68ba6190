"""Options that several commands share."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from canfb.cli.commands import SUMMARIES, examples_of
from canfb.cli.printing import report
from canfb.errors import ConfigError

if TYPE_CHECKING:
    from canfb.configuration import Config
    from canfb.module.module_config import ModuleConfig

Commands = Any  # argparse's sub-parser action has no public name
Row = Callable[[Any], object]
"""Adds to a parser, or to a group of one."""
Idle = tuple[Sequence[str], str, bool, str]
"""These options go with another one (True) or without it (False), and why."""
BUS_WORDS = ("interface", "channel", "bitrate", "fd", "data_bitrate", "timing")
BUS_METAVARS = {"interface": "NAME", "bitrate": "BIT/S", "data_bitrate": "BIT/S", "channel": "CHANNEL"}
ARGUMENTS = {"config": "CONFIG.yaml", "nodes": "NODE"}  # the rest are options
BUS_HELP = {
    "channel": "its channel: can0, vcan0, PCAN_USBBUS1; default: canfb use",
    "interface": "of python-can: socketcan, pcan, kvaser, udp_multicast; default: CAN_INTERFACE, canfb use",
    "bitrate": "bit rate; SocketCAN has its own, set by ip link",
    "fd": "open the interface for CAN FD (CANopen frames are classic ones)",
    "data_bitrate": "bit rate of the data phase of CAN FD",
    "timing": "bit timing, such as f_clock=8_000_000 tseg1=5 tseg2=2 sjw=2 brp=2 nof_samples=1",
    "bus_kwargs": "further keys of the interface, such as serial=1234",
}
"""In place of the texts of python-can, which take half a page."""
OFTEN = ("interface", "channel", "bitrate")
"""Those that each help shows; --help-bus shows all."""


def add_command(
    commands: Commands,
    name: str,
    action: Callable[[argparse.Namespace], int],
    *rows: Row,
    summary: str = "",
    idle: Sequence[Idle] = (),
    **defaults: Any,
) -> None:
    """Add a command that calls ``action``, or a part of one with a ``summary``, and its options."""
    summary = summary or SUMMARIES[name]
    parser: argparse.ArgumentParser = commands.add_parser(
        name, help=summary, description=summary, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.epilog = examples_of(parser.prog)
    parser.add_argument(
        "--debug", action="store_true", default=argparse.SUPPRESS, help="show the traceback of an error"
    )
    parser.set_defaults(action=action, parser=parser, idle=idle, **defaults)
    for row in rows:
        row(parser)


class _HelpBus(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        shown = argparse.ArgumentParser(add_help=False, usage=argparse.SUPPRESS)
        _bus_group(shown, BUS_HELP)
        print(shown.format_help(), end="")
        parser.exit()


def option(*names: str, **settings: Any) -> Row:
    return lambda parser: parser.add_argument(*names, **settings)


def group(title: str, *rows: Row) -> Row:
    def add(parser: Any) -> None:
        within = parser.add_argument_group(title)
        for row in rows:
            row(within)

    return add


JSON = option("--json", action="store_true", help="the result, for programs")
TIMEOUT = option("--timeout", type=float, default=1.0, metavar="S", help="time for an SDO answer (1)")
READY_FILE = option("--ready-file", metavar="PATH", help="a file that exists while the program is on the bus")


def add_group(commands: Commands, name: str, description: str = "") -> Commands:
    parser = commands.add_parser(
        name,
        help=SUMMARIES[name],
        description=description or SUMMARIES[name],
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.epilog = examples_of(parser.prog)
    return parser.add_subparsers(dest="part", required=True, metavar="PART")


def add_bus_options(parser: Any) -> None:
    _bus_group(parser, OFTEN)
    parser.add_argument("--help-bus", action=_HelpBus, nargs=0, help="all options of the bus, and exit")


def _bus_group(parser: argparse.ArgumentParser, shown: Iterable[str]) -> None:
    import can.cli  # here: a command without a bus does not wait for python-can

    can.cli.add_bus_arguments(parser, group_title="bus")
    for action in parser._actions:
        if action.dest in BUS_HELP:
            action.help = BUS_HELP[action.dest] if action.dest in shown else argparse.SUPPRESS
            action.metavar = BUS_METAVARS.get(action.dest, action.metavar)


def chosen_module(options: argparse.Namespace, config: Config) -> ModuleConfig:
    """The module with the node-ID ``options.module``, or the first; ConfigError if several have it."""
    node_id, modules = options.module, config.modules
    found = [module for module in modules if node_id in (None, module.node_id)]
    if len(found) == 1 or (found and node_id is None):
        return found[0]
    there = ", ".join(f"{module.node_id} ({module.node_id:02X}h)" for module in modules)
    which = "several modules have" if found else "no module has"
    raise ConfigError(f"{node_id}: {which} this node-ID; there are {there}")


def given(options: argparse.Namespace, names: Iterable[str]) -> list[str]:
    return [
        name
        for name in names
        if hasattr(options, name) and getattr(options, name) != options.parser.get_default(name)
    ]


def refuse_idle(options: argparse.Namespace, names: Iterable[str], why: str) -> None:
    for name in given(options, names):
        option = ARGUMENTS.get(name) or f"--{name.replace('_', '-')}"
        raise ConfigError(f"{option}: {why}")


def refuse_combinations(options: argparse.Namespace) -> None:
    for names, other, wanted, why in options.idle:
        if bool(given(options, [other])) != wanted:
            refuse_idle(options, names, why)


def given_bus(options: argparse.Namespace) -> dict[str, Any]:
    words = {word: getattr(options, word) for word in BUS_WORDS if hasattr(options, word)}
    return words | getattr(options, "bus_kwargs", {})


def default_bus_file() -> Path:
    """Below XDG_CONFIG_HOME, APPDATA on Windows, else ~/.config."""
    folder = os.environ.get("XDG_CONFIG_HOME") or os.environ.get("APPDATA") or Path.home() / ".config"
    return Path(folder) / "canfb" / "bus.json"


def remembered() -> dict[str, Any]:
    """python-can's words of the default bus, less those of the environment. ConfigError."""
    if "CAN_INTERFACE" in os.environ:
        return {}
    path = default_bus_file()
    try:
        words = dict(json.loads(path.read_text(encoding="utf-8")))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}; 'canfb use' writes it again") from None
    return {key: value for key, value in words.items() if f"CAN_{key.upper()}" not in os.environ}


def bus_options(options: argparse.Namespace, configured: dict[str, Any]) -> dict[str, Any]:
    """python-can's words, by rising precedence: ``canfb use``, configuration, command line. ConfigError."""
    from canfb.bus.opening import check_interface, describe

    words = configured | given_bus(options)
    if words.get("interface") is None and (default := remembered()):
        words = default | words
        if not getattr(options, "said_bus", False):
            report(f"bus: {describe(words)} (canfb use)")
            options.said_bus = True
    check_interface(words)
    return words


def chosen_bus(options: argparse.Namespace) -> dict[str, Any]:
    from canfb.configuration import ANY_NODES, load_config

    return bus_options(options, load_config(options.config, ANY_NODES).bus if options.config else {})


def named_config(options: argparse.Namespace) -> Config:
    from canfb.configuration import Config, load_config

    return load_config(options.config) if options.config else Config()
