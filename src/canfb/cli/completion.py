"""Shell completion of options and arguments by argcomplete (extra ``completion``).

The shell runs ``canfb`` with the line in its environment (``register-python-argcomplete canfb``).
"""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from canfb.cli.commands import build_parser, named_command
from canfb.errors import CanfbError

ASKED = "_ARGCOMPLETE"  # Environment variable of a completion: number of the program's word, from 1.
CAN_HARDWARE = "280"  # ARPHRD_CAN of Linux
NETWORK = Path("/sys/class/net")
YAML_FILES = ("yaml", "yml")


def answer(environment: Mapping[str, str]) -> None:
    try:
        import argcomplete
        from argcomplete.completers import DirectoriesCompleter, FilesCompleter
    except ImportError:
        return
    parser = build_parser(named_command(asked_words(environment)))
    completers: dict[str, Any] = {
        "CONFIG.yaml": FilesCompleter(YAML_FILES),
        "DIR": DirectoriesCompleter(),
        "NODE": nodes,
        "ID": nodes,
        "CHANNEL": can_interfaces,
    }
    for action in _actions(parser):
        if action.metavar in completers:
            action.completer = completers[str(action.metavar)]  # type: ignore[attr-defined]
    argcomplete.autocomplete(parser)


def asked_words(environment: Mapping[str, str]) -> list[str]:
    """The words after the program name, up to the cursor."""
    line, program = environment.get("COMP_LINE", ""), environment.get(ASKED, "")
    point = environment.get("COMP_POINT", "")
    before = line[: int(point)] if point.isdecimal() else line
    return before.split()[int(program) if program.isdecimal() else 1 :]


def nodes(action: argparse.Action, parsed_args: argparse.Namespace, **_: object) -> list[str]:
    """Node-IDs of the configuration on the line, and ``all`` if accepted."""
    found = ["all"] if "or all" in (action.help or "") else []
    name = getattr(parsed_args, "config", None)
    if name is not None:
        from canfb.configuration import ANY_NODES, load_config

        with contextlib.suppress(CanfbError):
            found += [f"0x{node:02X}" for node in load_config(name, ANY_NODES).node_ids]
    return found


def can_interfaces(**_: object) -> list[str]:
    try:
        types = {kind.parent.name: kind.read_text().strip() for kind in NETWORK.glob("*/type")}
    except OSError:
        return []
    return sorted(name for name, kind in types.items() if kind == CAN_HARDWARE)


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                yield from _actions(below)
        else:
            yield action
