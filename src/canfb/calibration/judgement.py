"""When a reference measurement is refused, and why. A bad one is never returned as good."""

from __future__ import annotations

from dataclasses import replace

from canfb.calibration.result import Calibration, Reason
from canfb.errors import CalibrationError

MIN_COVERAGE = 0.95
MIN_CYCLES = 10.0
# The paper's method leaves 0.05 % of a cycle; a table that may be off by that in the mean is refused.
MAX_UNCERTAINTY_CYCLES = 5e-4
# Rms of single samples, along the tracks and across them.
MAX_OFF_CYCLES = 0.03
# With phases well mixed in every block the motion costs little information; this much more
# uncertainty than that says that the motion, not the noise, is to blame.
LOCKED_LOSS = 3.0

CHANGE_SPEED = (
    "run the machine through many cycles, at a speed that is neither a whole number of cycles per "
    "sample nor a simple fraction of one"
)


def check_way(coverage: float, cycles: float) -> None:
    """Refuse a recording that meets too little of the cycle, or too few cycles."""
    if coverage < MIN_COVERAGE:
        locked = cycles >= MIN_CYCLES
        raise CalibrationError(
            f"only {100 * coverage:.0f} % of the cycle was sampled: {CHANGE_SPEED}",
            Reason.LOCKED if locked else Reason.COVERAGE,
        )
    if cycles < MIN_CYCLES:
        raise CalibrationError(
            f"the samples cover {cycles:.1f} cycles, too few: at least {MIN_CYCLES:.0f} are needed; "
            f"{CHANGE_SPEED}",
            Reason.CYCLES,
        )


def check_smooth(off_cycles: float, loss: float) -> None:
    """Refuse positions that lie far from any smooth motion."""
    if off_cycles > MAX_OFF_CYCLES:
        raise no_fit(f"the positions are {off_cycles:.2f} cycle rms away from any smooth motion", loss)


def no_fit(what: str, loss: float) -> CalibrationError:
    """The error for tracks and motion that cannot be separated.

    ``loss``: how many times the uncertainty grows because the motion has to be found as well.
    """
    if loss > LOCKED_LOSS:
        return CalibrationError(
            f"{what}: the motion is almost locked to the samples; {CHANGE_SPEED}", Reason.LOCKED
        )
    return CalibrationError(
        f"{what}: noise, too much acceleration between samples, or uneven sample times that are not known",
        Reason.NOISE,
    )


def judge(found: Calibration, loss: float = 1.0) -> Calibration:
    """The calibration if it can be used, else CalibrationError with it and the reason."""
    try:
        check_way(found.coverage, found.cycles_used)
        if found.uncertainty_rms > MAX_UNCERTAINTY_CYCLES:
            raise no_fit(f"the table would be uncertain by {found.uncertainty_rms:.1e} cycle rms", loss)
    except CalibrationError as error:
        refused = replace(found, reason=Reason(error.reason))
        raise CalibrationError(str(error), error.reason, refused) from None
    return found
