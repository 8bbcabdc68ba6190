"""Recovery for either order of prediction, and from one to the other while the machine runs."""

from __future__ import annotations

from canfb.signal.recovery.jerk_recovery import JerkRecovery
from canfb.signal.recovery.recovery import Recovery
from canfb.signal.third_order import THIRD, ThirdOrderTracker, check_order
from canfb.signal.tracker import Tracker


def recovery_of(order: int, residual_limit: float, coast_samples: int) -> Recovery:
    """A recovery with a tracker that predicts by this order, 2 or 3. ValueError for another one."""
    if check_order("prediction_order", order) == THIRD:
        return JerkRecovery(ThirdOrderTracker(residual_limit), coast_samples)
    return Recovery(Tracker(residual_limit), coast_samples)


def successor(old: Recovery, order: int, residual_limit: float) -> Recovery:
    """A recovery of another order that goes on where ``old`` is.

    The position is lost if it was in doubt, or if eq. 9 is to follow an acceleration that is not below its
    limit: phases show accelerations up to whole cycles per interval squared only.
    """
    new = recovery_of(order, residual_limit, old.coast_samples)
    acceleration, in_doubt = old.acceleration(), old.in_doubt
    new.take_over(old)
    if not new.lost and (in_doubt or (order != THIRD and abs(acceleration) >= residual_limit)):
        new.lose()
    return new
