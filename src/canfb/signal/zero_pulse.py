"""The zero pulse, once per revolution at the same place: it sets the cycle count right."""

from __future__ import annotations


class ZeroPulse:
    """Knows at which cycle of the revolution the zero pulse comes.

    The first pulse of a valid position says where; each later one must come a whole number
    of revolutions from it, else the cycle count is wrong by the difference.
    """

    def __init__(self, cycles_per_revolution: int) -> None:
        self.cycles_per_revolution = cycles_per_revolution
        self.forget()

    def forget(self) -> None:
        """Forget where the zero pulse is."""
        self._place: float | None = None  # cycles from cycle count 0, modulo a revolution

    @property
    def referenced(self) -> bool:
        """True once a zero pulse was seen."""
        return self._place is not None

    def set_place(self, pulse_cycles: int, pulse_phase: float) -> None:
        """Take the pulse at this position for where it is."""
        self._place = pulse_cycles % self.cycles_per_revolution + pulse_phase

    def error_cycles(self, pulse_cycles: int, pulse_phase: float) -> int:
        """How many cycles the count is too high at a pulse seen at this position: 0 if all is well.

        A pulse is as wide as a cycle, so less than half a cycle is no error.
        """
        if self._place is None:
            return 0
        n = self.cycles_per_revolution
        away = (pulse_cycles % n + pulse_phase - self._place) % n
        error = round(away)
        return error - n if error > n // 2 else error
