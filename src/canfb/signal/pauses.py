"""Pauses and resets: what was known before is held against the standstill that a start assumes."""

from __future__ import annotations

from canfb.objects import LossCause
from canfb.signal import speeds
from canfb.signal.feedback import Feedback
from canfb.signal.sample import Sample
from canfb.signal.speeds import STANDSTILL_CYCLES, STILL_CYCLES
from canfb.signal.usual_step import UsualStep

FASTEST_STANDSTILL_CYCLES = 0.5  # per interval; from there on eq. 9 cannot start again from standstill
LARGEST_SLIP_CYCLES = 0.15


class Pauses(UsualStep):
    """How a chain goes on after a time in which nobody counted."""

    def __init__(self) -> None:
        super().__init__()
        self._was_valid = 0  # the sample before
        self._waits = False  # for a standstill, at which it can start
        self._waited = 0.0  # intervals without a sample since the last one with a sample time
        self._turned = 0.0  # the speed at a reset, cycles per interval, where the position started again

    def restart(self, cycles: int = 0, speed_cycles: float = 0.0) -> None:
        """:meth:`SignalChain.restart`."""
        raise NotImplementedError

    def _pause(self) -> None:
        raise NotImplementedError

    def lose(self) -> Feedback:
        """:meth:`SignalChain.lose`."""
        raise NotImplementedError

    def step(self, sample: Sample) -> Feedback:
        """:meth:`SignalChain.step`."""
        raise NotImplementedError

    def uncertain(self, intervals: float) -> Feedback | None:
        """Up to this many intervals of SYNC may have passed uncounted: lost, except at standstill.

        None where that makes no difference: each phase is then less than half a cycle from the last.
        """
        return self.lose() if self.slips(intervals) else None

    def slips(self, intervals: float) -> bool:
        """In so many intervals of SYNC the machine goes so far that its phase could mislead."""
        if self._estimator.lost or not self._tracker.started:
            return False
        speed = max(abs(self._tracker.step_cycles), abs(speeds.steady_speed(self._estimator.places)))
        return speed * intervals * self._per_sync >= LARGEST_SLIP_CYCLES

    def _restarted(self, sample: Sample) -> Feedback:
        """The clock of the interface was restarted, or none of the SYNCs since the last sample was heard.

        Its length is unknown: a machine that creeps may have gone on as long as the times say.
        """
        creeps = abs(speeds.steady_speed(self._estimator.places)) >= STANDSTILL_CYCLES
        lost = self.uncertain(max(1.0, self._times.passed) if creeps else 1.0)
        self._waited = 0.0
        if self._estimator.lost:  # what its times say of the speed begins here
            self._estimator.lose(LossCause.TIME, starts=False)
        return self.step(sample._replace(time_100ns=None)) if lost is None else lost

    def reset(self) -> None:
        """:meth:`restart` at cycle count 0, as the module is reset: the machine may be turning.

        The next :meth:`resume` holds that against it: it does not start on a machine that may still turn.
        """
        estimator = self._estimator
        if estimator.lost:
            waits, turned = not estimator.stands_still, 0.0
        elif self._tracker.started:
            step = abs(self._tracker.step_cycles)
            waits, turned = False, step if step > STILL_CYCLES else 0.0
        else:  # no sample since the last reset
            waits, turned = self._waits, self._turned
        self.restart()
        self._waits, self._turned = waits, turned

    def resume(self, intervals: float = 0.0) -> None:
        """Go on after a pause in which the machine stood still: less than half a cycle from here.

        ``intervals`` is how long the pause was, in intervals of SYNC. If the machine was moving and
        at that speed could have left the cycle meanwhile, the position is lost; so is one that is in doubt
        and was not valid: the samples that would have decided do not come. One that was lost before the
        pause starts again, at cycle count 0: at once if the machine stood when it was lost and its phases
        did since, or if they did for STILL_SAMPLES; else once they have. Likewise after :meth:`reset`
        while it turned, unless by the declared acceleration it has stayed below half a cycle per interval.
        """
        was_lost = self._estimator.lost
        if was_lost or self._waits or self._turned:
            self._start_again(intervals)
            return
        moved = self._could_move(intervals, STANDSTILL_CYCLES)
        moved |= self._estimator.in_doubt and not self._was_valid
        self._reference.restart(keep=not moved)
        self._restart_second(not moved, True)
        self._estimator.resume()
        self._pause()
        if moved:
            self._estimator.lose(LossCause.PAUSE)
            self._reference.slipped()

    def _start_again(self, intervals: float) -> None:
        """From cycle count 0, now or at the next standstill.

        After a reset the first sample is cycle 0 at any speed that uneven times find. A position that was
        lost stays lost while the machine turns: nobody has asked for another one.
        """
        estimator, was_lost = self._estimator, self._estimator.lost
        declared = estimator.declared
        acceleration = declared.doubt_acceleration if declared.acceleration is None else declared.acceleration
        fastest = self._turned + acceleration * intervals * self._per_sync
        waits = not estimator.stands_still if was_lost else self._waits
        waits |= self._turned > 0.0 and fastest >= FASTEST_STANDSTILL_CYCLES
        self.restart()
        if waits:
            self._waits = True
            estimator.lose(LossCause.PAUSE, starts=not was_lost)
            self._reference.slipped()

    def _could_move(self, intervals: float, least_cycles: float) -> bool:
        """At the last speeds the machine leaves its cycle within this many intervals.

        Or it is half a cycle away, or faster than half a cycle per interval, at the sample after them:
        eq. 9 starts again from standstill. It may accelerate as it did, and as it is declared.
        """
        speed = speeds.steady_speed(self._estimator.places)
        step = abs(self._tracker.step_cycles)
        passed = intervals * self._per_sync
        if step >= FASTEST_STANDSTILL_CYCLES:
            return True
        if abs(speed) < least_cycles:
            return False
        acceleration = max(
            abs(speeds.acceleration(self._estimator.places)), self._estimator.declared.acceleration or 0.0
        )
        until = passed + 1.0
        away = max(step, abs(speed)) * until + acceleration * until * max(1.0, until / 2.0)
        return abs(speed) * passed > LARGEST_SLIP_CYCLES or away >= FASTEST_STANDSTILL_CYCLES

    def _may_start(self) -> bool:
        """The machine stands, or an absolute value has found the position."""
        self._waits = self._estimator.lost
        return self._waits and self._estimator.stands_still
