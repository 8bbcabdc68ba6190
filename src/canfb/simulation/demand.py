"""What a motion asks of the module at a SYNC rate, against what eq. 9 follows (eq. 10)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from canfb.signal.chain_config import ChainConfig
from canfb.signal.limits import max_acceleration
from canfb.signal.phase import FloatArray, phase_in_cycle
from canfb.simulation.cia402.plant import MotorConfig
from canfb.simulation.scenario import MotionConfig

HALF_CYCLE = 0.5  # at the start the count takes the shortest step


@dataclass(frozen=True)
class MotionDemand:
    """The largest speed and acceleration of a motion, and the module that has to follow them.

    what                  what moves, for people
    rate_hz               samples per second
    speed_cycles          largest speed, cycles per sample; None where it is not known
    acceleration_rad_s2   largest acceleration
    start_cycles          speed at the first sample, cycles per sample
    advice                what to change but the rate, empty for nothing
    errors_cycles         part of the residual limit that the errors of the encoder need
    per_sync              samples for each SYNC
    """

    what: str
    module: ChainConfig
    rate_hz: float
    speed_cycles: float | None
    acceleration_rad_s2: float
    start_cycles: float = 0.0
    advice: str = ""
    errors_cycles: float = 0.0
    per_sync: int = 1

    @property
    def allowed_rad_s2(self) -> float:
        return max_acceleration(self.module.cycles_per_revolution, self.rate_hz, self.module.residual_limit)

    @property
    def left_rad_s2(self) -> float:
        """What eq. 10 allows beside the errors of the encoder; 0.0 if they need the whole limit."""
        left = self.module.residual_limit - self.errors_cycles
        return max_acceleration(self.module.cycles_per_revolution, self.rate_hz, left) if left > 0.0 else 0.0

    @property
    def asked(self) -> float:
        asked, left = self.acceleration_rad_s2, self.left_rad_s2
        return asked / left if left else math.inf * asked if asked else 0.0

    @property
    def least_rate_hz(self) -> float:
        return self.sync_hz * math.sqrt(self.asked)

    @property
    def sync_hz(self) -> float:
        return self.rate_hz / self.per_sync

    @property
    def _at_rate(self) -> str:
        several = f" with {self.per_sync} samples for each SYNC" if self.per_sync > 1 else ""
        return f"at {self.sync_hz:g} Hz{several}"

    def describe(self) -> str:
        speed = "" if self.speed_cycles is None else f"up to {self.speed_cycles:.3g} cycles per sample, "
        return (
            f"{self.what}: {speed}acceleration up to {self.acceleration_rad_s2:.3g} rad/s^2, "
            f"the module follows {self.allowed_rad_s2:.3g} {self._at_rate} (eq. 10)"
        )

    def warning(self) -> str | None:
        if self.asked > 1.0:
            if self.asked == math.inf:
                return (
                    f"{self.what}: the module will lose the position: residual_limit "
                    f"{self.module.residual_limit:.3g} leaves nothing for an acceleration beside "
                    f"the {self.errors_cycles:g} cycle that an uncorrected encoder needs"
                )
            advice = f", or {self.advice}" if self.advice else ""
            return (
                f"{self.what}: the module will lose the position: acceleration "
                f"{self.acceleration_rad_s2:.3g} rad/s^2, it follows {self.allowed_rad_s2:.3g} "
                f"{self._at_rate}: set --rate to {rounded_up(self.least_rate_hz)} or more{advice}"
            )
        if self.start_cycles >= HALF_CYCLE:
            return (
                f"{self.what}: it turns by {self.start_cycles:.3g} cycles per sample from the first sample "
                "on, and the module counts correctly only from standstill, or from less than half a cycle "
                "per sample: give the motion a ramp_s"
            )
        return None


def of_motion(motion: MotionConfig, module: ChainConfig, rate_hz: float) -> MotionDemand:
    """Standstill, ramp and ripple of the configuration."""
    cycles = module.cycles_per_revolution / 60.0 / rate_hz  # per sample, for one rpm
    top = abs(motion.rpm) + abs(motion.ripple_rpm)
    in_motion = motion.standstill_s * rate_hz < 1.0 and motion.ramp_s * rate_hz < 1.0
    # A ramp that is shorter than an interval is a step of the speed between two samples.
    steepest = 0.0 if in_motion else min(rate_hz, 1.0 / motion.ramp_s if motion.ramp_s else math.inf)
    ripple = 2.0 * math.pi * motion.ripple_hz * abs(motion.ripple_rpm)
    return MotionDemand(
        f"motion: {motion.rpm:g} rpm",
        module,
        rate_hz,
        top * cycles,
        2.0 * math.pi / 60.0 * (abs(motion.rpm) * steepest + ripple),
        start_cycles=abs(motion.rpm) * cycles if in_motion else 0.0,
        errors_cycles=4.0 * module.phase_error_cycles,
        advice="a longer ramp_s" if motion.rpm else "less ripple",
    )


def of_drive(motor: MotorConfig, module: ChainConfig, rate_hz: float, revolutions_s: float) -> MotionDemand:
    """A motor, which may accelerate, or brake, with all its torque; ``revolutions_s`` is its speed."""
    able = (motor.rated_torque_nm + motor.coulomb_friction_nm) / motor.inertia_kg_m2
    speed = revolutions_s * module.cycles_per_revolution / rate_hz
    errors = 4.0 * module.phase_error_cycles
    demand = MotionDemand("drive", module, rate_hz, speed, able, errors_cycles=errors)
    followed = demand.left_rad_s2 * motor.inertia_kg_m2  # torque, Nm
    share = (followed - motor.coulomb_friction_nm) / motor.rated_torque_nm
    advice = f"write {int(1000 * share)} or less to 6072h" if share > 0.001 else "less friction and torque"
    return replace(demand, advice=advice)


def of_recording(
    sine: FloatArray, cosine: FloatArray, module: ChainConfig, rate_hz: float, name: str
) -> MotionDemand:
    """Tracks in counts, NaN where a sample is missing, by the smallest acceleration that fits the phases."""
    phase = np.asarray(phase_in_cycle(*module.conditioning.apply(sine, cosine)), np.float64)
    step = np.diff(phase)
    bend = np.diff(step)
    bend = np.where(np.isnan(bend), 0.0, bend - np.rint(bend))  # the residual of eq. 12, with its sign
    known = step[~np.isnan(step)]
    first = float(known[0] - np.rint(known[0])) if len(known) else 0.0
    speed = np.abs(first + np.concatenate([[0.0], np.cumsum(bend)]))
    largest = float(np.abs(bend).max(initial=0.0))
    acceleration = 2.0 * math.pi * largest * rate_hz**2 / module.cycles_per_revolution
    what = f"recording {name}, with the errors of its tracks"
    return MotionDemand(what, module, rate_hz, float(speed.max()), acceleration)


def rounded_up(rate_hz: float) -> str:
    """A rate not below this one, in two or three figures."""
    if rate_hz <= 0.0:
        return "0"
    unit = 10.0 ** (math.floor(math.log10(rate_hz)) - 1)
    return f"{math.ceil(rate_hz / unit - 1e-9) * unit:g}"
