"""The work area of one channel: where the machine may be (CiA 406, 6400h to 6402h)."""

from __future__ import annotations

from collections.abc import Callable

from canfb.device.od.dictionary import Dictionary
from canfb.module.cia406.limit_values import limit_position

STATE, LOW, HIGH = 0x6400, 0x6401, 0x6402
CHANNEL = 1
OUT_OF_RANGE, OVERFLOW, UNDERFLOW = 1 << 0, 1 << 1, 1 << 2
"""Bits of 6400h: outside of the limits; above the high one; below the low one."""


def work_area_state(position: int, low: int, high: int, total_range: int) -> int:
    """Bits of 6400h for a position 0 .. ``total_range`` - 1 and two limits (INTEGER32).

    With ``low`` above ``high`` the area goes over the wrap; outside of it the nearer limit decides.
    """
    first, last = limit_position(low, total_range), limit_position(high, total_range)
    if first <= last:
        if position < first:
            return OUT_OF_RANGE | UNDERFLOW
        return OUT_OF_RANGE | OVERFLOW if position > last else 0
    if position >= first or position <= last:
        return 0
    return OUT_OF_RANGE | (OVERFLOW if position - last <= first - position else UNDERFLOW)


class WorkArea:
    """Object 6400h of channel 1, computed when it is read. It keeps its state without a valid position."""

    def __init__(
        self, dictionary: Dictionary, position: Callable[[], int | None], total_range: Callable[[], int]
    ) -> None:
        """``position()`` is the last valid position, None for none yet: 6400h is 0 then."""
        self._low, self._high = dictionary.entry(LOW, CHANNEL), dictionary.entry(HIGH, CHANNEL)
        self._position, self._total_range = position, total_range
        dictionary.entry(STATE, CHANNEL).on_read = self._state

    def _state(self) -> int:
        position = self._position()
        if position is None:
            return 0
        return work_area_state(position, self._low.value, self._high.value, self._total_range())
