"""The devices of ``canfb simulate``: the encoder interface, and what moves the encoder; and the demand of the
motion on the module at a SYNC rate, compared to what eq. 9 follows (eq. 10).

Devices receive each frame in the order of the list: first the machine, then the interface, then the others.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from canfb import objects as od
from canfb.cia301.frame import Frame
from canfb.device.lss import UNCONFIGURED
from canfb.device.node import Device
from canfb.device.od.dictionary import Dictionary
from canfb.errors import ConfigError
from canfb.interface.encoder_interface import EncoderInterface, TimeBase
from canfb.module.module_config import ModuleConfig
from canfb.signal.chain_config import ChainConfig
from canfb.signal.limits import ROUNDING, max_acceleration
from canfb.signal.phase import FloatArray, phase_in_cycle
from canfb.simulation.cia402.drive import ServoDrive
from canfb.simulation.cia402.plant import DriveConfig, Motor, Plant, PlantSource
from canfb.simulation.embedded_bus import (
    IN_SLOW_MOTION,
    IN_TRUE_TIME,
    SimulatedDevice,
    WatchedSyncProducer,
    is_sync,
)
from canfb.simulation.encoder import MotionSource, StoppableMotion
from canfb.simulation.scenario import MotionConfig, SimulationConfig
from canfb.sources.protocol import Source
from canfb.sources.recording_source import RecordingLayout, RecordingSource, open_recording
from canfb.sources.sample_files import with_gaps

HALF_CYCLE = 0.5  # cycles per sample: the first step is taken as the shortest one


@dataclass(frozen=True)
class MotionDemand:
    """The largest speed and acceleration of a motion, and the module that has to follow them.

    what                  name of the motion, for messages
    rate_hz               samples per second
    speed_cycles          largest speed, cycles per sample
    acceleration_rad_s2   largest acceleration
    start_cycles          speed at the first sample, cycles per sample
    advice                what to change instead of the rate; empty: nothing
    errors_cycles         part of the residual limit for the errors of the encoder
    per_sync              samples for each SYNC
    at                    the demand at another rate: a short ramp is steeper
    """

    what: str
    module: ChainConfig
    rate_hz: float
    speed_cycles: float
    acceleration_rad_s2: float
    start_cycles: float = 0.0
    advice: str = ""
    errors_cycles: float = 0.0
    per_sync: int = 1
    at: Callable[[float], MotionDemand] | None = field(default=None, compare=False)

    @property
    def allowed_rad_s2(self) -> float:
        return max_acceleration(self.module.cycles_per_revolution, self.rate_hz, self.module.residual_limit)

    @property
    def left_rad_s2(self) -> float:
        """Acceleration that eq. 10 allows with the errors of the encoder; 0.0 if they exhaust the limit."""
        return self.allowed_rad_s2 * max(0.0, 1.0 - self.errors_cycles / self.module.residual_limit)

    @property
    def asked(self) -> float:
        asked, left = self.acceleration_rad_s2, self.left_rad_s2
        return asked / left if left else math.inf * asked if asked else 0.0

    @property
    def least_rate_hz(self) -> float:
        followed = self.followed
        return followed.rate_hz * math.sqrt(followed.asked) / self.per_sync

    @property
    def followed(self) -> MotionDemand:
        """The demand at the lowest rate at which the module follows it; unchanged if none is known."""
        if self.at is None or not 1.0 + ROUNDING < self.asked < math.inf:
            return self
        return self.at(self.rate_hz * math.sqrt(self.asked)).followed

    @property
    def _at_rate(self) -> str:
        several = f" with {self.per_sync} samples for each SYNC" if self.per_sync > 1 else ""
        return f"at {self.rate_hz / self.per_sync:g} Hz{several}"

    def describe(self) -> str:
        return (
            f"{self.what}: up to {self.speed_cycles:.3g} cycles per sample, "
            f"acceleration up to {self.acceleration_rad_s2:.3g} rad/s^2, "
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
        declared = getattr(self.module, "max_acceleration_rad_s2", 0.0)
        if self.errors_cycles and 0.0 < declared < self.acceleration_rad_s2:
            return (
                f"{self.what}: the module may lose the position: acceleration {self.acceleration_rad_s2:.3g} "
                f"rad/s^2, max_acceleration_rad_s2 (2010:02) is {declared:g}"
            )
        if self.start_cycles >= HALF_CYCLE:
            return (
                f"{self.what}: it turns by {self.start_cycles:.3g} cycles per sample from the first sample "
                "on, and the module counts correctly only from standstill, or from less than half a cycle "
                "per sample: give the motion a ramp_s"
            )
        return None


def of_motion(
    motion: MotionConfig, module: ChainConfig, rate_hz: float, *, sampled: bool = False
) -> MotionDemand:
    """Demand of a configured motion; ``sampled``: count only ripple that the samples show."""
    cycles = module.cycles_per_revolution / 60.0 / rate_hz  # per sample, for one rpm
    in_motion = motion.standstill_s * rate_hz < 1.0 and motion.ramp_s * rate_hz < 1.0
    # A ramp shorter than an interval is a speed step between two samples.
    steepest = 0.0 if in_motion else min(rate_hz, 1.0 / motion.ramp_s if motion.ramp_s else math.inf)
    omega = 2.0 * math.pi * motion.ripple_hz
    # The second difference of three samples of a sine is at most four times its amplitude.
    ripple = abs(motion.ripple_rpm) * (min(omega, 4.0 * rate_hz * rate_hz / omega) if sampled else omega)
    return MotionDemand(
        f"motion: {motion.rpm:g} rpm",
        module,
        rate_hz,
        (abs(motion.rpm) + abs(motion.ripple_rpm)) * cycles,
        2.0 * math.pi / 60.0 * (abs(motion.rpm) * steepest + ripple),
        start_cycles=abs(motion.rpm) * cycles if in_motion else 0.0,
        errors_cycles=4.0 * module.phase_error_cycles,
        advice="a longer ramp_s" if motion.rpm else "less ripple",
        at=partial(of_motion, motion, module),
    )


def of_drive(motor: DriveConfig, objects: Dictionary, module: ChainConfig, rate_hz: float) -> MotionDemand:
    """Largest demand of a drive with these objects: its largest speed, and braking with all its torque."""
    passive = motor.coulomb_friction_nm + abs(motor.load_torque_nm)
    able = (passive + max(motor.rated_torque_nm, motor.brake_torque_nm)) / motor.inertia_kg_m2
    speed = objects.entry(*MOST_RPM).value / 60.0 * module.cycles_per_revolution / rate_hz
    demand = MotionDemand(
        "drive", module, rate_hz, speed, able, errors_cycles=4.0 * module.phase_error_cycles
    )
    followed = demand.left_rad_s2 * motor.inertia_kg_m2  # torque, Nm
    share = (followed - passive) / motor.rated_torque_nm
    held = share > 0.001 and passive + motor.brake_torque_nm <= followed
    advice = f"write {int(1000 * share)} or less to 6072h" if held else "less friction and torque"
    return replace(demand, advice=advice)


def of_recording(
    sine: FloatArray, cosine: FloatArray, module: ChainConfig, rate_hz: float, name: str
) -> MotionDemand:
    """Demand of tracks in counts (NaN: missing sample), with the least acceleration that fits the phases."""
    step = np.diff(np.asarray(phase_in_cycle(*module.conditioning.apply(sine, cosine)), np.float64))
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
    """``rate_hz`` (> 0), rounded up to two or three figures."""
    unit = 10.0 ** (math.floor(math.log10(rate_hz)) - 1)
    return f"{math.ceil(rate_hz / unit - 1e-9) * unit:g}"


MOST_RPM = (0x6080, 0)


def simulated_axis(
    simulation: SimulationConfig, module: ModuleConfig, *, autostart: bool = False
) -> tuple[ServoDrive, PlantSource] | None:
    """The drive with its motor, and the encoder on the shaft; None without a drive."""
    settings = simulation.drive
    if settings is None:
        return None
    if module.node_id == UNCONFIGURED:
        raise ConfigError("drive: the module whose position the drive uses has no node_id (255)")
    plant = Plant(Motor(settings))
    shaft = simulation.shaft(module.adc_bits, module.cycles_per_revolution)
    return ServoDrive(plant, module, autostart=autostart), PlantSource(shaft, plant)


class SampleRecorder(SimulatedDevice):
    """Records the sample of each SYNC from the first one on; attach it after the ``interface``."""

    def __init__(self, interface: EncoderInterface) -> None:
        self._interface = interface
        self._counts = array("h")
        self._samples = 0
        self._sync = interface.dictionary.entry(*od.SYNC_COB_ID)
        self._channels = [
            interface.dictionary.entry(*track) for track in (od.INTERFACE_SINE, od.INTERFACE_COSINE)
        ]

    def __len__(self) -> int:
        return len(self._counts) // 2

    def tracks(self) -> tuple[FloatArray, FloatArray]:
        return with_gaps(*np.array(self._counts).reshape(-1, 2).T)

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        if is_sync(frame, self._sync.value):
            if self._interface.samples > self._samples:
                self._samples = self._interface.samples
                self._counts.extend(int(channel.value) for channel in self._channels)
            elif self._samples and not self._interface.ended:
                self._counts.extend((od.MISSED_COUNTS, od.MISSED_COUNTS))
        return []


class SlowMotion(SimulatedDevice, TimeBase):
    """A time base that advances by the nominal interval at each SYNC, however late; attach it first.

    The ``dictionary`` of the sampling node gives the CAN-ID of SYNC (1005h) and the interval (1006h; if this
    is 0, ``interval_s``).
    """

    def __init__(self, dictionary: Dictionary, interval_s: float) -> None:
        self._interval_s = interval_s
        self._cob_id = dictionary.entry(*od.SYNC_COB_ID)
        self._period = dictionary.entry(*od.CYCLE_PERIOD)
        self.time_s = 0.0  # The time of the machine.

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        if is_sync(frame, self._cob_id.value):
            self.time_s += self._period.value * 1e-6 or self._interval_s
        return []

    def at(self, now: float) -> float:
        return self.time_s


def let_machine_stop(interface: EncoderInterface) -> None:
    """Connect object 2060h of the interface: 1 starts its machine, 0 stops it. Only a motion can stop."""
    source, entry = interface.source, interface.dictionary.entry(*od.INTERFACE_MACHINE)
    if not isinstance(source, MotionSource) or not isinstance(source.motion, StoppableMotion):
        return
    motion = source.motion

    def obey() -> None:
        running = entry.value == od.MachineCommand.START
        motion.run(running, source.machine_time(interface.machine_now()))

    entry.on_check = None
    entry.on_written = obey
    entry.on_read = lambda: int(motion.running)


@dataclass(frozen=True, kw_only=True)
class Play:
    """Options of a run, beside the ``simulation:`` section.

    rate_hz     produce the SYNC at this rate; None: follow the SYNC of the bus
    autostart   operational without a master
    recorded    record the samples
    file        a recording instead of the motion, with its ``layout``
    """

    rate_hz: float | None = None
    autostart: bool = False
    recorded: bool = False
    file: str | None = None
    layout: RecordingLayout = field(default_factory=RecordingLayout)


@dataclass(frozen=True)
class SimulatedNetwork:
    """The devices, in the order in which they receive frames.

    demand     demand of the motion on the module, None: not known
    recorder   records the samples, if requested
    rate_hz    nominal rate of the SYNC
    """

    interface: EncoderInterface
    devices: list[Device]
    drive: ServoDrive | None
    demand: MotionDemand | None
    recorder: SampleRecorder
    rate_hz: float


def set_up(
    simulation: SimulationConfig, module: ModuleConfig, play: Play, report: Callable[[str], None]
) -> SimulatedNetwork:
    """The whole network, not started; ``report`` gets a line on each problem of the bus.

    CanfbError for an unusable recording, ConfigError for an impossible drive.
    """
    rate_hz = sync_rate(simulation, play.rate_hz)
    axis = simulated_axis(simulation, module, autostart=play.autostart or module.autostart)
    drive, source = axis or (None, source_of(simulation, module, play))
    interface = EncoderInterface(
        module.encoder_interface,
        source,
        autostart=play.autostart or module.autostart,
        times=module.times,
        samples_per_sync=module.samples_per_sync,
        clock=simulation.sample_clock(),
    )
    let_machine_stop(interface)
    # The machine first: it must have moved when the SYNC comes to the others.
    devices: list[Device] = [interface] if drive is None else [drive.plant, interface, drive]
    advice = IN_TRUE_TIME
    if simulation.pace == "sync":
        slow_motion, advice = SlowMotion(interface.dictionary, 1.0 / rate_hz), IN_SLOW_MOTION
        interface.time_base = slow_motion
        if drive is not None:
            drive.plant.time_base = drive.time_base = slow_motion
        devices.insert(0, slow_motion)
    recorder = SampleRecorder(interface)
    if play.recorded:
        devices.append(recorder)
    if play.rate_hz is not None:
        devices.append(WatchedSyncProducer(1.0 / play.rate_hz, report, advice, simulation, simulation.seed))
    demand = _demand(simulation, module, play, interface, drive)
    return SimulatedNetwork(interface, devices, drive, demand, recorder, rate_hz)


def sync_rate(simulation: SimulationConfig, rate_hz: float | None) -> float:
    return float(rate_hz or 1e6 / simulation.sync_period_us)


def source_of(simulation: SimulationConfig, module: ModuleConfig, play: Play) -> Source:
    interval_s = 1.0 / sync_rate(simulation, play.rate_hz)
    if play.file is not None:
        timed = play.layout.time_column is not None or play.rate_hz is not None
        # Jitter of the SYNC that plays a recording does not change the instants of its samples.
        layout = replace(
            play.layout,
            time_stamps=module.times and timed,
            interval_s=interval_s,
            paced=play.rate_hz is not None,
        )
        return open_recording(play.file, layout)
    return simulation.source(module.adc_bits, module.cycles_per_revolution, interval_s)


def _demand(
    simulation: SimulationConfig,
    module: ModuleConfig,
    play: Play,
    interface: EncoderInterface,
    drive: ServoDrive | None,
) -> MotionDemand | None:
    per_sync, source = module.samples_per_sync, interface.source
    rate_hz = sync_rate(simulation, play.rate_hz) * per_sync
    if drive is not None:
        if play.rate_hz is None:
            return None
        demand = of_drive(drive.plant.motor.config, drive.dictionary, module, rate_hz)
    elif isinstance(source, RecordingSource):
        demand = of_recording(*source.tracks, module, rate_hz, str(play.file))
    else:
        demand = of_motion(simulation.motion, module, rate_hz, sampled=True)
    return replace(demand, per_sync=per_sync)
