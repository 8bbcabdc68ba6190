"""Bus logs as files: suffixes, opening, counters of reading; the readers of python-can for formats other than
candump, with corrections.

A reader of python-can ends at the first unreadable line, so it gets lines in blocks here (:class:`_Lines`).
Its known bugs (https://github.com/hardbyte/python-can), and their workarounds:

    #1584, #1581   BLF: an object with length 0 is read for ever            _BlfReader
    none           candump: of the error frames only bus errors are read    CandumpLines
    none           BLF: a truncated file passes as a whole one              _BlfReader
    #1788          ASC: "timestamps relative"; "base" after another line    _AscLines
    none           ASC, TRC: a line with too few bytes is a shorter frame   _is_whole
    none           TRC: an empty line ends the header                       _TrcLines
"""

from __future__ import annotations

import contextlib
import gzip
import io
import re
import zlib
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import IO, Any

import can
from can.io import MESSAGE_READERS, MESSAGE_WRITERS

from canfb.errors import CanfbError, ConfigError
from canfb.files import UTF_16, decoded
from canfb.rows import Row, listed, those

GZIP = ".gz"
# python-can's binary writers seek back to their header, which gzip cannot; asammdf reads files only.
NOT_ZIPPED = frozenset({".blf", ".db", ".mf4"})
# Not searched in folders, where files with these suffixes need not be bus logs; name them one by one.
IN_NO_FOLDER = frozenset({".csv", ".db"})
NEEDS_PACKAGE = "this format needs another package: pip install 'canfb[mf4]'"


def log_suffix(path: Path) -> tuple[str, bool]:
    """The suffix of the format, in lower case, and whether the file is compressed."""
    zipped = path.suffix.lower() == GZIP
    unzipped = path.with_suffix("") if zipped else path
    return unzipped.suffix.lower(), zipped


READABLE = sorted(MESSAGE_READERS)
# Formats that can be written and read. Not .db: python-can writes it in a thread that fails silently if the
# disk is full.
WRITABLE = sorted(set(MESSAGE_WRITERS) & set(MESSAGE_READERS) - {".db"})


def is_log(path: Path) -> bool:
    """Whether a file of a folder is a bus log, judged by its name."""
    suffix, zipped = log_suffix(path)
    return suffix in READABLE and suffix not in IN_NO_FOLDER and not (zipped and suffix in NOT_ZIPPED)


def check_suffix(path: Path, known: list[str]) -> str:
    """The suffix, one of ``known``. ConfigError for another one."""
    suffix, zipped = log_suffix(path)
    if suffix in known and not (zipped and suffix in NOT_ZIPPED):
        return suffix
    what = f"unknown suffix {suffix!r}" if suffix else "no suffix"
    if zipped and suffix in NOT_ZIPPED:
        what = f"{suffix} cannot be compressed with gzip"
    raise ConfigError(f"{path}: {what}; bus logs end with {', '.join(known)}, or {GZIP} behind one of text")


UNREADABLE = (OSError, EOFError, zlib.error)  # Errors of reading a file, compressed or not.


@contextlib.contextmanager
def opened(path: Path) -> Iterator[tuple[Any, IO[bytes]]]:
    """The content, unpacked, and the raw file, whose position gives the progress."""
    with path.open("rb") as raw:
        file: Any = gzip.GzipFile(fileobj=raw) if log_suffix(path)[1] else raw
        is_utf_16 = file.peek(2)[:2] in UTF_16
        yield io.BytesIO(file.read().decode("utf-16", "replace").encode()) if is_utf_16 else file, raw


class LogError(CanfbError):
    """A bus log that cannot be read at all; the text says which, and why."""


@dataclass
class LogCounters:
    """Counts of all frames, of those left out by reason, and of lines without a frame.

    late             frames moved, as their stamps were out of order
    damaged_lines    incomplete frames; ``empty_lines`` include comments of a candump log
    bytes_read       of the file, for the progress
    channels         channels whose frames were used
    left_out         frames of other channels with 11-bit identifiers: by channel, by CAN-ID
    not_canopen      29-bit identifiers and CAN FD
    """

    frames: int = 0
    error_frames: int = 0
    not_canopen: int = 0
    late: int = 0
    damaged_lines: int = 0
    first_damaged_line: int = 0
    empty_lines: int = 0
    bytes_read: int = 0
    channels: set[str] = field(default_factory=set)
    left_out: defaultdict[str, Counter[int]] = field(default_factory=lambda: defaultdict(Counter))

    def left_out_of(self, can_ids: Collection[int]) -> int:
        return sum(one[can_id] for one in self.left_out.values() for can_id in can_ids)

    def damaged(self, line: int) -> None:
        self.damaged_lines += 1
        self.first_damaged_line = min(line, self.first_damaged_line or line)

    def lines_left_out(self) -> list[str]:
        damaged, empty = self.damaged_lines, self.empty_lines
        return those(
            (damaged, f"{damaged} damaged lines left out, the first is line {self.first_damaged_line}"),
            (empty, f"{empty} empty lines and comments left out"),
        )

    def facts(self, trouble: str | None) -> list[Row]:
        """What is missing and why, the most important first."""
        words = [
            *self._channels(),
            *self.lines_left_out(),
            *those(
                (self.error_frames, f"{self.error_frames} error frames left out"),
                (
                    self.not_canopen,
                    f"{self.not_canopen} frames with 29-bit identifiers or CAN FD left out",
                ),
                (self.late, f"{self.late} frames with stamps out of order, sorted"),
            ),
        ]
        return [
            Row("log", trouble, trouble=trouble),
            *(Row("log", text) for text in words),
            Row(
                frames=self.frames,
                damaged_lines=self.damaged_lines,
                channels=sorted(self.channels),
                left_out={name: one.total() for name, one in sorted(self.left_out.items())},
            ),
        ]

    def _channels(self) -> list[str]:
        number = sum(one.total() for one in self.left_out.values())
        left_out, taken = (listed(sorted(one), MOST_CHANNELS) for one in (self.left_out, self.channels))
        return those(
            (
                left_out,
                f"{number} frames of channel {left_out} left out: --channel selects {taken}",
            ),
            (
                len(self.channels) > 1 and not left_out,
                f"channels {taken} are taken as one bus; if they are several, --channel takes one",
            ),
        )


MOST_CHANNELS = 6  # channels listed in a message
LONGEST_LINE, CLASSIC_BYTES = 1 << 16, 8  # most bytes of a line, and of a frame that is not CAN FD
BLOCK_LINES = 256
BLF_OBJECT, BLF_OBJECT_PLACES = b"LOBJ", 8  # an object begins 0..4 bytes after the previous one
BLF_HEAD, BLF_LONGEST = 16, 1 << 24  # size of the header of an object, largest object, bytes
BLF_CONTAINER, BLF_ZLIB = 10, b"\2"


def messages_of(path: Path, suffix: str, counters: LogCounters) -> Iterator[can.Message]:
    """The messages of a log. Damage may raise any exception."""
    with opened(path) as (file, raw), contextlib.ExitStack() as closing:
        if suffix in TEXT:
            messages: Iterable[can.Message] = TEXT[suffix](file, counters).messages()
        elif suffix == ".blf":
            messages = _BlfReader(file)
        else:
            messages = closing.enter_context(can.LogReader(path))
        for message in messages:
            counters.bytes_read = raw.tell()
            message.is_fd |= len(message.data) > CLASSIC_BYTES  # a .db does not say it
            yield message


class _Lines:
    """The frames of a text log: a block of lines at once, or line by line if one gives no whole frame.

    ``frame`` matches lines of frames, ``cut`` damaged lines; ``head`` is put before the lines.
    """

    reader: type[Any]
    frame = re.compile("")
    cut = re.compile("(?!)")
    head = ""
    has_words_of_bytes = True  # blanks separate the data bytes

    def __init__(self, file: Any, counters: LogCounters, number: int = 0) -> None:
        self._file, self._counters = file, counters
        self._number = number  # number of the line, from 1
        self._failure: Exception | None = None

    def messages(self) -> Iterator[can.Message]:
        lines = self._lines()
        while block := list(islice(lines, BLOCK_LINES)):
            for (number, _), message in zip(block, self._read([line for _, line in block]), strict=True):
                if message is None:
                    self._counters.damaged(number)
                else:
                    yield message
        if self._failure is not None:
            raise self._failure

    def _lines(self) -> Iterator[tuple[int, str]]:
        try:
            while data := self._file.readline(LONGEST_LINE):
                self._number += 1
                line = decoded(data)
                kept = self.kept(line)
                if kept is not None:
                    yield self._number, kept
                elif "\0" in line or self.cut.fullmatch(line.strip()):
                    self._counters.damaged(self._number)
        except UNREADABLE as error:  # raised later, after the lines before it
            self._failure = error

    def kept(self, line: str) -> str | None:
        return line if self.frame.match(line) else None

    def _read(self, lines: Sequence[str]) -> Sequence[can.Message | None]:
        """The message of each line; None: damaged."""
        try:
            messages = list(self.reader(io.StringIO(self.head + "".join(lines))))
        except Exception:  # python-can cannot read one of the lines
            messages = []
        if len(messages) == len(lines) and all(map(self._is_whole, messages, lines)):
            return messages
        return [self._read([line])[0] for line in lines] if len(lines) > 1 else [None]

    def _is_whole(self, message: can.Message, line: str) -> bool:
        """Whether the line has all its bytes, and the last one both digits."""
        if message.is_error_frame or message.is_fd or message.is_remote_frame:
            return True
        length = len(message.data)
        return length == min(8, message.dlc) and not (
            self.has_words_of_bytes and length > 0 and self.is_cut_in_byte(line, length)
        )

    def is_cut_in_byte(self, line: str, length: int) -> bool:
        return len(line.rsplit(None, 1)[-1]) == 1


class _AscLines(_Lines):
    """Vector: header, then events by time; frames begin with channel, CAN-ID, Rx or Tx."""

    reader = can.ASCReader
    frame = re.compile(r"\s*\d+\.\d+\s+(\d+\s+(\w+\s+(Tx|Rx)\s|ErrorFrame)|CANFD\s+\d+\s+(Rx|Tx)\s)", re.I)
    cut = re.compile(
        r"\d+(\.\d*(\s+(\d+(\s+[0-9A-Fa-f]+x?(\s+[RT]x?)?)?)?)?)?|(?!//|.*J1939TP).*\s[RT]x\s+[dr]\s.*"
    )
    header = re.compile(r"\s*base\s+(hex|dec)(?:\s+timestamps\s+(absolute|relative))?", re.I)
    event = re.compile(r"\s*(\d+)[.,](\d+)(\s.*)", re.S)
    head = "base hex\ninternal events logged\n"

    _is_relative, _time_s, _base = False, 0.0, "hex"

    def kept(self, line: str) -> str | None:
        if found := self.header.match(line):
            self._base, self._is_relative = found[1].lower(), (found[2] or "").lower() == "relative"
            self.head = f"base {self._base}\ninternal events logged\n"
        elif found := self.event.match(line):
            self._time_s = self._time_s * self._is_relative + float(f"{found[1]}.{found[2]}")
            line = f"{self._time_s:.9f}{found[3]}"
        return super().kept(line)

    def is_cut_in_byte(self, line: str, length: int) -> bool:
        return (
            self._base == "hex"
            and len(line.split(maxsplit=6 + length)) == 6 + length
            and super().is_cut_in_byte(line, length)
        )


class _TrcLines(_Lines):
    """PEAK: ";$" begins the header; a line that is neither comment nor event is a frame."""

    reader = can.TRCReader
    frame = re.compile(
        r"(?!\s*(;|$|\d+\)?\s+[\d.]+\s+((\d+\s+)?(ST|EC|ER|EV|Warng|Error|Status|FFFFFFFF)\b|\w+\s+\d\s+ERROR\b)))"
    )
    of_1_2 = re.compile(r"(\)\s+[\d.]+\s+\d+\s+[RT]x\s+\w+)(?=\s+\d+\s)")  # 1.3 has "-" after the CAN-ID
    start = re.compile(r";\$STARTTIME\s*=\s*(\d+)(?:[.,](\d+))?$")
    header = re.compile(r";\$(?!STARTTIME)|;\$STARTTIME=\d+\.")

    def kept(self, line: str) -> str | None:
        text = self.start.sub(r";$STARTTIME=\1.\2", line.strip())
        if self.header.match(text):
            self.head += f"{text}\n".replace("VERSION=1.2", "VERSION=1.3")
        return super().kept(self.of_1_2.sub(r"\1 -", line.replace(",", ".")))


class CandumpLines(_Lines):
    """candump -L; ``number`` lines precede those of ``file``."""

    reader = can.CanutilsLogReader
    has_words_of_bytes = False
    frame = re.compile(r"(?!\s*(#|;|//|$))")
    form = re.compile(
        r"\s*\([0-9.eE+-]+\)\s+\S+\s+[0-9A-Fa-f]{1,8}#(#[0-9A-Fa-f])?[0-9A-FRa-fr]*(\s+[RTrt])?\s*"
    )
    error = re.compile(r" 2[0-9A-Fa-f]{7}#")

    def kept(self, line: str) -> str | None:
        """The line for python-can, changed if it would misread it; None for a comment."""
        if not self.frame.match(line):
            self._counters.empty_lines += 1
            return None
        return self.error.sub(" 20000080#", line) if self.form.fullmatch(line) else "no frame\n"


class _CsvLines(_Lines):
    """CSV of python-can."""

    reader = can.CSVReader
    has_words_of_bytes = False
    frame = re.compile(r"(?!\s*(timestamp|$))")
    head = "timestamp\n"


TEXT: dict[str, type[_Lines]] = {".asc": _AscLines, ".trc": _TrcLines, ".csv": _CsvLines}


class _BlfReader(can.BLFReader):
    """python-can silently skips damage; here it raises ValueError."""

    def __iter__(self) -> Iterator[can.Message]:  # type: ignore[override]
        while head := self.file.read(BLF_HEAD):
            length, kind = (int.from_bytes(head[n : n + 4], "little") for n in (8, 12))
            content = self.file.read(max(0, length - BLF_HEAD))
            self.file.read(length % 4)
            is_packed = content[:1] == BLF_ZLIB
            if head[:4] != BLF_OBJECT or kind != BLF_CONTAINER or not (is_packed or content[:1] == b"\0"):
                raise ValueError("an object is damaged")
            data = content[BLF_HEAD:]
            yield from self._parse_container(zlib.decompressobj().decompress(data) if is_packed else data)
            if len(content) < length - BLF_HEAD or len(self._tail) > BLF_LONGEST:
                raise ValueError("it was cut off")
        size = self.file.tell()
        if BLF_OBJECT in self._tail or size < self.file_size:
            raise ValueError("it was cut off")
        if not self.object_count and size > self.file_size:
            raise ValueError("it was never closed, its end may be missing")

    def _parse_data(self, data: bytes) -> Iterator[can.Message]:
        place = data.find(BLF_OBJECT, 0, BLF_OBJECT_PLACES)
        while place >= 0 and len(data) >= place + 12:
            length = int.from_bytes(data[place + 8 : place + 12], "little")
            if not length:
                yield from super()._parse_data(data[:place])
                raise ValueError("an object has no length")
            place += length
            place = data.find(BLF_OBJECT, place, place + BLF_OBJECT_PLACES)
        yield from super()._parse_data(data)
