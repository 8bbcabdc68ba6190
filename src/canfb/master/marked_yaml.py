"""A YAML file with the line of each key, for messages."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from canfb.checks import yaml_size

LONGEST = 200

_INT, _FLOAT = "tag:yaml.org,2002:int", "tag:yaml.org,2002:float"


class _ObjectLoader(yaml.SafeLoader):
    """YAML 1.1 without its numbers to the base of 60: 2010:03 is the name of an object."""


_ObjectLoader.yaml_implicit_resolvers = {
    first: [(tag, form) for tag, form in resolvers if tag not in (_INT, _FLOAT)]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_ObjectLoader.add_implicit_resolver(
    _INT,
    re.compile(r"[-+]?(?:0b[01_]+|0x[0-9a-fA-F_]+|0[0-7_]+|0|[1-9][0-9_]*)$"),
    list("-+0123456789"),
)
_ObjectLoader.add_implicit_resolver(
    _FLOAT,
    re.compile(
        r"[-+]?(?:[0-9][0-9_]*\.[0-9_]*(?:[eE][-+]?[0-9]+)?|\.[0-9]+|\.(?:inf|Inf|INF))$|\.(?:nan|NaN)$"
    ),
    list("-+.0123456789"),
)


class MarkedYaml:
    """The content of a YAML text, and where its keys are. ValueError, in one line, for one that is none.

    A key that comes twice in one mapping is refused: one of the two would be lost.
    """

    def __init__(self, data: bytes) -> None:
        try:
            loader = _ObjectLoader(data)
            try:
                self._root = loader.get_single_node()
                yaml_size(self._root)
                _refuse_doubles(self._root)
                self.content: Any = None if self._root is None else loader.construct_document(self._root)
            finally:
                loader.dispose()
        except yaml.YAMLError as error:
            raise ValueError(_in_one_line(error)) from None
        except RecursionError:
            raise ValueError("it is nested too deeply") from None

    def line(self, *keys: str) -> int:
        """The line, from 1, of the last of these nested keys that is there."""
        node, line = self._root, 1
        for key in keys:
            found = [pair for pair in _pairs(node) if pair[0].value == key]
            if not found:
                break
            line, node = found[0][0].start_mark.line + 1, found[0][1]
        return line


def _pairs(node: Any) -> list[tuple[Any, Any]]:
    return node.value if isinstance(node, yaml.MappingNode) else []


def _refuse_doubles(root: Any) -> None:
    """ValueError for the first double in the file."""
    waiting, known = [root], set[int]()
    while waiting:
        node = waiting.pop()
        if id(node) in known:
            continue
        known.add(id(node))
        seen: dict[str, int] = {}
        for key, value in _pairs(node):
            line = key.start_mark.line + 1
            if isinstance(key, yaml.ScalarNode):
                if key.value in seen:
                    first = seen[key.value]
                    raise ValueError(f"line {line}: key {key.value!r} is there already, in line {first}")
                seen[key.value] = line
            waiting.append(value)
        if isinstance(node, yaml.SequenceNode):
            waiting.extend(node.value)


def _in_one_line(error: yaml.YAMLError) -> str:
    mark = getattr(error, "problem_mark", None)
    said = " ".join(str(getattr(error, "problem", None) or error).split())[:LONGEST]
    return said if mark is None else f"line {mark.line + 1}: {said}"


def read_bytes(path: Path, refuse: type[Exception]) -> bytes:
    """The bytes of a file; ``refuse`` is raised, in one line, where it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise refuse(f"{path}: cannot be read: {error.strerror}") from None
