"""The module's own reference measurement (object 2030h), watched from outside."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from canfb.calibration.result import REASONS
from canfb.commissioning.access import CommissioningError, NodeAccess, ObjectAbsentError
from canfb.commissioning.active import ActiveSet, read_active
from canfb.commissioning.deviation import best_deviation
from canfb.commissioning.listening import Listener
from canfb.commissioning.pdo_layout import PdoLayout
from canfb.commissioning.procedure import Measurement, Settings, block_of
from canfb.commissioning.samples import Samples
from canfb.errors import CalibrationError

OBJECT = 0x2030
COMMAND, STATE, PROGRESS, REASON = 1, 2, 3, 7
START, STOP, ACCEPT = 1, 2, 3
IDLE, RECORDING, COMPUTING, READY, REFUSED, ACCEPTED = range(6)
LOOK_S = 0.2
PATIENCE_S = 60.0  # without progress


def let_measure(module: NodeAccess, layout: PdoLayout, heard: Callable[[float], None]) -> Samples:
    """Start the module's measurement, wait until it is ready; the samples that came in the meantime.

    CalibrationError, with the module's reason, if it refuses them; CommissioningError if it cannot measure
    or comes to nothing. Then, as after an interruption, the measurement is stopped.
    """
    try:
        module.write(OBJECT, COMMAND, "B", START)
    except ObjectAbsentError:
        raise CommissioningError(f"{module.name} cannot measure by itself: it has no object 2030h") from None
    try:
        with Listener(module.master, layout) as listener:
            _wait(module, listener, heard)
        return listener.result()
    except BaseException:
        stop(module)
        raise


def stop(module: NodeAccess) -> None:
    """End a measurement that has not been accepted; what was active stays so."""
    module.write(OBJECT, COMMAND, "B", STOP)


def accept(module: NodeAccess, measured: Measurement, settings: Settings) -> Measurement:
    """Let the module put its table in force; ``measured`` with this table in place of ours.

    CommissioningError if the module does not take it.
    """
    module.write(OBJECT, COMMAND, "B", ACCEPT)
    state = module.integer(OBJECT, STATE, "B")
    if state != ACCEPTED:
        raise CommissioningError(f"{module.name} has not accepted its measurement (2030:02 is {state})")
    return with_table(measured, read_active(module), settings)


def with_table(measured: Measurement, found: ActiveSet, settings: Settings) -> Measurement:
    """The same measurement with another table, whose figures are those on the same samples."""
    if found.table is None:
        raise CommissioningError("the module says that its table is active, and has none")
    ours = measured.calibration
    on_samples = best_deviation(measured.samples, found, measured.before, block_of(ours), settings.adc_bits)
    calibration = replace(
        ours,
        table=found.table,
        conditioning=found.conditioning,
        residual_rms=on_samples.rms,
        residual_peak=on_samples.peak,
    )
    return replace(measured, calibration=calibration, on_samples=on_samples)


def _wait(module: NodeAccess, listener: Listener, heard: Callable[[float], None]) -> None:
    master = module.master
    seen, moved = -1, master.now()
    while True:
        master.wait(LOOK_S)
        listener.look()
        state = module.integer(OBJECT, STATE, "B")
        progress = module.integer(OBJECT, PROGRESS, "B")
        heard(progress / 100.0)
        if state == READY:
            return
        if state == REFUSED:
            number = module.integer(OBJECT, REASON, "B")
            words = list(REASONS)
            reason = words[number] if number < len(words) else words[-1]
            raise CalibrationError(f"{module.name} refuses its measurement: {REASONS[reason]}", reason)
        if state not in (RECORDING, COMPUTING):
            raise CommissioningError(f"{module.name} has ended its measurement (2030:02 is {state})")
        if progress != seen:
            seen, moved = progress, master.now()
        elif master.now() - moved > PATIENCE_S:
            raise CommissioningError(f"{module.name} comes to nothing: {progress} % for {PATIENCE_S:g} s")
