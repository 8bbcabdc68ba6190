"""The last feedback, and where its position is, for all who publish it or compute from it."""

from __future__ import annotations

import math

from canfb.signal.chain import SignalChain
from canfb.signal.feedback import Feedback


class Latest:
    """``feedback`` is the last one, ``valid`` the last one with a valid position; None before the first.

    The tracks come late by 2002:07. With v and a of :meth:`Prediction.extrapolate`, cycles and intervals, the
    position at the instant of the sample is x + v l + a l (l + 1)/2, l that delay in sampling intervals.
    """

    __slots__ = ("_chain", "feedback", "valid")

    def __init__(self, chain: SignalChain) -> None:
        self._chain = chain
        self.forget()

    def forget(self) -> None:
        """After a reset of the node: no sample."""
        self.feedback: Feedback | None = None
        self.valid: Feedback | None = None

    def place(self, feedback: Feedback) -> tuple[int, float]:
        """Cycle count and phase, 0 <= phase < 1, at the instant of the sample."""
        lag = self._chain.lag_intervals
        if not lag:
            return feedback.cycles, feedback.phase
        way = (feedback.speed_cycles + feedback.acceleration_cycles * (1.0 + lag) * 0.5) * lag
        position = feedback.phase + way
        turns = math.floor(position)
        phase = position - turns
        return (feedback.cycles + turns, phase) if phase < 1.0 else (feedback.cycles + turns + 1, 0.0)
