"""When the possible speeds of a machine are followed, and what they show of a sample."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum

from canfb.signal.bounded_motion import BoundedMotion
from canfb.signal.limits import Declared
from canfb.signal.speed_hypotheses import Found, SpeedHypotheses, longest_decidable_row
from canfb.signal.speeds import Place

# At q = 0.7 a second difference of the times is below TELLING with probability 0.43, and below SILENT with
# 0.11. All of the first n - 2 are so by chance in about one of 10^5 starts.
LEAST_SAMPLES = 8  # until times count as even: 0.11^6
UNDECIDED_SAMPLES = 16  # until times count as not deciding: 0.43^14
EVEN = 2e-4  # relative difference of even intervals: drift of two crystals
START_SAMPLES = 8  # at q >= 1, uneven times contradict a wrong speed by sample 5 in 95 % of all starts
MOST_WAITING = 64  # samples after a start: at q = 0.4, a wrong speed is excluded after 12 to 40


class SpeedVerdict(Enum):
    """What the speeds left show of a sample."""

    UNKNOWN = "nothing: the times are even, or all has been said"
    OPEN = "the times are about to tell the speed"
    FALSE_START = "the machine did not start at the speed that was assumed"


class Starts:
    """Follows the speeds after a start with uneven times, and while the position is lost.

    ``origin`` is the cycle count of the first sample, None if the count is not known.
    """

    def __init__(self, origin: int | None = None) -> None:
        self.origin = origin
        self.active: SpeedHypotheses | None = None
        self._tried = False
        self._is_declared = self._may_be_uneven = self._acceleration_waits = False
        self._unit = 1.0  # unit of the speeds that are followed, in present intervals

    def rescale(self, factor: float) -> None:
        self._unit *= factor

    def stop(self) -> None:
        """Do not follow these speeds any more."""
        self.active, self._tried = None, True

    def skip(self, elapsed: float) -> None:
        if self.active is not None:
            self.active.skip(elapsed / self._unit)

    def begin(
        self,
        declared: Declared,
        timed: bool,
        elapsed: float,
        lost: bool,
        places: Sequence[Place],
        missed: float,
    ) -> bool:
        """True if the next sample is to be checked by the speeds. ``places`` are the samples of a start at an
        assumed speed, ``missed`` the intervals since the last of them.

        The first interval of ``timed`` samples may define the unit: that it is even shows nothing.
        """
        largest = declared.usual.largest
        if self.active is not None:  # `largest` is in present intervals, the search in those of its begin
            unit = self._unit
            self.active.motion = BoundedMotion(
                largest * unit * unit, declared.phase_error, declared.instant_error / unit
            )
            if self._acceleration_waits and self.active.samples == 1:
                self.active.expect_bad(_row(declared, largest))
            return True
        if self._tried:
            return False
        self._acceleration_waits = declared.acceleration_waits
        self._is_declared = declared.acceleration is not None or declared.acceleration_waits
        self._may_be_uneven = timed and self._is_declared
        even = abs(elapsed - 1.0) <= EVEN + 4.0 * declared.instant_error
        if self.origin is None and even and (lost or not self._may_be_uneven):
            return False
        if not (lost or places):
            return False
        motion = BoundedMotion(largest, declared.phase_error, declared.instant_error)
        self.active = speeds = SpeedHypotheses(motion, _row(declared, largest))
        self._unit = 1.0
        if places:
            self.origin = places[0][0]
        for _, phase, elapsed in places:
            speeds.feed(phase, elapsed)
        speeds.skip(missed)
        return True

    def take(self, phase: float, elapsed: float, lost: bool, count: int | None) -> SpeedVerdict | Found:
        """Check a sample by the speeds; ``count`` is that of the assumed speed, None if in doubt.

        Found: the last two samples, once the speed of a lost position is known.
        """
        speeds = self.active
        if speeds is None or not speeds.feed(phase, elapsed / self._unit):
            self.active = self.origin = None  # a later search does not know the cycles up to here
            self._tried |= speeds is None or bool(speeds.left)
            return SpeedVerdict.UNKNOWN
        if lost:
            return self._of_lost(speeds)
        if count is None:
            return SpeedVerdict.OPEN
        if self.origin is not None and not (holds := speeds.holds(count - self.origin)):
            return SpeedVerdict.OPEN if holds is None else SpeedVerdict.FALSE_START
        even = speeds.samples >= LEAST_SAMPLES and speeds.silent
        most = MOST_WAITING if speeds.telling else UNDECIDED_SAMPLES
        if speeds.is_decided or even or speeds.samples > most:
            self.stop()
            return SpeedVerdict.UNKNOWN
        # Without a declared acceleration q is small, and a start would be delayed in vain.
        known = speeds.silent and (speeds.samples >= LEAST_SAMPLES or not self._may_be_uneven)
        waits = self._is_declared and not known
        return SpeedVerdict.OPEN if waits else SpeedVerdict.UNKNOWN

    def _of_lost(self, speeds: SpeedHypotheses) -> SpeedVerdict | Found:
        found = speeds.found
        if found is not None:
            self.stop()
            return found._replace(elapsed=found.elapsed * self._unit)
        if speeds.samples > UNDECIDED_SAMPLES and not speeds.telling:
            self.active, self.origin = None, None
        return SpeedVerdict.UNKNOWN


def _row(declared: Declared, largest: float) -> int:
    return declared.bad or min(declared.bad_samples, longest_decidable_row(largest, declared.phase_error))
