"""When the speeds of a machine are followed, and what they say of a sample."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum

from canfb.signal.bounded_motion import BoundedMotion
from canfb.signal.limits import Declared
from canfb.signal.speed_hypotheses import Found, SpeedHypotheses, longest_decidable_row
from canfb.signal.speeds import Place

# At q = 0.7 a second difference is below TELLING with a probability of 0.43, below SILENT with 0.11. So times
# that tell pass for others in one of 10^5 starts, the second differences of as many samples taken together.
LEAST_SAMPLES = 8  # before they count as even: 0.11^6
UNDECIDED_SAMPLES = 16  # before they count as deciding nothing: 0.43^14
EVEN = 2e-4  # of the interval: drift of two crystals
START_SAMPLES = 8  # at q >= 1 uneven times contradict a wrong speed at a start by sample 5 in 95 %
MOST_WAITING = 64  # samples after a start: at q = 0.4 a wrong speed has gone after 12 to 40


class SpeedVerdict(Enum):
    """What the speeds that are left say of a sample."""

    UNKNOWN = "nothing: the times are even, or all has been said"
    OPEN = "the times are about to tell the speed"
    FALSE_START = "the machine did not start at the speed that was assumed"


class Starts:
    """When the speeds are followed: from a start on whose times are uneven, and while the position is lost.

    ``origin`` is the cycle count of the first sample, None where the count is not known.
    """

    def __init__(self, origin: int | None = None) -> None:
        self.origin = origin
        self.active: SpeedHypotheses | None = None
        self._tried = False
        self._is_declared = self._may_be_uneven = self._acceleration_waits = False
        self._unit = 1.0  # that of the speeds, in intervals as they are counted now

    def rescale(self, factor: float) -> None:
        self._unit *= factor

    def stop(self) -> None:
        """Whatever comes, these speeds are not followed any more."""
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
        """Is the next sample to be held against them? ``places`` are the samples of a start that is
        assumed, ``missed`` the intervals since the last of them.

        The first one of ``timed`` samples may be the unit of all others, and even by definition: it shows
        nothing then.
        """
        largest = declared.usual.largest
        if self.active is not None:  # the limit is in the unit of now, and the search in that of its begin
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
        """A sample; ``count`` is that of the speed assumed, None where it is in doubt.

        The last two samples at the speed of a position that was lost, once it is found.
        """
        speeds = self.active
        if speeds is None or not speeds.feed(phase, elapsed / self._unit):
            self.active = self.origin = None  # what is counted from here on lacks the way up to here
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
        # Without a declared acceleration q is small, and a healthy start would wait for nothing.
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
