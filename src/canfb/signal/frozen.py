"""A converter that repeats itself: the same counts again and again although the machine moves."""

from __future__ import annotations

STANDSTILL_CYCLES = 0.02  # per interval: below it the same counts are no surprise
SHIFT_CYCLES = 0.01  # the phase should have moved at least so far to make two repeats suspicious
REPEATS = 2


class FrozenInput:
    """Counts repeated pairs of counts.

    At standstill they prove nothing. In motion two repeats in a row are proof when the phase
    should have moved: an acceleration could make one coincide, not two. A machine that moves
    whole cycles per sample shows the same phase each time, and only noise tells that the
    converter lives; then ``frozen_samples`` (2010:04) repeats are wanted. 0: the check is off.
    """

    __slots__ = ("_speed", "frozen_samples", "repeats")

    def __init__(self, frozen_samples: int) -> None:
        self.frozen_samples = frozen_samples
        self.repeats = 0
        self._speed = 0.0

    def moved(self) -> None:
        """The counts are others than before."""
        self.repeats = 0

    def repeated(self, speed_cycles: float) -> bool:
        """The counts are those of the sample before; True if the input is frozen.

        ``speed_cycles`` is the speed of the samples before this one, cycles per interval.
        """
        if self.repeats == 0:
            self._speed = speed_cycles
        self.repeats += 1
        if not self.frozen_samples or abs(self._speed) < STANDSTILL_CYCLES:
            return False
        shift = abs(self._speed - round(self._speed))
        return self.repeats >= (REPEATS if shift > SHIFT_CYCLES else self.frozen_samples)
