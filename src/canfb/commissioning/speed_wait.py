"""Waiting until a machine turns steadily at one of several speeds, in whatever order they come."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from canfb.commissioning.access import CommissioningError, Master

NEAR_PART = 0.1  # of a speed: it is this one
STEADY_PART = 0.01  # of it, from the lowest to the highest of the last readings
STEADY_RPM = 0.5
READINGS, EVERY_S = 5, 0.3


def wait_for_speed(
    master: Master,
    read_rpm: Callable[[], float],
    wanted: Sequence[float],
    longest_s: float,
    heard: Callable[[float], None],
) -> float:
    """The one of ``wanted``, rpm, at which the machine turns steadily now.

    Where none of them is negative, it may turn either way. ``heard`` gets the part of the time that has
    passed. CommissioningError, with the speed that it has, after ``longest_s`` seconds.
    """
    began, last = master.now(), list[float]()
    while True:
        last = [*last[1 - READINGS :], read_rpm()]
        found = _steady_at(last, wanted)
        if found is not None:
            return found
        passed_s = master.now() - began
        if passed_s > longest_s:
            raise CommissioningError(
                f"the machine did not turn steadily at {listed(wanted)} rpm within {longest_s:g} s; it "
                f"turns at {last[-1]:.4g} rpm: --wait, or other --speeds"
            )
        heard(passed_s / longest_s)
        master.wait(EVERY_S)


def _steady_at(last: Sequence[float], wanted: Sequence[float]) -> float | None:
    if len(last) < READINGS:
        return None
    mean = math.fsum(last) / len(last)
    if max(last) - min(last) > max(STEADY_PART * abs(mean), STEADY_RPM):
        return None
    if min(wanted) > 0.0:
        mean = abs(mean)
    near = min(wanted, key=lambda rpm: abs(rpm - mean))
    return near if abs(near - mean) <= NEAR_PART * abs(near) else None


def listed(wanted: Sequence[float]) -> str:
    """Speeds in words."""
    words = [f"{rpm:g}" for rpm in wanted]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"
