"""Cams and work area of one channel (CiA 406, 6300h to 6337h, 6400h to 6402h).

Limits are INTEGER32, but the position is UNSIGNED32. A span may go over the wrap of the range.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from canfb.device.od.dictionary import Dictionary
from canfb.module.cia406.position import CHANNEL, U32


class Span(NamedTuple):
    """``low`` to ``high``, both included; over the wrap if ``low`` is above ``high``."""

    low: int
    high: int

    def holds(self, position: int) -> bool:
        low, high = self
        return low <= position <= high if low <= high else not high < position < low


def limit_position(limit: int, total_range: int) -> int:
    """The position, measuring units, of a limit in a range 0 .. ``total_range`` - 1.

    A negative limit is the position from 2^31 on with the same 32 bits, if the range reaches that far;
    else it counts back from the end of the range. Limits beyond the range stay beyond it.
    """
    if limit >= 0:
        return limit
    unsigned = limit & U32
    return unsigned if unsigned < total_range else limit + total_range


def span_of(low: int, high: int, total_range: int) -> Span | None:
    """The positions between two limits, cut to the range; None: all are beyond it."""
    first, last = limit_position(low, total_range), limit_position(high, total_range)
    if first <= last:
        if last < 0 or first >= total_range:
            return None
        return Span(max(first, 0), min(last, total_range - 1))
    # Over the wrap: the part up to the end of the range, and the part from 0 on.
    if first >= total_range:
        return None if last < 0 else Span(0, min(last, total_range - 1))
    return Span(first, last) if last >= 0 else Span(max(first, 0), total_range - 1)


CAMS = 8
STATE, ENABLE, POLARITY = 0x6300, 0x6301, 0x6302
LOW, HIGH, HYSTERESIS = 0x6310, 0x6320, 0x6330


class Cam:
    """Switches on within its limits, and off ``hysteresis`` units beyond them."""

    __slots__ = ("_release", "_span", "active")

    def __init__(self) -> None:
        self._span: Span | None = None
        self._release: Span | None = None
        self.active = False

    def configure(self, low: int, high: int, hysteresis: int, total_range: int) -> None:
        """Set the parameters; a change of them resets the state.

        A switching band that covers the whole range keeps the cam on.
        """
        span = release = span_of(low, high, total_range)
        if span is not None and hysteresis:
            width = (span.high - span.low) % total_range + 2 * hysteresis
            release = Span((span.low - hysteresis) % total_range, (span.high + hysteresis) % total_range)
            if width >= total_range - 1:
                release = Span(0, total_range - 1)
        if (span, release) != (self._span, self._release):
            self._span, self._release = span, release
            self.active = False

    def update(self, position: int) -> bool:
        span = self._release if self.active else self._span
        self.active = span is not None and span.holds(position)
        return self.active


class Cams:
    """Objects 6300h to 6302h and 6310h to 6337h of channel 1.

    A disabled cam reads 0 with either polarity. Without a valid position all cams keep their state; before
    the first one 6300h is 0. A change of its parameters or the scaling, and a preset, switch a cam off.

    ``follows``: :meth:`follow` must get each valid sample, since a cam in use has a hysteresis.
    ``position()``: the last valid position; None: none yet.
    """

    def __init__(self, dictionary: Dictionary, position: Callable[[], int | None]) -> None:
        entry, self._position = dictionary.entry, position
        self._enable, self._polarity = entry(ENABLE, CHANNEL), entry(POLARITY, CHANNEL)
        self._limits = [
            (entry(LOW + n, CHANNEL), entry(HIGH + n, CHANNEL), entry(HYSTERESIS + n, CHANNEL))
            for n in range(CAMS)
        ]
        self._cams = [Cam() for _ in range(CAMS)]
        entry(STATE, CHANNEL).on_read = self._state
        self._enable.on_written = self._configure
        for limits in self._limits:
            for limit in limits:
                limit.on_written = self._configure

    def configure(self, total_range: int) -> None:
        self._total_range = total_range  # set first: this is the begin of all state
        for cam in self._cams:
            cam.active = False
        self._configure()

    def follow(self, position: int) -> None:
        for cam in self._followed:
            cam.update(position)

    def _configure(self) -> None:
        self._followed: list[Cam] = []
        for n, (cam, (low, high, hysteresis)) in enumerate(zip(self._cams, self._limits, strict=True)):
            cam.configure(low.value, high.value, hysteresis.value, self._total_range)
            if not self._enable.value >> n & 1:
                cam.active = False
            elif hysteresis.value:
                self._followed.append(cam)
        self.follows = bool(self._followed)
        position = self._position()
        if position is not None:
            self.follow(position)

    def _state(self) -> int:
        position = self._position()
        if position is None:
            return 0
        enabled = int(self._enable.value)
        bits = sum(1 << n for n, cam in enumerate(self._cams) if enabled >> n & 1 and cam.update(position))
        return (bits ^ int(self._polarity.value)) & enabled


AREA_STATE, AREA_LOW, AREA_HIGH = 0x6400, 0x6401, 0x6402
# Bits of 6400h: outside of the limits; above the high one; below the low one.
OUT_OF_RANGE, OVERFLOW, UNDERFLOW = 1 << 0, 1 << 1, 1 << 2


def work_area_state(position: int, low: int, high: int, total_range: int) -> int:
    """Bits of 6400h for a position 0 .. ``total_range`` - 1 and two limits.

    If ``low`` is above ``high``, the area goes over the wrap; outside of it the nearer limit decides.
    """
    first, last = limit_position(low, total_range), limit_position(high, total_range)
    if first <= last:
        if position < first:
            return OUT_OF_RANGE | UNDERFLOW
        return OUT_OF_RANGE | OVERFLOW if position > last else 0
    if position >= first or position <= last:
        return 0
    return OUT_OF_RANGE | (OVERFLOW if position - last <= first - position else UNDERFLOW)


def show_work_area(
    dictionary: Dictionary, position: Callable[[], int | None], total_range: Callable[[], int]
) -> None:
    """Object 6400h of channel 1; 0 while ``position()``, the last valid one, is None."""
    low, high = dictionary.entry(AREA_LOW, CHANNEL), dictionary.entry(AREA_HIGH, CHANNEL)

    def state() -> int:
        at = position()
        return 0 if at is None else work_area_state(at, low.value, high.value, total_range())

    dictionary.entry(AREA_STATE, CHANNEL).on_read = state
