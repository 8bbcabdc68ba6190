"""Whatever a master writes and whatever happens to the bus: nothing is ever half active."""

from __future__ import annotations

import math
from dataclasses import astuple, replace

import pytest
from canopen import SdoAbortedError
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from measuring import DEVICE_STATE, Measuring, good_outcome

from canfb.calibration.deviation import drift
from canfb.calibration.result import Calibration, Reason
from canfb.cia301.frame import Frame
from canfb.module.objects.calibrating import CalibrationJob, Outcome
from canfb.objects import MeasurementCommand as Command
from canfb.objects import MeasurementState as State
from canfb.signal.conditioning import IDENTITY
from canfb.signal.correction import CorrectionTable
from ideal_tracks import wavy_table

WANTED = 200
TABLES = [wavy_table(32, size) for size in (0.01, 0.02)]


def measured() -> Calibration:
    found = good_outcome().calibration
    assert found is not None
    return found


class ModuleUnderAnyMaster(RuleBasedStateMachine):
    """The model: what is in force changes by 2020:03, by an accepted measurement and by a reset alone."""

    def __init__(self) -> None:
        super().__init__()
        self.bench = Measuring(WANTED)
        self.bench.start()
        self.bench.feed([(0, 1500)])
        self.operational = True
        self.power_on()
        self.late: list[CalibrationJob] = []

    def power_on(self) -> None:
        self.state, self.reason, self.task = State.IDLE, "accepted", Command.START
        self.recorded = 0
        self.figures = False  # of a measurement, good or not
        self.table: CorrectionTable | None = None
        self.conditioning = IDENTITY
        self.written = IDENTITY
        self.staged: CorrectionTable | None = None

    def refused(self, command: int) -> None:
        with pytest.raises(SdoAbortedError) as error:
            self.bench.command(command)
        assert error.value.code == DEVICE_STATE

    def remember_job(self) -> None:
        job = self.bench.module.pending_job()
        if job is not None:
            self.late.append(job)

    # commands

    @rule(task=st.sampled_from([Command.START, Command.CHECK]))
    def start(self, task: Command) -> None:
        self.remember_job()
        self.bench.command(task)
        self.state, self.reason, self.task, self.recorded = State.RECORDING, "accepted", task, 0
        self.figures = False

    @rule()
    def stop(self) -> None:
        self.remember_job()
        self.bench.command(Command.STOP)
        self.state, self.reason, self.figures = State.IDLE, "accepted", False

    @rule()
    def finish(self) -> None:
        if self.state is not State.RECORDING:
            self.refused(Command.FINISH)
            return
        self.bench.command(Command.FINISH)
        self.state = State.COMPUTING

    @rule()
    def accept(self) -> None:
        if self.state is not State.READY:
            self.refused(Command.ACCEPT)
            return
        self.bench.command(Command.ACCEPT)
        self.state = State.ACCEPTED
        self.table, self.conditioning = measured().table, measured().conditioning
        self.written = self.conditioning

    @rule(task=st.sampled_from([Command.START, Command.START, Command.CHECK]))
    def measure(self, task: Command) -> None:
        """Straight to the end, so that what comes after it is tried often enough."""
        self.start(task)
        self.finish()
        self.remember_job()
        self.computed()

    # the computation

    @precondition(lambda self: self.state is State.COMPUTING)
    @rule()
    def computed(self) -> None:
        self.bench.finish_with(good_outcome())
        self.state = State.CHECKED if self.task is Command.CHECK else State.READY
        self.figures = True

    @rule(reason=st.sampled_from([Reason.NOISE, Reason.COVERAGE, Reason.LOCKED]), figures=st.booleans())
    def computed_to_no_good(self, reason: Reason, figures: bool) -> None:
        if self.state is not State.COMPUTING:
            self.start(Command.START)
            self.finish()
        calibration = replace(measured(), reason=reason) if figures else None
        self.bench.finish_with(Outcome(reason, calibration, "no"))
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

    # samples

    @rule(count=st.integers(1, 90), lost=st.booleans())
    def samples(self, count: int, lost: bool) -> None:
        """Each that came is published; a missing one is seen with the SYNC after it."""
        published = self.bench.feed([(0, 1500)] * count)
        assert len(published) == (count if self.operational else 0)
        if self.operational and self.state is State.RECORDING:
            self.recorded += count
            if self.recorded >= WANTED:
                self.state = State.COMPUTING
        if lost and self.operational:
            self.bench.feed([None, (0, 1500)])
            if self.state is State.RECORDING:
                self.recorded += 2
                if self.recorded >= WANTED:
                    self.state = State.COMPUTING

    # other things that a master does

    @rule(table=st.sampled_from(TABLES))
    def stage(self, table: CorrectionTable) -> None:
        self.bench.sdo.download(0x2020, 1, table.to_bytes())
        self.staged = table

    @precondition(lambda self: self.staged is not None)
    @rule()
    def activate(self) -> None:
        assert self.staged is not None
        self.bench.sdo[0x2020][3].raw = self.staged.crc32
        self.table, self.conditioning = self.staged, self.written

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
        self.bench.sent(Frame(0x620, bytes.fromhex("2130200101000000")))
        self.bench.sent(Frame(0x620, bytes.fromhex("2120200140000000")))
        self.bench.sent(Frame(0x620, bytes([0]) + bytes(7)))
        self.bench.sent(Frame(0x620, bytes.fromhex("8020200100000008")))
        self.bench.sdo.responses.queue.clear()

    # NMT

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
        self.bench.sdo[0x2030][10].raw = WANTED
        self.operational = False
        self.power_on()

    # what holds at any time

    @invariant()
    def the_state_is_as_it_must_be(self) -> None:
        assert (self.bench.state, self.bench.reason) == (self.state, self.reason)
        working = self.state in (State.RECORDING, State.COMPUTING)
        assert self.bench.is_calibrating == working
        assert self.bench.sdo[0x2030][1].raw == (self.task if working else 0)
        assert (self.bench.module.pending_job() is not None) == (self.state is State.COMPUTING)
        parts = {State.IDLE: 0, State.RECORDING: 80 * self.recorded // WANTED, State.COMPUTING: 80}
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


ModuleUnderAnyMaster.TestCase.settings = settings(
    max_examples=min(60, settings().max_examples), stateful_step_count=25
)
TestAnyMaster = ModuleUnderAnyMaster.TestCase
