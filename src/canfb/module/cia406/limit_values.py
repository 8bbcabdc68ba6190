"""Limits of cams and work area: INTEGER32 beside a position that is UNSIGNED32 (CiA 406, 6310h to 6402h)."""

from __future__ import annotations

from typing import NamedTuple

U32 = 0xFFFFFFFF


class Span(NamedTuple):
    """Positions from ``low`` to ``high``, both included; over the wrap if ``low`` is above ``high``."""

    low: int
    high: int

    def holds(self, position: int) -> bool:
        """Whether the position is in the span."""
        low, high = self
        if low <= high:
            return low <= position <= high
        return position >= low or position <= high


def limit_position(limit: int, total_range: int) -> int:
    """The position, in measuring units, that a limit (INTEGER32) means in a range 0 .. ``total_range`` - 1.

    A negative limit has the same 32 bits as a position from 2^31 on where the range reaches that far;
    else it counts back from the end of the range: -1 is the last position. Limits beyond the range
    stay beyond it.
    """
    if limit >= 0:
        return limit
    unsigned = limit & U32
    return unsigned if unsigned < total_range else limit + total_range


def span_of(low: int, high: int, total_range: int) -> Span | None:
    """The positions between two limits (INTEGER32), cut to the range; None for a span wholly beyond it."""
    first, last = limit_position(low, total_range), limit_position(high, total_range)
    if first <= last:
        if last < 0 or first >= total_range:
            return None
        return Span(max(first, 0), min(last, total_range - 1))
    # Over the wrap: the part up to the end and the part from 0 on, each where the range has it.
    if first >= total_range:
        return None if last < 0 else Span(0, min(last, total_range - 1))
    return Span(first, last) if last >= 0 else Span(max(first, 0), total_range - 1)
