"""The zero pulse, once per revolution at the same place: it shows a wrong cycle count, and corrects it.

One pulse may be false: two, whole revolutions apart, give the place of the zero pulse. The pulse is about a
cycle wide, so each direction has a place of its own; until that is known, a pulse of one direction agrees
with one of the other within WIDEST_CYCLES.
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

REMEMBERED = 3  # pulses that are not confirmed
WIDEST_CYCLES = 1  # largest distance of the edges of both directions, rounded to whole cycles


class Pulse(NamedTuple):
    """A zero pulse: the position at its edge, and the time, sampling intervals since the start.

    ``direction`` of the machine there: 1, -1, or 0: not known.
    """

    cycles: int
    phase: float
    direction: int = 1
    time: float = 0.0


class PulseVerdict(Enum):
    """Check of a valid position against the zero pulse."""

    NOTHING = "there is no other pulse of this direction to compare it with"
    AGREES = "the count is right: the pulse is at its place, or where the first one was"
    CONTRADICTS = "the count is wrong, or this pulse is false, or one before it was"
    WRONG = "the count is wrong: an earlier pulse showed the same error"
    SLIPPED = "the pulse is at a place other than that of the first one, twice: either that one was false or \
the count has slipped since"


class ZeroPulse:
    """Finds the place of the zero pulse, and judges pulses that contradict it."""

    def __init__(self, cycles_per_revolution: int) -> None:
        self.cycles_per_revolution = cycles_per_revolution
        self.forget()

    def forget(self) -> None:
        self._places: dict[int, Pulse] = {}  # by direction, from two pulses each
        self.forget_doubts()

    def forget_doubts(self) -> None:
        self._seen: list[Pulse] = []
        self._has_first = True  # the first pulse since then is still among them

    @property
    def referenced(self) -> bool:
        """True once the place of the zero pulse is known in at least one direction."""
        return bool(self._places)

    def set_place(self, pulse: Pulse) -> None:
        self._places[pulse.direction] = pulse
        self.forget_doubts()

    def weigh(self, here: Pulse) -> PulseVerdict:
        """Judge a pulse at this count of a position that was valid up to here."""
        if here.direction in self._places and self.error_cycles(here) == 0:
            self.forget_doubts()
            return PulseVerdict.AGREES
        for number, seen in enumerate(self._seen):
            if self.agree(seen, here):
                return self._confirmed(number, here)
        others = [*self._places.values(), *self._seen]
        agrees = here.direction not in self._places and all(self._is_near(one, here) for one in others)
        if not any(seen.direction == here.direction and self._is_again(seen, here) for seen in self._seen):
            self._seen.append(here)
            if len(self._seen) > REMEMBERED:
                del self._seen[0]
                self._has_first = False
        return PulseVerdict.NOTHING if agrees and self._has_first else PulseVerdict.CONTRADICTS

    def _confirmed(self, number: int, here: Pulse) -> PulseVerdict:
        if here.direction in self._places:
            self.forget_doubts()
            return PulseVerdict.WRONG
        if self._places:  # only in the other direction: this pulse cannot show the error of the count
            if not all(self._is_near(one, here) for one in self._places.values()):
                return PulseVerdict.CONTRADICTS
            self.set_place(here)
            return PulseVerdict.AGREES
        agrees = self._has_first and (number == 0 or self._is_near(self._seen[0], here))
        self.set_place(here)
        return PulseVerdict.AGREES if agrees else PulseVerdict.SLIPPED

    def knows(self, here: Pulse) -> bool:
        return not self._places or here.direction in self._places

    def error_cycles(self, here: Pulse) -> int:
        """Cycles by which the count is too high at this pulse: 0 if it is right, or that is not known."""
        if here.direction in self._places:
            return self._away(self._places[here.direction], here)
        away = [self._away(place, here) for place in self._places.values()]
        return away[0] if away and abs(away[0]) > WIDEST_CYCLES else 0

    def _away(self, place: Pulse, here: Pulse) -> int:
        n = self.cycles_per_revolution
        away = (here.cycles % n + here.phase - (place.cycles % n + place.phase)) % n
        error = round(away)
        return error - n if error > n // 2 else error

    def agree(self, one: Pulse, here: Pulse) -> bool:
        """True if the pulses are one or more whole revolutions apart, in one direction."""
        return one.direction == here.direction and self._is_near(one, here) and not self._is_again(one, here)

    def _is_near(self, place: Pulse, here: Pulse) -> bool:
        widest = 0 if place.direction == here.direction else WIDEST_CYCLES
        return abs(self._away(place, here)) <= widest

    def _is_again(self, seen: Pulse, here: Pulse) -> bool:
        away = (here.cycles - seen.cycles) + (here.phase - seen.phase)
        return abs(away) <= self.cycles_per_revolution / 2.0 and self._is_near(seen, here)
