"""Arguments that several commands share."""

from __future__ import annotations

import argparse
import contextlib
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from canfb.cli.options import Row, option
from canfb.errors import ConfigError

if TYPE_CHECKING:
    from canfb.configuration import Config


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
    """NODE and a file in any order, and ``--config``: ``nodes``, ``module`` and ``file``, called ``name``."""
    words: dict[str, Any] = {"nargs": "+" if least else "*", "type": kind or node_or_yaml, "help": text}

    def add(parser: Any) -> None:
        parser.set_defaults(**{file: None})
        parser.add_argument("--config", metavar="CONFIG.yaml", help="bus and modules")
        parser.add_argument(
            "nodes", metavar=name, default=[], action=_Subjects, most=most, file=file, **words
        )

    return add


def _number(kind: Callable[[str], T], holds: Callable[[T], bool], what: str) -> Callable[[str], T]:
    """A type for argparse."""

    def parsed(text: str) -> T:
        with contextlib.suppress(ValueError):
            if holds(value := kind(text)):
                return value
        raise argparse.ArgumentTypeError(f"{text!r} is not {what}")

    return parsed


def _integer(text: str) -> int:
    return int(text, 0)


whole_number = _number(_integer, lambda number: True, "a whole number")
node_number = _number(_integer, lambda node: 1 <= node <= 127, "a node-ID (1 to 127, or 0x01 to 0x7F)")
positive = _number(float, lambda value: 0.0 < value < 1e6, "a number above 0")


def size(text: str) -> int:
    found = re.fullmatch(r"([1-9][0-9]{0,11})([kMG]?)B?", text)
    if found is None:
        raise argparse.ArgumentTypeError(f"{text!r} is no size; write it as 500k, 100M or 2G")
    return int(found[1]) * {"": 1, "k": 10**3, "M": 10**6, "G": 10**9}[found[2]]


def node_or_file(text: str) -> int | str:
    return node_number(text) if text[:1].isdecimal() and "." not in text else text


def required_file(name: str | None) -> Path:
    if name is None:
        raise ConfigError("a file is required beside NODE")
    return Path(name)


def node_or_yaml(text: str) -> int | str:
    return text if text.endswith((".yaml", ".yml")) else node_number(text)


MEASURED_NODES = (
    nodes("node-ID of the module (32), or CONFIG.yaml, whose first module is meant", most=1),
    option(
        "--encoder-interface",
        type=whole_number,
        metavar="ID",
        help="node-ID of the encoder interface (default: the node that sends the samples to the module)",
    ),
)
"""Of the commands that measure."""

COLUMNS = (
    option(
        "--columns",
        default="sine,cosine",
        metavar="SINE,COSINE",
        help="names or numbers (from 0) of the two columns",
    ),
    option("--mid-scale", type=float, default=0.0, metavar="READING", help="reading of a zero signal (0)"),
    option(
        "--scale", type=float, default=1.0, metavar="COUNTS", help="ADC counts for each volt of the file (1)"
    ),
    option("--time-column", metavar="NAME", help="column of times in seconds; gaps become missed samples"),
)
"""Of a CSV file of samples; :func:`canfb.sources.recording_source.chosen_layout` checks them."""

UNITS_S = {"": 1.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "%": 0.01}


class Jitter(NamedTuple):
    """±, seconds; or as a part of the period of the SYNC."""

    value: float
    is_part: bool


def jitter(text: str) -> Jitter:
    """20us, 0.1ms, 2e-5 or 2e-5s, or 30% of the period: a type for argparse."""
    found = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?(?:e-?[0-9]{1,2})?) ?(%|[mu\u00b5]?s|)", text)
    if found is None:
        raise argparse.ArgumentTypeError(f"{text!r} is no jitter; write 20us, 0.1ms, 2e-5 (seconds) or 30%")
    return Jitter(float(found[1]) * UNITS_S[found[2]], found[2] == "%")


def jitter_s(options: argparse.Namespace, rate_hz: float | None) -> float:
    """``--jitter`` in seconds. ConfigError for a part of a period not known."""
    if options.jitter.is_part and rate_hz is None:
        raise ConfigError("--jitter: a part of which period? give --rate, or a time")
    return float(options.jitter.value / (rate_hz or 1.0) if options.jitter.is_part else options.jitter.value)


def jitter_of(text: str) -> Row:
    help_text = f"{text}, ±: 20us, 2e-5 (seconds), 30%% of the period"
    return option("--jitter", type=jitter, metavar="TIME", help=help_text)


JITTER = jitter_of("have the SYNC jitter on purpose, uniformly")


def jittered(config: Config, options: argparse.Namespace) -> Config:
    from canfb.simulation.sync_producer import LARGEST_PART  # here: most commands simulate nothing

    if options.jitter is None:
        return config
    seconds = jitter_s(options, options.rate)
    if seconds * options.rate > LARGEST_PART:
        raise ConfigError(
            f"--jitter: is {seconds * options.rate:.0%} of the period; at most {LARGEST_PART:.0%} "
            f"({LARGEST_PART / options.rate * 1e6:.0f}us)"
        )
    simulation = replace(config.simulation, sync_jitter_us=seconds * 1e6, sync_jitter_rms_us=0.0)
    return replace(config, played=simulation)
