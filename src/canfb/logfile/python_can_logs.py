"""Logs in other formats than that of candump: the readers of python-can, and what they do not do themselves.

A reader of python-can ends at the first line that it cannot read; it gets lines one by one here
(:class:`_Lines`). Its known bugs (https://github.com/hardbyte/python-can), and where they are worked round:

    #1584, #1581   BLF: an object with length 0 is read again and again     _BlfReader
    none           candump: of the error frames only bus errors are read    _CandumpLines
    none           BLF: one that was cut off is like a whole one            _WholeReads, _check_end
    #1788          ASC: "timestamps relative"; "base" behind another line   _AscLines
    none           ASC, TRC: a line with too few bytes is a shorter frame   _is_whole
    none           TRC: an empty line ends the header                       _TrcLines
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Any

import can

from canfb.logfile.log_files import UNREADABLE, LogCounters, opened

LONGEST_LINE = 1 << 16  # bytes
BLF_OBJECT, BLF_OBJECT_PLACES = b"LOBJ", 8  # an object begins in the first 4 bytes behind the one before


def messages_of(path: Path, suffix: str, counters: LogCounters) -> Iterator[can.Message]:
    """What is in a log. What is raised behind damage has no common root."""
    with opened(path) as (file, raw), ExitStack() as closing:
        if suffix in TEXT:
            messages: Iterable[can.Message] = TEXT[suffix](file, counters).messages()
        elif suffix == ".blf":
            messages = _blf_messages(file)
        else:
            messages = closing.enter_context(can.LogReader(path))
        for message in messages:
            counters.bytes_read = raw.tell()
            yield message


class _Lines:
    """The lines of a text log, for a reader of python-can.

    ``frame`` says which should give one, ``cut`` which have lost their end.
    """

    reader: type[Any]
    frame = re.compile("")
    cut = re.compile("(?!)")
    first = ""  # a line that the reader does not look at
    has_words_of_bytes = True  # each byte stands by itself

    def __init__(self, file: Any, counters: LogCounters, number: int = 0) -> None:
        self._file, self._counters = file, counters
        self._number = number  # of the line, from 1
        self._pending = False
        self._failure: Exception | None = None
        self._header = self.first

    def messages(self) -> Iterator[can.Message]:
        reader = self.opened()
        is_over = False
        while not is_over:
            number = self._number
            try:
                for message in reader:
                    if self._is_whole(message):
                        self._pending = False
                        yield message
                is_over = True
            except Exception:  # a line that it cannot read
                if number == self._number:
                    raise
                self._pending = True
                self._header = self.first
        self._count_damaged()
        if self._failure is not None:
            raise self._failure

    def opened(self) -> Any:
        return self.reader(self)

    def close(self) -> None:
        """The reader calls it."""

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        self._count_damaged()
        if self._header:
            header, self._header = self._header, ""
            return header
        while True:
            line = self._next_line()
            if line is None:
                raise StopIteration
            self._line = line
            kept = self.kept(line)
            if kept is not None:
                self._pending = bool(self.frame.match(line))
                return kept
            if self.cut.fullmatch(line.strip()):
                self._pending = True
                self._count_damaged()

    def kept(self, line: str) -> str | None:
        return line if self.frame.match(line) else None

    def _next_line(self) -> str | None:
        try:
            data = self._file.readline(LONGEST_LINE)
        except UNREADABLE as error:
            self._failure, data = error, b""
        if not data:
            return None
        self._number += 1
        try:
            text = str(data, "utf-8")
        except UnicodeDecodeError:
            text = str(data, "cp1252", "replace")
        return text.lstrip("\ufeff")

    def _count_damaged(self) -> None:
        if self._pending:
            self._counters.damaged(self._number)
        self._pending = False

    def _is_whole(self, message: can.Message) -> bool:
        """Whether the frame has as many bytes as its line says, the last one with both digits."""
        if message.is_error_frame or message.is_fd or message.is_remote_frame:
            return True
        length = len(message.data)
        by_words = self.has_words_of_bytes and length > 0
        return length == message.dlc and not (by_words and self.is_cut_in_byte(self._line, length))

    def is_cut_in_byte(self, line: str, length: int) -> bool:
        return len(line.rsplit(None, 1)[-1]) == 1


class _AscLines(_Lines):
    """Vector: header, then events by time; frames begin with channel, CAN-ID, Rx or Tx."""

    reader = can.ASCReader
    frame = re.compile(r"\s*\d+\.\d+\s+(\d+\s+(\w+\s+(Tx|Rx)\s|ErrorFrame)|CANFD\s+\d+\s+(Rx|Tx)\s)", re.I)
    cut = re.compile(r"\d+(\.\d*(\s+(\d+(\s+[0-9A-Fa-f]+x?(\s+[RT])?)?)?)?)?")
    first = "internal events logged\n"
    header = re.compile(r"\s*base\s+(hex|dec)(?:\s+timestamps\s+(absolute|relative))?", re.I)
    event = re.compile(r"\s*(\d+\.\d+)(\s.*)", re.S)

    _is_relative, _time_s, _base = False, 0.0, "hex"
    _waiting: str | None = None

    def opened(self) -> Any:
        while (line := super()._next_line()) is not None:
            if found := self.header.match(line):
                self._base = found[1].lower()
                self._is_relative = (found[2] or "").lower() == "relative"
            if self.event.match(line):
                self._waiting = line
                break
        return can.ASCReader(self, base=self._base)  # type: ignore[arg-type]

    def _next_line(self) -> str | None:
        line, self._waiting = self._waiting, None
        return line if line is not None else super()._next_line()

    def kept(self, line: str) -> str | None:
        if self._is_relative and (found := self.event.match(line)):
            self._time_s += float(found[1])
            line = f"{self._time_s:.9f}{found[2]}"
        return super().kept(line)

    def is_cut_in_byte(self, line: str, length: int) -> bool:
        return (
            self._base == "hex"
            and len(line.split(maxsplit=6 + length)) == 6 + length
            and super().is_cut_in_byte(line, length)
        )


class _TrcLines(_Lines):
    """PEAK: what begins with ";$" is the header; frames begin with a number and a time."""

    reader = can.TRCReader
    frame = re.compile(r"\s*\d+\)?\s+[\d.]+\s+(?!(\d+\s+)?(ST|EC|ER|EV|Warng|Error|Status)\b)")
    cut = re.compile(r"\d+\)?(\s+[\d.]+)?")
    start = re.compile(r"\s*;\$STARTTIME\s*=\s*(\d+)(?:[.,](\d+))?\s*$")

    def kept(self, line: str) -> str | None:
        text = line.strip()
        if text.startswith(";$STARTTIME"):
            found = self.start.match(text)
            return None if found is None else f";$STARTTIME={found[1]}.{found[2] or 0}\n"
        return line if text.startswith(";$") or self.frame.match(line) else None


class CandumpLines(_Lines):
    """candump -L; ``number`` lines stand before those of the file."""

    reader = can.CanutilsLogReader
    has_words_of_bytes = False
    frame = re.compile(r"(?!\s*(#|;|//|$))")
    form = re.compile(
        r"\s*\([0-9.eE+-]+\)\s+\S+\s+[0-9A-Fa-f]{1,8}#(#[0-9A-Fa-f])?[0-9A-FRa-fr]*(\s+[RTrt])?\s*"
    )
    error = re.compile(r" 2[0-9A-Fa-f]{7}#")

    def kept(self, line: str) -> str | None:
        """Without comments and what python-can would take for a frame."""
        if not self.frame.match(line):
            self._counters.empty_lines += 1
            return None
        return self.error.sub(" 20000080#", line) if self.form.fullmatch(line) else "no frame\n"


TEXT: dict[str, type[_Lines]] = {".asc": _AscLines, ".trc": _TrcLines}


class _WholeReads:
    """A file that notes whether it ended within what was asked for."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self.is_short = False

    def read(self, length: int) -> bytes:
        data = self._file.read(length)
        # There may be no padding, of up to 3 bytes, behind the last object.
        self.is_short |= len(data) < length and (length > 16 or (length >= 4 and bool(data)))
        return data

    def close(self) -> None:
        """The reader calls it."""


class _BlfReader(can.BLFReader):
    def _parse_data(self, data: bytes) -> Iterator[can.Message]:
        """What is before an object without a length; ValueError behind it."""
        place = data.find(BLF_OBJECT, 0, BLF_OBJECT_PLACES)
        while place >= 0:
            length = int.from_bytes(data[place + 8 : place + 12], "little")
            if not length and len(data) >= place + 12:
                yield from super()._parse_data(data[:place])
                raise ValueError("an object has no length")
            place += length
            place = data.find(BLF_OBJECT, place, place + BLF_OBJECT_PLACES)
        yield from super()._parse_data(data)


def _blf_messages(file: IO[bytes]) -> Iterator[can.Message]:
    """ValueError behind what can be read of a file that was cut off, or never closed."""
    size = file.seek(0, 2)
    file.seek(0)
    whole = _WholeReads(file)
    reader = _BlfReader(whole)  # type: ignore[arg-type]
    has_frames = False
    for message in reader:
        has_frames = True
        yield message
    if whole.is_short or size < reader.file_size:
        raise ValueError("it was cut off")
    if has_frames and not reader.object_count:
        raise ValueError("it was never closed, its end may be missing")
