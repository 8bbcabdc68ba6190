"""The tasks of the page of ``canfb scope``: those of the other commands, with their texts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import PurePath

from canfb.calibrate.calibration_run import CalibrationRun, Steps
from canfb.calibrate.choices import LEAST_SAMPLES, CalibrateOptions
from canfb.calibrate.measurement import Measurement
from canfb.errors import CanfbError
from canfb.master.access import CommissioningError, Master, NodeAccess
from canfb.master.active_table import save
from canfb.master.all_or_nothing import Guard
from canfb.scope.desk import MeasuredCurves, TaskResult
from canfb.tables.table_file import table_of_bytes
from canfb.tables.table_state import TableState
from canfb.tables.table_tasks import Advice, TableTasks

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
