"""The motion of the drive: units, position demand, their objects, and the position loop.

The loop: proportional position controller, PI velocity controller, feed-forward, limits.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from canfb.device.od.dictionary import Dictionary, refuse_if
from canfb.module.cia406.position import saturated
from canfb.simulation.cia402.feedback_input import FeedbackInput
from canfb.simulation.cia402.state_machine import Status


class Trajectory:
    """Position demand with its speed: straight lines between targets (cyclic synchronous position)."""

    def __init__(self, position: float = 0.0, speed: float = 0.0) -> None:
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

    def brake(self, deceleration: float, period_s: float) -> None:
        before = self.speed
        self.speed = math.copysign(max(0.0, abs(before) - deceleration * period_s), before)
        if self.speed == 0.0:
            # The shaft stops within the period, after before^2 / (2 deceleration).
            self.position += before * abs(before) / (2.0 * deceleration) if deceleration > 0.0 else 0.0
        else:
            self.position += (before + self.speed) / 2.0 * period_s


VELOCITY_BANDWIDTH = 0.2  # times 1 / period, limited by the delays of sampling, torque and differentiation
POSITION_BANDWIDTH = 0.25  # times the bandwidth of the velocity loop
INTEGRAL_PERIODS = 40.0
BRAKING_SHARE = 0.7  # part of the largest torque that is used to brake towards a distant target


@dataclass(frozen=True)
class Gains:
    """Gains of the loop: ``position`` in 1/s, ``velocity`` in Nm s/rad, ``integral_s``, feed-forward 0..1."""

    position: float
    velocity: float
    integral_s: float
    velocity_forward: float
    acceleration_forward: float
    inertia_kg_m2: float


def chosen_gains(
    position: float,
    velocity: float,
    integral_s: float,
    velocity_forward: float,
    inertia_g_cm2: float,
    acceleration_forward: float,
    *,
    period_s: float,
) -> Gains:
    """The gains of 2100h; zeros are replaced by values from inertia and time between two positions."""
    bandwidth, inertia_kg_m2 = VELOCITY_BANDWIDTH / period_s, inertia_g_cm2 * KG_M2_PER_G_CM2
    return Gains(
        position or POSITION_BANDWIDTH * bandwidth,
        velocity or inertia_kg_m2 * bandwidth,
        integral_s or INTEGRAL_PERIODS * period_s,
        velocity_forward,
        acceleration_forward,
        inertia_kg_m2,
    )


@dataclass(frozen=True)
class Demand:
    """Set-point of the shaft: revolutions, rad/s, rad/s^2."""

    revolutions: float
    speed_rad_s: float = 0.0
    acceleration_rad_s2: float = 0.0


class PositionLoop:
    """Computes the torque from demand and position."""

    def __init__(self) -> None:
        self._integral_nm = 0.0
        self.limited = False  # whether the last step limited torque or speed

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
        """The torque in Nm for one position. ``gains`` as of :func:`chosen_gains`, ``period_s`` > 0."""
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
        if torque == unlimited or deviation * unlimited < 0.0:  # anti-windup: not further into the limit
            self._integral_nm += proportional * period_s / gains.integral_s
            self._integral_nm = max(-torque_limit_nm, min(torque_limit_nm, self._integral_nm))
        return torque


def approach(error: float, gain: float, braking: float) -> float:
    """Speed towards the target, rad/s: ``gain`` x ``error`` (rad), and for large errors the square root from
    which the motor can brake at ``braking`` (rad/s^2).
    """
    near = braking / (gain * gain)
    if abs(error) <= near:
        return gain * error
    return math.copysign(math.sqrt(2.0 * braking * (abs(error) - near / 2.0)), error)


CYCLIC_SYNCHRONOUS_POSITION = 8
OFF = 0xFFFFFFFF  # 6065h: following error not supervised.
KG_M2_PER_G_CM2 = 1e-7
STANDSTILL_REV_S = 0.02


class Axis:
    """Computes while the drive has power: :meth:`advance` at each SYNC, :meth:`control` with each position.

    Positions are in units of 608Fh and unbounded; the objects show them modulo 2^32, as INTEGER32. A target
    means the position nearest to the demand that has this value.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        feedback: FeedbackInput,
        motor_increments: int,
        on_mode: Callable[[], None],
    ) -> None:
        self.scaling = Scaling(dictionary)
        self._feedback = feedback
        self._loop, self._trajectory = PositionLoop(), Trajectory()
        # Increments per revolution of an encoder on the motor, then shown in 6063h; 0: no such encoder.
        self._motor_increments = motor_increments
        self._on_mode = on_mode  # Called after 6060h is written.
        entry = dictionary.entry
        self._target, self._mode, self._display = entry(0x607A), entry(0x6060), entry(0x6061)
        self._lowest, self._highest = entry(0x607D, 1), entry(0x607D, 2)
        self._deceleration = entry(0x6085)
        self._gains = [entry(0x2100, sub) for sub in range(1, 7)]
        self._demand_entry, self._torque_demand = entry(0x6062), entry(0x6074)
        self._internal, self._actual, self._speed = entry(0x6063), entry(0x6064), entry(0x606C)
        self._error_entry = entry(0x60F4)
        self._error_window, self._error_time = entry(0x6065), entry(0x6066)
        self._target.on_written = self._target_written
        self._supported = entry(0x6502)
        self._mode.on_check = refuse_if(
            lambda mode: mode and not (0 < mode <= 32 and self._supported.value >> (mode - 1) & 1)
        )
        self._mode.on_written = self._mode_written
        for gain in (*self._gains[:4], self._gains[5]):
            gain.on_check = refuse_if(lambda value: not 0.0 <= value <= 1e9)
        self.start()

    @property
    def mode(self) -> int:
        return int(self._mode.value)

    @property
    def stands_still(self) -> bool:
        return abs(self._feedback.speed) < STANDSTILL_REV_S

    @property
    def ramp_is_over(self) -> bool:
        return self._trajectory.speed == 0.0

    def start(self) -> None:
        """At power-on: hold the present position, not 607Ah."""
        self._loop = PositionLoop()
        self._place()
        self._new_target = self._braking = False
        self._outside_since_s = math.inf
        self._demand = Demand(self._trajectory.position / self.scaling.units)
        self._demanded_rad_s = 0.0  # speed of the demand before it is limited
        self._limited = False

    def ramp_down(self, *, from_actual: bool = False) -> None:
        if from_actual:
            self._place(self._feedback.speed * self.scaling.units)
        self._braking = True

    def advance(self, period_s: float) -> None:
        """At a SYNC: compute the position demand, ``period_s`` seconds after the previous one."""
        before = self._trajectory.position
        self._move(period_s)
        units = self.scaling.units
        speed = (self._trajectory.position - before) / units / period_s * 2.0 * math.pi
        self._demand = self._forward(self._trajectory.position / units, speed, period_s)
        self._demand_entry.value = wrapped(round(self._trajectory.position))

    def measure(self) -> None:
        feedback, units = self._feedback, self.scaling.units
        if not self._motor_increments:
            self._internal.value = wrapped(feedback.position)
        self._actual.value = wrapped(round(feedback.revolutions * units))
        self._speed.value = saturated(feedback.speed * units, 32)

    def measure_motor(self, revolutions: float) -> None:
        if self._motor_increments:
            self._internal.value = wrapped(math.floor(revolutions * self._motor_increments))

    def control(self, period_s: float) -> float:
        scaling, feedback = self.scaling, self._feedback
        torque = self._loop.step(
            self._demand,
            feedback.revolutions,
            2.0 * math.pi * feedback.speed,
            chosen_gains(*(one.value for one in self._gains), period_s=period_s),
            period_s=period_s,
            torque_limit_nm=scaling.largest_torque_nm,
            speed_limit_rad_s=2.0 * math.pi * scaling.largest_speed,
        )
        self._error_entry.value = saturated(self._error_units(), 32)
        self._torque_demand.value = scaling.per_mille(torque)
        return torque

    def follows_badly(self, now: float) -> bool:
        self._outside_since_s = min(self._outside_since_s, now) if self._is_outside() else math.inf
        # 1e-9: a sum of whole periods must not miss the limit by rounding.
        return bool(now - self._outside_since_s >= self._error_time.value / 1000.0 - 1e-9)

    def power_off(self) -> None:
        self._torque_demand.value = 0
        self._error_entry.value = 0

    def show_mode(self) -> bool:
        changed = self._display.value != self.mode
        self._display.value = self.mode
        return bool(changed)

    def status(self, enabled: bool) -> int:
        bits = {
            Status.INTERNAL_LIMIT: self._limited or self._loop.limited,
            Status.FOLLOWING_ERROR: self._is_outside(),
            Status.FOLLOWS_TARGET: self.mode == CYCLIC_SYNCHRONOUS_POSITION,
        }
        return sum(bit for bit, is_set in bits.items() if is_set and enabled)

    def _move(self, period_s: float) -> None:
        trajectory, mode = self._trajectory, self.mode
        if self._braking:
            trajectory.brake(float(self._deceleration.value), period_s)
        elif mode == CYCLIC_SYNCHRONOUS_POSITION:
            if self._new_target:
                target = self._within_limits(float(nearest(self._target.value, trajectory.position)))
                trajectory.set_target(target, max(1, round(self.scaling.interpolation_s / period_s)))
            trajectory.advance(period_s)
        else:
            trajectory.speed = 0.0
        self._new_target = False

    def _forward(self, revolutions: float, speed_rad_s: float, period_s: float) -> Demand:
        """The demand with feed-forward. Speed and acceleration are limited to those possible: a target may
        jump, or repeat after a lost SYNC.
        """
        limit = self.scaling.largest_torque_nm / (self._gains[4].value * KG_M2_PER_G_CM2)
        acceleration = (speed_rad_s - self._demanded_rad_s) / period_s
        self._demanded_rad_s = speed_rad_s
        most = limit * period_s
        change = max(-most, min(most, speed_rad_s - self._demand.speed_rad_s))
        forward = acceleration if abs(acceleration) <= limit else 0.0
        return Demand(revolutions, self._demand.speed_rad_s + change, forward)

    def _within_limits(self, target: float) -> float:
        low, high = self._lowest.value, self._highest.value
        limited = target if low <= -_HALF else max(target, float(low))
        limited = limited if high >= _HALF - 1 else min(limited, float(high))
        self._limited = limited != target
        return limited

    def _error_units(self) -> float:
        return (self._demand.revolutions - self._feedback.revolutions) * self.scaling.units

    def _is_outside(self) -> bool:
        window = self._error_window.value
        return bool(window != OFF and abs(self._error_units()) > window)

    def _place(self, speed: float = 0.0) -> None:
        self._trajectory = Trajectory(self._feedback.revolutions * self.scaling.units, speed)
        self._demand_entry.value = wrapped(round(self._trajectory.position))

    def _mode_written(self) -> None:
        if self.mode != self._display.value:
            self._trajectory.drop_target()
            self._new_target = False
        self._on_mode()

    def _target_written(self) -> None:
        self._new_target = True


_HALF, _FULL = 1 << 31, 1 << 32


def wrapped(value: int) -> int:
    """``value`` modulo 2^32, as INTEGER32."""
    return (value + _HALF) % _FULL - _HALF


def nearest(target: int, reference: float) -> int:
    """The position nearest to ``reference`` that equals ``target`` modulo 2^32."""
    place = round(reference)
    return place + wrapped(target - place)


class Scaling:
    """Reads the objects that define the units."""

    def __init__(self, dictionary: Dictionary) -> None:
        entry = dictionary.entry
        self._increments, self._turns = entry(0x608F, 1), entry(0x608F, 2)
        self._speed, self._torque, self._rated = entry(0x6080), entry(0x6072), entry(0x6076)
        self._time, self._exponent = entry(0x60C2, 1), entry(0x60C2, 2)

    @property
    def units(self) -> float:
        return float(max(1, self._increments.value) / max(1, self._turns.value))

    @property
    def largest_speed(self) -> float:
        return float(self._speed.value / 60.0)

    @property
    def rated_nm(self) -> float:
        return float(max(1, self._rated.value) / 1000.0)

    @property
    def largest_torque_nm(self) -> float:
        return float(self._torque.value / 1000.0 * self.rated_nm)

    def per_mille(self, torque_nm: float) -> int:
        return saturated(1000.0 * torque_nm / self.rated_nm, 16)

    @property
    def interpolation_s(self) -> float:
        return float(self._time.value * 10.0**self._exponent.value)
