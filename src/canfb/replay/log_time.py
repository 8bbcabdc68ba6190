"""The time of a log, as the time of a module: seconds since its first frame, which never go back."""

from __future__ import annotations

import math

LONGEST_GAP_S = 60.0
"""A longer silence is cut to this: the module has lost everything by then that it can lose."""
REORDERED_S = 1e-3
"""A frame so much earlier than the one before was written down late; more is a clock that was set."""


class LogTime:
    """Turns stamps of a log (seconds, of any clock) into the seconds of ``now``.

    ``origin_s`` is what has to be added to ``now`` to give the stamp. ``steps_back`` counts how often the
    clock of the log was set back, ``gaps`` the silences of more than a minute, ``bad`` the frames whose
    stamp was not a number.
    """

    __slots__ = ("bad", "begun", "gaps", "origin_s", "steps_back")

    def __init__(self) -> None:
        self.origin_s = 0.0
        self.begun = False
        self.steps_back = self.gaps = self.bad = 0

    def judged(self, stamp_s: float, now: float) -> float:
        """When a frame came of which ``now <= stamp_s - origin_s <= now + LONGEST_GAP_S`` does not hold.

        Seconds of ``now``; up to a millisecond before it for a frame that was written down late.
        """
        if not math.isfinite(stamp_s):
            self.bad += 1
            return now
        if not self.begun:
            self.begun = True
            self.origin_s = stamp_s
            return now
        received = stamp_s - self.origin_s
        if now - REORDERED_S <= received < now:
            return received
        if received < now:
            self.steps_back += 1
        else:
            self.gaps += 1
            now += LONGEST_GAP_S
        self.origin_s = stamp_s - now
        return now
