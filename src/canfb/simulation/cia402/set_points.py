"""Set-points of the profile position mode: the handshake of controlword bit 4 and statusword bit 12."""

from __future__ import annotations

from canfb.simulation.cia402.state_machine import Control


class SetPoints:
    """The active target and one that waits for it to be reached.

    A rising edge of bit 4 brings a new set-point: at once with bit 5, or when none is active, else it
    waits. It is acknowledged (statusword bit 12) when it is taken, until bit 4 is 0 again and there is
    room for another.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """No set-point."""
        self.active: float | None = None
        self._waiting: float | None = None
        self._requested = False
        self.acknowledged = False

    def control(self, controlword: int, value: float, from_position: float) -> bool:
        """Take the ``controlword`` with target ``value`` (units); True if the active target has changed.

        Bit 6: the value is relative to the last target, or to ``from_position`` where there is none.
        """
        requested = bool(controlword & Control.NEW_SET_POINT)
        rising, self._requested = requested and not self._requested, requested
        changed = False
        if rising and not self.acknowledged:
            changed = self._take(controlword, value, from_position)
        elif not requested:
            self.acknowledged = self._waiting is not None
        return changed

    def reached(self) -> bool:
        """The active target is reached; True if another one follows."""
        self.active, self._waiting = self._waiting, None
        if not self._requested:
            self.acknowledged = False
        return self.active is not None

    def _take(self, controlword: int, value: float, from_position: float) -> bool:
        last = self._waiting if self._waiting is not None else self.active
        base = from_position if last is None else last
        target = base + value if controlword & Control.RELATIVE else value
        self.acknowledged = True
        if controlword & Control.CHANGE_IMMEDIATELY or self.active is None:
            self.active, self._waiting = target, None
            return True
        self._waiting = target
        return False
