"""A recording as a source: a CSV file with a header line, or an NPZ file of canfb."""

from __future__ import annotations

import csv
import itertools
import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from canfb.checks import flag, integer_in, number, text
from canfb.errors import CanfbError, ConfigError
from canfb.signal.phase import FloatArray
from canfb.signal.sample import TICK_S, Sample
from canfb.sources.protocol import Source, SourceConfig, SourceEnded, Surroundings, column
from canfb.sources.tracks_file import read_tracks

LARGEST_TIME_S = 1e12
"""Of a time column: the times of a clock of any epoch have less."""
SHORTEST_STEP_S = 1e-9
"""Rows that are closer have no rate to which they could be stretched."""


@dataclass(frozen=True, kw_only=True)
class RecordingSourceConfig(SourceConfig):
    """A recording, one row for each SYNC.

    file           CSV with a header line, or NPZ as ``canfb calibrate --out`` writes it; required
    columns        names, or numbers from 0, of the sine and the cosine column of a CSV file
    mid_scale      the reading that means zero, any number of counts (CSV)
    time_column    column with seconds (CSV): a longer step than ``gap_s`` is a gap; None: there is none
    gap_s          the shortest gap, more than 0
    gap_samples    samples missed at each gap, 1..1000000
    time_stamps    True: the time column is the sample time (2000:05), too
    """

    kind: str = "recording"
    file: str
    columns: Sequence[str | int] = field(default=("sine", "cosine"), metadata={"list": True})
    mid_scale: float = 0.0
    time_column: str | int | None = None
    gap_s: float = 0.1
    gap_samples: int = 20
    time_stamps: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        text("file", self.file)
        if not isinstance(self.columns, Sequence) or isinstance(self.columns, str) or len(self.columns) != 2:
            raise ValueError(f"columns must be two, [sine, cosine], not {self.columns!r}")
        for name in self.columns:
            column("columns", name)
        number("mid_scale", self.mid_scale)
        if self.time_column is not None:
            column("time_column", self.time_column)
        number("gap_s", self.gap_s)
        if self.gap_s <= 0.0:
            raise ValueError(f"gap_s must be more than 0, not {self.gap_s!r}")
        integer_in("gap_samples", self.gap_samples, 1, 1_000_000)
        flag("time_stamps", self.time_stamps)
        if self.time_stamps and self.time_column is None:
            raise ValueError("time_stamps need a time_column")

    def check_machine(self) -> None:
        """ConfigError for a file that cannot be read."""
        try:
            with Path(self.file).open("rb"):
                pass
        except OSError as error:
            raise ConfigError(f"file {Path(self.file)} of source cannot be read: {error.strerror}") from None

    def open(self, surroundings: Surroundings) -> Source:
        """The recording, read."""
        sine, cosine = (str(name) for name in self.columns)
        layout = RecordingLayout(
            (sine, cosine),
            self.mid_scale,
            None if self.time_column is None else str(self.time_column),
            self.gap_s,
            self.gap_samples,
            self.time_stamps,
        )
        return open_recording(self.file, layout)


@dataclass(frozen=True)
class RecordingLayout:
    """How a CSV file with a header line holds the tracks.

    columns             names (or numbers from 0) of the sine and the cosine column
    mid_scale           the reading that means zero, subtracted from both
    time_column         name or number of a column with seconds, or None
    gap_s               a step of time longer than this is a gap: the last sample before it is
                        left out and ``gap_samples`` SYNCs get no answer
    time_stamps         the samples bring their time along: that of the time column, or without one a time
                        ``interval_s`` after the sample before
    interval_s          seconds from row to row where there is no time column
    paced               with a time column: its times are stretched until rows are ``interval_s`` apart, as
                        they are played, for a file that was recorded at another rate
    """

    columns: tuple[str, str]
    mid_scale: float = 0.0
    time_column: str | None = None
    gap_s: float = 0.1
    gap_samples: int = 20
    time_stamps: bool = False
    interval_s: float = 1e-3
    paced: bool = False


class RecordingSource:
    """Plays a recording, one row for each SYNC; ``row`` is the row (from 0) of the last sample."""

    def __init__(self, path: str | Path, layout: RecordingLayout) -> None:
        self._rows = _read(Path(path), layout)
        self._layout = layout
        self._pauses = _pauses(self._rows, layout)
        self._stretch = _stretch(self._rows, layout)
        self._waiting = 0
        self._next_row = 0
        self.row = -1

    def __len__(self) -> int:
        return len(self._rows)

    def tracks(self) -> tuple[FloatArray, FloatArray]:
        """Both tracks as they are played from the start, counts, NaN where a SYNC gets no answer."""
        pairs: list[tuple[float, float]] = []
        for n, (_, sine, cosine) in enumerate(self._rows):
            lost = self._pauses.get(n, 0)
            pairs += [(math.nan, math.nan)] * lost if lost else [(sine, cosine)]
        sines, cosines = np.array(pairs, np.float64).reshape(-1, 2).T
        return sines, cosines

    def next(self) -> Sample | None:
        """The next sample, None within a gap. SourceEnded at the end."""
        if self._waiting:
            self._waiting -= 1
            return None
        if self._next_row in self._pauses:
            self._waiting = self._pauses.pop(self._next_row) - 1
            self._next_row += 1
            return None
        if self._next_row >= len(self._rows):
            raise SourceEnded
        self.row = self._next_row
        self._next_row += 1
        seconds, sine, cosine = self._rows[self.row]
        if self._layout.time_column is None:
            seconds = self.row * self._layout.interval_s
        time = round(seconds * self._stretch / TICK_S) & 0xFFFFFFFF if self._layout.time_stamps else None
        return Sample(sine, cosine, time_100ns=time)


class ArraySource:
    """Plays tracks, one sample for each SYNC; NaN in one of them is a SYNC without a sample."""

    def __init__(self, sine: npt.NDArray[np.float64], cosine: npt.NDArray[np.float64]) -> None:
        self._tracks = sine, cosine
        self._samples = zip(sine.tolist(), cosine.tolist(), strict=True)

    def tracks(self) -> tuple[FloatArray, FloatArray]:
        """Both tracks as they are played from the start, counts, NaN where a SYNC gets no answer."""
        return self._tracks

    def next(self) -> Sample | None:
        """The next sample, None for a missed one. SourceEnded at the end."""
        try:
            sine, cosine = next(self._samples)
        except StopIteration:
            raise SourceEnded from None
        return None if math.isnan(sine + cosine) else Sample(sine, cosine)


def open_recording(file: str, layout: RecordingLayout) -> RecordingSource | ArraySource:
    """A recording: an NPZ file of ours by its name, which needs no layout, else CSV. CanfbError."""
    path = Path(file)
    if path.suffix == ".npz":
        tracks = read_tracks(path)
        return ArraySource(tracks.sine, tracks.cosine)
    return RecordingSource(path, layout)


def _pauses(rows: list[tuple[float, int, int]], layout: RecordingLayout) -> dict[int, int]:
    """Rows before a gap, each with the number of SYNCs without an answer there."""
    if layout.time_column is None:
        return {}
    return {
        n: max(layout.gap_samples, 1)
        for n, (row, after) in enumerate(itertools.pairwise(rows))
        if after[0] - row[0] > layout.gap_s
    }


def _stretch(rows: list[tuple[float, int, int]], layout: RecordingLayout) -> float:
    """By what the times of the rows are multiplied."""
    if layout.time_column is None or not layout.paced or len(rows) < 2:
        return 1.0
    step_s = statistics.median(after[0] - row[0] for row, after in itertools.pairwise(rows))
    return layout.interval_s / step_s if step_s > SHORTEST_STEP_S else 1.0


def _read(path: Path, layout: RecordingLayout) -> list[tuple[float, int, int]]:
    try:
        # A spreadsheet may have put a byte order mark before the first name.
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            try:
                header = next(reader, [])
                places = [_column(path, header, name) for name in layout.columns]
                time = None if layout.time_column is None else _column(path, header, layout.time_column)
                rows = [_row(path, reader.line_num, row, places, time, layout) for row in reader if row]
            except csv.Error as error:
                raise CanfbError(f"{path}:{reader.line_num}: {error}") from None
    except OSError as error:
        raise CanfbError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise CanfbError(f"{path}: this is not a text file with columns") from None
    if not rows:
        raise CanfbError(f"{path}: it contains no samples")
    return rows


def _column(path: Path, header: list[str], name: str) -> int:
    names = [" ".join(column.split()) for column in header]
    if name in names:
        return names.index(name)
    if name.isdecimal() and int(name) < len(names):
        return int(name)
    if not names:
        raise CanfbError(f"{path}:1: the header line with the names of the columns is missing")
    raise CanfbError(f"{path}:1: there is no column '{name}'; there are {', '.join(names)[:200]}")


def _row(
    path: Path, line: int, row: list[str], places: list[int], time: int | None, layout: RecordingLayout
) -> tuple[float, int, int]:
    try:
        sine, cosine = (round(float(row[place]) - layout.mid_scale) for place in places)
        seconds = 0.0 if time is None else float(row[time])
    except (IndexError, ValueError, OverflowError):
        raise CanfbError(f"{path}:{line}: a value in one of the selected columns is not a number") from None
    if not abs(seconds) <= LARGEST_TIME_S:
        raise CanfbError(f"{path}:{line}: {seconds} is not a time in seconds")
    if not (-32768 <= sine <= 32767 and -32768 <= cosine <= 32767):
        raise CanfbError(f"{path}:{line}: {sine}, {cosine} does not fit INTEGER16; is mid-scale right?")
    return seconds, sine, cosine
