"""What a motion asks of the module at a SYNC rate, against what its prediction follows (eq. 10).

With third-order prediction that is a jerk. An acceleration that steps by a between two samples then asks as
much as eq. 9 with that acceleration: a third difference of a T^2, a jerk of a / T.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from canfb.signal.chain_config import ChainConfig
from canfb.signal.limits import max_acceleration, max_jerk
from canfb.signal.phase import FloatArray, phase_in_cycle
from canfb.signal.third_order import THIRD
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
    errors_cycles         part of the residual limit of eq. 9 that the errors of the encoder need; twice as
                          much of that of third-order prediction
    jerk_rad_s3           largest jerk, for a module of ``prediction_order`` 3
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
    jerk_rad_s3: float = 0.0
    per_sync: int = 1

    @property
    def allowed_rad_s2(self) -> float:
        """Eq. 10 with the residual limit of the module."""
        return max_acceleration(self.module.cycles_per_revolution, self.rate_hz, self.module.residual_limit)

    @property
    def allowed_rad_s3(self) -> float:
        """The largest jerk that third-order prediction follows with that limit."""
        return max_jerk(self.module.cycles_per_revolution, self.rate_hz, self.module.residual_limit)

    @property
    def left_rad_s2(self) -> float:
        """What eq. 10 allows beside the errors of the encoder; 0.0 if they need the whole limit."""
        left = self.module.residual_limit - self.errors_cycles
        return max_acceleration(self.module.cycles_per_revolution, self.rate_hz, left) if left > 0.0 else 0.0

    @property
    def left_rad_s3(self) -> float:
        """The same of third-order prediction."""
        left = self.module.residual_limit - 2.0 * self.errors_cycles
        return max_jerk(self.module.cycles_per_revolution, self.rate_hz, left) if left > 0.0 else 0.0

    @property
    def _by_jerk(self) -> bool:
        return self.module.prediction_order == THIRD

    @property
    def asked(self) -> float:
        """Demand of the motion over the limit that is left for it; inf if none is left."""
        asked, left = (
            (self.jerk_rad_s3, self.left_rad_s3)
            if self._by_jerk
            else (self.acceleration_rad_s2, self.left_rad_s2)
        )
        return asked / left if left else math.inf * asked if asked else 0.0

    @property
    def least_rate_hz(self) -> float:
        """The SYNC rate at which the module follows: what it follows grows with the square of the rate.

        inf if no rate is enough.
        """
        return self.sync_hz * math.sqrt(self.asked)

    @property
    def sync_hz(self) -> float:
        """SYNC rate."""
        return self.rate_hz / self.per_sync

    @property
    def _at_rate(self) -> str:
        several = f" with {self.per_sync} samples for each SYNC" if self.per_sync > 1 else ""
        return f"at {self.sync_hz:g} Hz{several}"

    def _figures(self) -> tuple[str, str]:
        """What is asked, and what is followed."""
        if self._by_jerk:
            return f"jerk {{}}{self.jerk_rad_s3:.3g} rad/s^3", f"{self.allowed_rad_s3:.3g}"
        return f"acceleration {{}}{self.acceleration_rad_s2:.3g} rad/s^2", f"{self.allowed_rad_s2:.3g}"

    def describe(self) -> str:
        """One line with the figures."""
        speed = "" if self.speed_cycles is None else f"up to {self.speed_cycles:.3g} cycles per sample, "
        asked, followed = self._figures()
        law = "third-order prediction" if self.module.prediction_order == THIRD else "eq. 10"
        return (
            f"{self.what}: {speed}{asked.format('up to ')}, the module follows {followed} "
            f"{self._at_rate} ({law})"
        )

    def warning(self) -> str | None:
        """One line if the module cannot follow, None if it can."""
        if self.asked > 1.0:
            if self.asked == math.inf:
                needed = self.errors_cycles * (2.0 if self._by_jerk else 1.0)
                what = "a jerk" if self._by_jerk else "an acceleration"
                return (
                    f"{self.what}: the module will lose the position: residual_limit "
                    f"{self.module.residual_limit:.3g} leaves nothing for {what} beside the "
                    f"{needed:g} cycle that an uncorrected encoder needs"
                )
            advice = f", or {self.advice}" if self.advice else ""
            asked, followed = self._figures()
            return (
                f"{self.what}: the module will lose the position: {asked.format('')}, it follows {followed} "
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
    bend = (
        2.0 * math.pi * motion.ripple_hz * ripple
    )  # of the ripple; a ramp begins and ends between two samples
    return MotionDemand(
        f"motion: {motion.rpm:g} rpm",
        module,
        rate_hz,
        top * cycles,
        2.0 * math.pi / 60.0 * (abs(motion.rpm) * steepest + ripple),
        start_cycles=abs(motion.rpm) * cycles if in_motion else 0.0,
        errors_cycles=4.0 * module.phase_error_cycles,
        advice="a longer ramp_s" if motion.rpm else "less ripple",
        jerk_rad_s3=2.0 * math.pi / 60.0 * (abs(motion.rpm) * steepest * rate_hz + bend),
    )


def of_drive(motor: MotorConfig, module: ChainConfig, rate_hz: float, revolutions_s: float) -> MotionDemand:
    """A motor, which may accelerate, or brake, with all its torque; ``revolutions_s`` is its speed."""
    able = (motor.rated_torque_nm + motor.coulomb_friction_nm) / motor.inertia_kg_m2
    speed = revolutions_s * module.cycles_per_revolution / rate_hz
    errors = 4.0 * module.phase_error_cycles
    demand = MotionDemand(
        "drive", module, rate_hz, speed, able, errors_cycles=errors, jerk_rad_s3=able * rate_hz
    )
    # A step of the torque asks as much of third-order prediction as of eq. 9, but for the margins.
    followed = demand.left_rad_s3 / rate_hz if demand.module.prediction_order == THIRD else demand.left_rad_s2
    followed *= motor.inertia_kg_m2  # torque, Nm
    share = (followed - motor.coulomb_friction_nm) / motor.rated_torque_nm
    advice = f"write {int(1000 * share)} or less to 6072h" if share > 0.001 else "less friction and torque"
    return replace(demand, advice=advice)


def of_recording(
    sine: FloatArray, cosine: FloatArray, module: ChainConfig, rate_hz: float, name: str
) -> MotionDemand:
    """Tracks in counts, NaN where a sample is missing; the speed is counted from the first samples on.

    Phases alone leave an acceleration open by whole cycles per sample squared: the smallest is taken.
    """
    phase = np.asarray(phase_in_cycle(*module.conditioning.apply(sine, cosine)), np.float64)
    step = np.diff(phase)
    bend = np.diff(step)
    bend = np.where(np.isnan(bend), 0.0, bend - np.rint(bend))  # the residual of eq. 12, with its sign
    third = np.diff(phase, 3)
    third = np.where(np.isnan(third), 0.0, third - np.rint(third))
    known = step[~np.isnan(step)]
    first = float(known[0] - np.rint(known[0])) if len(known) else 0.0
    if module.prediction_order == THIRD:
        bend = (bend[0] if len(bend) else 0.0) + np.concatenate([[0.0], np.cumsum(third)])
    speed = np.abs(first + np.concatenate([[0.0], np.cumsum(bend)]))
    largest = float(np.abs(bend).max(initial=0.0))
    acceleration = 2.0 * math.pi * largest * rate_hz**2 / module.cycles_per_revolution
    what = f"recording {name}, with the errors of its tracks"
    jerk = 2.0 * math.pi * float(np.abs(third).max(initial=0.0)) * rate_hz**3 / module.cycles_per_revolution
    return MotionDemand(what, module, rate_hz, float(speed.max()), acceleration, jerk_rad_s3=jerk)


def rounded_up(rate_hz: float) -> str:
    """A rate not below this one, in two or three figures."""
    if rate_hz <= 0.0:
        return "0"
    unit = 10.0 ** (math.floor(math.log10(rate_hz)) - 1)
    return f"{math.ceil(rate_hz / unit - 1e-9) * unit:g}"
