"""The tasks of the page, one at a time, with progress and result: those of the other commands."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import PurePath

from canfb.calibrate.calibration_run import CalibrationRun, Steps
from canfb.calibrate.choices import LEAST_SAMPLES, CalibrateOptions
from canfb.calibrate.measurement import Measurement
from canfb.errors import CanfbError
from canfb.master.access import CommissioningError, Master, NodeAccess
from canfb.master.all_or_nothing import Guard, save
from canfb.scope.gate import WriteCode
from canfb.sdo.table_file import TableState, table_of_bytes
from canfb.sdo.table_tasks import Advice, TableTasks
from canfb.signal.correction import Correction
from canfb.signal.phase import FloatArray


class ScopeRefusal(CanfbError):
    """A task that may not begin; nothing has happened."""


@dataclass(frozen=True)
class Upload:
    """A file that the browser has sent."""

    name: str
    data: bytes


@dataclass(frozen=True)
class ScopeTask:
    """A task, by the ``label`` of its button.

    question      what is asked before it begins; {node} stands for the module
    writes        it changes the module: only with ``--write``
    takes_file    it needs a table file
    """

    label: str
    question: str
    writes: bool = True
    takes_file: bool = False


READ = ScopeTask("Read table", "", writes=False)
MEASURE = ScopeTask(
    "Measure only",
    "Reference measurement of {node}: the machine must turn. Nothing is written. Begin?",
    writes=False,
)
CALIBRATE = ScopeTask(
    "Calibrate",
    "Reference measurement of {node}: the machine must turn. The new table is activated, verified on fresh "
    "samples and saved; if a step fails, the previous one is restored. Begin?",
)
UPLOAD = ScopeTask(
    "Upload table", "Stage {file} in {node}? It has no effect until it is activated.", takes_file=True
)
ACTIVATE = ScopeTask(
    "Activate", "Put the staged table of {node} in force? Positions move by what the two tables differ."
)
SAVE = ScopeTask("Save", "Save table and parameters of {node} (1010h)? They replace what was saved before.")
TASKS = (READ, MEASURE, CALIBRATE, UPLOAD, ACTIVATE, SAVE)


@dataclass(frozen=True, eq=False)
class MeasuredCurves:
    """Mean deviation in equal parts of the cycle, in cycles, as a reference measurement has found it.

    before   with the table and conditioning that were active
    after    with those that were found; NaN where there is no sample
    """

    before: FloatArray
    after: FloatArray


@dataclass(frozen=True, eq=False)
class TaskResult:
    """What came out of a task.

    worked     it did what it was to do
    lines      for people, at the end the state of the module as it was read back
    active     table and conditioning in force; None where they could not be read
    measured   of a reference measurement
    """

    worked: bool
    lines: list[str]
    active: Correction | None = None
    measured: MeasuredCurves | None = None


class Stage(StrEnum):
    """Where the task is."""

    IDLE = "idle"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"


@dataclass(frozen=True, eq=False)
class DeskState:
    """What there is to see.

    title      the task and its node
    step       what it does now, and of that the part 0..1
    lines      what came out; of a failure, too, what the state of the module is
    measured   of a reference measurement that has ended
    """

    stage: Stage = Stage.IDLE
    title: str = ""
    step: str = ""
    part: float = 0.0
    lines: tuple[str, ...] = ()
    measured: MeasuredCurves | None = None


Begin = Callable[[ScopeTask, int, Upload | None], None]
"""Begins a task on a node. ScopeRefusal where it may not."""


class Desk:
    """One task at a time, for all pages that are open. ``run`` does it, elsewhere, and reports back here.

    ``code`` confirms what writes: no task that does begins without it.
    """

    def __init__(self, run: Begin, allowed: tuple[ScopeTask, ...]) -> None:
        self.allowed = allowed
        self.code = WriteCode()
        self.state = DeskState()
        self._run = run

    @property
    def writes(self) -> bool:
        """Whether some of the tasks write: they need the code."""
        return any(task.writes for task in self.allowed)

    def begin(self, task: ScopeTask, node: int, upload: Upload | None = None, code: str = "") -> None:
        """Begin it. ScopeRefusal: it is not allowed, another one runs, its code or file is missing."""
        if task not in self.allowed:
            raise ScopeRefusal(f"{task.label}: this page is read-only; start canfb scope with --write")
        if task.writes and (refusal := self.code.refusal(code)):
            raise ScopeRefusal(f"{task.label}: {refusal}")
        if self.state.stage is Stage.RUNNING:
            raise ScopeRefusal(f"{task.label}: wait for the end of {self.state.title}")
        if task.takes_file and upload is None:
            raise ScopeRefusal(f"{task.label}: choose a file first")
        self.state = DeskState(Stage.RUNNING, f"{task.label}, module {node} ({node:02X}h)", "begins")
        self._run(task, node, upload)

    def step(self, text: str) -> None:
        """A new step begins."""
        self.state = replace(self.state, step=text, part=0.0)

    def part(self, part: float) -> None:
        """So much of the step is done, 0..1."""
        self.state = replace(self.state, part=min(max(part, 0.0), 1.0))

    def end(self, result: TaskResult) -> None:
        """It has ended."""
        stage = Stage.DONE if result.worked else Stage.FAILED
        lines = tuple(result.lines)
        self.state = replace(
            self.state, stage=stage, step="", part=0.0, lines=lines, measured=result.measured
        )


def allowed_tasks(*, asks: bool, writes: bool) -> tuple[ScopeTask, ...]:
    """None where nothing may be sent, those that read (``asks``), or all (``writes``)."""
    return tuple(task for task in TASKS if writes or (asks and not task.writes))


BUTTONS = Advice("upload one first", "Activate puts it in force", "Save keeps it")


class ModuleTasks:
    """The tasks on module ``node_id`` (1..127) with an encoder interface, None if the module is to say it.

    ``date`` is ISO 8601, the time of day behind a space; ``least_samples`` and ``seconds`` are those of a
    reference measurement, usually as in canfb calibrate. Each task raises CanfbError where it fails.
    """

    def __init__(
        self,
        master: Master,
        node_id: int,
        interface: int | None,
        date: str,
        least_samples: int = LEAST_SAMPLES,
        seconds: float | None = None,
    ) -> None:
        self._master, self._node_id, self._interface, self._date = master, node_id, interface, date
        self._least_samples, self._seconds = least_samples, seconds
        self.module = NodeAccess(master, node_id, "module")
        self._tables = TableTasks(self.module, Guard(), BUTTONS)

    def calibrate(self, steps: Steps, *, dry_run: bool) -> TaskResult:
        """A reference measurement; without ``dry_run`` its table activated, verified and saved."""
        choices = CalibrateOptions(
            module=self._node_id,
            encoder_interface=self._interface,
            dry_run=dry_run,
            least_samples=self._least_samples,
            seconds=self._seconds,
            line="canfb scope",
        )
        run = CalibrationRun(choices, steps, self._date)
        account = run.over_bus(self._master, self._node_id, self._interface, Guard())
        return TaskResult(True, account.lines, measured=_curves(account.measured))

    def upload(self, name: str, data: bytes) -> TaskResult:
        """Stage the table of a file."""
        file = table_of_bytes(PurePath(name).name, data)
        return TaskResult(True, self._tables.upload(file, active=False, keep=False).lines)

    def activate(self) -> TaskResult:
        """Put the staged table in force."""
        return TaskResult(True, self._tables.activate(keep=False).lines)

    def save(self) -> TaskResult:
        """Keep table and parameters over a loss of power."""
        used = save(self.module)
        if used is None:
            raise CommissioningError(
                f"{self.module.name} cannot save (1010h; canfb run needs a state_dir for it)"
            )
        return TaskResult(True, [f"saved ({used})"])


def _curves(measured: Measurement | None) -> MeasuredCurves | None:
    if measured is None:
        return None
    before = measured.on_samples.mean_over_phase(before=True)
    return MeasuredCurves(before, measured.calibration.curve.after)


def result_of(act: Callable[[], TaskResult], module: NodeAccess) -> TaskResult:
    """Do it; whatever comes out, the lines end with the state of the module as it is read back then."""
    try:
        done = act()
    except CanfbError as error:
        done = TaskResult(False, [str(error)])
    lines = [*done.lines, ""] if done.lines else []
    try:
        state = TableState.of_module(module)
    except CanfbError as error:
        lines.append(f"the state of the module could not be read: {error}")
        return replace(done, worked=done.worked and bool(done.lines), lines=lines)
    return replace(done, lines=[*lines, *state.result().lines], active=state.used)
