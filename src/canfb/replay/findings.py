"""What is found in the samples of a replay, block by block: faults, margins, drift, an overview for pictures.

Each is given the blocks by its ``take`` and keeps a bounded amount of them, however long the log is: the
faults that are listed, the sample nearest to each limit, the first samples in motion (as a reference
measurement, against the table in force), and the extremes of stretches of time, which double in length when
there are too many.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from canfb.calibration.deviation import drift
from canfb.calibration.from_motion import calibrate_from_motion
from canfb.calibration.path_correction import sampled_together
from canfb.calibration.recording import recording
from canfb.errors import CalibrationError
from canfb.objects import StatusBit
from canfb.replay.sample_columns import Block
from canfb.signal.correction import Correction
from canfb.signal.phase import FloatArray

KINDS = {
    "missed": StatusBit.MISSED,
    "residual": StatusBit.RESIDUAL,
    "amplitude": StatusBit.AMPLITUDE,
    "clipped": StatusBit.CLIPPED,
    "frozen": StatusBit.FROZEN,
    "coarse": StatusBit.COARSE,
    "second": StatusBit.SECOND_POSITION,
    "coasting": StatusBit.COASTING,
    "lost": StatusBit.LOST,
}
"""Kinds of faults, and the bit of the status word that shows each."""
MOST_LISTED = 1000
"""Of each kind; all are counted."""
EMERGENCY = struct.Struct("<HB")


@dataclass
class LoggedFault:
    """One that lasted for so many intervals: when it began and when it was last there (stamps, seconds)."""

    kind: str
    begin_s: float
    end_s: float
    samples: int


@dataclass(frozen=True)
class SentEmergency:
    """An EMCY of the replay: stamp of the log (seconds), error code, 1001h, and the manufacturer's bytes."""

    time_s: float
    code: int
    register: int
    manufacturer: bytes


@dataclass
class FaultList:
    """All faults of a replay.

    samples   intervals with this fault, by kind
    times     how often it began
    listed    the first :data:`MOST_LISTED` of each kind, in the order in which they begin
    """

    samples: dict[str, int] = field(default_factory=lambda: dict.fromkeys(KINDS, 0))
    times: dict[str, int] = field(default_factory=lambda: dict.fromkeys(KINDS, 0))
    listed: list[LoggedFault] = field(default_factory=list)
    emergencies: list[SentEmergency] = field(default_factory=list)
    emergencies_sent: int = 0
    _open: dict[str, LoggedFault] = field(default_factory=dict)

    def take(self, block: Block) -> None:
        """More intervals."""
        status, times = block["status"], block["time_s"]
        present = int(np.bitwise_or.reduce(status))
        for kind, bit in KINDS.items():
            if present & bit:
                self._take_kind(kind, status & bit != 0, times)
            else:
                self._open.pop(kind, None)

    def _take_kind(self, kind: str, there: np.ndarray, times: np.ndarray) -> None:
        self.samples[kind] += int(there.sum())
        steps = np.diff(there.astype(np.int8), prepend=0, append=0)
        begins, ends = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
        carried = self._open.pop(kind, None)
        for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
            last_s = float(times[end - 1])
            if carried is not None and begin == 0:
                fault, fault_samples = carried, carried.samples
                fault.end_s, fault.samples = last_s, fault_samples + end
            else:
                fault = LoggedFault(kind, float(times[begin]), last_s, end - begin)
                self.times[kind] += 1
                if self.times[kind] <= MOST_LISTED:
                    self.listed.append(fault)
            if end == len(there):
                self._open[kind] = fault

    def emergency(self, data: bytes, time_s: float) -> None:
        """The module has sent an EMCY."""
        self.emergencies_sent += 1
        if len(data) == 8 and len(self.emergencies) < MOST_LISTED:
            code, register = EMERGENCY.unpack_from(data)
            self.emergencies.append(SentEmergency(time_s, code, register, data[3:]))

    def in_order(self) -> list[LoggedFault]:
        """The faults listed, as they began."""
        return sorted(self.listed, key=lambda fault: (fault.begin_s, fault.kind))


BoolArray = npt.NDArray[np.bool_]


@dataclass
class Extreme:
    """The value that came nearest to its limit: when (stamp of the log, seconds), and the limit then.

    ``margin`` is the part of the limit that was left, 1 - value/limit (limit/value for a lower limit);
    below 0 it was passed. NaN before there was any value.
    """

    value: float = math.nan
    limit: float = math.nan
    time_s: float = math.nan
    margin: float = math.nan

    def look(
        self,
        block: Block,
        value: npt.NDArray[np.float64],
        limit: npt.NDArray[np.float64],
        *,
        lower: bool = False,
    ) -> None:
        """At more values with their limits, which are ``lower`` ones or not; NaN is none."""
        with np.errstate(divide="ignore", invalid="ignore"):
            margins = 1.0 - (limit / value if lower else value / limit)
        margins = np.where(np.isfinite(value) & np.isfinite(limit), margins, np.nan)
        if np.isnan(margins).all():
            return
        place = int(np.nanargmin(margins))
        if not self.margin <= margins[place]:
            self.value, self.limit = float(value[place]), float(limit[place])
            self.time_s, self.margin = float(block["time_s"][place]), float(margins[place])


@dataclass
class Margins:
    """Of all samples that came, also of those before the newest of a SYNC.

    residual          cycles, against the residual limit; while the position was followed
    amplitude_low, amplitude_high   counts, after conditioning
    acceleration      cycles per interval squared, against the residual limit: what eq. 9 leaves of an
                      acceleration is the residual (eq. 10)
    machine_acceleration   the same against 2010:02, if that is set
    speed_rad_s       the largest; its limit is what the SYNC jitter allows, inf with sample times
    acceleration_rad_s2    the largest
    """

    residual: Extreme = field(default_factory=Extreme)
    amplitude_low: Extreme = field(default_factory=Extreme)
    amplitude_high: Extreme = field(default_factory=Extreme)
    acceleration: Extreme = field(default_factory=Extreme)
    machine_acceleration: Extreme = field(default_factory=Extreme)
    speed_rad_s: Extreme = field(default_factory=Extreme)
    acceleration_rad_s2: float = 0.0
    max_speed_rad_s: float = math.inf
    """What the jitter allows, as the module last knew it; set by the replay."""

    def take(self, block: Block) -> None:
        """More samples."""
        status = block["status"]
        came = status & StatusBit.MISSED == 0
        followed = came & (status & (StatusBit.COASTING | StatusBit.LOST) == 0)
        limit = block["residual_limit"]
        # A residual over its limit is coasted over: it counts as well. Samples coasted for another reason
        # have none.
        compared = came & (status & StatusBit.LOST == 0) & ((followed) | (status & StatusBit.RESIDUAL != 0))
        residual = _where(compared & (block["samples"] > 2), block["residual"])
        self.residual.look(block, residual, limit)
        amplitude = _where(came, block["amplitude_counts"])
        low = block["amplitude_low_counts"].astype(np.float64)
        self.amplitude_low.look(block, amplitude, low, lower=True)
        self.amplitude_high.look(block, amplitude, block["amplitude_high_counts"].astype(np.float64))
        self._take_motion(block, followed & (status & StatusBit.VALID != 0))

    def _take_motion(self, block: Block, valid: BoolArray) -> None:
        acceleration = _where(valid, np.abs(block["acceleration_cycles"]))
        self.acceleration.look(block, acceleration, block["residual_limit"])
        known = block["acceleration_limit_cycles"]
        self.machine_acceleration.look(block, acceleration, _where(known > 0.0, known))
        interval_s = _where(valid & (block["interval_s"] > 0.0), block["interval_s"])
        rad = 2.0 * math.pi / block["cycles_per_revolution"]
        speed = np.abs(block["speed_cycles"]) * rad / interval_s
        fastest = np.full(len(speed), self.max_speed_rad_s)
        if math.isinf(self.max_speed_rad_s):
            self._note_speed(block, speed)
        else:
            self.speed_rad_s.look(block, speed, fastest)
        squared = acceleration * rad / interval_s**2
        if not np.isnan(squared).all():
            self.acceleration_rad_s2 = max(self.acceleration_rad_s2, float(np.nanmax(squared)))

    def _note_speed(self, block: Block, speed: npt.NDArray[np.float64]) -> None:
        if np.isnan(speed).all():
            return
        place = int(np.nanargmax(speed))
        if not self.speed_rad_s.value >= speed[place]:
            self.speed_rad_s = Extreme(float(speed[place]), math.inf, float(block["time_s"][place]), 1.0)


def _where(chosen: BoolArray, values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return np.where(chosen, values, np.nan)


MOST_MEASURED = 1 << 15
"""So many samples of a log are measured: enough for a table, and of bounded time."""
LEAST_SAMPLES = 1000


@dataclass(frozen=True)
class LogDrift:
    """Cycles, without the constant part; NaN and a ``reason`` where the log does not show it."""

    rms: float = float("nan")
    peak: float = float("nan")
    uncertainty_rms: float = float("nan")
    reason: str | None = None


class DriftTracks:
    """Keeps the first samples from the first motion on, as they came; give it blocks."""

    def __init__(self) -> None:
        self._sine: list[FloatArray] = []
        self._cosine: list[FloatArray] = []
        self._hertz: list[FloatArray] = []
        self._samples = 0
        self._moved = False

    def take(self, block: Block) -> None:
        """More samples."""
        cycles = block["cycles"]
        self._moved = self._moved or int(cycles.max()) - int(cycles.min()) > 1
        if not self._moved or self._samples >= MOST_MEASURED:
            return
        missed = block["status"] & StatusBit.MISSED != 0
        for kept, name in ((self._sine, "sine_counts"), (self._cosine, "cosine_counts")):
            kept.append(np.where(missed, np.nan, block[name].astype(np.float64)))
        interval_s = np.where(block["interval_s"] > 0.0, block["interval_s"], np.inf)
        self._hertz.append(block["speed_cycles"] / interval_s)
        self._samples += len(missed)

    def drift(self, active: Correction, adc_bits: int) -> LogDrift:
        """Against the ``active`` table and conditioning."""
        if self._samples < LEAST_SAMPLES:
            return LogDrift(reason="no motion" if not self._moved else "few samples")
        sine, cosine = np.concatenate(self._sine), np.concatenate(self._cosine)
        try:
            cosine = self._together(sine, cosine, active.conditioning.cosine_delay_s, adc_bits)
            fresh = calibrate_from_motion(sine, cosine, active.conditioning, adc_bits=adc_bits)
            found = drift(fresh, active.table, active.conditioning)
        except CalibrationError as error:
            return LogDrift(reason=str(error.reason))
        except ValueError as error:
            return LogDrift(reason=" ".join(str(error).split()))
        return LogDrift(found.rms, found.peak, fresh.uncertainty_rms)

    def _together(
        self, sine: FloatArray, cosine: FloatArray, cosine_delay_s: float, adc_bits: int
    ) -> FloatArray:
        """The cosine at the instant of the sine."""
        if not cosine_delay_s:
            return cosine
        record = recording(sine, cosine, None, None, adc_bits, may_be_offset=True)
        turned = 2.0 * np.pi * cosine_delay_s * np.concatenate(self._hertz)
        return np.where(np.isnan(cosine), np.nan, sampled_together(record, turned))


MOST_STRETCHES = 2048
STRETCH_ROWS = 16
MOST_SAMPLES = 16384
FAULTY = int(np.bitwise_or.reduce([int(bit) for bit in KINDS.values()]))

# What of a stretch is kept: the column, and how.
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
    """Give it blocks by :meth:`take`.

    ``stretches`` has, for each stretch: begin_s (stamp of the log), residual (the largest) and its limit,
    amplitude_least, amplitude_most and their limits (counts), speed_least, speed_most (rad/s), and faults
    (intervals with one). ``sine`` and ``cosine`` are ADC counts of some samples, evenly chosen.
    """

    def __init__(self) -> None:
        self.stretches: dict[str, FloatArray] = {name: np.empty(0) for name in _KEPT}
        self.sine, self.cosine = np.empty(0), np.empty(0)
        self._stride = 1

    def take(self, block: Block) -> None:
        """More samples."""
        columns = dict(block)
        came = block["status"] & StatusBit.MISSED == 0
        columns["faulty"] = (block["status"] & FAULTY != 0).astype(np.float64)
        columns["residual"] = np.where(came, block["residual"], np.nan)
        columns["amplitude_counts"] = np.where(came, block["amplitude_counts"], np.nan)
        columns["speed_rad_s"] = _speed(block)
        begins = np.arange(0, len(came), STRETCH_ROWS)
        for name, (column, how) in _KEPT.items():
            reduced = how.reduceat(columns[column].astype(np.float64), begins)
            self.stretches[name] = np.concatenate([self.stretches[name], reduced])
        while len(self.stretches["begin_s"]) > MOST_STRETCHES:
            self._merge()
        self._take_samples(block, came)

    def _merge(self) -> None:
        """Two stretches each become one."""
        pairs = np.arange(0, len(self.stretches["begin_s"]), 2)
        for name, (_, how) in _KEPT.items():
            self.stretches[name] = how.reduceat(self.stretches[name], pairs)

    def _take_samples(self, block: Block, came: npt.NDArray[np.bool_]) -> None:
        chosen = np.flatnonzero(came)[:: self._stride]
        self.sine = np.concatenate([self.sine, block["sine_counts"][chosen].astype(np.float64)])
        self.cosine = np.concatenate([self.cosine, block["cosine_counts"][chosen].astype(np.float64)])
        while len(self.sine) > MOST_SAMPLES:
            self.sine, self.cosine, self._stride = self.sine[::2], self.cosine[::2], 2 * self._stride


def _speed(block: Block) -> FloatArray:
    interval_s = np.where(block["interval_s"] > 0.0, block["interval_s"], np.nan)
    valid = block["status"] & StatusBit.VALID != 0
    speed = block["speed_cycles"] * 2.0 * np.pi / block["cycles_per_revolution"] / interval_s
    return np.where(valid, speed, np.nan)
