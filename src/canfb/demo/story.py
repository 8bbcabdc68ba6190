"""The chapters of the demo, each with its figures and checks."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import canopen
import numpy as np

from canfb.calibration.methods import calibrate_from_motion
from canfb.calibration.result import Calibration
from canfb.cia301.frame import Frame
from canfb.eds_files import eds_path
from canfb.interface.encoder_interface import EncoderInterface, SampleClock
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.objects import OperatingParameter, RecordingCommand
from canfb.signal.correction import Correction
from canfb.signal.phase import FloatArray, IntArray
from canfb.signal.sample import Feedback, Sample
from canfb.signal.supervision import VALID
from canfb.simulation.embedded_bus import BackgroundTraffic, Drive, EmbeddedBus, SyncTiming
from canfb.simulation.encoder import (
    Encoder,
    Motion,
    MotionSource,
    Ramp,
    Ripple,
    SCurve,
    ShaftEncoder,
    ShaftMotion,
    demo_encoder,
)
from canfb.simulation.set_up import SampleRecorder


class EmbeddedNetwork(canopen.Network):
    """The master of canopen on an embedded bus, without thread or waiting: answers arrive at once."""

    def __init__(self, bus: EmbeddedBus) -> None:
        super().__init__()
        self._embedded = bus
        self._own: list[tuple[int, bytes, bool]] = []  # frames sent but not yet delivered
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
CLOCK_START_100NS = 0xFFFFFFFF - 50_000_000  # the sample clock wraps 5 s after the start
APERTURE_JITTER_S = 20e-9
OTHER_LOAD = 0.1  # bus load by other nodes
CYCLES_PER_REVOLUTION = 2500
UNITS_PER_CYCLE = 1_638_400  # fine enough to see 1e-6 of a cycle in a 32-bit position
UNITS_PER_REVOLUTION = CYCLES_PER_REVOLUTION * UNITS_PER_CYCLE
DRIVE_RPM = 2000.0
NODE_ID, INTERFACE_ID = 0x20, 0x10
POSITION_COB_ID = 0x180 + NODE_ID
BEFORE_SYNC_S = 50e-6


Fault = Callable[[Sample], Sample | None]


class FaultySource(MotionSource):
    """A motion with faults: sample number -> the faulty sample, None: lost."""

    def __init__(self, shaft: ShaftEncoder, motion: ShaftMotion, interval_s: float) -> None:
        super().__init__(shaft, motion, interval_s)
        self.faults: dict[int, Fault] = {}
        self.truth_cycles: list[float] = []

    def sample_at(self, now: float) -> Sample | None:  # type: ignore[override]  # as any Source has it
        fault = self.faults.get(len(self.truth_cycles))
        sample = super().sample_at(now)
        self.truth_cycles.append(self.position_cycles)
        return sample if fault is None else fault(sample)


# A ramp to 2000 rpm within eq. 10 at 1 kHz, then speed that wanders by 3 %.
DRIVE_MOTION = Motion(
    (Ramp(0.5, 0.0), Ramp(1.5, DRIVE_RPM)), (Ripple(0.02 * DRIVE_RPM, 0.31), Ripple(0.01 * DRIVE_RPM, 1.7))
)


class DemoNetwork:
    """The network, powered on but not yet started, in the time of a real bus.

    Frames take time and wait for each other, the SYNC jitters, and all clocks drift.
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
        self.source = FaultySource(shaft, motion or DRIVE_MOTION, SYNC_PERIOD_S)
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
        """Run for this many SYNC periods, and until the PDOs of the last one have arrived."""
        self.bus.run_until(self.bus.now + samples * SYNC_PERIOD_S)
        due = self.drive.deadline()
        if due is not None:
            self.bus.run_until(due - BEFORE_SYNC_S)

    def errors_cycles(self, first: int, last: int) -> FloatArray:
        """Position of the drive minus the truth, cycles, for the samples first..last-1.

        A position belongs to the sample of its SYNC or, if flagged, to the one before a lost sample.
        """
        consumed = self.drive.consumed
        number = np.array(consumed.sync_number) - 1
        chosen = (number >= first) & (number < last)
        position = np.array(consumed.position_units, dtype=np.float64)[chosen] / UNITS_PER_CYCLE
        return np.asarray(position - np.array(self.source.truth_cycles)[number[chosen]], np.float64)


RPM, ACCELERATION_RAD_S2, JERK_RAD_S3 = 3000.0, 7850.0, 785_000.0
AT_REST_S = 0.15  # standstill, in which the clocks of interface and module lock to SYNC
AT_SPEED_S = 0.03
MOST_RESIDUAL_CYCLES = 0.28  # > acceleration 0.195 + sample times at 3000 rpm 0.05 + table and noise 0.01
WRONG_CYCLES = 0.25
# Samples for each SYNC: the first number counts the move correctly; the others are compared with it.
WAYS = (4, 2, 1)


@dataclass(frozen=True)
class ServoRun:
    """Result of the move.

    limit_cycles        residual limit in force at the end
    time_s, residual    of each sample, seconds from the start of the move, cycles
    valid               every position was valid from the first sample on
    cycles_off          error of the position at the end, cycles
    wrong_and_valid     positions published as valid with an error above 0.25 cycle
    """

    samples_per_sync: int
    limit_cycles: float
    time_s: FloatArray
    residual: FloatArray
    valid: bool
    cycles_off: int
    wrong_and_valid: int

    @property
    def exact(self) -> bool:
        return self.valid and not self.cycles_off and not self.wrong_and_valid

    @property
    def largest_residual(self) -> float:
        return float(self.residual.max(initial=0.0))

    @property
    def name(self) -> str:
        samples = {1: "one sample", 2: "two samples", 4: "four samples"}[self.samples_per_sync]
        return f"{samples} for each SYNC"

    @property
    def outcome(self) -> str:
        if self.exact:
            return f"counted exactly, largest residual {self.largest_residual:.3f} cycle"
        return f"lost, {abs(self.cycles_off)} cycles off"

    def figures(self) -> dict[str, Any]:
        return {
            "samples_per_sync": self.samples_per_sync,
            "counted_exactly": self.exact,
            "largest_residual_cycles": self.largest_residual,
            "residual_limit_cycles": self.limit_cycles,
            "cycles_off": self.cycles_off,
            "wrong_positions_called_valid": self.wrong_and_valid,
        }


def _run(encoder: Encoder, correction: Correction, seed: int, samples_per_sync: int) -> ServoRun:
    """Simulate the move. The count starts at zero, in the cycle in which the module was started."""
    move = SCurve(RPM * 2.0 * math.pi / 60.0, ACCELERATION_RAD_S2, JERK_RAD_S3, AT_REST_S)
    network = DemoNetwork(encoder, seed, move, samples_per_sync)
    module, source = network.module, network.source
    module.use_correction(correction)
    feedbacks: list[tuple[float, Feedback]] = []
    away: list[float] = []

    def listen(feedback: Feedback, now: float) -> None:
        """At each SYNC record all its samples, each with its time within the interval."""
        all_of_it = (*module.chain.between, feedback)
        apart_s = SYNC_PERIOD_S / samples_per_sync
        begin = source.machine_time(now) - AT_REST_S - SYNC_PERIOD_S
        feedbacks.extend((begin + (k + 1) * apart_s, one) for k, one in enumerate(all_of_it))
        away.append(feedback.cycles + feedback.phase - source.position_cycles)

    module.on_feedback = listen
    network.canopen.nmt.state = "OPERATIONAL"  # start all nodes
    network.drive.start_sync(network.bus.now)
    network.bus.run_until(network.bus.now + SYNC_PERIOD_S * 2 + move.end_s + AT_SPEED_S)
    error = np.array(away) - away[0]
    newest = [one for _, one in feedbacks][samples_per_sync - 1 :: samples_per_sync]
    wrong = (np.abs(error) > WRONG_CYCLES) & [one.valid for one in newest]
    return ServoRun(
        samples_per_sync,
        limit_cycles=module.limits.residual_limit,
        time_s=np.array([time for time, _ in feedbacks]),
        residual=np.array([one.residual for _, one in feedbacks]),
        valid=all(one.valid for _, one in feedbacks),
        cycles_off=round(float(error[-1])),
        wrong_and_valid=int(np.count_nonzero(wrong)),
    )


RUN_UP_SAMPLES = 2500
TRACK_SAMPLES = 3000
REFERENCE_SAMPLES = 20_000
REFERENCE_HZ = 50_000
FAULT_SAMPLES = 80
LOST_SAMPLE = 60
FAULTS: dict[int, tuple[str, Fault]] = {
    15: ("both tracks open", lambda sample: Sample(0, 0)),
    30: ("tracks inverted", lambda sample: Sample(-sample.sine, -sample.cosine)),
    45: ("sine track clipped", lambda sample: Sample(2047, sample.cosine)),
    LOST_SAMPLE: ("sample lost", lambda sample: None),
}
INVALID = 1 << 31
MIN_IMPROVEMENT = 50.0
MAX_ERROR_AFTER = 5e-4  # largest error with table, cycles, including noise of a single 12-bit sample


@dataclass
class Story:
    """The results for report, text and ``--json``."""

    samples: int = 0
    cycles_per_sample: float = 0.0
    wrong_counts: int = 0
    error_before: FloatArray = field(default_factory=lambda: np.zeros(0))
    error_after: FloatArray = field(default_factory=lambda: np.zeros(0))
    phase_before: FloatArray = field(default_factory=lambda: np.zeros(0))
    phase_after: FloatArray = field(default_factory=lambda: np.zeros(0))
    calibration: Calibration | None = None
    table_crc32: int = 0
    flagged_at_once: int = 0
    wrong_and_valid: int = 0
    wrong_counts_after: int = 0
    residual_number: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    residual: FloatArray = field(default_factory=lambda: np.zeros(0))
    fault_window: tuple[int, int] = (0, 0)
    bus_load: float = 0.0
    servo: list[ServoRun] = field(default_factory=list)
    checks: dict[str, bool] = field(default_factory=dict)

    @property
    def held(self) -> bool:
        return bool(self.checks) and all(self.checks.values())


def _start_network(network: DemoNetwork, story: Story) -> None:
    sdo, interface_sdo = network.master.sdo, network.interface_master.sdo
    adc_cob_id = interface_sdo[0x1800][1].raw & 0x7FF
    sdo[0x1400][1].raw = INVALID | adc_cob_id
    sdo[0x1400][1].raw = adc_cob_id
    sdo[0x1801][1].raw = INVALID | sdo[0x1801][1].raw
    sdo[0x6001].raw = sdo[0x6002].raw = UNITS_PER_REVOLUTION
    sdo[0x6000].raw = OperatingParameter.SCALING
    sdo[0x1006].raw = round(SYNC_PERIOD_S * 1e6)
    story.checks["RPDO linked by SDO"] = sdo[0x1400][1].raw == adc_cob_id
    network.master.nmt.state = "OPERATIONAL"
    network.interface_master.nmt.state = "OPERATIONAL"
    network.drive.start_sync(network.bus.now)


def _track(network: DemoNetwork, story: Story) -> None:
    network.run(RUN_UP_SAMPLES + TRACK_SAMPLES)
    truth = network.source.truth_cycles
    story.cycles_per_sample = (truth[-1] - truth[-TRACK_SAMPLES]) / (TRACK_SAMPLES - 1)
    story.error_before, story.phase_before = _error(network, RUN_UP_SAMPLES, RUN_UP_SAMPLES + TRACK_SAMPLES)
    story.checks["one position PDO for each sample"] = len(network.drive.consumed.status) == len(truth)


def _calibrate(network: DemoNetwork, story: Story) -> None:
    recording = network.interface_master.sdo[0x2050]
    recording[4].raw = REFERENCE_HZ
    recording[1].raw = RecordingCommand.START
    network.run(round(REFERENCE_SAMPLES / REFERENCE_HZ / SYNC_PERIOD_S))
    recording[1].raw = RecordingCommand.STOP
    counts = np.frombuffer(network.interface_master.sdo.upload(0x2050, 3), "<i2").reshape(-1, 2)
    story.calibration = calibrate_from_motion(counts[:, 0], counts[:, 1])
    table = story.calibration.table
    sdo = network.master.sdo
    sdo.download(0x2020, 1, table.to_bytes())
    story.checks["the module has the table that was sent"] = sdo[0x2020][2].raw == table.crc32
    sdo[0x2020][3].raw = table.crc32
    story.table_crc32 = sdo[0x2020][4].raw
    story.checks["the table is active"] = story.table_crc32 == table.crc32


def _verify(network: DemoNetwork, story: Story) -> None:
    network.run(20)
    first = len(network.source.truth_cycles)
    network.run(TRACK_SAMPLES)
    story.error_after, story.phase_after = _error(network, first, first + TRACK_SAMPLES)


def _provoke_faults(network: DemoNetwork, story: Story) -> None:
    first = len(network.source.truth_cycles)
    network.source.faults = {first + place: act for place, (_, act) in FAULTS.items()}
    story.fault_window = (first, first + FAULT_SAMPLES)
    network.run(FAULT_SAMPLES)
    consumed = network.drive.consumed
    numbers = np.array(consumed.sync_number) - 1
    story.residual_number = numbers[numbers >= first] - first
    story.residual = np.array(consumed.residual_cycles)[numbers >= first]
    flagged = {n for n, status in zip(numbers.tolist(), consumed.status, strict=True) if not status & VALID}
    lost = first + LOST_SAMPLE
    # A missing sample can be detected only at the next SYNC.
    story.flagged_at_once = sum((n + 1 if n == lost else n) in flagged for n in network.source.faults)


def _error(network: DemoNetwork, first: int, last: int) -> tuple[FloatArray, FloatArray]:
    error = network.errors_cycles(first, last)
    return error - error.mean(), np.mod(np.array(network.source.truth_cycles[first:last]), 1.0)


def _finish(network: DemoNetwork, story: Story) -> None:
    story.samples = len(network.source.truth_cycles)
    error = network.errors_cycles(0, story.samples)
    valid = np.array(network.drive.consumed.status) & VALID != 0
    zero = float(np.median(error))
    wrong = np.abs(error - zero) > 0.25
    story.wrong_counts = int(np.count_nonzero(np.rint(error - zero)[valid]))
    story.wrong_and_valid = int(np.count_nonzero(wrong & valid))
    story.wrong_counts_after = int(np.count_nonzero(wrong[-10:]))
    story.bus_load = network.bus.bits / BIT_RATE / network.bus.now
    before, after = np.abs(story.error_before).max(), np.abs(story.error_after).max()
    story.checks |= {
        "no wrong cycle count": story.wrong_counts == 0,
        f"error at least {MIN_IMPROVEMENT:.0f} times smaller": bool(before > MIN_IMPROVEMENT * after),
        f"error below {100 * MAX_ERROR_AFTER:g} % of a cycle": bool(after < MAX_ERROR_AFTER),
        "every fault flagged in the same sample": story.flagged_at_once == len(FAULTS),
        "no wrong position called valid": story.wrong_and_valid == 0,
        "position right after the faults": story.wrong_counts_after == 0,
        "the bus is not overloaded": story.bus_load < 0.8,
    }


def _move_servo(network: DemoNetwork, story: Story) -> None:
    used = network.module.chain.correction
    story.servo = [_run(network.encoder, used, network.seed, way) for way in WAYS]
    first = story.servo[0]
    story.checks |= {
        "servo move counted exactly": first.exact,
        f"servo residuals below {MOST_RESIDUAL_CYCLES:g} cycle": bool(
            first.largest_residual < MOST_RESIDUAL_CYCLES
        ),
    }


CHAPTERS: tuple[tuple[str, Callable[[DemoNetwork, Story], None]], ...] = (
    ("starting the network", _start_network),
    ("tracking", _track),
    ("reference measurement", _calibrate),
    ("verifying", _verify),
    ("provoking faults", _provoke_faults),
    ("", _finish),
    ("servo move", _move_servo),
)


def run_story(network: DemoNetwork, progress: Callable[[str], None] = lambda text: None) -> Story:
    """Run all chapters on ``network``; ``progress`` gets a line at the start of each."""
    story = Story()
    for title, chapter in CHAPTERS:
        if title:
            progress(title)
        chapter(network, story)
    return story
