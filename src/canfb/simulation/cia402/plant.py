"""The plant of the simulated drive: a motor with its shaft, a coupling, and the encoder behind it.

J dw/dt = M - M_load - b w - M_friction sign(w), dM/dt = (M_command - M) / tau, solved exactly for a constant
torque in steps of 0.1 ms; friction holds a shaft that has come to rest.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from canfb.checks import LARGEST, number_in, within
from canfb.cia301 import cob
from canfb.cia301.frame import Frame
from canfb.interface.encoder_interface import TimeBase
from canfb.signal.sample import Sample
from canfb.simulation.embedded_bus import SimulatedDevice, is_sync
from canfb.simulation.encoder import ShaftEncoder

LONGEST_STEP_S = 1e-4
LONG_S = 0.1
REMEMBERED_STEPS = 256  # steps in which an encoder may look up a past position
SETTLED = 50.0  # time constants after which the torque equals its command, to the last digit


SLIP_S = 0.5  # duration of a slip: slow enough that the tracks of the encoder do not reveal it


@dataclass(frozen=True, kw_only=True)
class DriveConfig:
    """A drive on the shaft of the encoder, and its motor; there is no gear.

    inertia_kg_m2            moment of inertia of motor and load, 1e-9..1e6
    viscous_friction_nm_s    friction torque per rad/s, 0..1e6 Nm s/rad
    coulomb_friction_nm      friction torque at any speed and largest at standstill, 0..1e6 Nm
    rated_torque_nm          unit of 6072h and 6077h, 1000 per mille (6076h), 0.001..1e6 Nm
    torque_time_constant_s   of the current loop, 0..1 s
    load_torque_nm           load on the shaft from ``load_at_s`` on, -1e6..1e6 Nm; positive opposes
                             positive motion
    load_at_s                time of the machine, 0..1e9 s
    brake_torque_nm          of the holding brake, closed without power, 0..1e6 Nm; 0: none, it coasts
    node_id                  of the drive, 1..127
    start_revolutions        position of the shaft at the start, -1e6..1e6 revolutions
    motor_increments         increments per revolution of an encoder on the motor, 0..4294967295: 6063h is
                             its position at the SYNC; 0: none, 6063h is that of the feedback
    slip_revolutions         slip of the coupling between motor and encoder, -1000..1000 revolutions, in
                             half a second; 0: none
    slip_at_s                begin of the slip, time of the machine, 0..1e9 s
    synchronous_feedback     true: the torque follows at the next SYNC (RPDO4 of type 1); false: at once (255)
    """

    inertia_kg_m2: float = 1e-3
    viscous_friction_nm_s: float = 1e-4
    coulomb_friction_nm: float = 0.01
    rated_torque_nm: float = 0.5
    torque_time_constant_s: float = 0.0005
    load_torque_nm: float = 0.0
    load_at_s: float = 0.0
    brake_torque_nm: float = 0.0
    node_id: int = 0x30
    start_revolutions: float = 0.0
    motor_increments: int = 0
    slip_revolutions: float = 0.0
    slip_at_s: float = 0.0
    synchronous_feedback: bool = False

    def __post_init__(self) -> None:
        within(
            self,
            inertia_kg_m2=(1e-9, 1e6),
            viscous_friction_nm_s=(0.0, 1e6),
            coulomb_friction_nm=(0.0, 1e6),
            rated_torque_nm=(0.001, 1e6),
            torque_time_constant_s=(0.0, 1.0),
            load_torque_nm=(-1e6, 1e6),
            load_at_s=(0.0, 1e9),
            brake_torque_nm=(0.0, 1e6),
            node_id=(1, 127),
            start_revolutions=(-1e6, 1e6),
            motor_increments=(0, 0xFFFFFFFF),
            slip_revolutions=(-1000.0, 1000.0),
            slip_at_s=(0.0, 1e9),
            synchronous_feedback=bool,
        )

    def slipped(self, time_s: float) -> float:
        """Lag of the encoder behind the motor, revolutions."""
        part = min(1.0, max(0.0, (time_s - self.slip_at_s) / SLIP_S))
        return self.slip_revolutions * (1.0 - math.cos(math.pi * part)) / 2.0


class Motor:
    """Motion of the shaft; ``revolutions``, ``speed_rad_s`` and ``torque_nm`` at ``time_s``."""

    def __init__(self, config: DriveConfig) -> None:
        self.config = config
        self.time_s = 0.0
        self.revolutions = config.start_revolutions
        self.speed_rad_s = 0.0
        self.torque_nm = 0.0
        self.command_nm = 0.0
        self.braked = True
        self._steps: deque[tuple[float, float, float]] = deque(maxlen=REMEMBERED_STEPS)

    def revolutions_before(self, seconds: float) -> float:
        """Position ``seconds`` ago; if negative, ahead: extrapolated at the present speed."""
        instant_s, after = self.time_s - seconds, (self.time_s, self.revolutions, self.speed_rad_s)
        if seconds > 0.0:
            for before in reversed(self._steps):
                if before[0] <= instant_s:
                    return _cubic(before, after, instant_s)
                after = before
        at_s, revolutions, speed_rad_s = after
        return revolutions - speed_rad_s * (at_s - instant_s) / (2.0 * math.pi)

    def run(self, duration_s: float) -> None:
        """Advance by ``duration_s`` >= 0; ValueError if negative."""
        number_in("duration_s", duration_s, 0.0, LARGEST)
        if duration_s == 0.0:
            return
        left_s = duration_s - max(LONG_S, SETTLED * self.config.torque_time_constant_s)
        if left_s > 0.0 and not self.time_s < self.config.load_at_s < self.time_s + duration_s:
            # A long pause: once the torque has settled it is constant, and one step is as exact as many.
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
        # The mean torque over the step drives the shaft, because it may settle much faster than a step.
        kept = math.exp(-step_s / lag) if lag > 0.0 else 0.0
        mean = self.command_nm - change * (lag / step_s * (1.0 - kept) if lag > 0.0 else 0.0)
        self.torque_nm = self.command_nm - change * kept
        load = self.config.load_torque_nm if self.time_s >= self.config.load_at_s else 0.0
        self._move(mean - load, step_s)
        self.time_s += step_s

    def _move(self, torque_nm: float, step_s: float) -> None:
        friction = self.config.coulomb_friction_nm + (self.config.brake_torque_nm if self.braked else 0.0)
        if self.speed_rad_s == 0.0 and abs(torque_nm) <= friction:
            return
        net = torque_nm - math.copysign(friction, self.speed_rad_s or torque_nm)
        stop_s = self._time_to_stop(net)
        self._accelerate(net, min(stop_s, step_s))
        if stop_s < step_s:
            self.speed_rad_s = 0.0
            self._move(torque_nm, step_s - stop_s)

    def _time_to_stop(self, net_nm: float) -> float:
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
        viscous, inertia, speed = (
            self.config.viscous_friction_nm_s,
            self.config.inertia_kg_m2,
            self.speed_rad_s,
        )
        if viscous * time_s < 1e-6 * inertia:  # the exponential would lose digits; the line is exact enough
            self.speed_rad_s = speed + (net_nm - viscous * speed) / inertia * time_s
            angle = (speed + self.speed_rad_s) / 2.0 * time_s
        else:
            decay = -math.expm1(-viscous / inertia * time_s)
            self.speed_rad_s = speed + (net_nm / viscous - speed) * decay
            angle = (net_nm * time_s - inertia * (self.speed_rad_s - speed)) / viscous
        self.revolutions += angle / (2.0 * math.pi)


def _cubic(before: tuple[float, float, float], after: tuple[float, float, float], at_s: float) -> float:
    (from_s, start, start_rad_s), (to_s, end, end_rad_s) = before, after
    step_s = to_s - from_s
    part = (at_s - from_s) / step_s
    rest = 1.0 - part
    blend = part * part * (3.0 - 2.0 * part)
    bent = part * rest * (rest * start_rad_s - part * end_rad_s) * step_s / (2.0 * math.pi)
    return start + (end - start) * blend + bent


class Plant(SimulatedDevice):
    """A motor that runs in the time of ``time_base`` from the first SYNC on, also without further SYNCs.

    It must receive a SYNC before the devices that sample or drive it: attach it first.
    """

    def __init__(self, motor: Motor) -> None:
        self.motor = motor
        self.syncs = 0
        self.time_base = TimeBase()
        self.sync_cob_id: Callable[[], int] = lambda: cob.SYNC
        self._now_s: float | None = None  # end of the simulated time; None before the first SYNC

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        """Advance to the receive time of a SYNC; the first one starts the machine."""
        if is_sync(frame, self.sync_cob_id()):
            received_s = self.time_base.at(now if frame.timestamp is None else frame.timestamp)
            if self._now_s is None:
                self._now_s = received_s
            self.go_on_to(received_s)
            self.syncs += 1
        return []

    def drive(self, torque_nm: float, powered: bool, now: float) -> None:
        self.go_on_to(now)
        self.motor.command_nm = torque_nm if powered else 0.0
        if not powered:
            self.motor.torque_nm = 0.0  # the power stage is off: no current flows
        self.motor.braked = not powered

    def go_on_to(self, now: float) -> None:
        """Advance to ``now``; without effect for a past time or before the first SYNC."""
        if self._now_s is not None and now > self._now_s:
            self.motor.run(now - self._now_s)
            self._now_s = now

    def ahead_s(self, now: float) -> float:
        """By how much the motor is ahead of ``now``, seconds: a SYNC may be handled after a torque."""
        return 0.0 if self._now_s is None else max(0.0, self._now_s - now)


class PlantSource:
    """The encoder on the shaft of a plant, behind a coupling that may slip."""

    def __init__(self, shaft: ShaftEncoder, plant: Plant) -> None:
        self._shaft, self._plant = shaft, plant
        self._last_s = 0.0
        self._last_revolutions = plant.motor.revolutions

    def sample_at(self, now: float) -> Sample:
        self._plant.go_on_to(now)
        return self._sample(self._plant.ahead_s(now))

    def next(self) -> Sample:
        return self._sample(0.0)

    def _sample(self, ahead_s: float) -> Sample:
        motor, slipped = self._plant.motor, self._plant.motor.config.slipped
        time_s = motor.time_s - ahead_s
        from_s, start = self._last_s, self._last_revolutions
        end = motor.revolutions_before(ahead_s) - slipped(time_s)

        def between(at_s: float) -> float:
            if not from_s < at_s < time_s:
                return motor.revolutions_before(motor.time_s - at_s) - slipped(at_s)
            return start + (end - start) * (at_s - from_s) / (time_s - from_s)

        self._last_s, self._last_revolutions = time_s, end
        return self._shaft.sample(time_s, between)
