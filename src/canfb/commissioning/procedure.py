"""Activate, verify and save a table, in this order. Whatever fails: the module is left unchanged."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass

from canfb.calibration.deviation import Deviation, best_deviation
from canfb.commissioning.access import CommissioningError, NodeAccess
from canfb.commissioning.active import put_back, put_in_force, save
from canfb.commissioning.guard import Guard
from canfb.commissioning.measurement import Measurement, Settings, block_of
from canfb.commissioning.samples import TrackSamples
from canfb.errors import CanfbError
from canfb.signal.correction import Correction

# Fresh samples may come at another speed; a table that is wrong is worse than this by far.
WORSE = 1.5


@dataclass
class Installation:
    """What was done with a measurement.

    fresh      deviation of samples taken after the activation, None if nothing was activated
    active     the new set is active
    saved_as   object that saved it, None: not saved
    save_note  why it is not saved, in plain words
    """

    fresh: Deviation | None = None
    active: bool = False
    saved_as: str | None = None
    save_note: str = ""


def install(
    module: NodeAccess,
    measured: Measurement,
    collect: Callable[[], TrackSamples],
    settings: Settings,
    guard: Guard,
    *,
    put: Callable[[], Measurement] | None = None,
    keep: bool = True,
    step: Callable[[str], None] = lambda text: None,
) -> tuple[Measurement, Installation]:
    """Activate the new set, verify it on fresh samples from ``collect``, and save it if ``keep``.

    ``put`` replaces the upload: it activates another table and gives the measurement with it.

    It is saved only after the verification. If anything fails, or is interrupted, the old set is
    restored (and saved again, where saving had begun) before the error is raised; its text says so.
    """
    done, before = Installation(), measured.before
    saving = False
    try:
        step("activating the table")
        if put is None:
            put_in_force(module, measured.found)
        else:
            measured = put()
        done.active = True
        step("verifying on fresh samples")
        done.fresh = verify(collect(), measured, settings)
        if keep:
            step("saving")
            saving = True
            _save(module, done)
        else:
            done.save_note = "not saved, as requested: the table is lost when the module is switched off"
    except BaseException as error:
        with guard.held():
            with contextlib.suppress(OSError):  # a terminal that has gone
                step("restoring the old table")
            undone, said = _undo(module, before, saving)
        if isinstance(error, CanfbError) or not undone:
            raise CommissioningError(f"{str(error) or 'interrupted'}; {said}") from error
        with contextlib.suppress(OSError):
            step(said)
        raise
    return measured, done


def verify(samples: TrackSamples, measured: Measurement, settings: Settings) -> Deviation:
    """Deviation of fresh samples with the new set. CommissioningError if it is worse than predicted."""
    calibration = measured.calibration
    fresh = best_deviation(
        samples.recording(settings.adc_bits), measured.found, measured.before, block_of(calibration)
    )
    limit = WORSE * calibration.residual_rms + calibration.uncertainty_rms
    if fresh.rms > limit:
        raise CommissioningError(
            f"on fresh samples the table leaves {100 * fresh.rms:.3g} % of a cycle rms, "
            f"{100 * calibration.residual_rms:.3g} % was predicted: something has changed since"
        )
    return fresh


def _save(module: NodeAccess, done: Installation) -> None:
    done.saved_as = save(module)
    if done.saved_as is None:
        done.save_note = (
            f"not saved: {module.name} cannot save (1010h; canfb run needs a state_dir for it), the table is "
            "lost when it is switched off"
        )


def _undo(module: NodeAccess, before: Correction, saving: bool) -> tuple[bool, str]:
    """Restore the old set; whether that worked, and a line about it."""
    try:
        put_back(module, before)
        if saving:
            save(module)
    except CanfbError as error:
        return False, str(error)
    return True, f"the previous table and conditioning are active in {module.name}"
