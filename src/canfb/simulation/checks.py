"""Checks of configured values."""

from __future__ import annotations


def number(name: str, value: object, low: float, high: float) -> None:
    """ValueError unless the value is a number in ``low``..``high``; NaN is none."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise ValueError(f"{name} must be a number {low:g}..{high:g}, not {value!r}")
