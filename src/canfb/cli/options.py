"""Options that several commands share."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from canfb.cli.commands import SUMMARIES
from canfb.cli.examples import examples_of
from canfb.errors import ConfigError

if TYPE_CHECKING:
    from canfb.configuration import Config
    from canfb.module.module_config import ModuleConfig

Commands = Any  # argparse's sub-parser action has no public name
BUS_WORDS = ("interface", "channel", "bitrate", "fd", "data_bitrate", "timing")
BUS_METAVARS = {"interface": "NAME", "bitrate": "BIT/S", "data_bitrate": "BIT/S", "channel": "CHANNEL"}
BUS_HELP = {
    "channel": "its channel: can0, vcan0, PCAN_USBBUS1; default: CAN_CHANNEL or can.conf",
    "interface": "of python-can: socketcan, pcan, kvaser, udp_multicast; default: CAN_INTERFACE or can.conf",
    "bitrate": "bit rate; default: CAN_BITRATE or can.conf. SocketCAN has its own, set by ip link",
    "fd": "open the interface for CAN FD (CANopen frames are classic ones)",
    "data_bitrate": "bit rate of the data phase of CAN FD",
    "timing": "bit timing, such as f_clock=8_000_000 tseg1=5 tseg2=2 sjw=2 brp=2 nof_samples=1",
    "bus_kwargs": "further keys of the interface, such as serial=1234",
}
"""In place of the texts of python-can, which take half a page."""


def add_command(
    commands: Commands, name: str, action: Callable[[argparse.Namespace], int], summary: str = ""
) -> argparse.ArgumentParser:
    """Add a command that calls ``action``, or a part of one with a ``summary``; its parser, for options."""
    summary = summary or SUMMARIES[name]
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
    for action in parser._actions:
        if action.dest in BUS_HELP and action.help is not argparse.SUPPRESS:
            action.help = BUS_HELP[action.dest]
            action.metavar = BUS_METAVARS.get(action.dest, action.metavar)


def add_answer_within(parser: argparse._ActionsContainer) -> None:
    """``--answer-within``, of the commands that use SDO."""
    parser.add_argument(
        "--answer-within", type=float, default=1.0, metavar="S", help="time for an SDO answer (1)"
    )


def add_measured_nodes(parser: argparse.ArgumentParser) -> None:
    """``--module`` and ``--encoder-interface``, of the commands that measure."""
    parser.add_argument("--module", type=whole_number, metavar="ID", help="node-ID of the module (32)")
    parser.add_argument(
        "--encoder-interface",
        type=whole_number,
        metavar="ID",
        help="node-ID of the encoder interface (default: the node that sends the samples to the module)",
    )


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


def positive(text: str) -> float:
    """A number above 0: a type for argparse."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number above 0")
    return value


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


def chosen_bus(options: argparse.Namespace) -> dict[str, Any]:
    """:func:`bus_options` with the configuration of ``--config`` or CONFIG.yaml, if there is one."""
    from canfb.configuration import ANY_NODES, load_config

    chosen = options.config or getattr(options, "configuration", None)
    return bus_options(options, load_config(chosen, ANY_NODES).bus if chosen else {})


def named_config(options: argparse.Namespace) -> Config:
    """The configuration of ``--config`` or CONFIG.yaml; without one, an empty one."""
    from canfb.configuration import Config, load_config

    return load_config(options.config) if options.config else Config()


def add_ready_file(parser: argparse.ArgumentParser) -> None:
    """``--ready-file``, for :class:`canfb.hosting.readiness.Readiness`."""
    parser.add_argument(
        "--ready-file", metavar="PATH", help="a file that exists while the program is on the bus"
    )


def is_yaml(text: str) -> bool:
    """It is named like a configuration."""
    return text.endswith((".yaml", ".yml"))


def yaml_file(text: str) -> str:
    """A configuration, CONFIG.yaml: a type for argparse."""
    if not is_yaml(text):
        raise argparse.ArgumentTypeError(f"{text!r} is no CONFIG.yaml; a name of several words needs quotes")
    return text


def node_or_yaml(text: str) -> int | str:
    """A node-ID, or a configuration; :func:`take_yaml` tells them apart. A type for argparse."""
    return text if is_yaml(text) else node_number(text)


def take_yaml(options: argparse.Namespace) -> None:
    """Move a configuration among ``options.nodes`` to ``options.config``. ConfigError for several."""
    files = [one for one in options.nodes if isinstance(one, str)]
    if len(files) + (options.config is not None) > 1:
        raise ConfigError(f"{files[-1]}: there is another configuration already; one is taken")
    options.nodes = [one for one in options.nodes if not isinstance(one, str)]
    options.config = files[0] if files else options.config


def add_jitter(parser: argparse.ArgumentParser) -> None:
    """``--jitter``, of commands that produce the SYNC: uneven on purpose (docs/time.md)."""
    parser.add_argument(
        "--jitter",
        type=float,
        metavar="PART",
        help="have the SYNC jitter on purpose, uniformly within +- this part of its period, 0 to 0.45",
    )


def jittered(config: Config, options: argparse.Namespace) -> Config:
    """With a SYNC at ``--rate`` that jitters so. ConfigError for a bad one, or without a rate."""
    from canfb.simulation.sync_producer import LARGEST_PART  # here: most commands simulate nothing

    part = options.jitter
    if part is None:
        return config
    if options.rate is None:
        refuse_idle(options, ("jitter",), "only with --rate: the SYNC is that of the bus")
    if not 0.0 <= part <= LARGEST_PART:
        raise ConfigError(f"--jitter {part:g}: must be 0 to {LARGEST_PART:g}, as part of the period")
    jitter_us = part / options.rate * 1e6
    simulation = replace(config.simulation, sync_jitter_us=jitter_us, sync_jitter_rms_us=0.0)
    return replace(config, simulation=simulation)
