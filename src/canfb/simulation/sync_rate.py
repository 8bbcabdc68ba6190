"""The rate at which a SYNC really comes, beside the one that was asked for."""

from __future__ import annotations

from collections.abc import Callable

from canfb.cia301 import cob
from canfb.cia301.frame import Frame

WINDOW_S, WINDOW_SYNCS = 2.0, 100  # over which the rate is taken, whichever is longer
TOLERANCE = 0.02
AGAIN_S = 60.0
IN_TRUE_TIME = "; set a lower --rate, or --pace sync"
IN_SLOW_MOTION = ", and the machine turns slower in proportion"


class SyncRateWatch:
    """Receives the SYNC, and calls ``report`` with one line if its rate is not ``asked_hz``; sans-I/O.

    ``advice`` is what it says of a computer that does not keep up.

    It says so after the first window with a rate that is off by more than 2 %, and then once a minute
    at most. ValueError unless the rate is positive.
    """

    def __init__(self, asked_hz: float, report: Callable[[str], None], advice: str = IN_TRUE_TIME) -> None:
        if not asked_hz > 0.0:
            raise ValueError(f"asked_hz must be positive, not {asked_hz!r}")
        self.held_hz: float | None = None
        """Of the last window; None before its end."""
        self._asked_hz = asked_hz
        self._report = report
        self._advice = advice
        self._window_s = max(WINDOW_S, WINDOW_SYNCS / asked_hz)
        self._began_s: float | None = None
        self._syncs = 0
        self._said_s: float | None = None

    def start(self, now: float) -> list[Frame]:
        """Nothing to send."""
        return []

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        """Count the SYNC at ``now`` (seconds)."""
        if frame.can_id != cob.SYNC or frame.rtr:
            return []
        if self._began_s is None:
            self._began_s = now
            return []
        self._syncs += 1
        passed = now - self._began_s
        if passed >= self._window_s:
            self.held_hz = self._syncs / passed
            self._judge(self.held_hz, now)
            self._began_s, self._syncs = now, 0
        return []

    def tick(self, now: float) -> list[Frame]:
        """Nothing is ever due."""
        return []

    def deadline(self) -> float | None:
        """No time is waited for."""
        return None

    def _judge(self, held_hz: float, now: float) -> None:
        if abs(held_hz / self._asked_hz - 1.0) <= TOLERANCE:
            return
        if self._said_s is None or now - self._said_s >= AGAIN_S:
            self._said_s = now
            self._report(
                f"SYNC: {held_hz:.4g} Hz reached, {self._asked_hz:g} Hz requested: "
                f"this computer does not keep up{self._advice}"
            )
