"""Files of samples: columns of numbers from a CSV file of a spreadsheet, oscilloscope or logger; both tracks
from an NPZ file of canfb."""

from __future__ import annotations

import csv
import io
import re
import zipfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np

from canfb.checks import number_in
from canfb.errors import CanfbError, reason
from canfb.files import decoded, read_bytes
from canfb.objects import MISSED_COUNTS
from canfb.signal.phase import ArrayLike, FloatArray, pair_of_tracks

SEPARATORS = "\t;,"  # tried in this order: a name or a number may contain a comma
# The beginning of .log, .csv, .trc and .asc.
BUS_LOG = re.compile(
    r"\([0-9.]+\) \S+ [0-9A-Fa-f]+#|timestamp,arbitration_id,|;\$FILEVERSION|date \w+ \w+ \d"
)
SEPARATOR_LINE = re.compile(r"sep=(.)\s*")
NAMES = {"\t": "tab", ";": "semicolon", ",": "comma"}


class Columns(NamedTuple):
    """The values of the chosen columns, shape (n, columns); ``lines`` are their line numbers.

    ``separator`` is the one found between the columns.
    """

    values: FloatArray
    lines: list[int]
    separator: str

    @property
    def note(self) -> str:
        return "" if self.separator == "," else f", separated by {NAMES.get(self.separator, self.separator)}"


def read_columns(path: Path, names: Sequence[str]) -> Columns:
    """The columns with these names, or numbers from 0, of a file whose first line has the names.

    The separator is found in the header, or given by a line ``sep=;``; decimal commas are read. CanfbError
    with the line.
    """
    text = decoded(read_bytes(path, CanfbError))
    is_log = BUS_LOG.match(text)
    if is_log or "\0" in text:
        what = "a log of the bus:" if is_log else "not a text file with columns; of a log of the bus"
        raise CanfbError(
            f"{path}: this is {what} canfb log replay {path} --config CONFIG.yaml --out samples.csv writes "
            "the samples, for --columns sine_counts,cosine_counts"
        )
    head, _, rest = text.partition("\n")
    declared = SEPARATOR_LINE.fullmatch(head)
    skipped = 1 if declared else 0
    text, head = (rest, rest.partition("\n")[0]) if declared else (text, head)
    separator = declared[1] if declared else next((one for one in SEPARATORS if one in head), ",")
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator)
    try:
        header = [" ".join(name.split()) for name in next(reader, [])]
        places = [_place(path, header, name) for name in names]
        values: list[list[float]] = []
        lines: list[int] = []
        for row in reader:
            if any(map(str.strip, row)):
                lines.append(reader.line_num + skipped)
                values.append(_numbers(path, lines[-1], row, places))
    except csv.Error as error:
        raise CanfbError(f"{path}:{reader.line_num + skipped}: {error}") from None
    if not values:
        raise CanfbError(f"{path}: it contains no samples")
    return Columns(np.array(values), lines, separator)


def _place(path: Path, header: list[str], name: str) -> int:
    if header.count(name) == 1:
        return header.index(name)
    if name.isdecimal() and int(name) < len(header):
        return int(name)
    if not header:
        raise CanfbError(f"{path}:1: the header line with the names of the columns is missing")
    raise CanfbError(
        f"{path}:1: there is {'more than one' if name in header else 'no'} column '{name}'; "
        f"there are {', '.join(header)[:200]}"
    )


def _numbers(path: Path, line: int, row: list[str], places: Iterable[int]) -> list[float]:
    try:
        return [float(row[at] if "." in row[at] else row[at].replace(",", ".")) for at in places]
    except (IndexError, ValueError):
        raise CanfbError(f"{path}:{line}: a value in one of the selected columns is not a number") from None


# Limit of all arrays, bytes: a few kB of ZIP can contain any number of zeros. Six hours at 1 kHz, with times.
LARGEST_UNPACKED = 1 << 28


class Tracks(NamedTuple):
    """Sine and cosine in ADC counts, NaN: missed sample; and, None if unknown:

    rate_hz        samples per second
    time_s         time of each sample
    cycles_per_s   the speed
    """

    sine: FloatArray
    cosine: FloatArray
    rate_hz: float | None
    time_s: FloatArray | None
    cycles_per_s: float | None


def with_gaps(sine: ArrayLike, cosine: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Counts as floats, with NaN for pairs of -32768. ValueError for arrays of different length."""
    s, c = (np.array(one, np.float64) for one in pair_of_tracks(sine, cosine, may_be_offset=True))
    missed = (s == MISSED_COUNTS) & (c == MISSED_COUNTS) | np.isnan(s) | np.isnan(c)
    s[missed] = c[missed] = np.nan
    return s, c


def read_tracks(path: Path) -> Tracks:
    """Read an NPZ file with arrays sine and cosine, and rate_hz, time_s, cycles_per_s if known. CanfbError,
    one line.
    """
    try:
        with path.open("rb") as file:
            with zipfile.ZipFile(file) as packed:
                size = sum(one.file_size for one in packed.infolist())
            if size > LARGEST_UNPACKED:
                raise ValueError(f"its arrays have {size} bytes; at most {LARGEST_UNPACKED} are read")
            file.seek(0)
            return _tracks(file)
    except OSError as error:
        raise CanfbError(f"{path}: cannot be read: {reason(error)}") from None
    except Exception as error:
        raise CanfbError(f"{path}: this is not a file of samples: {reason(error)}") from None


def _tracks(file: IO[bytes]) -> Tracks:
    with np.load(file, allow_pickle=False) as content:
        missing = [name for name in ("sine", "cosine") if name not in content]
        if missing:
            there = ", ".join(content.files) or "nothing"
            raise ValueError(f"there is no array '{missing[0]}', only {there}")
        numbers = {name: float(content[name]) for name in ("rate_hz", "cycles_per_s") if name in content}
        number_in("rate_hz", numbers.get("rate_hz", 0.0), 0.0, 1e12)
        sine, cosine = with_gaps(content["sine"], content["cosine"])
        time_s = np.asarray(content["time_s"], np.float64) if "time_s" in content else None
        return Tracks(sine, cosine, numbers.get("rate_hz") or None, time_s, numbers.get("cycles_per_s"))
