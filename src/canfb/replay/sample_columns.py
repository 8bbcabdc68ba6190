"""The feedbacks of a replay as columns, in blocks of bounded size."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from canfb import objects as od
from canfb.module.feedback_module import FeedbackModule
from canfb.signal.chain_config import ChainLimits
from canfb.signal.feedback import Feedback

BLOCK_ROWS = 1 << 12

Block = Mapping[str, npt.NDArray[Any]]
"""Columns of equal length, by name."""

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

_LARGEST_COUNT = (1 << 63) - 1
# In the order in which they are collected: with Feedback and ChainLimits after them.
_TAKEN = ("time_s", "position", "sine_counts", "cosine_counts", "interval_s")
_FEEDBACK = dict(
    zip(
        ("amplitude_counts", "raw_phase", "cycles", "phase", "residual", "status", "speed_cycles",
         "acceleration_cycles", "jump_cycles", "samples"),
        Feedback._fields[2:],
        strict=True,
    )
)  # fmt: skip
_LIMITS = (
    "residual_limit",
    "amplitude_low_counts",
    "amplitude_high_counts",
    "acceleration_limit_cycles",
    "cycles_per_revolution",
)


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
        self._position = entry(*od.POSITION_VALUE)
        self._sine, self._cosine = entry(*od.SAMPLE_SINE), entry(*od.SAMPLE_COSINE)
        self._collected: list[tuple[Any, ...]] = []
        self._earlier: list[tuple[Any, ...]] = []

    def take(self, feedback: Feedback, now: float) -> None:
        """A feedback of the module."""
        module, collected = self._module, self._collected
        collected.append(
            (
                now + self.origin_s,
                self._position.value,
                self._sine.value,
                self._cosine.value,
                module.interval_s,
                feedback,
                module.limits,
            )
        )
        if module.chain.between:
            *before, _, limits = collected[-1]
            self._earlier += [(*before, one, limits) for one in module.chain.between]
        if len(collected) == BLOCK_ROWS:
            self.flush()

    def flush(self) -> None:
        """Hand on what was collected."""
        collected = self._collected
        if not collected:
            return
        block = _block(collected)
        self.rows += len(collected)
        collected.clear()
        for take in self._takers:
            take(block)
        if self._earlier:
            earlier = _block(self._earlier)
            self._earlier.clear()
            for take in self._earlier_takers:
                take(earlier)


def _block(rows: list[tuple[Any, ...]]) -> Block:
    *taken, feedbacks, limits = zip(*rows, strict=True)
    fields = dict(zip(Feedback._fields, zip(*feedbacks, strict=True), strict=True))
    columns: dict[str, Any] = dict(zip(_TAKEN, taken, strict=True))
    columns |= {name: fields[field] for name, field in _FEEDBACK.items()}
    columns["cycles"] = _within_64_bits(columns["cycles"])
    if limits.count(limits[0]) == len(limits):
        same = dict(zip(_LIMITS, _limit_values(limits[0]), strict=True))
        constant = {name: np.full(len(limits), value, COLUMNS[name]) for name, value in same.items()}
        return {
            name: np.array(columns[name], COLUMNS[name]) for name in COLUMNS if name in columns
        } | constant
    columns |= dict(zip(_LIMITS, zip(*map(_limit_values, limits), strict=True), strict=True))
    return {name: np.array(columns[name], kind) for name, kind in COLUMNS.items()}


def _limit_values(limits: ChainLimits) -> tuple[float, ...]:
    """In the order of their columns; 0.0 for an acceleration that is not known."""
    sample = limits.sample
    return (
        limits.residual_limit,
        sample.amplitude_low_counts,
        sample.amplitude_high_counts,
        limits.acceleration or 0.0,
        limits.cycles_per_revolution,
    )


def _within_64_bits(counts: tuple[int, ...]) -> Sequence[int]:
    """2011:04 is INTEGER64 as well."""
    if max(counts) <= _LARGEST_COUNT and min(counts) >= -_LARGEST_COUNT:
        return counts
    return [max(-_LARGEST_COUNT, min(one, _LARGEST_COUNT)) for one in counts]
