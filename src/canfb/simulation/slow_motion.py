"""A machine that goes on by one interval with each SYNC, for a computer that does not keep up."""

from __future__ import annotations

from canfb import objects as od
from canfb.checks import number_in
from canfb.cia301.cob import CAN_ID
from canfb.cia301.frame import Frame
from canfb.device.od.dictionary import Dictionary

SECONDS_PER_US = 1e-6
SHORTEST_INTERVAL_S, LONGEST_INTERVAL_S = 1e-6, 10.0


class SlowMotion:
    """The machine goes on by one nominal interval with each SYNC, however late it is, and stands between.

    The samples are equidistant in the time of the machine. Attach it to the bus before the nodes whose
    ``time_base`` (:mod:`canfb.interface.sample_instants`) it is; it sends nothing.

    ``dictionary`` is that of the node that samples: its 1005h says which frame is the SYNC, its 1006h how
    long the interval is. ``interval_s``, 1e-6 to 10 s, counts while 1006h is 0; ValueError for another.
    """

    def __init__(self, dictionary: Dictionary, interval_s: float) -> None:
        number_in("interval_s", interval_s, SHORTEST_INTERVAL_S, LONGEST_INTERVAL_S)
        self._interval_s = interval_s
        self._cob_id = dictionary.entry(*od.SYNC_COB_ID)
        self._period = dictionary.entry(*od.CYCLE_PERIOD)
        self.time_s = 0.0
        """The time of the machine."""

    def start(self, now: float) -> list[Frame]:
        """Power-on: there is nothing to send."""
        return []

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        """A SYNC: the machine goes on."""
        if frame.can_id == self._cob_id.value & CAN_ID and not frame.rtr:
            self.time_s += self._period.value * SECONDS_PER_US or self._interval_s
        return []

    def tick(self, now: float) -> list[Frame]:
        """Nothing is ever due."""
        return []

    def deadline(self) -> float | None:
        """No time is waited for."""
        return None

    def received_at(self, frame: Frame, now: float) -> float:
        """The time of the last SYNC."""
        return self.time_s

    def at(self, now: float) -> float:
        """The time of the last SYNC."""
        return self.time_s
