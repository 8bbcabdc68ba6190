"""Evaluation of the samples of a replay, block by block: faults, margins, drift, an overview for pictures.

Each ``take`` uses bounded memory.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from canfb import objects as od
from canfb.calibration.methods import calibrate_from_motion
from canfb.calibration.over_speeds import sampled_together
from canfb.calibration.recording import recording
from canfb.calibration.result import drift, runs
from canfb.errors import CalibrationError
from canfb.module.feedback_module import FeedbackModule
from canfb.signal.correction import Correction
from canfb.signal.phase import BoolArray, FloatArray
from canfb.signal.sample import Feedback

BLOCK_ROWS = 1 << 12

Block = npt.NDArray[np.void]  # A structured array: a column by its name, ``block["status"]``.

# Columns and types of the rows: one for each sampling interval, also without a sample (status bit 6).
#
# time_s             stamp of the log, seconds
# position           6004h
# sine_counts, ...   ADC counts as received; the previous ones for a missed sample
# interval_s         the sampling interval, 0.0 while unknown
# amplitude_counts to samples   the fields of :class:`canfb.signal.sample.Feedback`
# residual_limit to cycles_per_revolution   the limits in force
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

_DTYPE = np.dtype(list(COLUMNS.items()))
_CYCLES = Feedback._fields.index("cycles") - 2
_LARGEST_COUNT = (1 << 63) - 1  # 2011:04 is INTEGER64 as well


class SampleColumns:
    """Collects the results of ``module`` for each sample, and passes full blocks to ``takers``.

    With several samples for each SYNC a row is the newest. The earlier ones are passed to ``earlier_takers``
    in separate blocks: with the stages of the feedback, but time, position and counts of the newest.
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
        self._collected: list[tuple[Any, ...]] = []
        self._earlier: list[tuple[Any, ...]] = []

    def take(self, feedback: Feedback, now: float) -> None:
        module = self._module
        position, sine, cosine = self._entries
        limits, sample = module.limits, module.limits.sample
        in_force = (
            limits.residual_limit,
            sample.amplitude_low_counts,
            sample.amplitude_high_counts,
            limits.acceleration or 0.0,
            limits.cycles_per_revolution,
        )
        before = (now + self.origin_s, position.value, sine.value, cosine.value, module.interval_s)
        self._collected.append((*before, *_stages(feedback), *in_force))
        self._earlier += [(*before, *_stages(one), *in_force) for one in module.chain.between]
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
    stages, cycles = feedback[2:], max(-_LARGEST_COUNT, min(feedback.cycles, _LARGEST_COUNT))
    return (*stages[:_CYCLES], cycles, *stages[_CYCLES + 1 :])


# Kinds of faults, and their bits of the status word.
KINDS = {
    "missed": od.StatusBit.MISSED,
    "residual": od.StatusBit.RESIDUAL,
    "amplitude": od.StatusBit.AMPLITUDE,
    "clipped": od.StatusBit.CLIPPED,
    "frozen": od.StatusBit.FROZEN,
    "coarse": od.StatusBit.COARSE,
    "second": od.StatusBit.SECOND_POSITION,
    "coasting": od.StatusBit.COASTING,
    "lost": od.StatusBit.LOST,
}
MOST_LISTED = 1000  # Of each kind; all are counted.


@dataclass
class LoggedFault:
    """A fault: its beginning (stamp, seconds), and duration in intervals."""

    kind: str
    begin_s: float
    samples: int


@dataclass
class FaultList:
    """All faults of a replay.

    samples   intervals with this fault, by kind
    times     number of faults, by kind
    listed    the first :data:`MOST_LISTED` of each kind
    """

    samples: dict[str, int] = field(default_factory=lambda: dict.fromkeys(KINDS, 0))
    times: dict[str, int] = field(default_factory=lambda: dict.fromkeys(KINDS, 0))
    listed: list[LoggedFault] = field(default_factory=list)
    _open: dict[str, LoggedFault] = field(default_factory=dict)

    def take(self, block: Block) -> None:
        for kind, bit in KINDS.items():
            there = block["status"] & bit != 0
            self.samples[kind] += int(there.sum())
            goes_on = self._open.pop(kind, None)
            for begin, end in runs(there).tolist():
                if begin == 0 and goes_on is not None:
                    fault = goes_on
                    fault.samples += end
                else:
                    fault = LoggedFault(kind, float(block["time_s"][begin]), end - begin)
                    self.times[kind] += 1
                    self.listed += [fault] * (self.times[kind] <= MOST_LISTED)
                if end == len(there):
                    self._open[kind] = fault


BEGIN_SAMPLES = 64


class Extreme(NamedTuple):
    """The value nearest to its limit, with the limit and time (stamp of the log, seconds) of that sample.

    ``margin`` is 1 - value/limit (1 - limit/value for a lower limit); below 0 the limit was exceeded. NaN
    before the first value.
    """

    value: float = math.nan
    limit: float = math.nan
    time_s: float = math.nan
    margin: float = math.nan


class Margins:
    """Margins of all received samples, also earlier ones of a SYNC: an :class:`Extreme` for each of

    residual            cycles, against the residual limit; while the position was followed
    amplitude_low, amplitude_high   counts, after conditioning
    acceleration_cycles cycles per interval squared, against the residual limit: an acceleration gives a
                        residual of that size (eq. 10)
    speed_rad_s         the largest; SYNC jitter sets its limit, inf with sample times
    """

    def __init__(self, max_speed_rad_s: Callable[[], float]) -> None:
        self.nearest = dict.fromkeys(
            ("residual", "amplitude_low", "amplitude_high", "acceleration_cycles", "speed_rad_s"), Extreme()
        )
        self.acceleration_rad_s2 = 0.0  # The largest.
        # Distance over the first samples, modulo whole cycles between two of them.
        self.begin_cycles = math.nan
        self._max_speed_rad_s = max_speed_rad_s  # the limit by jitter, from the module

    def take(self, block: Block) -> None:
        status = block["status"]
        came = status & od.StatusBit.MISSED == 0
        if math.isnan(self.begin_cycles):
            turns = np.diff(block["raw_phase"][:BEGIN_SAMPLES])
            self.begin_cycles = float(np.nansum(np.abs((turns + 0.5) % 1.0 - 0.5)))
        # Samples coasted because of their residual count; those coasted for another reason have none.
        coasted = (status & od.StatusBit.COASTING != 0) & (status & od.StatusBit.RESIDUAL == 0)
        compared = came & (status & od.StatusBit.LOST == 0) & ~coasted & (block["samples"] > 2)
        self._look("residual", block, _where(compared, block["residual"]), block["residual_limit"])
        amplitude = _where(came, block["amplitude_counts"])
        self._look("amplitude_low", block, amplitude, block["amplitude_low_counts"])
        self._look("amplitude_high", block, amplitude, block["amplitude_high_counts"])
        valid = status & od.StatusBit.VALID != 0
        acceleration = _where(valid, np.abs(block["acceleration_cycles"]))
        self._look("acceleration_cycles", block, acceleration, block["residual_limit"])
        rad, interval_s = _units(block)
        speed = _where(valid, np.abs(block["speed_cycles"])) * rad / interval_s
        self._look("speed_rad_s", block, speed, np.full(len(speed), self._max_speed_rad_s()))
        squared = acceleration * rad / interval_s**2
        self.acceleration_rad_s2 = float(np.fmax.reduce(squared, initial=self.acceleration_rad_s2))

    def _look(self, name: str, block: Block, value: FloatArray, limit: npt.NDArray[Any]) -> None:
        with np.errstate(divide="ignore", invalid="ignore"):
            margins = 1.0 - (limit / value if name == "amplitude_low" else value / limit)
        usable = np.flatnonzero(np.isfinite(value) & ~np.isnan(limit))
        if len(usable):
            place = usable[np.lexsort((-value[usable], margins[usable]))[0]]
            found = Extreme(*(float(one[place]) for one in (value, limit, block["time_s"], margins)))
            before = self.nearest[name]
            if not (before.margin, -before.value) <= (found.margin, -found.value):
                self.nearest[name] = found


def _where(chosen: BoolArray, values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return np.where(chosen, values, np.nan)


def _units(block: Block) -> tuple[FloatArray, FloatArray]:
    """Radians per cycle, seconds per interval (NaN: not known)."""
    return 2.0 * np.pi / block["cycles_per_revolution"], _where(
        block["interval_s"] > 0.0, block["interval_s"]
    )


MOST_MEASURED = 1 << 15  # Samples of a log that are used for the drift: sufficient for a table.
LEAST_SAMPLES = 1000


@dataclass(frozen=True)
class LogDrift:
    """Drift in cycles, without its constant part; NaN and a ``reason`` if the log does not show it."""

    rms: float = math.nan
    peak: float = math.nan
    uncertainty_rms: float = math.nan
    reason: str | None = None


class DriftTracks:
    """Keeps the first raw samples after the first motion."""

    def __init__(self) -> None:
        self._blocks: list[Block] = []

    def take(self, block: Block) -> None:
        moved = self._blocks or np.ptp(block["cycles"]) > 1
        if moved and len(self._blocks) * BLOCK_ROWS < MOST_MEASURED:
            self._blocks.append(block)

    def drift(self, active: Correction, adc_bits: int) -> LogDrift:
        if sum(map(len, self._blocks)) < LEAST_SAMPLES:
            return LogDrift(reason="few samples" if self._blocks else "no motion")
        block = np.concatenate(self._blocks)
        came = block["status"] & od.StatusBit.MISSED == 0
        sine, cosine = (_where(came, block[name]) for name in ("sine_counts", "cosine_counts"))
        hertz = block["speed_cycles"] / np.where(block["interval_s"] > 0.0, block["interval_s"], np.inf)
        delay_s = active.conditioning.cosine_delay_s
        try:
            if delay_s:  # convert the cosine to the instant of the sine
                record = recording(sine, cosine, None, None, adc_bits, may_be_offset=True)
                cosine = sampled_together(record, 2.0 * np.pi * delay_s * hertz)
            fresh = calibrate_from_motion(sine, cosine, active.conditioning, adc_bits=adc_bits)
            found = drift(fresh, active.table, active.conditioning)
        except CalibrationError as error:
            return LogDrift(reason=str(error.reason))
        except ValueError as error:
            return LogDrift(reason=" ".join(str(error).split()))
        return LogDrift(found.rms, found.peak, fresh.uncertainty_rms)


MOST_STRETCHES = 2048
STRETCH_ROWS = 16
MOST_SAMPLES = 16384
FAULTY = int(np.bitwise_or.reduce([int(bit) for bit in KINDS.values()]))

# Summary of a stretch: the column, and the function that reduces it.
_KEPT: dict[str, tuple[str, Any]] = {
    "begin_s": ("time_s", np.minimum),
    "residual": ("residual", np.fmax),
    "residual_limit": ("residual_limit", np.minimum),
    "amplitude_least": ("amplitude_counts", np.fmin),
    "amplitude_most": ("amplitude_counts", np.fmax),
    "amplitude_low_counts": ("amplitude_low_counts", np.maximum),
    "amplitude_high_counts": ("amplitude_high_counts", np.minimum),
    "speed_least": ("speed_rad_s", np.fmin),
    "speed_most": ("speed_rad_s", np.fmax),
    "faults": ("faulty", np.add),
}


class Overview:
    """Summary of all blocks for pictures.

    ``stretches``: a column for each of ``_KEPT``, in s, cycles, counts, rad/s and intervals with a fault.
    ``sine`` and ``cosine``: ADC counts of samples at even intervals.
    """

    def __init__(self) -> None:
        self.stretches: dict[str, FloatArray] = {name: np.empty(0) for name in _KEPT}
        self.sine, self.cosine = np.empty(0), np.empty(0)
        self._stride = 1

    def take(self, block: Block) -> None:
        columns = {name: block[name] for name in COLUMNS}
        came = block["status"] & od.StatusBit.MISSED == 0
        columns["faulty"] = (block["status"] & FAULTY != 0).astype(np.float64)
        columns |= {name: _where(came, block[name]) for name in ("residual", "amplitude_counts")}
        rad, interval_s = _units(block)
        valid = block["status"] & od.StatusBit.VALID != 0
        columns["speed_rad_s"] = _where(valid, block["speed_cycles"]) * rad / interval_s
        begins = np.arange(0, len(came), STRETCH_ROWS)
        for name, (column, how) in _KEPT.items():
            reduced = how.reduceat(columns[column].astype(np.float64), begins)
            self.stretches[name] = np.concatenate([self.stretches[name], reduced])
        while len(self.stretches["begin_s"]) > MOST_STRETCHES:  # join two stretches each
            pairs = np.arange(0, len(self.stretches["begin_s"]), 2)
            for name, (_, how) in _KEPT.items():
                self.stretches[name] = how.reduceat(self.stretches[name], pairs)
        chosen = np.flatnonzero(came)[:: self._stride]
        self.sine = np.concatenate([self.sine, block["sine_counts"][chosen].astype(np.float64)])
        self.cosine = np.concatenate([self.cosine, block["cosine_counts"][chosen].astype(np.float64)])
        while len(self.sine) > MOST_SAMPLES:
            self.sine, self.cosine, self._stride = self.sine[::2], self.cosine[::2], 2 * self._stride
