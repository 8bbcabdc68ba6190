"""The module's own reference measurement (object 2030h), watched from outside."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, replace

from canfb import objects as od
from canfb.calibrate.measurement import Measurement, Settings, block_of
from canfb.calibration.deviation import best_deviation
from canfb.calibration.result import Reason
from canfb.errors import CalibrationError, CanfbError
from canfb.master.access import CommissioningError, NodeAccess, ObjectAbsentError, Progress
from canfb.master.all_or_nothing import read_active
from canfb.master.listening import Listener
from canfb.master.samples import TrackSamples
from canfb.objects import MeasurementCommand as Command
from canfb.objects import MeasurementState as State
from canfb.signal.correction import Correction
from canfb.view.pdo_map import PdoLayout

FIGURES = (
    od.MEASUREMENT_DRIFT_RMS,
    od.MEASUREMENT_DRIFT_PEAK,
    od.MEASUREMENT_RESIDUAL_RMS,
    od.MEASUREMENT_RESIDUAL_PEAK,
)
LOOK_S = 0.2
STANDING_S = 2.0  # no sample for this long: it waits for somebody to act
PATIENCE_S = 120.0  # without progress: a slow computer calculates for long


@dataclass(frozen=True)
class ModuleDrift:
    """Figures of the module about its table: present error, rms and peak, and noise, in cycles."""

    rms: float
    peak: float
    residual_rms: float
    residual_peak: float
    coverage: float


def let_measure(module: NodeAccess, layout: PdoLayout, progress: Progress) -> TrackSamples:
    """Let the module measure until it is ready; the samples that were on the bus in the meantime.

    CalibrationError, with the module's reason, if it refuses them; CommissioningError if it cannot measure
    or makes no progress. Then, as after an interruption, the measurement is dropped.
    """
    _start(module, Command.START)
    try:
        with Listener(module.master, layout) as listener:
            _wait(module, State.READY, progress, listener.look)
        return listener.result()
    except BaseException:
        discard(module)
        raise


def let_check(module: NodeAccess, progress: Progress) -> ModuleDrift:
    """Let the module measure how far its encoder has moved away from its table. Errors as above."""
    _start(module, Command.CHECK)
    try:
        _wait(module, State.CHECKED, progress, lambda: None)
        rms, peak, noise, largest = (float(module.read(*figure, "f")) for figure in FIGURES)
        coverage = module.integer(*od.MEASUREMENT_COVERAGE, "B") / 100.0
    finally:
        discard(module)
    return ModuleDrift(rms, peak, noise, largest, coverage)


def discard(module: NodeAccess) -> None:
    """Drop a measurement that has not been accepted; what is active stays so. Never fails."""
    with contextlib.suppress(CanfbError):
        module.write(*od.MEASUREMENT_COMMAND, "B", Command.STOP)


def accept(module: NodeAccess, measured: Measurement, settings: Settings) -> Measurement:
    """Let the module activate its table; ``measured`` with this table instead of ours.

    CommissioningError if the module does not take it.
    """
    module.write(*od.MEASUREMENT_COMMAND, "B", Command.ACCEPT)
    state = module.integer(*od.MEASUREMENT_STATE, "B")
    if state != State.ACCEPTED:
        raise CommissioningError(f"{module.name} has not accepted its measurement (2030:02 is {state})")
    return with_table(measured, read_active(module), settings)


def with_table(measured: Measurement, found: Correction, settings: Settings) -> Measurement:
    """The same measurement with another table, whose figures are those on the same samples."""
    if found.table is None:
        raise CommissioningError("the module reports an active table, but has none")
    ours = measured.calibration
    on_samples = best_deviation(
        measured.samples.recording(settings.adc_bits), found, measured.before, block_of(ours)
    )
    calibration = replace(
        ours,
        table=found.table,
        conditioning=found.conditioning,
        residual_rms=on_samples.rms,
        residual_peak=on_samples.peak,
    )
    return replace(measured, calibration=calibration, on_samples=on_samples)


def _start(module: NodeAccess, command: int) -> None:
    try:
        module.write(*od.MEASUREMENT_COMMAND, "B", command)
    except ObjectAbsentError:
        raise CommissioningError(f"{module.name} cannot measure by itself: it has no object 2030h") from None


class _Samples:
    """Whether the module processes samples while it records."""

    def __init__(self, module: NodeAccess) -> None:
        self._module = module
        self._count, self._moved_s = -1, module.master.now()

    def look(self) -> None:
        """CommissioningError, with what to do, when it has not for STANDING_S."""
        count, now = self._module.integer(*od.FEEDBACK_SAMPLES, "I"), self._module.master.now()
        if count != self._count:
            self._count, self._moved_s = count, now
        elif now - self._moved_s > STANDING_S:
            node_id = self._module.node_id
            raise CommissioningError(
                f"{self._module.name} has processed no sample for {STANDING_S:g} s: it must be OPERATIONAL "
                f"(NMT start, 000h 01 {node_id:02X}), and must receive SYNC and samples"
            )


def _wait(module: NodeAccess, target: int, progress: Progress, look: Callable[[], None]) -> None:
    """Until 2030:02 is ``target``."""
    master = module.master
    last, moved = -1, master.now()
    samples = _Samples(module)
    while True:
        master.wait(LOOK_S)
        look()
        state = module.integer(*od.MEASUREMENT_STATE, "B")
        percent = module.integer(*od.MEASUREMENT_PROGRESS, "B")
        progress(percent / 100.0)
        if state == target:
            return
        if state == State.REFUSED:
            reason = Reason.of_number(module.integer(*od.MEASUREMENT_REASON, "B"))
            raise CalibrationError(f"{module.name} refuses its measurement: {reason.text}", reason)
        if state not in (State.RECORDING, State.COMPUTING):
            raise CommissioningError(f"{module.name} has ended its measurement (2030:02 is {state})")
        if state == State.RECORDING:
            samples.look()
        if percent != last:
            last, moved = percent, master.now()
        elif master.now() - moved > PATIENCE_S:
            raise CommissioningError(f"{module.name} makes no progress: {percent} % for {PATIENCE_S:g} s")
