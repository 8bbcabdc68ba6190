"""YAML with the line of each key: the one reader of configurations, tables and backups.

YAML 1.1 as PyYAML has it, but for its numbers to the base of 60: they are text (2010:03 is an object).
A file may stand for a limited number of values: with aliases ten short lines can stand for 10^9 of them, and
one that contains itself for any number.
"""

from __future__ import annotations

import re
from typing import Any

import yaml

MOST_VALUES = 100_000  # with each alias written out; a table of 4096 entries has 5000
LONGEST = 200  # of a message, characters
_INT, _FLOAT = "tag:yaml.org,2002:int", "tag:yaml.org,2002:float"


class YamlError(ValueError):
    """What is wrong with a YAML text, and where."""

    def __init__(self, line: int, said: str) -> None:
        super().__init__(f"line {line}: {said[:LONGEST]}")
        self.line, self.said = line, said


class _Loader(yaml.SafeLoader):
    """The loader of all files: 2001-99-99, 0x_ and !!bool 7 get their line."""

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        try:
            return super().construct_object(node, deep)
        except (ValueError, KeyError, IndexError, AttributeError, TypeError, OverflowError, RecursionError):
            raise yaml.MarkedYAMLError(
                problem=f"{str(node.value)[:40]!r}; quote text values", problem_mark=node.start_mark
            ) from None


_Loader.yaml_implicit_resolvers = {
    first: [(tag, form) for tag, form in resolvers if tag not in (_INT, _FLOAT)]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(
    _INT,
    re.compile(r"[-+]?(?:0b[01_]+|0x[0-9a-fA-F_]+|0|[1-9][0-9_]*)$"),
    list("-+0123456789"),
)
_Loader.add_implicit_resolver(
    _FLOAT,
    re.compile(
        r"[-+]?(?:[0-9][0-9_]*\.[0-9_]*(?:[eE][-+]?[0-9]+)?|\.[0-9_]+(?:[eE][-+][0-9]+)?"
        r"|\.(?:inf|Inf|INF))$|\.(?:nan|NaN|NAN)$"
    ),
    list("-+.0123456789"),
)


class _LoaderWithExponents(_Loader):
    """Takes 1e6 for a number."""


_LoaderWithExponents.add_implicit_resolver(
    _FLOAT, re.compile(r"[-+]?[0-9]+[eE][-+]?[0-9]+$"), list("-+0123456789")
)


def compose(text: str | bytes, *, exponents: bool = False) -> yaml.Node | None:
    """The nodes of a YAML text, each with its line; None for an empty text.

    YamlError, also for a key that is no word or comes twice.

    ``exponents``: 1e6 is a number, as people write it; in a file of ours it may be a CRC (388251E1).
    """
    try:
        loader = (_LoaderWithExponents if exponents else _Loader)(text)
    except yaml.reader.ReaderError as error:
        begun = text[: error.position]
        line = begun.count("\n" if isinstance(begun, str) else b"\n") + 1  # type: ignore[arg-type]
        raise YamlError(line, f"this is not YAML: {error.reason}") from None
    try:
        root: yaml.Node | None = loader.get_single_node()
        if root is not None and _checked(root, {}) > MOST_VALUES:
            raise YamlError(loader.line + 1, f"more than {MOST_VALUES} values, aliases expanded")
        return root
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        words = " ".join(filter(None, (error.context, error.problem)))
        raise YamlError(mark.line + 1 if mark else 1, f"this is not YAML: {words}") from None
    except RecursionError:
        raise YamlError(loader.line + 1, "nested too deeply") from None
    finally:
        loader.dispose()


def _checked(node: yaml.Node, known: dict[int, int]) -> int:
    """Its values, each alias written out. YamlError for a key that is no word or comes twice."""
    if id(node) in known:
        return known[id(node)]
    known[id(node)] = MOST_VALUES + 1  # until it has been counted
    seen: dict[str, int] = {}
    for key, _ in pairs(node):
        if not isinstance(key, yaml.ScalarNode):
            raise YamlError(line_of(key), "a key must be a single word")
        if key.value in seen:
            raise YamlError(line_of(key), f"key {key.value!r} is already in line {seen[key.value]}")
        seen[key.value] = line_of(key)
    inner = node.value if isinstance(node.value, list) else []
    parts = [part for one in inner for part in (one if isinstance(one, tuple) else (one,))]
    known[id(node)] = 1 + sum(_checked(part, known) for part in parts)
    return known[id(node)]


def construct(node: yaml.Node | None) -> Any:
    """The value of a node that :func:`compose` gave. YamlError."""
    if node is None:
        return None
    loader = _Loader("")
    try:
        return loader.construct_document(node)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        raise YamlError(mark.line + 1 if mark else 1, f"{error.problem}") from None
    finally:
        loader.dispose()


def found_at(root: yaml.Node | None, *keys: str | int) -> tuple[int, yaml.Node | None]:
    """The last of these nested keys, or places in lists, that is there: its line, from 1, and its value."""
    line, node = 1, root
    for key in keys:
        if isinstance(node, yaml.SequenceNode) and isinstance(key, int):
            node = node.value[key]
            continue
        found = [pair for pair in pairs(node) if pair[0].value == key]
        if not found:
            break
        line, node = line_of(found[0][0]), found[0][1]
    return line, node


def pairs(node: yaml.Node | None) -> list[tuple[yaml.Node, yaml.Node]]:
    return list(node.value) if isinstance(node, yaml.MappingNode) else []


def line_of(node: yaml.Node) -> int:
    return int(node.start_mark.line) + 1


class MarkedYaml:
    """The content of a YAML text, and where its keys are. YamlError."""

    def __init__(self, data: bytes) -> None:
        self._root = compose(data)
        self.content: Any = construct(self._root)

    def line(self, *keys: str) -> int:
        return found_at(self._root, *keys)[0]
