"""The tasks of the page of ``canfb scope``: those of the other commands, with their texts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import PurePath

from canfb.calibrate.calibration_run import CalibrationRun, Steps
from canfb.calibrate.choices import LEAST_SAMPLES, Choices
from canfb.calibrate.measurement import Measurement
from canfb.errors import CanfbError
from canfb.master.access import CommissioningError, Master, NodeAccess
from canfb.master.active import save
from canfb.master.all_or_nothing import Guard
from canfb.signal.correction import Correction
from canfb.tables.table_file import table_of_bytes
from canfb.tables.table_state import TableState
from canfb.tables.table_tasks import Advice, TableTasks

BUTTONS = Advice("upload one first", "Activate puts it in force", "Save keeps it")


@dataclass(frozen=True)
class TaskDone:
    """Result of a task: text, and measured curves if there are any."""

    lines: list[str]
    measured: Measurement | None = None


@dataclass(frozen=True)
class TaskOutcome:
    """Whether it worked, what to say, the active table where it could be read, and what was measured."""

    worked: bool
    lines: list[str]
    active: Correction | None
    measured: Measurement | None = None


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

    def calibrate(self, steps: Steps, *, dry_run: bool) -> TaskDone:
        """A reference measurement; without ``dry_run`` its table activated, verified and saved."""
        choices = Choices(
            module=self._node_id,
            encoder_interface=self._interface,
            dry_run=dry_run,
            least_samples=self._least_samples,
            seconds=self._seconds,
            line="canfb scope",
        )
        run = CalibrationRun(choices, steps, self._date)
        account = run.over_bus(self._master, self._node_id, self._interface, Guard())
        return TaskDone(account.lines, account.measured)

    def upload(self, name: str, data: bytes) -> TaskDone:
        """Stage the table of a file."""
        file = table_of_bytes(PurePath(name).name, data)
        return TaskDone(self._tables.upload(file, active=False, keep=False).lines)

    def activate(self) -> TaskDone:
        """Put the staged table in force."""
        return TaskDone(self._tables.activate(keep=False).lines)

    def save(self) -> TaskDone:
        """Keep table and parameters over a loss of power."""
        used = save(self.module)
        if used is None:
            raise CommissioningError(
                f"{self.module.name} cannot save (1010h; canfb run needs a state_dir for it)"
            )
        return TaskDone([f"saved ({used})"])


def outcome_of(act: Callable[[], TaskDone], module: NodeAccess) -> TaskOutcome:
    """Do it; whatever comes out, the lines end with the state of the module as it is read back then."""
    try:
        worked, done = True, act()
    except CanfbError as error:
        worked, done = False, TaskDone([str(error)])
    lines = [*done.lines, ""] if done.lines else []
    try:
        state = TableState.of_module(module)
    except CanfbError as error:
        lines.append(f"the state of the module could not be read: {error}")
        return TaskOutcome(worked and bool(done.lines), lines, None, done.measured)
    return TaskOutcome(worked, [*lines, *state.lines()], state.used, done.measured)
