"""Pauses and resets: whether the position can continue, or start again, with what was known before.

No cycles are counted in a pause. The position is lost if the machine could have left its cycle, by its speed
and the declared acceleration. After a reset it starts again at cycle count 0, or is lost if the machine may
still turn; another reset ends that if the phases before it were equal.
"""

from __future__ import annotations

from math import inf

from canfb.signal import speeds
from canfb.signal.speeds import SLIP_CYCLES, STILL_CYCLES, STILL_SAMPLES
from canfb.signal.stages import Stages

FASTEST_STANDSTILL_CYCLES = 0.5  # per interval: from this speed on, eq. 9 cannot start from standstill


class Pauses:
    """How ``stages`` continue after a time without counting. Intervals are from sample to sample."""

    def __init__(self, stages: Stages) -> None:
        self._stages, self._estimator = stages, stages.estimator
        # The speed at the last reset, cycles per interval; inf: the position was lost, the machine may turn.
        self.turned = 0.0

    def moves(self, intervals: float, cycles: float) -> bool:
        estimator, tracker = self._estimator, self._estimator.tracker
        if estimator.lost or not tracker.started:
            return False
        speed = max(abs(tracker.step_cycles), abs(speeds.steady_speed(estimator.places)))
        return speed * intervals >= cycles

    @property
    def creeps(self) -> bool:
        return not speeds.stood_still(self._estimator.places, least=0)

    def reset(self) -> None:
        estimator = self._estimator
        if estimator.lost:
            self.turned = 0.0 if estimator.still.samples >= STILL_SAMPLES else inf
        elif estimator.tracker.started:
            step = abs(estimator.tracker.step_cycles)
            self.turned = step if step > STILL_CYCLES else 0.0
        self._stages.restart()

    def resume(self, intervals: float) -> bool:
        """Continue after ``intervals``; True if the position continues, False if it starts again.

        The rules are in :meth:`canfb.signal.chain.SignalChain.resume`.
        """
        if self._estimator.lost or self.turned:
            self._start_again(intervals)
            return False
        self._stages.resume(*self._displacement(intervals))
        return True

    def _start_again(self, intervals: float) -> None:
        """Start at cycle count 0, or be lost.

        After a reset the first sample has cycle count 0, whatever speed uneven times find.
        """
        stages, estimator = self._stages, self._estimator
        if estimator.lost and not estimator.still.stays:
            # At whole cycles per interval, all phases are equal as at standstill.
            stages.resume(inf, starts=False)
            return
        declared = estimator.declared
        acceleration = declared.doubt_acceleration if declared.acceleration is None else declared.acceleration
        fastest = self.turned + acceleration * intervals  # NaN: no acceleration, for an unknown time
        waits = self.turned > 0.0 and not fastest < FASTEST_STANDSTILL_CYCLES
        self.turned = 0.0
        stages.restart()
        if waits:
            stages.lose_after_pause(starts=True)

    def _displacement(self, intervals: float) -> tuple[float, float]:
        """Displacement up to the sample after ``intervals``, and its tolerance, cycles.

        inf if in doubt, if the machine may leave its cycle, or may be half a cycle away or as fast: eq. 9
        starts from standstill. It may accelerate as it did, and as declared.
        """
        estimator, places = self._estimator, self._estimator.places
        speed, step = speeds.steady_speed(places), abs(estimator.tracker.step_cycles)
        if step >= FASTEST_STANDSTILL_CYCLES or (estimator.in_doubt and not self._stages.was_valid):
            return inf, 0.0
        if speeds.stood_still(places, least=0):
            return 0.0, 0.0
        declared, until = estimator.declared.acceleration or 0.0, intervals + 1.0
        longest = until * max(1.0, until / 2.0)
        away = max(step, abs(speed)) * until + max(abs(speeds.acceleration(places)), declared) * longest
        if abs(speed) * intervals > SLIP_CYCLES or not away < FASTEST_STANDSTILL_CYCLES:
            return inf, 0.0
        return speed * until, declared * longest
