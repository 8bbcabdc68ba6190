"""How long a sampling interval is: from 1006h, else from the SYNCs as they come."""

from __future__ import annotations

from canfb.device.dictionary import Entry

SMOOTHING = 1.0 / 32.0
SAME_RATE = 1.5  # an interval longer than this multiple is a gap, not a new rate
SECONDS_PER_US = 1e-6


class IntervalEstimate:
    """The sampling interval in seconds, 0.0 while nothing is known.

    The communication cycle period 1006h is taken where a master has written it. Else the
    arrival times are averaged, and gaps are left out.
    """

    __slots__ = ("_estimate_s", "_gaps", "_last_s", "_period_us")

    def __init__(self, communication_cycle_period: Entry) -> None:
        self._period_us = communication_cycle_period
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._estimate_s = 0.0
        self.pause()

    def pause(self) -> None:
        """Keep the estimate over a pause; the next event starts a new interval."""
        self._last_s: float | None = None
        self._gaps = 0

    @property
    def seconds(self) -> float:
        """The sampling interval in force."""
        return self._period_us.value * SECONDS_PER_US or self._estimate_s

    def event(self, now: float) -> None:
        """A SYNC, or a sample where there is no SYNC, at ``now`` (seconds)."""
        last, self._last_s = self._last_s, now
        if last is None or now <= last:
            return
        interval, estimate = now - last, self._estimate_s
        if estimate == 0.0:
            self._estimate_s = interval
        elif interval < SAME_RATE * estimate:
            self._estimate_s += (interval - estimate) * SMOOTHING
            self._gaps = 0
        else:
            self._gaps += 1
            if self._gaps >= 8:  # no gaps, but a slower bus
                self._estimate_s, self._gaps = interval, 0
