"""Object 2030h: the module measures its own reference, and goes on publishing."""

import functools
import math
import struct
from collections.abc import Iterable, Sequence
from dataclasses import astuple, replace
from typing import Any

import numpy as np
import pytest
from canopen import SdoAbortedError
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from module_bench import Bench

from canfb import CorrectionTable, Frame
from canfb.calibration.result import Calibration, Reason, drift
from canfb.device.storage.storage import MemoryStore
from canfb.module.objects.calibrating import CalibrationJob, Outcome
from canfb.objects import MeasurementCommand as Command, MeasurementState as State, StatusBit
from canfb.signal.conditioning import IDENTITY, Conditioning
from canfb.signal.phase import FloatArray
from canfb.signal.sample_recording import SampleRecording
from canfb.simulation.encoder import Encoder, Harmonic
from drawing import examples
from ideal_tracks import wavy_table

ENCODER = Encoder(
    amplitude_counts=1500.0, sine_offset=0.03, cosine_offset=-0.02, sine_amplitude=1.04,
    cosine_amplitude=0.97, phase_error_rad=0.06, noise_lsb=0.5,
    harmonics=(Harmonic(2, 0.008, 0.006, 0.4, 1.1), Harmonic(3, 0.01, 0.012)),
)  # fmt: skip
SAMPLES = 3000
DEVICE_STATE = "0x08000022"
Counts = tuple[int, int]


def motion(cycles_per_sample: float, samples: int, rng: np.random.Generator) -> FloatArray:
    """From standstill up to a speed that wanders by 3 %; positions in cycles."""
    time = np.arange(samples)
    ramp = min(samples // 4, 1000)
    speed = cycles_per_sample * (1.0 + 0.03 * np.sin(time / 190.0 + rng.uniform(0.0, 6.0)))
    return np.cumsum(speed * np.minimum(1.0, time / ramp))


def counts_of(encoder: Encoder, position: FloatArray, rng: np.random.Generator) -> list[Counts]:
    sine, cosine = encoder.sample(position, rng)
    return list(zip(sine.tolist(), cosine.tolist(), strict=True))


@functools.cache
def good_outcome() -> Outcome:
    """What the module makes of a good recording of ENCODER: for all tests that need just any measurement."""
    rng = np.random.default_rng(1)
    recording = SampleRecording()
    for counts in counts_of(ENCODER, motion(0.31, 2000, rng), rng):
        recording.take(*counts)
    found = CalibrationJob(recording.to_bytes(), None, 12)()
    assert found.reason == "accepted", found.text
    return found


class Measuring(Bench):
    """The bench with object 2030h in the master's words; nothing is computed unless a test says so."""

    def __init__(self, samples: int = SAMPLES, **fields: Any) -> None:
        super().__init__(**fields)
        self.bus.computes = False
        self.sdo[0x2030][10].raw = samples

    def command(self, value: int) -> None:
        self.sdo[0x2030][1].raw = value

    def refused(self, command: int) -> None:
        with pytest.raises(SdoAbortedError, match=DEVICE_STATE):
            self.command(command)

    def begin(self) -> None:
        self.start()
        self.command(Command.START)

    @property
    def state(self) -> int:
        return self.sdo[0x2030][2].raw

    @property
    def reason(self) -> str:
        return list(Reason)[self.sdo[0x2030][7].raw]

    def figures(self) -> list[float]:
        """Residual rms and peak, drift rms and peak, cycles."""
        return [self.sdo[0x2030][subindex].raw for subindex in (5, 6, 8, 9)]

    def conditioning(self) -> tuple[float, ...]:
        return tuple(self.sdo[0x2002][subindex].raw for subindex in range(1, 6))

    @property
    def is_calibrating(self) -> bool:
        return bool(self.sdo[0x2011][1].raw & StatusBit.CALIBRATING)

    def feed(self, samples: Iterable[Counts | None]) -> list[tuple[int, int, int]]:
        """One SYNC each with its sample, or without; the position PDOs that came."""
        published = []
        for counts in samples:
            frames = self.sync()
            if counts is not None:
                frames += self.counts(*counts)
            published += [self.position([frame]) for frame in frames if frame.can_id == 0x1A0]
        return published

    @property
    def job(self) -> CalibrationJob:
        job = self.module.pending_job()
        assert job is not None
        return job

    def compute(self) -> Outcome:
        result = self.job()
        assert self.finish_with(result) == []
        return result

    def finish_with(self, result: Outcome | Exception) -> list[Frame]:
        return self.module.finish_job(self.job, result, self.bus.now)


WAVY = wavy_table()


@pytest.mark.parametrize("cycles_per_sample", [0.013, 123.456], ids=str)
def test_the_whole_story_at_any_speed(cycles_per_sample: float) -> None:
    """Recorded, computed, accepted: all the while every SYNC has its position, and it is right."""
    rng = np.random.default_rng(7)
    position = motion(cycles_per_sample, SAMPLES + 600, rng)
    samples = counts_of(ENCODER, position, rng)
    bench, twin = Measuring(), Measuring()
    twin.start()
    bench.begin()
    assert (bench.state, bench.is_calibrating) == (State.RECORDING, True)
    seen = [bench.sdo[0x2030][3].raw]
    for first in range(0, SAMPLES, 500):
        part = samples[first : first + 500]
        published = bench.feed(part)
        assert len(published) == len(part)
        marked = [(units, status | StatusBit.CALIBRATING, off) for units, status, off in twin.feed(part)]
        assert published == marked
        seen.append(bench.sdo[0x2030][3].raw)
    assert seen == sorted(set(seen))
    assert (bench.state, bench.is_calibrating) == (State.COMPUTING, True)
    assert bench.sdo[0x2030][4].raw >= 95
    published = bench.feed(samples[SAMPLES : SAMPLES + 300])
    assert len(published) == 300, "while it computes, too"
    assert all(status & StatusBit.CALIBRATING for _, status, _ in published)
    result = bench.compute()
    assert result.calibration is not None
    assert bench.in_force() == (0, 0, 0), "nothing is in force before it is accepted"
    bench.command(Command.ACCEPT)
    assert bench.sdo.upload(0x2020, 1) == result.calibration.table.to_bytes()
    assert bench.figures()[2:] == [0.0, 0.0]
    after = np.array([units for units, _, _ in bench.feed(samples[SAMPLES + 300 :])]) / 8192
    off = (after - position[SAMPLES + 300 :] + 0.5) % 1.0 - 0.5
    before = np.array([units for units, _, _ in twin.feed(samples[SAMPLES + 300 :])]) / 8192
    raw_off = (before - position[SAMPLES + 300 :] + 0.5) % 1.0 - 0.5
    assert np.std(off) < 3e-4
    assert np.std(raw_off) > 5e-3


def test_a_poor_encoder_whose_position_is_lost_is_measured_all_the_same() -> None:
    """40 % offset, 20 % amplitude error, started at speed: the count is wrong, the samples are not."""
    rng = np.random.default_rng(3)
    poor = Encoder(
        amplitude_counts=1250.0, sine_offset=0.4, cosine_offset=-0.4, sine_amplitude=1.2,
        cosine_amplitude=0.8, noise_lsb=0.5,
    )  # fmt: skip
    time = np.arange(1500)
    bench = Measuring(1500)
    bench.begin()
    published = bench.feed(counts_of(poor, 0.37 * time + 3.0 * np.sin(time / 150.0), rng))
    assert any(status & StatusBit.LOST for _, status, _ in published)
    result = bench.compute()
    assert bench.state == State.READY, result.text
    bench.command(Command.ACCEPT)
    bench.remote.nmt.state = "PRE-OPERATIONAL"
    bench.module.chain.restart()  # it was lost in motion, and a start alone does not say that it stands now
    bench.start()
    published = bench.feed(counts_of(poor, motion(5.3, 600, rng), rng))
    assert {status for _, status, _ in published} == {StatusBit.VALID | StatusBit.TABLE_ACTIVE}


def recordings(rng: np.random.Generator, n: int) -> dict[str, Sequence[Counts | None]]:
    time = np.arange(float(n))
    moving = motion(0.31, n, rng)
    good = counts_of(ENCODER, moving, rng)
    large = counts_of(replace(ENCODER, amplitude_counts=2300.0), moving, rng)
    return {
        "samples": [*good[:150], *[None] * (n - 149)],  # a SYNC tells that the sample before it is missing
        "clipped": large,
        "ellipse": [(sine, 1500) for sine, _ in good],
        "coverage": counts_of(ENCODER, np.full_like(time, 0.3), rng),
        "cycles": counts_of(ENCODER, time * 5.0 / n, rng),
        "locked": counts_of(ENCODER, 0.125 * time, rng),
        "noise": counts_of(replace(ENCODER, noise_lsb=200.0), moving, rng),
    }


@pytest.mark.parametrize("reason", recordings(np.random.default_rng(1), 300))
def test_what_cannot_be_used_is_refused_with_its_reason(reason: str) -> None:
    bench = Measuring()
    bench.activate(WAVY)
    bench.begin()
    bench.feed(recordings(np.random.default_rng(1), SAMPLES)[reason])
    result = bench.compute()
    assert (bench.state, bench.reason) == (State.REFUSED, reason), result.text
    assert bench.sdo[0x2030][7].raw == Reason(reason).number
    assert not bench.is_calibrating
    assert bench.sdo[0x2030][3].raw == 100
    assert all(math.isnan(figure) for figure in bench.figures()[2:]), "no drift from what is refused"
    bench.refused(Command.ACCEPT)
    assert bench.in_force()[1] == WAVY.crc32
    bench.command(Command.START)
    assert (bench.state, bench.reason) == (State.RECORDING, "accepted")


def recorded(bench: Measuring) -> tuple[CalibrationJob, list[tuple[int, int]]]:
    bench.command(Command.FINISH)
    return bench.job, list(struct.iter_unpack("<hh", bench.job.samples))


MISSED = (-32768, -32768)


def test_flagged_samples_are_left_out_and_keep_their_place() -> None:
    bench = Measuring()
    bench.start()
    bench.feed([(0, 1500)] * 5)
    bench.command(Command.START)
    bench.feed([(0, 1500), (0, 100), None, (9, 1500), (2047, 0), (9, 1500)])
    bench.map_rpdo2(0x20000608)
    for flags in (0, 2, 1):
        bench.sync()
        bench.sent(Frame(0x290, bytes([flags])))
        bench.counts(7, 1500)
    _, pairs = recorded(bench)
    assert pairs[:6] == [(0, 1500), MISSED, MISSED, (9, 1500), (2047, 0), (9, 1500)], (
        "a small amplitude is a fault; what is clipped stays, for the computation to tell"
    )
    assert pairs[6:] == [(7, 1500), MISSED, (7, 1500)], "2000:06: invalid"


@pytest.mark.parametrize("full_scale", [2048, 2000, 32768, 65535])
def test_clipped_samples_are_found_as_such_whatever_the_full_scale(full_scale: int) -> None:
    bench = Measuring(amplitude_high_counts=65535)
    bench.sdo[0x2001][2].raw = full_scale
    bench.begin()
    top = min(full_scale - 1, 32767)
    bench.feed([(top, 10), (-top - 1, 10), (3, 10)])
    job, pairs = recorded(bench)
    full = 1 << (job.adc_bits - 1)
    assert [pair[0] for pair in pairs][:2] == [full - 1, -full] if full_scale < 65535 else True
    assert full >= min(full_scale, 32768)


def test_sample_times_count_where_they_come() -> None:
    """At uneven times a constant speed looks like noise; with the times it is a straight line."""
    rng = np.random.default_rng(9)
    bench = Measuring(1000)
    bench.map_rpdo2(0x20000520)
    bench.begin()
    time_s = 429.4 + (np.arange(1100) + rng.uniform(-0.3, 0.3, 1100)) * 1e-3  # the 32 bits wrap at 429.5 s
    ticks = (time_s * 1e7).astype(np.int64).tolist()
    ticks[600] = ticks[599]
    for tick, counts in zip(ticks, counts_of(ENCODER, 83.2e3 * time_s, rng), strict=True):
        bench.sync()
        if tick == ticks[599]:
            bench.module.chain.forget_times()  # the time of the last sample is a first one then
        elif rng.random() < 0.02:
            continue
        bench.sent(Frame(0x290, struct.pack("<I", tick % (1 << 32))))
        bench.counts(*counts)
        if bench.state == State.COMPUTING:
            break
    assert bench.job.times is not None
    result = bench.compute()
    assert bench.state == State.READY, result.text
    assert result.calibration is not None
    assert drift(measured(), result.calibration.table, result.calibration.conditioning).rms < 3e-4


NUMBERS, COUNTS = st.sampled_from([200, 300]), st.integers(0, 90)  # of samples
TABLES = [wavy_table(32, size) for size in (0.01, 0.02)]


def measured() -> Calibration:
    found = good_outcome().calibration
    assert found is not None
    return found


class ModuleUnderAnyMaster(RuleBasedStateMachine):
    """The model: what is in force changes by 2020:03, by an accepted measurement and by a reset alone,
    which brings back what was saved.
    """

    def __init__(self) -> None:
        super().__init__()
        self.bench = Measuring(store=MemoryStore())
        self.bench.start()
        self.bench.feed([(0, 1500)])
        self.operational = True
        self.saved: tuple[CorrectionTable | None, Conditioning] = (None, IDENTITY)
        self.power_on()
        self.late: list[CalibrationJob] = []

    def power_on(self) -> None:
        self.state, self.reason, self.task = State.IDLE, "accepted", Command.START
        self.recorded, self.part = 0, 0.0
        self.wanted = 0
        self.figures = False  # of a measurement, good or not
        self.table, self.conditioning = self.saved
        self.written = self.conditioning
        self.staged: CorrectionTable | None = None

    def remember_job(self) -> None:
        job = self.bench.module.pending_job()
        if job is not None:
            self.late.append(job)

    @rule(task=st.sampled_from([Command.START, Command.CHECK]), wanted=NUMBERS, later=NUMBERS, count=COUNTS)
    def start(self, task: Command, wanted: int, later: int, count: int = 0) -> None:
        """The number of samples is that of the start."""
        self.remember_job()
        self.bench.sdo[0x2030][10].raw = wanted
        self.bench.command(task)
        self.bench.sdo[0x2030][10].raw = later
        self.state, self.reason, self.task, self.recorded = State.RECORDING, "accepted", task, 0
        self.wanted, self.figures = wanted, False
        self.samples(count, False)

    @rule()
    def stop(self) -> None:
        self.remember_job()
        self.bench.command(Command.STOP)
        self.state, self.reason, self.figures = State.IDLE, "accepted", False

    @rule(part=st.sampled_from([0.0, 0.5, 1.0, 7.0, -1.0]))
    def finish(self, part: float) -> None:
        if self.state is not State.RECORDING:
            self.bench.refused(Command.FINISH)
            return
        self.bench.command(Command.FINISH)
        self.bench.module.job_progress(self.bench.job, part)
        self.bench.module.job_progress(replace(self.bench.job), 0.9)  # of another job
        self.state, self.part = State.COMPUTING, max(0.0, min(part, 1.0))

    @rule()
    def accept(self) -> None:
        if self.state is not State.READY:
            self.bench.refused(Command.ACCEPT)
            return
        self.bench.sdo[0x1020][1].raw = 7
        self.bench.command(Command.ACCEPT)
        assert self.bench.sdo[0x1020][1].raw == 0, "the configuration is another one now"
        self.state = State.ACCEPTED
        self.table, self.conditioning = measured().table, measured().conditioning
        self.written = self.conditioning

    @rule(task=st.sampled_from([Command.START, Command.START, Command.CHECK]))
    def measure(self, task: Command) -> None:
        """Straight to the end, so that what comes after it is tried often enough."""
        self.start(task, 200, 200)
        self.finish(0.5)
        self.remember_job()
        self.computed()

    @precondition(lambda self: self.state is State.COMPUTING)
    @rule()
    def computed(self) -> None:
        self.bench.finish_with(good_outcome())
        self.state = State.CHECKED if self.task is Command.CHECK else State.READY
        self.figures = True

    @rule(reason=st.sampled_from([Reason.NOISE, Reason.COVERAGE, Reason.LOCKED]), figures=st.booleans())
    def computed_to_no_good(self, reason: Reason, figures: bool) -> None:
        if self.state is not State.COMPUTING:
            self.start(Command.START, 200, 200)
            self.finish(0.0)
        self.bench.finish_with(Outcome(reason, replace(measured(), reason=reason) if figures else None, "no"))
        self.state, self.reason, self.figures = State.REFUSED, reason, figures

    @precondition(lambda self: self.state is State.COMPUTING)
    @rule()
    def computation_crashed(self) -> None:
        self.bench.finish_with(ChildProcessError("killed"))
        self.state, self.reason = State.REFUSED, "failed"

    @precondition(lambda self: self.late)
    @rule(crashed=st.booleans())
    def result_that_comes_too_late(self, crashed: bool) -> None:
        result = OSError() if crashed else good_outcome()
        self.bench.module.finish_job(self.late.pop(), result, self.bench.bus.now)

    @rule(count=st.integers(1, 90), lost=st.booleans())
    def samples(self, count: int, lost: bool) -> None:
        """Each that came is published; a missing one is seen with the SYNC after it."""
        published = self.bench.feed([(0, 1500)] * count)
        assert len(published) == (count if self.operational else 0)
        self.came(count)
        if lost and self.operational:
            self.bench.feed([None, (0, 1500)])
            self.came(2)

    def came(self, count: int) -> None:
        if self.operational and self.state is State.RECORDING:
            self.recorded += count
            if self.recorded >= self.wanted:
                self.state, self.part = State.COMPUTING, 0.0

    @rule(table=st.sampled_from(TABLES), again=st.booleans())
    def stage(self, table: CorrectionTable, again: bool) -> None:
        """The active one may be activated once more, with the conditioning that waits."""
        self.bench.sdo.download(0x2020, 1, table.to_bytes())
        self.staged = table
        if again and self.table is not None:
            self.activate(self.table)

    @rule(table=st.sampled_from([*TABLES, None]))
    def activate(self, table: CorrectionTable | None) -> None:
        """By the CRC of the staged table or of the active one, and no other."""
        crc32 = 1 if table is None else table.crc32
        if crc32 not in [one.crc32 for one in (self.staged, self.table) if one is not None]:
            with pytest.raises(SdoAbortedError, match="06090030"):
                self.bench.sdo[0x2020][3].raw = crc32
            return
        self.bench.sdo[0x2020][3].raw = crc32
        self.table, self.conditioning = table, self.written
        assert table is not None
        assert self.bench.sdo.upload(0x2020, 1) == table.to_bytes()

    @rule()
    def save(self) -> None:
        """What is in force, whatever waits; it comes back with a reset of the node."""
        self.bench.save()
        self.saved = self.table, self.conditioning

    @rule()
    def load(self) -> None:
        self.bench.load(4)
        self.saved = None, IDENTITY

    @rule()
    def back_to_the_identity(self) -> None:
        self.bench.sdo[0x2020][3].raw = 0
        self.table, self.conditioning = None, self.written

    @rule(offset=st.sampled_from([-20.0, 0.0, 20.0]))
    def write_a_conditioning(self, offset: float) -> None:
        self.bench.sdo[0x2002][1].raw = offset
        self.written = replace(self.written, sine_offset_counts=offset)

    @rule()
    def break_off_a_transfer(self) -> None:
        for request in ("2130200101000000", "2120200140000000", "0000000000000000", "8020200100000008"):
            self.bench.sent(Frame(0x620, bytes.fromhex(request)))
        self.bench.sdo.responses.queue.clear()

    @rule(command=st.sampled_from(["PRE-OPERATIONAL", "STOPPED", "OPERATIONAL", "RESET COMMUNICATION"]))
    def nmt(self, command: str) -> None:
        self.bench.remote.nmt.state = command
        if command != "OPERATIONAL":
            if self.operational and self.state is State.RECORDING:
                self.state, self.reason = State.REFUSED, "interrupted"
            if command == "STOPPED":
                self.bench.remote.nmt.state = "PRE-OPERATIONAL"
        self.operational = command == "OPERATIONAL"
        if command == "OPERATIONAL":
            self.samples(1, False)  # what is missing is seen once samples come

    @rule()
    def reset(self) -> None:
        self.remember_job()
        self.bench.remote.nmt.state = "RESET"
        assert self.bench.sdo[0x2030][10].raw == 20000
        self.operational = False
        self.power_on()

    @invariant()
    def the_state_is_as_it_must_be(self) -> None:
        assert (self.bench.state, self.bench.reason) == (self.state, self.reason)
        working = self.state in (State.RECORDING, State.COMPUTING)
        assert self.bench.is_calibrating == working
        assert self.bench.sdo[0x2030][1].raw == (self.task if working else 0)
        assert (self.bench.module.pending_job() is not None) == (self.state is State.COMPUTING)
        recorded, computed = 80 * self.recorded // max(self.wanted, 1), 80 + int(19 * self.part)
        parts = {State.IDLE: 0, State.RECORDING: recorded, State.COMPUTING: computed}
        assert self.bench.sdo[0x2030][3].raw == parts.get(self.state, 100)

    @invariant()
    def table_and_conditioning_are_in_force_together(self) -> None:
        chain = self.bench.module.chain
        assert (chain.correction.table, chain.correction.conditioning) == (self.table, self.conditioning)
        crc32, entries = (0, 0) if self.table is None else (self.table.crc32, len(self.table))
        staged = 0 if self.staged is None else self.staged.crc32
        assert self.bench.in_force() == (staged, crc32, entries)
        assert self.bench.conditioning() == astuple(self.written)[:5]  # 2002:01..05

    @invariant()
    def figures_are_there_when_there_is_a_measurement(self) -> None:
        residuals, drifts = self.bench.figures()[:2], self.bench.figures()[2:]
        none = [math.nan, math.nan]
        wanted = [measured().residual_rms, measured().residual_peak] if self.figures else none
        assert residuals == pytest.approx(wanted, nan_ok=True)
        usable = self.state in (State.READY, State.ACCEPTED, State.CHECKED)
        wanted = list(drift(measured(), self.table, self.conditioning)) if usable else none
        assert drifts == pytest.approx(wanted, nan_ok=True)


TestAnyMaster = ModuleUnderAnyMaster.TestCase
TestAnyMaster.settings = examples(100, stateful_step_count=25)
