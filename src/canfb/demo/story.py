"""The chapters of the demo, each with its figures and what had to hold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from canfb.calibration.from_motion import calibrate_from_motion
from canfb.calibration.result import Calibration
from canfb.demo.demo_network import (
    BIT_RATE,
    SYNC_PERIOD_S,
    UNITS_PER_REVOLUTION,
    DemoNetwork,
    Fault,
)
from canfb.demo.servo_act import MOST_RESIDUAL_CYCLES, ServoRun, servo_move
from canfb.signal.phase import FloatArray
from canfb.signal.sample import Sample
from canfb.signal.supervision import VALID

RUN_UP_SAMPLES = 2500
TRACK_SAMPLES = 3000
REFERENCE_SAMPLES = 20_000
REFERENCE_HZ = 50_000
RECORD, STOP = 1, 2  # 2050:01
FAULT_SAMPLES = 80
LOST_SAMPLE = 60
FAULTS: dict[int, tuple[str, Fault]] = {
    15: ("both tracks open", lambda sample: Sample(0, 0)),
    30: ("tracks inverted", lambda sample: Sample(-sample.sine, -sample.cosine)),
    45: ("sine track clipped", lambda sample: Sample(2047, sample.cosine)),
    LOST_SAMPLE: ("sample lost", lambda sample: None),
}
SCALING_ON = 1 << 2
INVALID = 1 << 31
MIN_IMPROVEMENT = 50.0
MAX_ERROR_AFTER = 5e-4  # cycles, noise of a single 12-bit sample included


@dataclass
class Faults:
    """What the provoked faults did."""

    provoked: int = 0
    flagged_at_once: int = 0
    flagged_samples: int = 0
    wrong_and_valid: int = 0
    wrong_counts_after: int = 0


@dataclass
class Story:
    """The content of the report, the figures and ``--json``."""

    samples: int = 0
    cycles_per_sample: float = 0.0
    wrong_counts: int = 0
    error_before: FloatArray = field(default_factory=lambda: np.zeros(0))
    error_after: FloatArray = field(default_factory=lambda: np.zeros(0))
    phase_before: FloatArray = field(default_factory=lambda: np.zeros(0))
    phase_after: FloatArray = field(default_factory=lambda: np.zeros(0))
    calibration: Calibration | None = None
    table_crc32: int = 0
    faults: Faults = field(default_factory=Faults)
    residual_number: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
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
    sdo[0x6000].raw = SCALING_ON
    sdo[0x1006].raw = round(SYNC_PERIOD_S * 1e6)
    story.checks["RPDO linked by SDO"] = sdo[0x1400][1].raw == adc_cob_id
    network.master.nmt.state = "OPERATIONAL"
    network.interface_master.nmt.state = "OPERATIONAL"
    network.drive.start_sync(network.bus.now)


def _track(network: DemoNetwork, story: Story) -> None:
    network.run(RUN_UP_SAMPLES)
    network.run(TRACK_SAMPLES)
    truth = network.source.truth_cycles
    story.cycles_per_sample = (truth[-1] - truth[-TRACK_SAMPLES]) / (TRACK_SAMPLES - 1)
    story.error_before, story.phase_before = _error(network, RUN_UP_SAMPLES, RUN_UP_SAMPLES + TRACK_SAMPLES)
    story.checks["one position PDO for each sample"] = len(network.drive.consumed.status) == len(truth)


def _calibrate(network: DemoNetwork, story: Story) -> None:
    recording = network.interface_master.sdo[0x2050]
    recording[4].raw = REFERENCE_HZ
    recording[1].raw = RECORD
    network.run(round(REFERENCE_SAMPLES / REFERENCE_HZ / SYNC_PERIOD_S))
    recording[1].raw = STOP
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
    faults = story.faults
    faults.provoked = len(FAULTS)
    # A sample that never came can be missed only when the next SYNC comes.
    faults.flagged_at_once = sum((n + 1 if n == lost else n) in flagged for n in network.source.faults)
    faults.flagged_samples = sum(n in flagged for n in range(first, first + FAULT_SAMPLES))


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
    story.faults.wrong_and_valid = int(np.count_nonzero(wrong & valid))
    story.faults.wrong_counts_after = int(np.count_nonzero(wrong[-10:]))
    story.bus_load = network.bus.bits / BIT_RATE / network.bus.now
    before, after = np.abs(story.error_before).max(), np.abs(story.error_after).max()
    story.checks |= {
        "no wrong cycle count": story.wrong_counts == 0,
        f"error at least {MIN_IMPROVEMENT:.0f} times smaller": bool(before > MIN_IMPROVEMENT * after),
        f"error below {100 * MAX_ERROR_AFTER:g} % of a cycle": bool(after < MAX_ERROR_AFTER),
        "every fault flagged in the same sample": story.faults.flagged_at_once == story.faults.provoked,
        "no wrong position called valid": story.faults.wrong_and_valid == 0,
        "position right after the faults": story.faults.wrong_counts_after == 0,
        "the bus is not overloaded": story.bus_load < 0.8,
    }


def _move_servo(network: DemoNetwork, story: Story) -> None:
    story.servo = servo_move(network.encoder, network.module.chain.correction, network.seed)
    two_samples = story.servo[0]
    story.checks |= {
        "servo move counted exactly": two_samples.exact,
        f"servo residuals below {MOST_RESIDUAL_CYCLES:g} cycle": bool(
            two_samples.largest_residual < MOST_RESIDUAL_CYCLES
        ),
    }


def peak(error: FloatArray) -> float:
    return float(np.abs(error).max())


def rms(error: FloatArray) -> float:
    return float(np.sqrt(np.mean(error**2)))


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
