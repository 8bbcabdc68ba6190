"""What may stand in ``bus:``: python-can's own words, looked up in python-can."""

from __future__ import annotations

import ast
import difflib
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import can
from can.interfaces import BACKENDS

from canfb.bus.opening import FORCE_PYTHON_CAN
from canfb.errors import ConfigError

# Read by python-can itself, whatever the interface.
_GENERAL = frozenset(
    {
        "interface",
        "channel",
        "bitrate",
        FORCE_PYTHON_CAN,
        "fd",
        "data_bitrate",
        "timing",
        "receive_own_messages",
        "can_filters",
        "ignore_config",
        "config_context",
        "state",
        "port",
        "f_clock",
        "f_clock_mhz",
        "brp",
        "tseg1",
        "tseg2",
        "sjw",
        "nof_samples",
        "nom_brp",
        "nom_tseg1",
        "nom_tseg2",
        "nom_sjw",
        "data_brp",
        "data_tseg1",
        "data_tseg2",
        "data_sjw",
    }
)


def check_interface(words: Mapping[str, Any]) -> None:
    """ConfigError for an ``interface`` that python-can does not have. None: that of its configuration."""
    interface = words.get("interface")
    if interface is not None and (not isinstance(interface, str) or interface not in can.VALID_INTERFACES):
        known = sorted(can.VALID_INTERFACES)
        raise ConfigError(f"unknown interface {interface!r} in bus; {_hint(str(interface), known)}")


def check_words(words: Mapping[str, Any]) -> None:
    """ConfigError for a key that means nothing to this interface of python-can, or a bad bit rate.

    An interface that is a plug-in of python-can may have any keys.
    """
    check_interface(words)
    for key in ("bitrate", "data_bitrate"):
        value = words.get(key)
        if value is not None and (not isinstance(value, int) or isinstance(value, bool) or value <= 0):
            raise ConfigError(f"{key} in bus must be bits per second, such as 1000000, not {value!r}")
    interface = words.get("interface")
    if interface is None:
        return
    named, mentioned = _words_of(str(interface))
    for key in words:
        if mentioned and key not in _GENERAL | named | mentioned:
            known = sorted({"interface", "channel", "bitrate", *named})
            raise ConfigError(f"unknown key {key!r} in bus for {interface}; {_hint(key, known)}")


def _hint(word: str, known: list[str]) -> str:
    near = difflib.get_close_matches(word, known, n=1)
    return f"did you mean {near[0]!r}?" if near else f"known: {', '.join(known)}"


@cache
def _words_of(interface: str) -> tuple[frozenset[str], frozenset[str]]:
    """The parameters that its classes name, and all words that its source mentions.

    A driver need not be installed for that, and keys that are read from ``**kwargs`` are found.
    """
    named, mentioned = set[str](), set[str]()
    for path in _sources(interface):
        for node in ast.walk(ast.parse(path.read_bytes())):
            if isinstance(node, ast.FunctionDef) and node.name == "__init__":
                named.update(arg.arg for arg in (*node.args.args[1:], *node.args.kwonlyargs))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                mentioned.add(node.value)
    return frozenset(named), frozenset(mentioned)


def _sources(interface: str) -> Iterator[Path]:
    module = BACKENDS[interface][0]
    spec = find_spec(module) if module.startswith("can.interfaces.") else None
    if spec is None or spec.origin is None:
        return
    path = Path(spec.origin)
    yield from path.parent.glob("*.py") if path.name == "__init__.py" else [path]
