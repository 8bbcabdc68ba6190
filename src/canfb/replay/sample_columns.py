"""The feedbacks of a replay as columns, in blocks of bounded size."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from canfb import objects as od
from canfb.module.feedback_module import FeedbackModule
from canfb.signal.chain_config import ChainLimits
from canfb.signal.feedback import Feedback

BLOCK_ROWS = 1 << 12

Block = npt.NDArray[np.void]
"""A structured array: a column by its name, ``block["status"]``."""

COLUMNS: dict[str, Any] = {
    "time_s": np.float64,
    "position": np.int64,
    "sine_counts": np.int32,
    "cosine_counts": np.int32,
    "interval_s": np.float64,
    "amplitude_counts": np.float64,
    "raw_phase": np.float64,
    "cycles": np.int64,
    "phase": np.float64,
    "residual": np.float64,
    "status": np.uint16,
    "speed_cycles": np.float64,
    "acceleration_cycles": np.float64,
    "jump_cycles": np.int64,
    "samples": np.int64,
    "residual_limit": np.float64,
    "amplitude_low_counts": np.int32,
    "amplitude_high_counts": np.int32,
    "acceleration_limit_cycles": np.float64,
    "cycles_per_revolution": np.int64,
}
"""One row for each sampling interval, also for one without a sample (status bit 6), and the types.

time_s             stamp of the log, seconds
position           6004h
sine_counts, ...   ADC counts as they came; those of before for a sample that was missed
interval_s         the sampling interval, 0.0 while it is not known
amplitude_counts to samples   the fields of :class:`canfb.signal.feedback.Feedback`
residual_limit to cycles_per_revolution   the limits in force
"""

_DTYPE = np.dtype(list(COLUMNS.items()))
_CYCLES = Feedback._fields.index("cycles") - 2
_LARGEST_COUNT = (1 << 63) - 1  # 2011:04 is INTEGER64 as well


class SampleColumns:
    """Collects what ``module`` makes of each sample, and gives full blocks to ``takers``.

    With several samples for each SYNC a row is the newest. The ones before it come in blocks of their own to
    ``earlier_takers``: with the stages of the feedback, and time, position and counts of the newest.
    ``origin_s`` is added to the times of the module. Call :meth:`flush` at the end.
    """

    def __init__(
        self,
        module: FeedbackModule,
        takers: Sequence[Callable[[Block], None]],
        earlier_takers: Sequence[Callable[[Block], None]] = (),
    ) -> None:
        self.origin_s = 0.0
        self.rows = 0
        self._module = module
        self._takers, self._earlier_takers = takers, earlier_takers
        entry = module.dictionary.entry
        self._entries = [entry(*place) for place in (od.POSITION_VALUE, od.SAMPLE_SINE, od.SAMPLE_COSINE)]
        self._limits: ChainLimits | None = None
        self._collected: list[tuple[Any, ...]] = []
        self._earlier: list[tuple[Any, ...]] = []

    def take(self, feedback: Feedback, now: float) -> None:
        module = self._module
        if module.limits is not self._limits:
            self._limits = module.limits
            self._limit_values = _limit_values(module.limits)
        position, sine, cosine = self._entries
        before = (now + self.origin_s, position.value, sine.value, cosine.value, module.interval_s)
        self._collected.append((*before, *_stages(feedback), *self._limit_values))
        for one in module.chain.between:
            self._earlier.append((*before, *_stages(one), *self._limit_values))
        if len(self._collected) == BLOCK_ROWS:
            self.flush()

    def flush(self) -> None:
        self.rows += len(self._collected)
        for collected, takers in ((self._collected, self._takers), (self._earlier, self._earlier_takers)):
            block = np.array(collected, _DTYPE)
            collected.clear()
            for take in takers if len(block) else ():
                take(block)


def _stages(feedback: Feedback) -> tuple[Any, ...]:
    stages = feedback[2:]
    if -_LARGEST_COUNT <= feedback.cycles <= _LARGEST_COUNT:
        return stages
    cycles = _LARGEST_COUNT if feedback.cycles > 0 else -_LARGEST_COUNT
    return (*stages[:_CYCLES], cycles, *stages[_CYCLES + 1 :])


def _limit_values(limits: ChainLimits) -> tuple[float, ...]:
    sample = limits.sample
    return (
        limits.residual_limit,
        sample.amplitude_low_counts,
        sample.amplitude_high_counts,
        limits.acceleration or 0.0,
        limits.cycles_per_revolution,
    )
