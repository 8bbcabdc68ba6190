"""A motor with its shaft: inertia, viscous and Coulomb friction, a load, a holding brake."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from canfb.checks import number_in

LONGEST_STEP_S = 1e-4
LONG_S = 0.1
REMEMBERED_STEPS = 256  # where an encoder may still look back to
SETTLED = 50.0  # time constants after which the torque is its command, to the last digit


@dataclass(frozen=True, kw_only=True)
class MotorConfig:
    """What turns. The encoder sits on the shaft of the motor; there is no gear.

    inertia_kg_m2            moment of inertia of motor and load, 1e-9..1e6
    viscous_friction_nm_s    friction torque for each rad/s, 0..1e6 Nm s/rad
    coulomb_friction_nm      friction torque at any speed, and what holds at standstill, 0..1e6 Nm
    rated_torque_nm          1000 per mille of 6072h and 6077h (6076h), 0.001..1e6 Nm
    torque_time_constant_s   of the current loop: the torque follows its command so fast, 0..1 s
    load_torque_nm           what pulls at the shaft from ``load_at_s`` on, -1e6..1e6 Nm, positive
                             against positive motion
    load_at_s                time of the machine, 0..1e9 s
    brake_torque_nm          of the holding brake, closed without power, 0..1e6 Nm; 0 = none, it coasts
    """

    inertia_kg_m2: float = 1e-3
    viscous_friction_nm_s: float = 1e-4
    coulomb_friction_nm: float = 0.01
    rated_torque_nm: float = 0.5
    torque_time_constant_s: float = 0.0005
    load_torque_nm: float = 0.0
    load_at_s: float = 0.0
    brake_torque_nm: float = 0.0

    def __post_init__(self) -> None:
        number_in("inertia_kg_m2", self.inertia_kg_m2, 1e-9, 1e6)
        number_in("viscous_friction_nm_s", self.viscous_friction_nm_s, 0.0, 1e6)
        number_in("coulomb_friction_nm", self.coulomb_friction_nm, 0.0, 1e6)
        number_in("rated_torque_nm", self.rated_torque_nm, 0.001, 1e6)
        number_in("torque_time_constant_s", self.torque_time_constant_s, 0.0, 1.0)
        number_in("load_torque_nm", self.load_torque_nm, -1e6, 1e6)
        number_in("load_at_s", self.load_at_s, 0.0, 1e9)
        number_in("brake_torque_nm", self.brake_torque_nm, 0.0, 1e6)


class Motor:
    """The motion of the shaft, integrated in steps of 0.1 ms at most.

    Within a step the torques are constant and the motion is exact: an exponential with viscous friction,
    standstill where friction holds the shaft. ``time_s`` is the time of the machine; ``revolutions``,
    ``speed_rad_s`` and ``torque_nm`` are those of the shaft at that time.
    """

    def __init__(self, config: MotorConfig, revolutions: float = 0.0) -> None:
        self.config = config
        self.time_s = 0.0
        self.revolutions = revolutions
        self.speed_rad_s = 0.0
        self.torque_nm = 0.0
        self.command_nm = 0.0
        self.braked = True
        self._steps: deque[tuple[float, float, float]] = deque(maxlen=REMEMBERED_STEPS)

    @property
    def load_nm(self) -> float:
        """What pulls at the shaft now."""
        return self.config.load_torque_nm if self.time_s >= self.config.load_at_s else 0.0

    def revolutions_before(self, seconds: float) -> float:
        """Position this many seconds ago, or, negative, ahead: then at the present speed, for a short time.

        Between the steps of the motion a cubic that has their positions and speeds; before the remembered
        ones, which are the last tenths of milliseconds, at the speed of the oldest.
        """
        wanted_s, after = self.time_s - seconds, (self.time_s, self.revolutions, self.speed_rad_s)
        if seconds > 0.0:
            for before in reversed(self._steps):
                if before[0] <= wanted_s:
                    return _cubic(before, after, wanted_s)
                after = before
        at_s, revolutions, speed_rad_s = after
        return revolutions - speed_rad_s * (at_s - wanted_s) / (2.0 * math.pi)

    def run(self, duration_s: float) -> None:
        """Let this many seconds pass, 0 or more; ValueError for a time that goes back."""
        if not 0.0 <= duration_s < math.inf:
            raise ValueError(f"duration_s must be 0 or more seconds, not {duration_s!r}")
        if duration_s == 0.0:
            return
        left_s = duration_s - max(LONG_S, SETTLED * self.config.torque_time_constant_s)
        if left_s > 0.0 and not self.time_s < self.config.load_at_s < self.time_s + duration_s:
            # A long pause: once the torque has settled nothing changes, and one step is as exact as many.
            self.run(duration_s - left_s)
            self._step(left_s)
            return
        steps = math.ceil(duration_s / LONGEST_STEP_S * (1.0 - 1e-9))
        step_s, end_s = duration_s / steps, self.time_s + duration_s
        for _ in range(steps):
            self._step(step_s)
        self.time_s = end_s

    def _step(self, step_s: float) -> None:
        self._steps.append((self.time_s, self.revolutions, self.speed_rad_s))
        lag = self.config.torque_time_constant_s
        change = self.command_nm - self.torque_nm
        # The mean over the step drives the shaft: the torque itself may settle much faster than a step.
        kept = math.exp(-step_s / lag) if lag > 0.0 else 0.0
        mean = self.command_nm - change * (lag / step_s * (1.0 - kept) if lag > 0.0 else 0.0)
        self.torque_nm = self.command_nm - change * kept
        self._move(mean - self.load_nm, step_s)
        self.time_s += step_s

    def _move(self, torque_nm: float, step_s: float) -> None:
        """The shaft under this torque, until it stands still or the step is over."""
        friction = self.config.coulomb_friction_nm + (self.config.brake_torque_nm if self.braked else 0.0)
        if self.speed_rad_s == 0.0:
            if abs(torque_nm) <= friction:
                return
            self._accelerate(torque_nm - math.copysign(friction, torque_nm), step_s)
            return
        net = torque_nm - math.copysign(friction, self.speed_rad_s)
        stop_s = self._time_to_stop(net)
        if stop_s >= step_s:
            self._accelerate(net, step_s)
            return
        self._accelerate(net, stop_s)
        self.speed_rad_s = 0.0
        self._move(torque_nm, step_s - stop_s)

    def _time_to_stop(self, net_nm: float) -> float:
        """When the speed is 0 under this torque, in seconds; infinite if it never is."""
        speed, viscous, inertia = (
            self.speed_rad_s,
            self.config.viscous_friction_nm_s,
            self.config.inertia_kg_m2,
        )
        if net_nm * speed >= 0.0:
            return math.inf
        if viscous == 0.0:
            return -speed * inertia / net_nm
        return inertia / viscous * math.log1p(-speed * viscous / net_nm)

    def _accelerate(self, net_nm: float, time_s: float) -> None:
        """J dw/dt = net - b w, solved; the angle is its integral."""
        viscous, inertia, speed = (
            self.config.viscous_friction_nm_s,
            self.config.inertia_kg_m2,
            self.speed_rad_s,
        )
        if viscous * time_s < 1e-6 * inertia:  # the exponential would lose digits that this line has
            self.speed_rad_s = speed + (net_nm - viscous * speed) / inertia * time_s
            angle = (speed + self.speed_rad_s) / 2.0 * time_s
        else:
            decay = -math.expm1(-viscous / inertia * time_s)
            self.speed_rad_s = speed + (net_nm / viscous - speed) * decay
            angle = (net_nm * time_s - inertia * (self.speed_rad_s - speed)) / viscous
        self.revolutions += angle / (2.0 * math.pi)


def _cubic(before: tuple[float, float, float], after: tuple[float, float, float], at_s: float) -> float:
    """Revolutions between two moments (time s, revolutions, rad/s), by Hermite's cubic."""
    (from_s, start, start_rad_s), (to_s, end, end_rad_s) = before, after
    step_s = to_s - from_s
    if step_s <= 0.0:
        return end
    part = (at_s - from_s) / step_s
    rest = 1.0 - part
    blend = part * part * (3.0 - 2.0 * part)
    bent = part * rest * (rest * start_rad_s - part * end_rad_s) * step_s / (2.0 * math.pi)
    return start + (end - start) * blend + bent
