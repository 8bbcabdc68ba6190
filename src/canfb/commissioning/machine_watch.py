"""Speed, status and counters of the module during a measurement."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from canfb import objects as od
from canfb.commissioning.access import CommissioningError, NodeAccess, ObjectAbsentError
from canfb.commissioning.lock_watch import Listening
from canfb.objects import PositionState, StatusBit, fault_words, position_state

MISSED, LOST = "missed samples", "position lost"
COUNTERS = {
    MISSED: od.COUNTER_MISSED,
    "residual": od.COUNTER_RESIDUAL,
    "amplitude": od.COUNTER_AMPLITUDE,
    "coasting": od.COUNTER_COASTED,
    LOST: od.COUNTER_LOST,
    "clipped": od.COUNTER_CLIPPED,
    "frozen": od.COUNTER_FROZEN,
    "coarse track": od.COUNTER_COARSE_DISAGREEMENTS,
}
"""Counters of 2012h of what is flagged."""
U32 = 1 << 32
READINGS_EVERY_S = 0.3
SHORTEST_S = 1e-6  # a rest of rounding is nothing to wait for
MORE_THAN_BEFORE = 3.0


@dataclass(frozen=True)
class Look:
    """The module at one time: status word (2011:01), cycle count (2011:04), counters of 2012h."""

    status: int
    cycles: int
    counters: Mapping[str, int]

    @property
    def is_lost(self) -> bool:
        """The position is lost."""
        return position_state(self.status) is PositionState.LOST


@dataclass(frozen=True)
class Meanwhile:
    """The module before and after samples were collected."""

    before: Look
    after: Look

    @property
    def is_lost(self) -> bool:
        """The position was lost before, or is so now."""
        return self.before.is_lost or self.after.is_lost

    @property
    def counted(self) -> dict[str, int]:
        """What it counted in between, of what it counted at all."""
        return counted(self.before.counters, self.after.counters)

    @property
    def missed(self) -> int:
        """Samples that it missed in between (2012:01)."""
        return self.counted.get(MISSED, 0)

    @property
    def cycles(self) -> int | None:
        """From its position before to that after; None where that is not known to have been valid."""
        valid = self.before.status & self.after.status & StatusBit.VALID
        if not valid or LOST in self.counted:
            return None
        return abs(self.after.cycles - self.before.cycles)


def look_at(module: NodeAccess) -> Look | None:
    """Status, cycle count and counters of the module; None if it does not say them."""
    try:
        return Look(
            module.integer(*od.FEEDBACK_STATUS, "H"),
            module.integer(*od.FEEDBACK_CYCLE_COUNT, "q"),
            read_counters(module),
        )
    except CommissioningError:
        return None


def lost_words(module: NodeAccess, status: int) -> str:
    """That its position is lost, with the cause that the status word has, and who knows more."""
    causes = fault_words(status)
    why = f" ({', '.join(causes)})" if causes else ""
    return (
        f"the position of {module.name} is lost{why}: canfb why {module.node_id:#04x} says why and what to do"
    )


@dataclass(frozen=True)
class SpeedReading:
    """The speed that the module says, rad/s, ``at`` this many intervals after the first sample."""

    at: float
    rad_per_s: float


class SpeedReadings:
    """Reads the speed of the module while samples are collected.

    CommissioningError from a reading if its position is not valid: its speed says nothing then.
    """

    def __init__(self, module: NodeAccess) -> None:
        self._module = module
        self._next_s = 0.0
        self.found: list[SpeedReading] = []

    def __call__(self, listening: Listening) -> bool:
        """Read, if it is time for it. False: the collection goes on."""
        if listening.elapsed_s < self._next_s or not listening.intervals:
            return False
        self._next_s = listening.elapsed_s + READINGS_EVERY_S
        before = listening.intervals
        speed = self.read()
        self.found.append(SpeedReading((before + listening.intervals) / 2.0 - 1.0, speed))
        return False

    def read(self) -> float:
        """The speed now, rad/s."""
        check_valid(self._module)
        speed = float(self._module.read(*od.FEEDBACK_VELOCITY, "f"))
        if not math.isfinite(speed):
            raise CommissioningError(f"{self._module.name}: its speed (2011:07) is {speed}")
        return speed


def check_valid(module: NodeAccess) -> None:
    """CommissioningError, with what to do, unless the position is valid."""
    status = module.integer(*od.FEEDBACK_STATUS, "H")
    if status & StatusBit.LOST:
        raise CommissioningError(
            f"{module.name}: the position is lost (2011:01), so its speed is not known: let the machine "
            "stand still, start the node again (NMT), and see that the present limits hold"
        )
    if not status & (StatusBit.VALID | StatusBit.COASTING):
        raise CommissioningError(
            f"{module.name} has no valid position (2011:01 is {status:04X}h): it must be OPERATIONAL "
            f"(NMT start, canfb nmt start {module.node_id:#04x}), and must receive SYNC and samples"
        )


def read_counters(module: NodeAccess) -> dict[str, int]:
    """The counters of the module, of those that it has."""
    found = {}
    for name, place in COUNTERS.items():
        try:
            found[name] = module.integer(*place, "I")
        except ObjectAbsentError:
            continue
    return found


def counted(before: Mapping[str, int], after: Mapping[str, int]) -> dict[str, int]:
    """What was counted in between, of what was counted at all."""
    steps = {name: (after[name] - count) % U32 for name, count in before.items() if name in after}
    return {name: step for name, step in steps.items() if step}


def watch(
    module: NodeAccess,
    duration_s: float,
    usual: Mapping[str, int],
    usual_s: float,
    heard: Callable[[float], None] = lambda part: None,
) -> None:
    """See for ``duration_s`` seconds that the module flags no more than before.

    ``usual`` was counted in ``usual_s`` seconds before. CommissioningError as soon as it flags more, or
    processes no samples.
    """
    master = module.master
    began, first = master.now(), read_counters(module)
    samples = module.integer(*od.FEEDBACK_SAMPLES, "I")
    while True:
        passed = master.now() - began
        more = {}
        for name, count in counted(first, read_counters(module)).items():
            known = usual.get(name, 0)
            expected = known * passed / usual_s
            if not known or count > MORE_THAN_BEFORE * (expected + 1.0):
                more[name] = count
        if more:
            raise CommissioningError(
                f"{module.name} flags samples with the new limits that it did not flag before: "
                f"{in_words(more)}"
            )
        heard(min(1.0, passed / duration_s))
        left = began + duration_s - master.now()
        if left < SHORTEST_S:
            break
        master.wait(min(READINGS_EVERY_S, left))
    check_valid(module)
    if module.integer(*od.FEEDBACK_SAMPLES, "I") == samples:
        raise CommissioningError(f"{module.name} has processed no sample with the new limits (2011:08)")


def in_words(counts: Mapping[str, int]) -> str:
    """3 residual, 1 amplitude."""
    return ", ".join(f"{count} {name}" for name, count in counts.items())
