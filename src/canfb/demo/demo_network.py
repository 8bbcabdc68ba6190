"""The network of the demo: a drive, the encoder interface and the module, and python canopen as master."""

from __future__ import annotations

from collections.abc import Callable

import canopen
import numpy as np

from canfb.cia301.frame import Frame
from canfb.eds_files import eds_path
from canfb.interface.encoder_interface import EncoderInterface
from canfb.interface.sample_instants import SampleClock
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.signal.phase import FloatArray
from canfb.signal.sample import Sample
from canfb.simulation.embedded_bus import BackgroundTraffic, EmbeddedBus
from canfb.simulation.encoder import Encoder, ShaftEncoder, demo_encoder
from canfb.simulation.motion import Motion, MotionSource, Ramp, Ripple, ShaftMotion
from canfb.simulation.set_up import SampleRecorder
from canfb.simulation.sync_producer import Drive, SyncTiming


class EmbeddedNetwork(canopen.Network):
    """python canopen's master on an embedded bus: no thread, no waiting, the answer is there at once."""

    def __init__(self, bus: EmbeddedBus) -> None:
        super().__init__()
        self._embedded = bus
        self._own: list[tuple[int, bytes, bool]] = []  # sent, and not yet delivered
        bus.observers.append(self._take)

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        frame = Frame(can_id, bytes(data), remote)
        self._own.append(frame[:3])
        self._embedded.send(frame)

    def _take(self, frame: Frame, now: float) -> None:
        if self._own and frame[:3] in self._own:  # a controller does not receive what it sends
            self._own.remove(frame[:3])
        elif not frame.rtr:
            self.notify(frame.can_id, bytearray(frame.data), now)


SYNC_PERIOD_S = 1e-3
BIT_RATE = 1_000_000
TIMING = SyncTiming(sync_jitter_us=100.0, sync_drift_ppm=-50.0)
CLOCK_DRIFT_PPM = 100.0
CLOCK_START_100NS = 0xFFFFFFFF - 50_000_000  # it wraps 5 s after the start
APERTURE_JITTER_S = 20e-9
OTHER_LOAD = 0.1  # of nodes that have nothing to do with it
CYCLES_PER_REVOLUTION = 2500
UNITS_PER_CYCLE = 1_638_400  # fine enough to see 1e-6 of a cycle in a 32-bit position
UNITS_PER_REVOLUTION = CYCLES_PER_REVOLUTION * UNITS_PER_CYCLE
DRIVE_RPM = 2000.0
NODE_ID, INTERFACE_ID = 0x20, 0x10
POSITION_COB_ID = 0x180 + NODE_ID
BEFORE_SYNC_S = 50e-6


Fault = Callable[[Sample], Sample | None]


class FaultySource(MotionSource):
    """A motion with faults on request: sample number -> what becomes of it, None = lost."""

    def __init__(self, shaft: ShaftEncoder, motion: ShaftMotion, interval_s: float) -> None:
        super().__init__(shaft, motion, interval_s)
        self.faults: dict[int, Fault] = {}
        self.truth_cycles: list[float] = []

    def sample_at(self, now: float) -> Sample | None:  # type: ignore[override]  # as any Source has it
        fault = self.faults.get(len(self.truth_cycles))
        sample = super().sample_at(now)
        self.truth_cycles.append(self.position_cycles)
        return sample if fault is None else fault(sample)


def demo_motion() -> Motion:
    """A ramp to 2000 rpm within eq. 10 at 1 kHz, then speed that wanders by 3 %."""
    ramps = (Ramp(0.5, 0.0), Ramp(1.5, DRIVE_RPM))
    return Motion(ramps, (Ripple(0.02 * DRIVE_RPM, 0.31), Ripple(0.01 * DRIVE_RPM, 1.7)))


class DemoNetwork:
    """The network, powered on but not yet started, in the time of a real bus.

    Frames take time and wait for each other, the SYNC jitters, and no two clocks agree.
    """

    def __init__(
        self,
        encoder: Encoder | None = None,
        seed: int = 1,
        motion: ShaftMotion | None = None,
        samples_per_sync: int = 1,
    ) -> None:
        self.encoder, self.seed = encoder or demo_encoder(), seed
        self.bus = EmbeddedBus(BIT_RATE)
        self.canopen = EmbeddedNetwork(self.bus)
        shaft = ShaftEncoder(self.encoder, CYCLES_PER_REVOLUTION, seed, APERTURE_JITTER_S)
        self.source = FaultySource(shaft, motion or demo_motion(), SYNC_PERIOD_S)
        config = ModuleConfig(
            node_id=NODE_ID,
            encoder_interface=INTERFACE_ID,
            times=True,
            samples_per_sync=samples_per_sync,
        )
        self.module = FeedbackModule(config)
        clock = SampleClock(CLOCK_DRIFT_PPM, CLOCK_START_100NS)
        self.interface = EncoderInterface(
            INTERFACE_ID, self.source, times=True, samples_per_sync=samples_per_sync, clock=clock
        )
        self.recorder = SampleRecorder(self.interface)
        self.drive = Drive(SYNC_PERIOD_S, POSITION_COB_ID, UNITS_PER_REVOLUTION, TIMING, seed)
        others = BackgroundTraffic(OTHER_LOAD, BIT_RATE, seed)
        self.master = canopen.RemoteNode(NODE_ID, str(eds_path("canfb-module")))
        self.interface_master = canopen.RemoteNode(INTERFACE_ID, str(eds_path("encoder-interface")))
        self.canopen.add_node(self.master)
        self.canopen.add_node(self.interface_master)
        for participant in (self.module, self.interface, self.recorder, self.drive, others):
            self.bus.attach(participant)

    def run(self, samples: int) -> None:
        """Let this many SYNC periods pass, and then all PDOs of the last one."""
        self.bus.run_until(self.bus.now + samples * SYNC_PERIOD_S)
        due = self.drive.deadline()
        if due is not None:
            self.bus.run_until(due - BEFORE_SYNC_S)

    def errors_cycles(self, first: int, last: int) -> FloatArray:
        """Position of the drive minus the truth, cycles, for the samples first..last-1.

        A position belongs to the sample of its SYNC or, flagged, to the one before a lost one.
        """
        consumed = self.drive.consumed
        number = np.array(consumed.sync_number) - 1
        chosen = (number >= first) & (number < last)
        position = np.array(consumed.position_units, dtype=np.float64)[chosen] / UNITS_PER_CYCLE
        error: FloatArray = position - np.array(self.source.truth_cycles)[number[chosen]]
        return error
