"""What the position demand does from one SYNC to the next: units of position, seconds, their quotients."""

from __future__ import annotations

import math


class Trajectory:
    """Position demand with speed; the motions below move it on by one period at a time."""

    def __init__(self) -> None:
        self.position = 0.0
        self.speed = 0.0

    def place(self, position: float, speed: float = 0.0) -> None:
        """Begin here."""
        self.position = position
        self.speed = speed

    def hold(self) -> None:
        """Stand still."""
        self.speed = 0.0

    def brake(self, deceleration: float, period_s: float) -> bool:
        """Slow down; True when it stands still."""
        before = self.speed
        self.speed = math.copysign(max(0.0, abs(before) - deceleration * period_s), before)
        if self.speed == 0.0:
            # What is left of the speed ends within the period.
            self.position += before * abs(before) / (2.0 * deceleration) if deceleration > 0.0 else 0.0
        else:
            self.position += (before + self.speed) / 2.0 * period_s
        return self.speed == 0.0

    def profile(
        self, target: float, velocity: float, acceleration: float, deceleration: float, period_s: float
    ) -> bool:
        """One period of a trapezoid towards the target, from any speed; True when it is there."""
        distance = target - self.position
        side = -1.0 if distance < 0.0 or (distance == 0.0 and self.speed > 0.0) else 1.0
        ahead, speed = side * distance, side * self.speed
        if ahead <= deceleration * period_s**2 and abs(speed) <= 2.0 * deceleration * period_s:
            self.place(target)
            return True
        following = self._next_speed(ahead, speed, velocity, acceleration, deceleration, period_s)
        self.position += side * (speed + following) / 2.0 * period_s
        self.speed = side * following
        return False

    @staticmethod
    def _next_speed(
        ahead: float, speed: float, velocity: float, acceleration: float, deceleration: float, period_s: float
    ) -> float:
        """Speed at the end of the period, from which braking ends at the target or is possible at all."""
        slower = deceleration * period_s
        if speed < 0.0:  # the wrong way
            return min(0.0, speed + slower)
        half = slower / 2.0
        room = half * half + 2.0 * deceleration * (ahead - speed * period_s / 2.0)
        stopping = math.sqrt(room) - half if room > 0.0 else 0.0
        following = min(speed + acceleration * period_s, velocity, stopping)
        return max(following, speed - slower, 0.0)


class Interpolation:
    """Cyclic synchronous position: a straight line from target to target, over this many SYNCs."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """There is no target yet."""
        self._left = 0
        self._target = 0.0

    def set_target(self, position: float, syncs: int) -> None:
        """A new target, to be reached in ``syncs`` SYNCs, 1 or more."""
        self._target = position
        self._left = syncs

    def advance(self, trajectory: Trajectory, period_s: float) -> None:
        """One SYNC."""
        if not self._left:
            trajectory.hold()
            return
        before = trajectory.position
        trajectory.position = (
            self._target if self._left == 1 else before + (self._target - before) / self._left
        )
        self._left -= 1
        trajectory.speed = (trajectory.position - before) / period_s
