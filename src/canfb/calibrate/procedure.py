"""Activate, verify and save a table, in this order. Whatever fails: the module is left unchanged."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass

from canfb import objects as od
from canfb.calibrate.measurement import Measurement, Settings, block_of
from canfb.calibration.deviation import Deviation, best_deviation
from canfb.errors import CanfbError
from canfb.master.access import CommissioningError, NodeAccess, ObjectAbsentError
from canfb.master.all_or_nothing import (
    Guard,
    all_or_nothing,
    put_back,
    put_in_force,
    put_in_force_again,
    save,
)
from canfb.master.samples import TrackSamples
from canfb.signal.limits import CALIBRATED_PHASE_ERROR_CYCLES, MOST_PHASE_ERROR_CYCLES
from canfb.view.limits_in_force import LIMIT_UNITS

SPARE_PHASE_ERROR = 2.0  # times the largest error of the fresh samples: not every place of the cycle was met
# Fresh samples may come at another speed; a table that is wrong is worse than this by far.
WORSE = 1.5


@dataclass
class Installation:
    """What was done with a measurement.

    fresh      deviation of samples taken after the activation, None if nothing was activated
    active     the new set is active
    saved_as   object that saved it, None: not saved
    save_note  why it is not saved, in plain words
    phase_error_cycles   written to 2010:0C, None: not written
    """

    fresh: Deviation | None = None
    active: bool = False
    saved_as: str | None = None
    save_note: str = ""
    phase_error_cycles: float | None = None


def install(
    module: NodeAccess,
    measured: Measurement,
    collect: Callable[[], TrackSamples],
    settings: Settings,
    guard: Guard,
    *,
    put: Callable[[], Measurement] | None = None,
    back: Callable[[], None] = lambda: None,
    prove: Callable[[TrackSamples], Deviation] | None = None,
    peak_cycles: float = 0.0,
    keep: bool = True,
    step: Callable[[str], None] = lambda text: None,
) -> tuple[Measurement, Installation]:
    """Activate the new set, verify it on fresh samples from ``collect``, and save it if ``keep``.

    ``put`` replaces the upload: it activates another table and gives the measurement with it; ``back`` puts
    back what else it wrote. ``prove`` replaces :func:`verify`. ``peak_cycles`` is an error that is known
    from elsewhere.

    It is saved only after the verification. If anything fails, or is interrupted, the old set is
    restored (and saved again, where saving had begun) before the error is raised; its text says so.
    """
    done, before = Installation(), measured.before
    declared: int | None = None  # 2010:0C before, once it is written
    saving, undone = False, ""

    def restore() -> None:
        if declared is not None:
            module.write(*od.SUPERVISION_PHASE_ERROR, "H", declared)
        back()
        put_in_force_again(module, before)
        if saving:
            save(module)

    def undo() -> str:
        nonlocal undone
        with contextlib.suppress(OSError):  # a terminal that has gone
            step("restoring the old table")
        put_back(module, "the previous table and conditioning", restore, saving=saving)
        undone = f"the previous table and conditioning are active in {module.name}"
        return undone

    try:
        with all_or_nothing(module, guard, undo):
            step("activating the table")
            if put is None:
                put_in_force(module, measured.found)
            else:
                measured = put()
            done.active = True
            step("verifying on fresh samples")
            fresh = collect()
            done.fresh = verify(fresh, measured, settings) if prove is None else prove(fresh)
            before_error = phase_error(module)
            if before_error is not None:
                declared = before_error
                done.phase_error_cycles = declare_phase_error(module, done.fresh, peak_cycles)
            if keep:
                step("saving")
                saving = True
                _save(module, done)
            else:
                done.save_note = "not saved: the table is lost when the module is switched off (--save)"
    except CanfbError:
        raise
    except BaseException:
        with contextlib.suppress(OSError):
            step(undone)
        raise
    return measured, done


def verify(samples: TrackSamples, measured: Measurement, settings: Settings) -> Deviation:
    """Deviation of fresh samples with the new set. CommissioningError if it is worse than predicted."""
    calibration = measured.calibration
    fresh = best_deviation(
        samples.recording(settings.adc_bits), measured.found, measured.before, block_of(calibration)
    )
    check_as_predicted(fresh.rms, calibration.residual_rms, calibration.uncertainty_rms)
    return fresh


def check_as_predicted(found_rms: float, predicted_rms: float, uncertainty_rms: float) -> None:
    """CommissioningError if fresh samples show more, cycles."""
    if found_rms > WORSE * predicted_rms + uncertainty_rms:
        raise CommissioningError(
            f"on fresh samples the table leaves {100 * found_rms:.3g} % of a cycle rms, "
            f"{100 * predicted_rms:.3g} % was predicted: something has changed since"
        )


def _save(module: NodeAccess, done: Installation) -> None:
    done.saved_as = save(module)
    if done.saved_as is None:
        done.save_note = (
            f"not saved: {module.name} cannot save (1010h; canfb run needs a state_dir for it), the table is "
            "lost when it is switched off"
        )


def phase_error(module: NodeAccess) -> int | None:
    """2010:0C as it is, 1/65536 cycle; None for a module without it."""
    try:
        return module.integer(*od.SUPERVISION_PHASE_ERROR, "H")
    except ObjectAbsentError:
        return None


def declare_phase_error(module: NodeAccess, fresh: Deviation, peak_cycles: float = 0.0) -> float:
    """Write what the fresh samples show to 2010:0C, or ``peak_cycles`` if it is more; what stands there then,
    cycles."""
    peak = max(fresh.peak, peak_cycles)
    largest = min(max(SPARE_PHASE_ERROR * peak, CALIBRATED_PHASE_ERROR_CYCLES), MOST_PHASE_ERROR_CYCLES)
    units = math.ceil(largest * LIMIT_UNITS)
    module.write(*od.SUPERVISION_PHASE_ERROR, "H", units)
    return units / LIMIT_UNITS
