"""Why the position was lost the last time, objects 2012:10..16.

A module that says no more than "lost" leaves its user to guess between a bus that stalled, a limit that is
too narrow and a dirty encoder. So it keeps what it knew in the sample of the loss, until a reset.
"""

from __future__ import annotations

from collections.abc import Callable

from canfb import objects as od
from canfb.device.od.dictionary import Dictionary
from canfb.module.parameters import Limits
from canfb.objects import LossCause
from canfb.signal.chain import SignalChain
from canfb.signal.feedback import Feedback
from canfb.signal.supervision import AMPLITUDE, CLIPPED, FROZEN, LOST, MISSED, RESIDUAL, VALID

U32 = 0xFFFFFFFF
SIXTEEN_BITS = 65536.0
BAD = MISSED | AMPLITUDE | CLIPPED | FROZEN | RESIDUAL
FAULTS = sum(od.FAULT_WORDS)
NEVER_SEEN = -1


class LastLoss:
    """Keeps the last loss, and gives it to 2012:10..16. All are 0 before there is one.

    :meth:`follow` must see each sample that has a fault or whose position is lost, in order.
    ``now()`` is in seconds.
    """

    def __init__(
        self, dictionary: Dictionary, limits: Limits, chain: SignalChain, now: Callable[[], float]
    ) -> None:
        self._limits, self._chain, self._now = limits, chain, now
        for place, read in (
            (od.COUNTER_LOSS_CAUSE, lambda: int(self.cause)),
            (od.COUNTER_LOSS_AGE, self._since_ms),
            (od.COUNTER_LOSS_BAD, lambda: self.bad_samples),
            (od.COUNTER_LOSS_RESIDUAL, lambda: self._residual),
            (od.COUNTER_LOSS_LIMIT, lambda: self._limit),
            (od.COUNTER_LOSS_SPEED, lambda: self._speed),
            (od.COUNTER_LOSS_FAULTS, lambda: self.faults),
        ):
            dictionary.entry(*place).on_read = read
        self.reset()

    def reset(self) -> None:
        """After a reset: not lost since."""
        self.cause = LossCause.NONE
        self.bad_samples = 0
        """Samples in a row that were missed or bad, the one of the loss among them."""
        self.faults = 0
        """Bits of the status word of all samples since the last valid one."""
        self._lost_s = 0.0
        self._residual = self._limit = self._speed = 0
        self._before = NEVER_SEEN  # number of the last sample with a fault
        self._begin_row()
        self._is_lost = False

    def _begin_row(self) -> None:
        self._bad = self._row_faults = 0

    def follow(self, feedback: Feedback) -> None:
        """A sample with a fault, or without a valid position."""
        status, number = feedback.status, feedback.samples
        if number != self._before + 1:
            self._begin_row()
        self._before = number
        if status & VALID:
            self._begin_row()
            self._is_lost = False
            return
        self._bad = self._bad + 1 if status & BAD else 0
        self._row_faults |= status & FAULTS
        if status & LOST and not self._is_lost:
            self._keep(feedback)
        self._is_lost = bool(status & LOST)

    def _keep(self, feedback: Feedback) -> None:
        limits = self._limits.in_force
        self.cause = self._chain.loss_cause
        self.bad_samples, self.faults = self._bad, self._row_faults
        self._lost_s = self._now()
        self._residual = min(round(feedback.residual * SIXTEEN_BITS), U32)
        self._limit = min(round(limits.residual_limit * SIXTEEN_BITS), U32)
        self._speed = min(round(abs(feedback.speed_cycles) * SIXTEEN_BITS), U32)

    def _since_ms(self) -> int:
        if not self.cause:
            return 0
        return max(0, min(round((self._now() - self._lost_s) * 1e3), U32))
