"""A recording as a source: a CSV file with a header line, or an NPZ file of canfb."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from canfb.checks import within
from canfb.errors import CanfbError, ConfigError, saying
from canfb.signal.phase import ArrayLike, FloatArray, goes_round_off_zero
from canfb.signal.sample import TICK_S, Sample
from canfb.sources.protocol import Source, SourceConfig, SourceEnded, Surroundings, column
from canfb.sources.sample_files import Columns, read_columns, read_tracks

LARGEST_TIME_S = 1e12  # Limit of a time column; clocks of any epoch stay below.
MOST_SAMPLES = 1 << 25  # Nine hours at 1 kHz. Gaps let a few rows stand for any number of samples.
# If all values are below and some have a fraction, they are taken as volts, not counts.
LARGEST_VOLTS = 32.0
NEAR = 0.25  # Largest offset of an encoder, part of the amplitude.
LONG_STEP = 1.5  # A gap is longer than a short step of the file by this factor, however slow the recording.
SHORTEST_STEP_S = 1e-9  # Rows that are closer have no rate, so they cannot be stretched.


OF_CSV = ("columns", "mid_scale", "scale", "time_column", "gap_s", "gap_samples")


@dataclass(frozen=True)
class RecordingLayout:
    """Layout of the tracks in a recording.

    columns        names, or numbers from 0, of the sine and the cosine column (CSV)
    mid_scale      reading of a zero signal, any number of counts, or of the file's unit (CSV)
    time_column    column of times in seconds (CSV): a step above ``gap_s`` is a gap; None: none
    gap_s          the shortest gap, 1e-9..1e12 (CSV)
    gap_samples    samples missed at each gap, 1..1000000 (CSV)
    time_stamps    True: the time column is also the sample time (2000:05)
    scale          ADC counts per unit of the file, such as volts (CSV): any finite value but 0
    interval_s     interval of the rows without a time column, seconds
    paced          scale the times so that rows are ``interval_s`` apart
    """

    columns: Sequence[str | int] = field(default=("sine", "cosine"), metadata={"list": True})
    mid_scale: float = 0.0
    time_column: str | int | None = None
    gap_s: float = 0.1
    gap_samples: int = 20
    time_stamps: bool = False
    scale: float = 1.0
    interval_s: float = field(default=1e-3, metadata={"key": False})
    paced: bool = field(default=False, metadata={"key": False})


@dataclass(frozen=True, kw_only=True)
class RecordingSourceConfig(RecordingLayout, SourceConfig):
    """A recording, one row for each SYNC.

    file           CSV with a header line, or NPZ of ``canfb calibrate --out``; required
    """

    kind: str = "recording"
    file: str

    def __post_init__(self) -> None:
        super().__post_init__()
        within(
            self,
            file=str,
            mid_scale=float,
            scale=float,
            gap_s=(SHORTEST_STEP_S, LARGEST_TIME_S),
            gap_samples=(1, 1_000_000),
            time_stamps=bool,
        )
        if (
            not isinstance(self.columns, Sequence)
            or isinstance(self.columns, str)
            or len(self.columns) != 2
            or self.columns[0] == self.columns[1]
        ):
            raise ValueError(f"columns must be two, [sine, cosine], not {self.columns!r}")
        for name in self.columns:
            column("columns", name)
        if self.scale == 0.0:
            raise ValueError("scale must not be 0")
        if self.time_column is not None:
            column("time_column", self.time_column)
        if self.time_stamps and self.time_column is None:
            raise ValueError("time_stamps need a time_column")
        layout = {**vars(self), "columns": tuple(self.columns)}
        idle = [key for key in OF_CSV if layout[key] != getattr(RecordingLayout, key)]
        if idle and self.file.lower().endswith(".npz"):
            raise ValueError(f"{', '.join(idle)}: only for CSV, not for {self.file}")

    def check_machine(self) -> None:
        with saying(ConfigError, f"file {Path(self.file)} of source cannot be read", OSError):
            Path(self.file).open("rb").close()

    def open(self, surroundings: Surroundings) -> Source:
        return open_recording(self.file, self)


def chosen_layout(columns: str, mid_scale: float, scale: float, time_column: str | None) -> RecordingLayout:
    """The layout of the options of a command. ConfigError for an impossible one."""
    names = [name.strip() for name in columns.split(",")]
    if len(names) != 2 or names[0] == names[1]:
        raise ConfigError(f"--columns {columns}: two columns are required: sine,cosine")
    if not math.isfinite(mid_scale):
        raise ConfigError(f"--mid-scale {mid_scale:g}: must be a number")
    if not math.isfinite(scale) or scale == 0.0:
        raise ConfigError(f"--scale {scale:g}: must be a number of counts, not 0")
    return RecordingLayout((names[0], names[1]), mid_scale, time_column, scale=scale)


class RecordingSource:
    """Plays tracks, one sample for each SYNC; NaN: no sample. ``note``: how the file was read."""

    def __init__(
        self, sine: FloatArray, cosine: FloatArray, time_100ns: list[int] | None = None, note: str = ""
    ) -> None:
        self.tracks = sine, cosine
        self.note = note
        times = itertools.repeat(None) if time_100ns is None else time_100ns
        self._samples = zip(sine.tolist(), cosine.tolist(), times, strict=False)

    def next(self) -> Sample | None:
        try:
            sine, cosine, time = next(self._samples)
        except StopIteration:
            raise SourceEnded from None
        return None if math.isnan(sine + cosine) else Sample(sine, cosine, time_100ns=time)


def open_recording(file: str | Path, layout: RecordingLayout) -> RecordingSource:
    """Open a recording: an NPZ file of canfb (by its suffix; no layout needed), else CSV. CanfbError."""
    path = Path(file)
    if path.suffix.lower() == ".npz":
        sine, cosine, *_ = read_tracks(path)
        ticks = np.rint(np.arange(len(sine)) * (layout.interval_s / TICK_S)).astype(np.int64) & 0xFFFFFFFF
        return RecordingSource(sine, cosine, ticks.tolist() if layout.time_stamps else None)
    timed = () if layout.time_column is None else (layout.time_column,)
    columns = read_columns(path, [str(name) for name in (*layout.columns, *timed)])
    pairs = _counts(path, columns, layout)
    seconds: FloatArray = np.arange(len(pairs), dtype=np.float64) * layout.interval_s
    if timed:
        seconds = columns.values[:, 2]
        _check(path, columns, ~(np.abs(seconds) <= LARGEST_TIME_S), "{2} is not a time in seconds")
        _check(path, columns, np.diff(seconds, prepend=-np.inf) < 0.0, "the time goes back to {2:g} s")
    played = np.ones(len(pairs), np.int64)
    steps_s = np.diff(seconds) if timed and len(pairs) > 1 else np.zeros(1)
    slow_s = LONG_STEP * float(np.quantile(steps_s, 0.25, method="lower"))
    before_gap = np.flatnonzero(steps_s > max(layout.gap_s, slow_s))
    played[before_gap], pairs[before_gap] = max(layout.gap_samples, 1), np.nan
    if played.sum() > MOST_SAMPLES:
        raise CanfbError(
            f"{path}: with its gaps it has {played.sum()} samples; at most {MOST_SAMPLES} are read"
        )
    ticks = np.rint(seconds * _stretch(seconds, layout) / TICK_S)
    stamps = [int(tick) & 0xFFFFFFFF for tick in np.repeat(ticks, played)] if layout.time_stamps else None
    sine, cosine = np.repeat(pairs, played, axis=0).T
    return RecordingSource(sine, cosine, stamps, columns.note)


def _counts(path: Path, columns: Columns, layout: RecordingLayout) -> FloatArray:
    values = columns.values[:, :2]
    _check(
        path,
        columns,
        ~np.isfinite(values).all(axis=1),
        "a value in one of the selected columns is not a number",
    )
    largest = float(np.abs(values).max())
    if layout.scale == 1.0 and largest < LARGEST_VOLTS and (values != np.rint(values)).any():
        raise CanfbError(
            f"{path}: the largest value is {largest:g}: these are volts, and ADC counts are needed: set "
            "scale to 2^(bits - 1) / volts of full scale, and the bits of the converter (--scale, --adc-bits)"
        )
    centred = values - layout.mid_scale
    for side, sign in (("below", 1.0), ("above", -1.0)):
        if goes_round_off_zero(*(sign * centred.T)):
            raise CanfbError(
                f"{path}: the tracks are not centred, no reading is {side} {layout.mid_scale:g}: "
                f"{_remedy(values, layout)}"
            )
    counts: FloatArray = np.rint(centred * layout.scale)
    outside = ((counts < -32768) | (counts > 32767)).any(axis=1)
    message = "{0:.9g}, {1:.9g} does not fit INTEGER16: " + _remedy(values, layout)
    _check(path, columns._replace(values=counts), outside, message)
    return counts


def _remedy(values: FloatArray, layout: RecordingLayout) -> str:
    """Options that convert readings to signed 16-bit counts; mid-scale 2^(bits - 1) if near the middle."""
    low, high = values.min(axis=0), values.max(axis=0)
    middle, amplitude = float((low + high).mean()) / 2.0, float((high - low).max()) / 2.0
    zero = float(f"{middle:.3g}")
    if (values == np.rint(values)).all():
        converter = float(1 << int(max(high.max(), 1.0)).bit_length() - 1)
        zero = next((one for one in (0.0, converter) if abs(one - middle) < NEAR * amplitude), round(middle))
    reach = max(float(high.max()) - zero + 1.0, zero - float(low.min()))
    fits = f" --scale {0.5 ** math.ceil(math.log2(reach / 32768.0)):.10g}"
    scale = fits if reach * abs(layout.scale) > 32768.0 else ""
    return ((f"--mid-scale {zero:.10g}" if zero or layout.mid_scale else "") + scale).strip()


def _stretch(seconds: FloatArray, layout: RecordingLayout) -> float:
    if layout.time_column is None or not layout.paced or len(seconds) < 2:
        return 1.0
    step_s = float(np.median(np.diff(seconds)))
    return layout.interval_s / step_s if step_s > SHORTEST_STEP_S else 1.0


def _check(path: Path, columns: Columns, wrong: ArrayLike, message: str) -> None:
    places = np.flatnonzero(wrong)
    if len(places):
        first = int(places[0])
        raise CanfbError(f"{path}:{columns.lines[first]}: {message.format(*columns.values[first])}")
