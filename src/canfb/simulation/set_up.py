"""What ``canfb simulate`` puts on a bus: the encoder interface, and what moves the encoder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from canfb.device.device_protocol import Device
from canfb.interface.encoder_interface import EncoderInterface
from canfb.simulation.demand import MotionDemand, of_motion, of_recording
from canfb.simulation.fed_module import FedModule
from canfb.simulation.machine_switch import MachineSwitch, StoppableMotion
from canfb.simulation.sample_recorder import SampleRecorder
from canfb.simulation.scenario import SimulationConfig
from canfb.simulation.shaft_encoder import ShaftEncoder
from canfb.simulation.simulated_axis import SimulatedAxis, simulated_axis
from canfb.simulation.slow_motion import SlowMotion
from canfb.simulation.sync_producer import SyncProducer
from canfb.simulation.sync_rate import IN_SLOW_MOTION, IN_TRUE_TIME, SyncRateWatch
from canfb.sources.motion_source import MotionSource
from canfb.sources.protocol import Source
from canfb.sources.recording_source import ArraySource, RecordingLayout, RecordingSource, open_recording


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
    layout: RecordingLayout = field(default_factory=lambda: RecordingLayout(("sine", "cosine")))


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
    axis = simulated_axis(
        simulation, module, autostart=play.autostart or module.autostart, rate_hz=play.rate_hz
    )
    source = source_of(simulation, module, play) if axis is None else axis.source
    demand = _demand(simulation, module, play, source) if axis is None else axis.demand
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
        producer = SyncProducer(1.0 / play.rate_hz, simulation, simulation.seed)
        devices += [SyncRateWatch(play.rate_hz, report, advice), producer]
    return SimulatedNetwork(interface, devices, axis, demand, recorder, rate_hz)


def sync_rate(simulation: SimulationConfig, rate_hz: float | None) -> float:
    """The nominal rate of the SYNC, Hz: that which is produced, else that of the configuration."""
    return float(rate_hz or 1e6 / simulation.sync_period_us)


def source_of(simulation: SimulationConfig, module: FedModule, play: Play) -> Source:
    """The recording that is played, else the motion of the configuration. CanfbError for a bad one."""
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
    chain = module.chain
    shaft = ShaftEncoder(
        simulation.encoder.encoder(chain.adc_bits),
        chain.cycles_per_revolution,
        simulation.seed,
        simulation.aperture_jitter_s,
    )
    motion = StoppableMotion(simulation.motion.motion(), simulation.motion.ramp_s)
    return MotionSource(shaft, motion, interval_s)


def _demand(simulation: SimulationConfig, module: FedModule, play: Play, source: Source) -> MotionDemand:
    """What the motion, or the recording, asks of the module."""
    per_sync = module.samples_per_sync
    rate_hz = sync_rate(simulation, play.rate_hz) * per_sync
    if isinstance(source, (RecordingSource, ArraySource)):
        demand = of_recording(*source.tracks(), module.chain, rate_hz, str(play.file))
    else:
        demand = of_motion(simulation.motion, module.chain, rate_hz)
    return replace(demand, per_sync=per_sync)
