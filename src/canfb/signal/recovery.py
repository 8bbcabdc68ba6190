"""Coasting over bad samples, and the moment when the position counts as lost.

The recursion of eq. 9 never forgets: after one wrong cycle count it runs on with a wrong
speed. So a sample that fails a check never enters it. The position coasts at the last
speed instead, marked as such, and a later good sample is taken only if it meets the
prediction closely, and confirmed by the ones that follow, before the position is valid again.
"""

from __future__ import annotations

from canfb.signal.supervision import COASTING, LOST, RESIDUAL, VALID
from canfb.signal.tracker import Track, Tracker

# A gap of two intervals multiplies the effect of an acceleration by three, so the sample
# that ends a gap must meet the prediction closer than one in the middle of a run.
REACQUIRE_LIMIT = 1.0 / 8.0
CONFIRM_SAMPLES = 2


class Recovery:
    """Feeds a :class:`Tracker` with good samples and bridges the bad ones.

    ``coast_samples`` (2010:03): so many sampling intervals without a good sample are
    bridged; one more, and the position is lost. Lost stays until :meth:`restart`: the
    cycle count then runs on from the phase, but nothing vouches for it.
    """

    __slots__ = ("_bridged", "_unconfirmed", "coast_samples", "lost", "tracker")

    def __init__(self, tracker: Tracker, coast_samples: int) -> None:
        self.tracker = tracker
        self.coast_samples = coast_samples
        self.restart()

    def restart(self, cycles: int = 0) -> None:
        """Start afresh at standstill with this cycle count; the position is not lost any more."""
        self.tracker.restart(cycles)
        self.lost = False
        self._bridged = 0.0  # intervals since the last good sample
        self._unconfirmed = 0

    def resume(self) -> None:
        """Go on at standstill from the last position, or from cycle count 0 if it was lost."""
        if self.lost or not self.tracker.started:
            self.restart()
        else:
            self.tracker.halt()
            self._bridged = 0.0
            self._unconfirmed = 0

    def good(self, phase: float, elapsed: float) -> tuple[Track, int]:
        """A sample that passed its checks: position and status bits VALID, COASTING, LOST, RESIDUAL."""
        settled = elapsed == 1.0 and not (self._bridged or self._unconfirmed or self.lost)
        if settled and (followed := self.tracker.follow(phase)) is not None:
            return followed, VALID
        track = self.tracker.look(phase, elapsed)
        if settled and track.ok:
            self.tracker.accept(track, elapsed)
            return track, VALID
        if self.lost:
            self.tracker.accept(track, elapsed)
            return track, LOST if track.ok else LOST | RESIDUAL
        return self._after_gap(track, elapsed)

    def bad(self, elapsed: float) -> tuple[Track, int]:
        """A sample that failed its checks, or none at all: the predicted position and status bits."""
        predicted = self.tracker.predict(elapsed)
        if not self.tracker.started:  # no position yet: nothing to coast on, nothing to lose
            return predicted, LOST if self.lost else 0
        self._bridged += elapsed
        if not self.lost and self._bridged <= self.coast_samples:
            self.tracker.skip(elapsed)
            return predicted, COASTING
        self.lost = True
        self._bridged = 0.0
        self.tracker.restart(predicted.cycles)
        return predicted, LOST

    def _after_gap(self, track: Track, elapsed: float) -> tuple[Track, int]:
        recovering = self._bridged > 0.0 or self._unconfirmed > 0 or elapsed != 1.0
        limit = min(self.tracker.residual_limit, REACQUIRE_LIMIT) if recovering else 0.0
        if track.residual < limit and self._bridged + elapsed - 1.0 <= self.coast_samples:
            self.tracker.accept(track, elapsed)
            gap = self._bridged > 0.0 or elapsed != 1.0
            self._unconfirmed = CONFIRM_SAMPLES if gap else self._unconfirmed - 1
            self._bridged = 0.0
            return track, COASTING if self._unconfirmed else VALID
        self._unconfirmed = 0
        predicted, bits = self.bad(elapsed)
        return predicted._replace(residual=track.residual), bits | RESIDUAL
