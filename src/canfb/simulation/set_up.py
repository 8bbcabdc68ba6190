"""What ``canfb simulate`` puts on a bus: the encoder interface, and what moves the encoder.

Devices take each frame in the order of the list: first the machine, then the interface, then the others.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from canfb import objects as od
from canfb.checks import number_in
from canfb.cia301 import cob
from canfb.cia301.codes import AbortCode
from canfb.cia301.frame import Frame
from canfb.device.device_protocol import Device
from canfb.device.lss import UNCONFIGURED
from canfb.device.od.dictionary import Dictionary, refuse_if
from canfb.errors import ConfigError
from canfb.interface.encoder_interface import EncoderInterface
from canfb.signal.chain_config import ChainConfig
from canfb.signal.phase import FloatArray
from canfb.simulation.cia402.drive import FeedbackModuleLink, ServoDrive
from canfb.simulation.cia402.plant import Coupling, Motor, MotorConfig, Plant, PlantSource
from canfb.simulation.demand import MotionDemand, of_drive, of_motion, of_recording
from canfb.simulation.motion import MotionSource, StoppableMotion
from canfb.simulation.scenario import SimulationConfig
from canfb.simulation.sync_producer import (
    IN_SLOW_MOTION,
    IN_TRUE_TIME,
    SilentDevice,
    WatchedSyncProducer,
)
from canfb.sources.protocol import Source
from canfb.sources.recording_source import RecordingLayout, RecordingSource, open_recording

MOST_RPM = (0x6080, 0)

MISSED = -32768  # in both tracks, as in 2050:03

SHORTEST_INTERVAL_S, LONGEST_INTERVAL_S = 1e-6, 10.0


@dataclass(frozen=True, kw_only=True)
class FedModule:
    """A module and its encoder interface.

    chain                       its encoder, converter and residual limit
    node_id                     1..127; 255: none yet
    encoder_interface           node-ID of the interface that is simulated
    times                       the ADC PDO carries the sample time
    samples_per_sync            1..8 pairs of sine and cosine for each SYNC
    autostart                   operational without a master
    increments_per_revolution   scale of its position (6001h)
    total_range                 where its position wraps (6002h)
    """

    chain: ChainConfig
    node_id: int
    encoder_interface: int
    times: bool
    samples_per_sync: int
    autostart: bool
    increments_per_revolution: int
    total_range: int


@dataclass(frozen=True)
class SimulatedAxis:
    """A drive with its motor, and the encoder on the shaft; ``module_id`` is the module it listens to."""

    plant: Plant
    source: PlantSource
    drive: ServoDrive
    module_id: int

    def describe(self) -> str:
        node, module = self.drive.node_id, self.module_id
        return f"drive: node {node} ({node:02X}h), position from node {module} ({module:02X}h)"

    def summary(self) -> str:
        state = self.drive.power.name.replace("_", " ").capitalize()
        error = f", error {self.drive.error:04X}h" if self.drive.error else ""
        return f"drive: {state}{error}; the shaft is at {self.plant.motor.revolutions:.3f} revolutions"


def simulated_axis(
    simulation: SimulationConfig, module: FedModule, *, autostart: bool = False
) -> SimulatedAxis | None:
    settings = simulation.drive
    if settings is None:
        return None
    if module.node_id == UNCONFIGURED:
        raise ConfigError("drive: the module whose position the drive uses has no node_id (255)")
    plant = Plant(Motor(settings, settings.start_revolutions))
    chain = module.chain
    shaft = simulation.shaft(chain.adc_bits, chain.cycles_per_revolution)
    source = PlantSource(shaft, plant, Coupling(settings.slip_revolutions, settings.slip_at_s))
    link = FeedbackModuleLink(
        node_id=module.node_id,
        increments_per_revolution=module.increments_per_revolution,
        total_range=module.total_range,
        synchronous=settings.synchronous_feedback,
    )
    drive = ServoDrive(
        settings.node_id, plant, link, autostart=autostart, motor_increments=settings.motor_increments
    )
    return SimulatedAxis(plant, source, drive, module.node_id)


def drive_demand(
    motor: MotorConfig, dictionary: Dictionary, chain: ChainConfig, rate_hz: float
) -> MotionDemand:
    """What a drive with this dictionary asks of the module at most: its largest speed, and all its torque."""
    return of_drive(motor, chain, rate_hz, dictionary.entry(*MOST_RPM).value / 60.0)


class SampleRecorder(SilentDevice):
    """Keeps the sample of each SYNC from the first one on; attach it behind the ``interface``."""

    def __init__(self, interface: EncoderInterface) -> None:
        self._interface = interface
        self._counts = array("h")
        self._samples = 0
        self._channels = [
            interface.dictionary.entry(*track) for track in (od.INTERFACE_SINE, od.INTERFACE_COSINE)
        ]

    def __len__(self) -> int:
        return len(self._counts) // 2

    def tracks(self) -> tuple[FloatArray, FloatArray]:
        pairs = np.array(self._counts, np.float64).reshape(-1, 2)
        pairs[(pairs == MISSED).all(axis=1)] = np.nan
        return pairs[:, 0].copy(), pairs[:, 1].copy()

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        if frame.can_id == cob.SYNC and not frame.rtr:
            if self._interface.samples > self._samples:
                self._samples = self._interface.samples
                self._counts.extend(int(channel.value) for channel in self._channels)
            elif self._samples and not self._interface.ended:
                self._counts.extend((MISSED, MISSED))
        return []


class SlowMotion(SilentDevice):
    """A time base: one nominal interval with each SYNC, however late it is. Attach it before its nodes.

    ``dictionary``, of the node that samples, says which frame is the SYNC and, in 1006h, how long the
    interval is; ``interval_s``, 1e-6 to 10 s, counts while 1006h is 0.
    """

    def __init__(self, dictionary: Dictionary, interval_s: float) -> None:
        number_in("interval_s", interval_s, SHORTEST_INTERVAL_S, LONGEST_INTERVAL_S)
        self._interval_s = interval_s
        self._cob_id = dictionary.entry(*od.SYNC_COB_ID)
        self._period = dictionary.entry(*od.CYCLE_PERIOD)
        self.time_s = 0.0
        """The time of the machine."""

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        if frame.can_id == self._cob_id.value & cob.CAN_ID and not frame.rtr:
            self.time_s += self._period.value * 1e-6 or self._interval_s
        return []

    def received_at(self, frame: Frame, now: float) -> float:
        return self.time_s

    def at(self, now: float) -> float:
        return self.time_s


class MachineSwitch:
    """Object 2060h of the interface: 1 lets its machine run, 0 stops it; 08000022h where it cannot be
    stopped.
    """

    def __init__(self, interface: EncoderInterface) -> None:
        entry, source = interface.dictionary.entry(*od.INTERFACE_MACHINE), interface.source
        self._source = source if isinstance(source, MotionSource) else None
        motion = getattr(source, "motion", None)
        self._motion = motion if isinstance(motion, StoppableMotion) else None
        self._entry, self._now = entry, interface.machine_now
        entry.on_check = refuse_if(lambda value: self._motion is None, AbortCode.DEVICE_STATE)
        entry.on_written = self._obey
        entry.on_read = lambda: int(self._motion is None or self._motion.running)

    def _obey(self) -> None:
        if self._motion is not None and self._source is not None:
            running = self._entry.value == od.MachineCommand.START
            self._motion.run(running, self._source.machine_time(self._now()))


@dataclass(frozen=True, kw_only=True)
class Play:
    """What is played, beside the ``simulation:`` section.

    rate_hz     produce the SYNC at this rate; None: follow that of the bus
    autostart   operational without a master
    recorded    record what is sampled
    file        a recording in place of the motion, with its ``layout``
    """

    rate_hz: float | None = None
    autostart: bool = False
    recorded: bool = False
    file: str | None = None
    layout: RecordingLayout = field(default_factory=RecordingLayout)


@dataclass(frozen=True)
class SimulatedNetwork:
    """The devices, in the order in which they take frames.

    demand     what the motion asks of the module, None where it is not known
    recorder   what is sampled, where that is recorded
    rate_hz    the nominal rate of the SYNC
    """

    interface: EncoderInterface
    devices: list[Device]
    axis: SimulatedAxis | None
    demand: MotionDemand | None
    recorder: SampleRecorder
    rate_hz: float


def set_up(
    simulation: SimulationConfig, module: FedModule, play: Play, report: Callable[[str], None]
) -> SimulatedNetwork:
    """All of it, powered off; ``report`` gets a line on what is wrong on the bus.

    CanfbError for a recording that cannot be used, ConfigError for a drive that cannot be.
    """
    rate_hz = sync_rate(simulation, play.rate_hz)
    axis = simulated_axis(simulation, module, autostart=play.autostart or module.autostart)
    source = source_of(simulation, module, play) if axis is None else axis.source
    interface = EncoderInterface(
        module.encoder_interface,
        source,
        autostart=play.autostart or module.autostart,
        times=module.times,
        samples_per_sync=module.samples_per_sync,
        clock=simulation.sample_clock(),
    )
    MachineSwitch(interface)
    # The machine first: it must have moved when the SYNC comes to the others.
    devices: list[Device] = [interface] if axis is None else [axis.plant, interface, axis.drive]
    advice = IN_TRUE_TIME
    if simulation.pace == "sync":
        slow_motion, advice = SlowMotion(interface.dictionary, 1.0 / rate_hz), IN_SLOW_MOTION
        interface.time_base = slow_motion
        if axis is not None:
            axis.plant.time_base = axis.drive.time_base = slow_motion
        devices.insert(0, slow_motion)
    recorder = SampleRecorder(interface)
    if play.recorded:
        devices.append(recorder)
    if play.rate_hz is not None:
        devices.append(WatchedSyncProducer(1.0 / play.rate_hz, report, advice, simulation, simulation.seed))
    demand = _demand(simulation, module, play, interface, axis)
    return SimulatedNetwork(interface, devices, axis, demand, recorder, rate_hz)


def sync_rate(simulation: SimulationConfig, rate_hz: float | None) -> float:
    return float(rate_hz or 1e6 / simulation.sync_period_us)


def source_of(simulation: SimulationConfig, module: FedModule, play: Play) -> Source:
    interval_s = 1.0 / sync_rate(simulation, play.rate_hz)
    if play.file is not None:
        timed = play.layout.time_column is not None or play.rate_hz is not None
        # The samples of a recording are as regular as they were, however the SYNC jitters that asks for them.
        layout = replace(
            play.layout,
            time_stamps=module.times and timed,
            interval_s=interval_s,
            paced=play.rate_hz is not None,
        )
        return open_recording(play.file, layout)
    return simulation.source(module.chain.adc_bits, module.chain.cycles_per_revolution, interval_s)


def _demand(
    simulation: SimulationConfig,
    module: FedModule,
    play: Play,
    interface: EncoderInterface,
    axis: SimulatedAxis | None,
) -> MotionDemand | None:
    per_sync, source = module.samples_per_sync, interface.source
    rate_hz = sync_rate(simulation, play.rate_hz) * per_sync
    if axis is not None:
        if play.rate_hz is None:
            return None
        demand = drive_demand(axis.plant.motor.config, axis.drive.dictionary, module.chain, rate_hz)
    elif isinstance(source, RecordingSource):
        demand = of_recording(*source.tracks(), module.chain, rate_hz, str(play.file))
    else:
        demand = of_motion(simulation.motion, module.chain, rate_hz)
    return replace(demand, per_sync=per_sync)
