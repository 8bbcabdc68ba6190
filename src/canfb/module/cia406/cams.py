"""The eight cams of one channel: electronic limit switches over the position (CiA 406, 6300h to 6337h)."""

from __future__ import annotations

from collections.abc import Callable

from canfb.device.od.dictionary import Dictionary
from canfb.module.cia406.limit_values import Span, span_of

CAMS = 8
CHANNEL = 1
STATE, ENABLE, POLARITY = 0x6300, 0x6301, 0x6302
LOW, HIGH, HYSTERESIS = 0x6310, 0x6320, 0x6330


class Cam:
    """One switch: on within its limits, off again only ``hysteresis`` measuring units beyond them."""

    __slots__ = ("_release", "_span", "active")

    def __init__(self) -> None:
        self._span: Span | None = None
        self._release: Span | None = None
        self.active = False

    def configure(self, low: int, high: int, hysteresis: int, total_range: int) -> None:
        """Take limits (INTEGER32) and hysteresis (measuring units). Others than before forget the state.

        The switching band goes over the wrap of the range as the position does. One that covers the
        whole range keeps the cam on once it was on.
        """
        span = release = span_of(low, high, total_range)
        if span is not None and hysteresis:
            width = (span.high - span.low) % total_range + 2 * hysteresis
            if width >= total_range - 1:
                release = Span(0, total_range - 1)
            else:
                first, last = span.low - hysteresis, span.high + hysteresis
                release = Span(first % total_range, last % total_range)
        if (span, release) != (self._span, self._release):
            self._span, self._release = span, release
            self.active = False

    def update(self, position: int) -> bool:
        """The state at this position."""
        span = self._release if self.active else self._span
        self.active = span is not None and span.holds(position)
        return self.active


class Cams:
    """Objects 6300h to 6302h and 6310h to 6337h of channel 1.

    A disabled cam reads 0, whatever its polarity. While the position is not valid all cams keep their
    state, and before the first valid position 6300h is 0. A change of its limits, hysteresis or enable
    bit, of the scaling, and a preset make a cam forget that it was on.

    Only :attr:`follows` needs every sample; without it the state is computed when it is read.
    """

    def __init__(self, dictionary: Dictionary, position: Callable[[], int | None]) -> None:
        """``position()`` is the last valid position, None for none yet."""
        entry = dictionary.entry
        self._position = position
        self._enable, self._polarity = entry(ENABLE, CHANNEL), entry(POLARITY, CHANNEL)
        self._limits = [
            (entry(LOW + n, CHANNEL), entry(HIGH + n, CHANNEL), entry(HYSTERESIS + n, CHANNEL))
            for n in range(CAMS)
        ]
        self._cams = [Cam() for _ in range(CAMS)]
        self._followed: list[Cam] = []
        self._total_range = 1
        self.follows = False
        """A cam in use has a hysteresis: :meth:`follow` must see each valid sample."""
        entry(STATE, CHANNEL).on_read = self._state
        self._enable.on_written = self._configure
        for limits in self._limits:
            for limit in limits:
                limit.on_written = self._configure

    def configure(self, total_range: int) -> None:
        """Take over all parameters for positions 0 .. ``total_range`` - 1, and forget the hysteresis."""
        self._total_range = total_range
        for cam in self._cams:
            cam.active = False
        self._configure()

    def follow(self, position: int) -> None:
        """A valid position, in measuring units."""
        for cam in self._followed:
            cam.update(position)

    def _configure(self) -> None:
        self._followed = []
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
        enabled, bits = int(self._enable.value), 0
        for n, cam in enumerate(self._cams):
            if enabled >> n & 1 and cam.update(position):
                bits |= 1 << n
        return (bits ^ int(self._polarity.value)) & enabled
