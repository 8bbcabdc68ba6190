"""Checks of arguments and configured values: a ValueError that names the parameter, or nothing."""

from __future__ import annotations

import sys
from typing import Any

LARGEST = sys.float_info.max
"""Beyond it are infinity, and whole numbers that are no float."""

MOST_VALUES = 100_000
"""Of a YAML file, with each alias written out; a table of 4096 entries has 5000."""


def integer_in(name: str, value: object, low: int, high: int) -> None:
    """ValueError that names the parameter unless ``value`` is a whole number low..high."""
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise ValueError(f"{name} must be a whole number {low}..{high}, not {value!r}")


def number_in(name: str, value: object, low: float, high: float) -> None:
    """ValueError unless ``value`` is a number low..high; NaN is refused."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise ValueError(f"{name} must be a number {low:g}..{high:g}, not {value!r}")


def number(name: str, value: object) -> None:
    """ValueError unless ``value`` is a finite number."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= LARGEST:
        raise ValueError(f"{name} must be a number, not {value!r}")


def flag(name: str, value: object) -> None:
    """ValueError unless ``value`` is True or False."""
    if not isinstance(value, bool):
        raise ValueError(f"{name} must be true or false, not {value!r}")


def text(name: str, value: object) -> None:
    """ValueError unless ``value`` is a string with more than blanks, and without a NUL."""
    if not isinstance(value, str) or not value.strip() or "\0" in value:
        raise ValueError(f"{name} must be text, not {value!r}")


def yaml_size(root: Any) -> None:
    """ValueError unless the nodes of a YAML file stand for at most MOST_VALUES values.

    With aliases ten short lines can stand for 10^9 of them; one that contains itself, for any number.
    """
    if root is not None and _values(root, {}) > MOST_VALUES:
        raise ValueError(f"the file stands for more than {MOST_VALUES} values")


def _values(node: Any, known: dict[int, int]) -> int:
    if id(node) not in known:
        known[id(node)] = MOST_VALUES + 1  # until it has been counted
        inner = node.value if isinstance(node.value, list) else []
        parts = [part for one in inner for part in (one if isinstance(one, tuple) else (one,))]
        known[id(node)] = 1 + sum(_values(part, known) for part in parts)
    return known[id(node)]
