"""No frame of its own while LSS changes the bit rate of the bus (CiA 305, activate bit timing)."""

from __future__ import annotations

from canfb.device.agenda import Timed
from canfb.device.core import Core
from canfb.device.moment import NEVER


class Silence(Timed):
    """Whether the device is silent, and until when.

    `boot_up_owed` is for a boot-up that fell into it: it is sent at the end.
    """

    def __init__(self, core: Core) -> None:
        self.active = False
        self.boot_up_owed = False
        self.deadline = NEVER
        self._reactions = core.reactions

    def begin(self, until: float) -> None:
        """Silent from now on, until this time (seconds); one that is running lasts to the later end."""
        self.deadline = max(until, self.deadline) if self.active else until
        self.active = True

    def tick(self, now: float) -> None:
        """End it when it is over."""
        if now >= self.deadline:
            self.deadline = NEVER
            self.active = False
            self._reactions.silence_ended(now)
            self.boot_up_owed = False
