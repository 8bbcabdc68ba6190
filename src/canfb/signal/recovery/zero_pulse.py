"""The zero pulse, once per revolution at the same place: it shows a wrong cycle count, and sets it right.

One pulse may be false. So nothing depends on a single one: two of them, whole revolutions apart,
say where the pulse is, and two agree on how many cycles the count is wrong.
"""

from __future__ import annotations

from enum import Enum

REMEMBERED = 3  # pulses that nothing has confirmed


class PulseVerdict(Enum):
    """Check of a valid position against the zero pulse."""

    NOTHING = "there is no other pulse to compare it with"
    AGREES = "the count is right: the pulse is at its place, or where the first one was"
    CONTRADICTS = "the count is wrong, or this pulse is false, or one before it was"
    WRONG = "the count is wrong: an earlier pulse showed the same error"
    SLIPPED = "the pulse is at a place other than that of the first one, twice: either that one was false or \
the count has slipped since"


class ZeroPulse:
    """Knows at which cycle of the revolution the zero pulse comes, and weighs pulses that contradict it."""

    def __init__(self, cycles_per_revolution: int) -> None:
        self.cycles_per_revolution = cycles_per_revolution
        self.forget()

    def forget(self) -> None:
        """Forget where the zero pulse is."""
        self._place: float | None = None  # cycles from cycle count 0, modulo a revolution
        self.forget_doubts()

    def forget_doubts(self) -> None:
        """Forget the pulses that nothing has confirmed."""
        self._seen: list[tuple[int, float]] = []
        self._has_first = True  # the first of them is still there

    @property
    def referenced(self) -> bool:
        """True once the place of the zero pulse is known."""
        return self._place is not None

    def set_place(self, pulse_cycles: int, pulse_phase: float) -> None:
        """Take the pulse at this position for where it is."""
        self._place = pulse_cycles % self.cycles_per_revolution + pulse_phase
        self.forget_doubts()

    def weigh(self, pulse_cycles: int, pulse_phase: float) -> PulseVerdict:
        """Take a pulse of a position that was valid up to here, seen at this count."""
        if self.referenced and self.error_cycles(pulse_cycles, pulse_phase) == 0:
            self.forget_doubts()
            return PulseVerdict.AGREES
        here = pulse_cycles, pulse_phase
        for number, seen in enumerate(self._seen):
            if self._is_turns_from(seen, here):
                return self._confirmed(number, here)
        if not any(self._is_again(seen, here) for seen in self._seen):
            self._seen.append(here)
            if len(self._seen) > REMEMBERED:
                del self._seen[0]
                self._has_first = False
        is_first = not self.referenced and self._has_first and len(self._seen) == 1
        return PulseVerdict.NOTHING if is_first else PulseVerdict.CONTRADICTS

    def _confirmed(self, number: int, here: tuple[int, float]) -> PulseVerdict:
        is_first = number == 0 and self._has_first
        if self.referenced:
            self.forget_doubts()
            return PulseVerdict.WRONG
        self.set_place(*here)
        return PulseVerdict.AGREES if is_first else PulseVerdict.SLIPPED

    def error_cycles(self, pulse_cycles: int, pulse_phase: float) -> int:
        """How many cycles the count is too high at a pulse seen at this position: 0 if all is well.

        A pulse is as wide as a cycle, so less than half a cycle is not an error.
        """
        return 0 if self._place is None else self._away(pulse_cycles, pulse_phase, self._place)

    def _away(self, cycles: int, phase: float, place: float) -> int:
        n = self.cycles_per_revolution
        away = (cycles % n + phase - place) % n
        error = round(away)
        return error - n if error > n // 2 else error

    def _is_same(self, seen: tuple[int, float], here: tuple[int, float]) -> bool:
        return self._away(*here, seen[0] % self.cycles_per_revolution + seen[1]) == 0

    def _is_again(self, seen: tuple[int, float], here: tuple[int, float]) -> bool:
        away = (here[0] - seen[0]) + (here[1] - seen[1])
        return abs(away) <= self.cycles_per_revolution / 2.0 and self._is_same(seen, here)

    def _is_turns_from(self, seen: tuple[int, float], here: tuple[int, float]) -> bool:
        """Whole revolutions away, at least one: a false pulse may come again and again while it rests."""
        return self._is_same(seen, here) and not self._is_again(seen, here)
