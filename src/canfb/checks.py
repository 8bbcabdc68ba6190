"""Checks of arguments and configured values: a ValueError that names the parameter, or nothing."""

from __future__ import annotations

import sys
from collections.abc import Callable

LARGEST = sys.float_info.max  # Beyond it are infinity, and whole numbers that are no float.


def integer_in(name: str, value: object, low: int, high: int) -> None:
    """ValueError unless ``value`` is a whole number low..high."""
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise ValueError(f"{name} must be a whole number {low}..{high}, not {value!r}")


def number_in(name: str, value: object, low: float, high: float) -> None:
    """ValueError unless ``value`` is a number low..high; NaN is refused."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise ValueError(f"{name} must be a number {low:g}..{high:g}, not {value!r}")


def number(name: str, value: object) -> None:
    """ValueError unless ``value`` is a finite number."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= LARGEST:
        raise ValueError(f"{name} must be a finite number, not {value!r}")


def flag(name: str, value: object) -> None:
    """ValueError unless ``value`` is True or False."""
    if not isinstance(value, bool):
        raise ValueError(f"{name} must be true or false, not {value!r}")


def text(name: str, value: object) -> None:
    """ValueError unless ``value`` is text, not blank, that can name a file."""
    if not isinstance(value, str) or not value.strip() or any(map(_is_never_written, value)):
        raise ValueError(f"{name} must be text, not {value!r}")


def _is_never_written(one: str) -> bool:
    # U+DC80..U+DCFF stand for bytes of a name that is not UTF-8.
    return one == "\0" or "\ud800" <= one < "\udc80" or "\udcff" < one < "\ue000"


KINDS: dict[type, Callable[[str, object], None]] = {bool: flag, str: text, float: number}


def within(config: object, **allowed: tuple[float, float] | type) -> None:
    """Each attribute is in its range, one of whole numbers too, or of :data:`KINDS`; or its default None."""
    for name, one in allowed.items():
        value = getattr(config, name)
        if value is None and getattr(type(config), name, 0) is None:
            continue
        if isinstance(one, type):
            KINDS[one](name, value)
        elif isinstance(one[0], int) and isinstance(one[1], int):
            integer_in(name, value, one[0], one[1])
        else:
            number_in(name, value, *one)
