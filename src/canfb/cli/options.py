"""Options and arguments that several commands share."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn, TypeVar

from canfb.cli.commands import COMMANDS, examples_of
from canfb.cli.printing import report
from canfb.errors import ConfigError, saying

if TYPE_CHECKING:
    from canfb.configuration import Config
    from canfb.module.module_config import ModuleConfig

Commands = Any  # argparse's sub-parser action has no public name
Row = Callable[[Any], object]  # Adds arguments to a parser, or to a group.
# Options that require another option (True) or exclude it (False), that option, and the reason.
Idle = tuple[Sequence[str], str, bool, str]
Within = tuple[float, float, str]  # Range of a number: smallest, largest, and both in words.


def between(low: float, high: float, unit: str = "") -> Within:
    return low, high, f"{low:g} to {high:.9g}{unit}"


PORTS = between(0, 65535)
BUS_WORDS = ("interface", "channel", "bitrate", "fd", "data_bitrate", "timing")
BUS_METAVARS = {"interface": "NAME", "bitrate": "BIT/S", "data_bitrate": "BIT/S", "channel": "CHANNEL"}
ARGUMENTS = {"config": "CONFIG.yaml", "nodes": "NODE"}  # all others are options
# Replaces the texts of python-can, which take half a page.
BUS_HELP = {
    "channel": "its channel: can0, vcan0, PCAN_USBBUS1; default: canfb use",
    "interface": "of python-can: socketcan, pcan, kvaser, udp_multicast; default: CAN_INTERFACE, canfb use",
    "bitrate": "bit rate; SocketCAN has its own, set by ip link",
    "fd": "open the interface for CAN FD (CANopen frames are classic ones)",
    "data_bitrate": "bit rate of the data phase of CAN FD",
    "timing": "bit timing, such as f_clock=8_000_000 tseg1=5 tseg2=2 sjw=2 brp=2 nof_samples=1",
    "bus_kwargs": "further keys of the interface, such as serial=1234",
}
OFTEN = ("interface", "channel", "bitrate")  # Bus options in each help; --help-bus shows all.


def add_command(
    commands: Commands,
    name: str,
    action: Callable[[argparse.Namespace], int],
    *rows: Row,
    summary: str = "",
    idle: Sequence[Idle] = (),
    **defaults: Any,
) -> None:
    """Add a command, or with a ``summary`` a sub-command, that calls ``action``, and its options."""
    summary = summary or COMMANDS[name][1]
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


def option(*names: str, within: Within | None = None, **settings: Any) -> Row:
    def add(parser: Any) -> None:
        parser.add_argument(*names, **settings).within = within

    return add


def group(title: str, *rows: Row) -> Row:
    def add(parser: Any) -> None:
        within = parser.add_argument_group(title)
        for row in rows:
            row(within)

    return add


JSON = option("--json", action="store_true", help="the result as JSON")
TIMEOUT = option(
    "--timeout",
    type=float,
    within=between(0.01, 60.0),
    default=1.0,
    metavar="S",
    help="time for an SDO answer (1)",
)
READY_FILE = option("--ready-file", metavar="PATH", help="a file that exists while the program is on the bus")


def add_group(commands: Commands, name: str, description: str = "") -> Commands:
    parser = commands.add_parser(
        name,
        help=COMMANDS[name][1],
        description=description or COMMANDS[name][1],
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.epilog = examples_of(parser.prog)
    return parser.add_subparsers(dest="part", required=True, metavar="PART")


def add_bus_options(parser: Any) -> None:
    _bus_group(parser, OFTEN)
    parser.add_argument("--help-bus", action=_HelpBus, nargs=0, help="show all bus options and exit")


def _bus_group(parser: argparse.ArgumentParser, shown: Iterable[str]) -> None:
    import can.cli  # imported here: commands without a bus do not need python-can

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
    """ConfigError for options that exclude each other, and for numbers out of range."""
    for names, other, wanted, why in options.idle:
        if bool(given(options, [other])) != wanted:
            refuse_idle(options, names, why)
    for action in options.parser._actions:
        within, value = getattr(action, "within", None), getattr(options, action.dest, None)
        if within and value is not None and not within[0] <= value <= within[1]:
            said = f"{value:g}" if isinstance(value, float) else value
            raise ConfigError(f"{action.option_strings[0]} {said}: must be {within[2]}")


def given_bus(options: argparse.Namespace) -> dict[str, Any]:
    words = {word: getattr(options, word) for word in BUS_WORDS if hasattr(options, word)}
    return words | getattr(options, "bus_kwargs", {})


def default_bus_file() -> Path:
    """File in XDG_CONFIG_HOME (Windows: APPDATA), else ~/.config. FileNotFoundError without a home folder."""
    with saying(FileNotFoundError, "no folder for a default bus, set XDG_CONFIG_HOME", RuntimeError):
        folder = os.environ.get("XDG_CONFIG_HOME") or os.environ.get("APPDATA") or Path.home() / ".config"
    return Path(folder) / "canfb" / "bus.json"


def remembered() -> dict[str, Any]:
    """Options of python-can of the default bus, except those in the environment. ConfigError."""
    if "CAN_INTERFACE" in os.environ:
        return {}
    try:
        path = default_bus_file()
        words = dict(json.loads(path.read_text(encoding="utf-8")))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}; 'canfb use' writes it again") from None
    return {key: value for key, value in words.items() if f"CAN_{key.upper()}" not in os.environ}


def bus_options(options: argparse.Namespace, configured: dict[str, Any]) -> dict[str, Any]:
    """Options of python-can; rising precedence: ``canfb use``, configuration, command line. ConfigError."""
    from canfb.bus.opening import check_words, describe

    words = configured | given_bus(options)
    if words.get("interface") is None and (default := remembered()):
        words = default | words
        if not getattr(options, "said_bus", False):
            report(f"bus: {describe(words)} (canfb use)")
            options.said_bus = True
    check_words(words)
    return words


def chosen_bus(options: argparse.Namespace) -> dict[str, Any]:
    from canfb.configuration import ANY_NODES

    return bus_options(options, named_config(options, ANY_NODES).bus)


def named_config(options: argparse.Namespace, *needs: Sequence[str]) -> Config:
    from canfb.configuration import Config, load_config

    return load_config(options.config, *needs) if options.config is not None else Config()


T = TypeVar("T")


class _Subjects(argparse.Action):
    """Node-IDs and files in any order: ``nodes``, at most ``most``; ``module``, the first; one ``file``."""

    def __init__(self, *words: Any, most: int | None = None, file: str = "config", **more: Any) -> None:
        super().__init__(*words, **more)
        self._most, self._file = most, file

    def __call__(self, parser: argparse.ArgumentParser, namespace: Any, values: Any, *_: object) -> None:
        nodes = [one for one in values if isinstance(one, int)]
        files = [one for one in values if not isinstance(one, int)]
        if self._most is not None and len(nodes) > self._most:
            raise argparse.ArgumentError(self, f"{nodes[self._most]}: there is another node-ID already")
        if len(files) > (getattr(namespace, self._file) is None):
            raise argparse.ArgumentError(self, f"{files[-1]}: there is another file already")
        if files:
            setattr(namespace, self._file, files[0])
        namespace.nodes, namespace.module = nodes, nodes[0] if nodes else None


def nodes(
    text: str,
    *,
    least: int = 0,
    most: int | None = None,
    kind: Callable[[str], int | str] | None = None,
    file: str = "config",
    name: str = "NODE",
) -> Row:
    """NODE (shown as ``name``) and ``file`` in any order, ``--config``; sets ``nodes`` and ``module``."""
    words: dict[str, Any] = {"nargs": "+" if least else "*", "type": kind or node_or_yaml, "help": text}

    def add(parser: Any) -> None:
        parser.set_defaults(**{file: None})
        parser.add_argument("--config", metavar="CONFIG.yaml", help="bus and modules")
        parser.add_argument(
            "nodes", metavar=name, default=[], action=_Subjects, most=most, file=file, **words
        )

    return add


def checked(kind: Callable[[str], T], holds: Callable[[T], bool], otherwise: str) -> Callable[[str], T]:
    def parsed(text: str) -> T:
        with contextlib.suppress(ValueError):
            if holds(value := kind(text)):
                return value
        raise argparse.ArgumentTypeError(f"{text!r} {otherwise}")

    return parsed


def _integer(text: str) -> int:
    return int(text, 0)


whole_number = checked(_integer, lambda _: True, "is not a whole number")
node_number = checked(_integer, lambda node: 1 <= node <= 127, "is not a node-ID (1 to 127, or 0x01 to 0x7F)")
positive = checked(float, lambda value: 0.0 < value < 1e9, "is not a number above 0 and below 1e9")


def size(text: str) -> int:
    found = re.fullmatch(r"([1-9][0-9]{0,11})([kMG]?)B?", text)
    if found is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not a size such as 500k, 100M or 2G")
    return int(found[1]) * {"": 1, "k": 10**3, "M": 10**6, "G": 10**9}[found[2]]


def node_or_file(text: str) -> int | str:
    return node_number(text) if text[:1].isdecimal() and "." not in text else text


def required_file(name: str | None) -> Path:
    if name is None:
        raise ConfigError("a file is required beside NODE")
    return Path(name)


def node_or_yaml(text: str) -> int | str:
    return text if text.endswith((".yaml", ".yml")) else node_number(text)


# Options of commands that measure.
MEASURED_NODES = (
    nodes("node-ID of the module (32), or CONFIG.yaml: its first module", most=1),
    option(
        "--encoder-interface",
        type=whole_number,
        within=between(1, 127),
        metavar="ID",
        help="node-ID of the encoder interface (default: the node that sends the samples to the module)",
    ),
)
RATE = option(
    "--rate",
    type=float,
    within=between(0.1, 1e5),
    metavar="HZ",
    help="produce the SYNC, on a bus without one",
)

# Options of a CSV file of samples; :func:`canfb.sources.recording_source.chosen_layout` checks them.
COLUMNS = (
    option(
        "--columns",
        default="sine,cosine",
        metavar="SINE,COSINE",
        help="names or numbers (from 0) of the two columns (sine,cosine)",
    ),
    option("--mid-scale", type=float, default=0.0, metavar="READING", help="reading of a zero signal (0)"),
    option("--scale", type=float, default=1.0, metavar="COUNTS", help="ADC counts per unit of the file (1)"),
    option("--time-column", metavar="NAME", help="column of times in seconds; gaps become missed samples"),
)

UNITS_S = {"": 1.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "%": 0.01}


class Jitter(NamedTuple):
    """Jitter, ±, in seconds or as a part of the SYNC period."""

    value: float
    is_part: bool


def jitter(text: str) -> Jitter:
    """Type for argparse: 20us, 0.1ms, 2e-5 or 2e-5s, or 30% of the period."""
    found = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?(?:e-?[0-9]{1,2})?) ?(%|[mu\u00b5]?s|)", text)
    if found is None:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a jitter such as 20us, 0.1ms, 2e-5 (seconds) or 30%"
        )
    return Jitter(float(found[1]) * UNITS_S[found[2]], found[2] == "%")


def jitter_s(options: argparse.Namespace, rate_hz: float) -> float:
    """``--jitter`` in seconds; a part is multiplied by the period, 1 / ``rate_hz``."""
    return float(options.jitter.value / rate_hz if options.jitter.is_part else options.jitter.value)


def jitter_of(text: str) -> Row:
    return option(
        "--jitter",
        type=jitter,
        metavar="TIME",
        help=f"{text}, ±: 20us, 2e-5 (seconds), 30%% of the period",
    )


JITTER = jitter_of("uniform jitter of the produced SYNC")


def jittered(config: Config, options: argparse.Namespace) -> Config:
    from canfb.simulation.embedded_bus import LARGEST_PART  # imported here: most commands simulate nothing

    name, seconds = "sync_jitter_us", config.simulation.sync_jitter_us * 1e-6
    if options.jitter is not None:
        name, seconds = "--jitter", jitter_s(options, options.rate)
    if seconds * (options.rate or 0.0) > LARGEST_PART:
        raise ConfigError(
            f"{name}: is {seconds * options.rate:.0%} of the period; at most {LARGEST_PART:.0%} "
            f"({LARGEST_PART / options.rate * 1e6:.0f}us)"
        )
    if options.jitter is None:
        return config
    simulation = replace(config.simulation, sync_jitter_us=seconds * 1e6, sync_jitter_rms_us=0.0)
    return replace(config, played=simulation)
