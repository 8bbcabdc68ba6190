"""Activate, verify and save a table, in this order. Any failure leaves the module unchanged."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import astuple, dataclass, replace

from canfb import objects as od
from canfb.calibrate.measurement import Measurement, Settings, SpeedSamples, block_of, errors_at
from canfb.calibration.deviation import Deviation, best_deviation
from canfb.calibration.result import Reason
from canfb.errors import CalibrationError, CanfbError
from canfb.master.access import CommissioningError, NodeAccess, ObjectAbsentError, Progress, Unchanged
from canfb.master.all_or_nothing import (
    Guard,
    change,
    check_crc,
    put_back,
    put_in_force,
    put_in_force_again,
    read_active,
)
from canfb.master.samples import TrackSamples, listening
from canfb.master.session import CORNERS, read_corners
from canfb.signal.front_end import Corners
from canfb.signal.limits import CALIBRATED_PHASE_ERROR_CYCLES, MOST_PHASE_ERROR_CYCLES
from canfb.view.module_view import LIMIT_UNITS, PdoLayout

SPARE_PHASE_ERROR = 2.0  # 2010:0C over the largest error of the fresh samples, which do not meet every phase
# Largest ratio of the error of fresh samples to the prediction: their speed may differ. A wrong table exceeds
# it by far.
WORSE = 1.5


@dataclass
class Installation:
    """Result of :func:`install`.

    fresh      deviation of samples taken after the activation, None: nothing was activated
    saved_as   object that saved it, None: not saved
    phase_error_cycles   written to 2010:0C, None: not written
    """

    fresh: Deviation | None = None
    saved_as: str | None = None
    phase_error_cycles: float | None = None


def install(
    module: NodeAccess,
    measured: Measurement,
    prove: Callable[[Measurement], Deviation],
    guard: Guard,
    *,
    put: Callable[[Measurement], Measurement] | None = None,
    keep: bool = True,
    step: Callable[[str], None] = lambda text: None,
) -> tuple[Measurement, Installation]:
    """Activate the new correction, ``prove`` it on fresh samples, and save it if ``keep``.

    ``put`` activates another table instead of the upload and returns the measurement with it. After a
    failure or an interruption the old correction is restored (and saved again, if saving had begun) before
    the error is raised.
    """
    done, before, over = Installation(), measured.before, measured.over_speeds
    declared: float | None = None  # 2010:0C before; None: not read yet, or a module without it
    as_before = f"the previous table and conditioning are active in {module.name}"

    def act() -> None:
        nonlocal declared, measured
        step("activating the table")
        if over is not None:
            write_corners(module, over.after.corners)
        if put is None:
            put_in_force(module, measured.found)
        else:
            measured = put(measured)
        step("verifying on fresh samples")
        done.fresh = prove(measured)
        check_crc(module, od.TABLE_ACTIVE_CRC, "active", measured.calibration.table.crc32)
        declared = module.read_known(od.SUPERVISION_PHASE_ERROR)
        if declared is not None:
            peak = done.fresh.peak if over is None else max(done.fresh.peak, over.peak_cycles)
            done.phase_error_cycles = declare_phase_error(module, peak)

    def restore() -> None:
        step("restoring the old table")
        if declared is not None:
            module.write(*od.SUPERVISION_PHASE_ERROR, "H", declared)
        if over is not None:
            write_corners(module, over.before.corners)
        put_in_force_again(module, before)

    try:
        done.saved_as = change(
            module,
            guard,
            act,
            restore,
            what="the previous table and conditioning",
            undone=lambda: as_before,
            keep=keep,
            step=step,
        )
    except CanfbError:
        raise
    except BaseException:
        step(as_before)
        raise
    step(f"the table is in force{', and saved' * (done.saved_as is not None)}")
    return measured, done


def write_corners(module: NodeAccess, corners: Corners) -> None:
    if read_corners(module) == corners:
        return
    for place, value in zip(CORNERS, astuple(corners), strict=True):
        module.write(*place, "f", value)
    if read_corners(module) != corners:
        raise CommissioningError(
            f"{module.name}: the corners read back (2001:05, 2001:06) differ from what was written"
        )


def verify(samples: TrackSamples, measured: Measurement, settings: Settings) -> Deviation:
    """Deviation of fresh samples with the new correction. CommissioningError if worse than predicted."""
    calibration = measured.calibration
    fresh = best_deviation(
        samples.recording(settings.adc_bits), measured.found, measured.before, block_of(calibration)
    )
    check_as_predicted(fresh.rms, calibration.residual_rms, calibration.uncertainty_rms)
    return fresh


def verify_at_speed(fresh: SpeedSamples, measured: Measurement, settings: Settings) -> Deviation:
    """:func:`verify` at the present speed, against the error predicted for the nearest measured speed."""
    calibration, over = measured.calibration, measured.over_speeds
    assert over is not None
    block, bits = calibration.block_samples, settings.adc_bits
    found = errors_at(fresh, over.before, over.after, over.path, block, bits)
    check_as_predicted(found.after, over.near(found.hertz).after, calibration.uncertainty_rms)
    return found.deviation


def check_as_predicted(found_rms: float, predicted_rms: float, uncertainty_rms: float) -> None:
    """CommissioningError if the error of fresh samples exceeds the prediction, cycles rms."""
    if found_rms > WORSE * predicted_rms + uncertainty_rms:
        raise CommissioningError(
            f"on fresh samples the table leaves {100 * found_rms:.3g} % of a cycle rms, "
            f"{100 * predicted_rms:.3g} % was predicted: something has changed since, or the speed ripples "
            "within two cycles: let the machine turn faster"
        )


def declare_phase_error(module: NodeAccess, peak_cycles: float) -> float:
    """Write 2010:0C for the largest error of the fresh samples; returns its value, cycles."""
    largest = min(
        max(SPARE_PHASE_ERROR * peak_cycles, CALIBRATED_PHASE_ERROR_CYCLES), MOST_PHASE_ERROR_CYCLES
    )
    units = math.ceil(largest * LIMIT_UNITS)
    module.write(*od.SUPERVISION_PHASE_ERROR, "H", units)
    return units / LIMIT_UNITS


LOOK_S = 0.2
STANDING_S = 2.0  # without samples for this long, the module waits for an action of the user
PATIENCE_S = 120.0  # longest time without progress: a slow computer may calculate for long


def let_measure(module: NodeAccess, layout: PdoLayout, progress: Progress) -> TrackSamples:
    """Let the module measure until it is ready; returns the samples on the bus in the meantime.

    CalibrationError, with the module's reason, if it refuses them; CommissioningError if it cannot measure
    or makes no progress. Then, or after an interruption, the measurement is discarded.
    """
    _start(module, od.MeasurementCommand.START)
    try:
        with listening(module.master, layout) as listener:
            _wait(module, od.MeasurementState.READY, progress, listener.look)
        return listener.result()
    except BaseException:
        discard(module)
        raise


def let_check(module: NodeAccess, progress: Progress) -> tuple[float, float, float, float]:
    """Let the module check its encoder: drift rms, peak, noise of a sample, cycles; coverage 0..1."""
    _start(module, od.MeasurementCommand.CHECK)
    try:
        _wait(module, od.MeasurementState.CHECKED, progress, lambda: None)
        places = od.MEASUREMENT_DRIFT_RMS, od.MEASUREMENT_DRIFT_PEAK, od.MEASUREMENT_RESIDUAL_RMS
        rms, peak, noise = (float(module.read(*place, "f")) for place in places)
        return rms, peak, noise, module.integer(*od.MEASUREMENT_COVERAGE, "B") / 100.0
    finally:
        discard(module)


def discard(module: NodeAccess) -> None:
    """Discard a measurement that was not accepted; the active table is kept. Never fails."""
    with contextlib.suppress(CanfbError):
        put_back(
            module,
            "2030:01 = 0",
            lambda: module.write(*od.MEASUREMENT_COMMAND, "B", od.MeasurementCommand.STOP),
        )


def accept(module: NodeAccess, measured: Measurement, settings: Settings) -> Measurement:
    """Let the module activate its own table; returns ``measured`` with this table.

    CommissioningError if the module refuses.
    """
    module.write(*od.MEASUREMENT_COMMAND, "B", od.MeasurementCommand.ACCEPT)
    state = module.integer(*od.MEASUREMENT_STATE, "B")
    if state != od.MeasurementState.ACCEPTED:
        raise CommissioningError(f"{module.name} has not accepted its measurement (2030:02 is {state})")
    found = read_active(module)
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


def _wait(module: NodeAccess, target: int, progress: Progress, look: Callable[[], None]) -> None:
    """Wait until 2030:02 is ``target``. CommissioningError, with advice, if it does not progress."""
    master = module.master
    progressing, sampling = Unchanged(master), Unchanged(master)
    while True:
        master.wait(LOOK_S)
        look()
        state = module.integer(*od.MEASUREMENT_STATE, "B")
        percent = module.integer(*od.MEASUREMENT_PROGRESS, "B")
        progress(percent / 100.0)
        if state == target:
            return
        if state == od.MeasurementState.REFUSED:
            reason = Reason.of_number(module.integer(*od.MEASUREMENT_REASON, "B"))
            raise CalibrationError(f"{module.name} refuses its measurement: {reason.text}", reason)
        if state not in (od.MeasurementState.RECORDING, od.MeasurementState.COMPUTING):
            raise CommissioningError(f"{module.name} has ended its measurement (2030:02 is {state})")
        standing_s = sampling.seconds(module.integer(*od.FEEDBACK_SAMPLES, "I"))
        if state == od.MeasurementState.RECORDING and standing_s > STANDING_S:
            raise CommissioningError(
                f"{module.name} has processed no sample for {STANDING_S:g} s: it must be OPERATIONAL "
                f"(NMT start, 000h 01 {module.node_id:02X}), and must receive SYNC and samples"
            )
        if progressing.seconds(percent) > PATIENCE_S:
            raise CommissioningError(f"{module.name} makes no progress: {percent} % for {PATIENCE_S:g} s")
