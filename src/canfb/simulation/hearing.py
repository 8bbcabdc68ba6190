"""When a frame was received: by the clock of the bus where there is one."""

from __future__ import annotations

from canfb.device.frame import Frame

OLDEST_S = 10.0


def heard_at(frame: Frame, now: float) -> float:
    """Receive time of ``frame`` in seconds on the clock of ``now``, the time at which it is handled.

    A time stamp that lies ahead of ``now``, or more than 10 s behind it, belongs to another clock: ``now``.
    """
    stamp = frame.timestamp
    return now if stamp is None or not now - OLDEST_S <= stamp <= now else stamp
