"""At which time of the machine a frame was received."""

from __future__ import annotations

from typing import Protocol

from canfb.cia301.frame import Frame

OLDEST_S = 10.0


class Hearing(Protocol):
    """The time of the machine, as a node has it; one that is simulated may be another than the true time."""

    def heard_at(self, frame: Frame, now: float) -> float:
        """The time of the machine, seconds, at which ``frame`` was received that is handled at ``now``."""

    def at(self, now: float) -> float:
        """The time of the machine, seconds, at ``now``."""


class TrueTime:
    """The machine turns in true time: at the clock of the bus where there is one."""

    def heard_at(self, frame: Frame, now: float) -> float:
        """Receive time of ``frame`` in seconds on the clock of ``now``, the time at which it is handled.

        A time stamp that lies ahead of ``now``, or more than 10 s behind it, belongs to another clock:
        ``now``.
        """
        stamp = frame.timestamp
        return now if stamp is None or not now - OLDEST_S <= stamp <= now else stamp

    def at(self, now: float) -> float:
        """``now``."""
        return now


TRUE_TIME = TrueTime()
