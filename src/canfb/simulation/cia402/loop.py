"""The position demand from SYNC to SYNC, and the position loop that follows it.

The loop: proportional position controller, PI velocity controller, feed-forward, limits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


class Trajectory:
    """Position demand with its speed: straight lines between targets (cyclic synchronous position)."""

    def __init__(self) -> None:
        self.place(0.0)

    def place(self, position: float, speed: float = 0.0) -> None:
        self.position, self.speed = position, speed
        self.drop_target()

    def drop_target(self) -> None:
        self._target, self._left = 0.0, 0

    def set_target(self, position: float, syncs: int) -> None:
        self._target, self._left = position, syncs

    def advance(self, period_s: float) -> None:
        before, left = self.position, self._left
        if left:
            self.position = self._target if left == 1 else before + (self._target - before) / left
            self._left -= 1
        self.speed = (self.position - before) / period_s

    def brake(self, deceleration: float, period_s: float) -> bool:
        before = self.speed
        self.speed = math.copysign(max(0.0, abs(before) - deceleration * period_s), before)
        if self.speed == 0.0:
            # What is left of the speed ends within the period.
            self.position += before * abs(before) / (2.0 * deceleration) if deceleration > 0.0 else 0.0
        else:
            self.position += (before + self.speed) / 2.0 * period_s
        return self.speed == 0.0


VELOCITY_BANDWIDTH = 0.2  # of 1 / period: what the delays of sampling, torque and difference leave
POSITION_BANDWIDTH = 0.25  # of that of the velocity loop
INTEGRAL_PERIODS = 40.0
BRAKING_SHARE = 0.7  # of the torque, for coming down to a target that is far away


@dataclass(frozen=True)
class Gains:
    """Gains of the loop: ``position`` in 1/s, ``velocity`` in Nm s/rad, ``integral_s``, feed-forward 0..1."""

    position: float
    velocity: float
    integral_s: float
    velocity_forward: float
    acceleration_forward: float
    inertia_kg_m2: float


def chosen_gains(gains: Gains, period_s: float) -> Gains:
    """The gains with those that are 0 chosen from the inertia and the time between two positions."""
    bandwidth = VELOCITY_BANDWIDTH / period_s
    return Gains(
        gains.position or POSITION_BANDWIDTH * bandwidth,
        gains.velocity or gains.inertia_kg_m2 * bandwidth,
        gains.integral_s or INTEGRAL_PERIODS * period_s,
        gains.velocity_forward,
        gains.acceleration_forward,
        gains.inertia_kg_m2,
    )


@dataclass(frozen=True)
class Demand:
    """Where the shaft is to be: revolutions, rad/s, rad/s^2."""

    revolutions: float
    speed_rad_s: float = 0.0
    acceleration_rad_s2: float = 0.0


class PositionLoop:
    """From demand and position to the torque."""

    def __init__(self) -> None:
        self._integral_nm = 0.0
        self.limited = False
        """Whether the torque or the speed was limited in the last step."""

    def reset(self) -> None:
        self._integral_nm = 0.0
        self.limited = False

    def step(
        self,
        demand: Demand,
        revolutions: float,
        speed_rad_s: float,
        gains: Gains,
        *,
        period_s: float,
        torque_limit_nm: float,
        speed_limit_rad_s: float,
    ) -> float:
        """The torque in Nm, for one position. The gains are all chosen, the period is more than 0 s."""
        error = 2.0 * math.pi * (demand.revolutions - revolutions)
        braking = BRAKING_SHARE * torque_limit_nm / gains.inertia_kg_m2
        requested = gains.velocity_forward * demand.speed_rad_s + approach(error, gains.position, braking)
        speed = max(-speed_limit_rad_s, min(speed_limit_rad_s, requested))
        deviation = speed - speed_rad_s
        forward = gains.acceleration_forward * gains.inertia_kg_m2 * demand.acceleration_rad_s2
        proportional = gains.velocity * deviation
        unlimited = proportional + self._integral_nm + forward
        torque = max(-torque_limit_nm, min(torque_limit_nm, unlimited))
        self.limited = torque != unlimited or speed != requested
        if torque == unlimited or deviation * unlimited < 0.0:  # never further into the limit
            self._integral_nm += proportional * period_s / gains.integral_s
            self._integral_nm = max(-torque_limit_nm, min(torque_limit_nm, self._integral_nm))
        return torque


def approach(error: float, gain: float, braking: float) -> float:
    """``gain`` times the ``error`` (rad), but no faster than the motor brakes (``braking``, rad/s^2), by a
    square root.
    """
    near = braking / (gain * gain)
    if abs(error) <= near:
        return gain * error
    return math.copysign(math.sqrt(2.0 * braking * (abs(error) - near / 2.0)), error)
