"""A recording as a source: a CSV file with a header line, or an NPZ file of canfb."""

from __future__ import annotations

import csv
import itertools
import math
import statistics
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from canfb.errors import CanfbError
from canfb.signal.phase import FloatArray
from canfb.signal.sample import Sample
from canfb.signal.sample_times import TICK_S
from canfb.sources.protocol import SourceEnded


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
        for number, (_, sine, cosine) in enumerate(self._rows):
            lost = self._pauses.get(number, 0)
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
    return layout.interval_s / step_s if step_s > 0.0 else 1.0


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
        raise CanfbError(f"{path}: there are no samples in it")
    return rows


def _column(path: Path, header: list[str], name: str) -> int:
    names = [" ".join(column.split()) for column in header]
    if name in names:
        return names.index(name)
    if name.isdecimal() and int(name) < len(names):
        return int(name)
    if not names:
        raise CanfbError(f"{path}:1: there is no line with the names of the columns")
    raise CanfbError(f"{path}:1: there is no column '{name}'; there are {', '.join(names)[:200]}")


def _row(
    path: Path, line: int, row: list[str], places: list[int], time: int | None, layout: RecordingLayout
) -> tuple[float, int, int]:
    try:
        sine, cosine = (round(float(row[place]) - layout.mid_scale) for place in places)
        seconds = 0.0 if time is None else float(row[time])
    except (IndexError, ValueError, OverflowError):
        raise CanfbError(f"{path}:{line}: not a number in one of the columns asked for") from None
    if not math.isfinite(seconds):
        raise CanfbError(f"{path}:{line}: {seconds} is no time in seconds")
    if not (-32768 <= sine <= 32767 and -32768 <= cosine <= 32767):
        raise CanfbError(f"{path}:{line}: {sine}, {cosine} does not fit INTEGER16; is mid-scale right?")
    return seconds, sine, cosine
