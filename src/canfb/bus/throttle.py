"""Not every one of many: what comes too often is counted, and the count is reported now and then."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Generic, TypeVar

from canfb.device.moment import NEVER

T = TypeVar("T")
BURST = 5  # that pass in a window
WINDOW_S = 1.0
LONGEST_WINDOW_S = 10.0


@dataclass(frozen=True, slots=True)
class Held(Generic[T]):
    """What was held back: how many in the last ``seconds``, and the last of them."""

    key: Hashable
    count: int
    seconds: float
    last: T


@dataclass(slots=True)
class _Window(Generic[T]):
    """From ``began_s`` on, for ``length_s``."""

    began_s: float
    length_s: float
    passed: int
    held: int = 0
    last: T | None = None


class Throttle(Generic[T]):
    """Lets BURST items of a key pass in WINDOW_S, and counts the rest of them.

    While more come the window grows to LONGEST_WINDOW_S, and nothing passes but the counts. Keys are few:
    nothing is forgotten of one before its window has ended. Times are seconds.
    """

    def __init__(self) -> None:
        self._windows: dict[Hashable, _Window[T]] = {}
        self.deadline = NEVER
        """When :meth:`ended` is to be called next."""

    def admits(self, key: Hashable, item: T, now: float) -> bool:
        """Whether this one passes; else it is counted."""
        window = self._windows.get(key)
        if window is None:
            self._windows[key] = _Window(now, WINDOW_S, 1)
            self.deadline = min(self.deadline, now + WINDOW_S)
            return True
        if window.passed < BURST:
            window.passed += 1
            return True
        window.held += 1
        window.last = item
        return False

    def ended(self, now: float) -> list[Held[T]]:
        """What was held back in windows that have ended by ``now``."""
        if now < self.deadline:
            return []
        over = [key for key, window in self._windows.items() if now >= window.began_s + window.length_s]
        return self._close(over, now, go_on=True)

    def close(self, now: float) -> list[Held[T]]:
        """What is held back at the end."""
        return self._close(list(self._windows), now, go_on=False)

    def _close(self, keys: list[Hashable], now: float, *, go_on: bool) -> list[Held[T]]:
        lines = []
        for key in keys:
            window = self._windows.pop(key)
            if window.last is not None:
                lines.append(Held(key, window.held, now - window.began_s, window.last))
                if go_on:
                    length_s = min(2.0 * window.length_s, LONGEST_WINDOW_S)
                    self._windows[key] = _Window(now, length_s, BURST)
        ends = (window.began_s + window.length_s for window in self._windows.values())
        self.deadline = min(ends, default=NEVER)
        return lines
