"""Bus logs as files: their suffixes, and their frames, in any format that python-can reads.

Logs of candump -L are read in blocks, by a regular expression over many lines at once: python-can takes more
time for a line than the module for its frame. Lines that are not the usual ones are read one by one.
"""

from __future__ import annotations

import contextlib
import gzip
import re
from binascii import unhexlify
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import IO, Any

import can
from can.io import MESSAGE_READERS, MESSAGE_WRITERS

from canfb.cia301.frame import Frame
from canfb.errors import CanfbError, ConfigError, reason

GZIP = ".gz"
# python-can's binary writers seek back to their header, which gzip cannot; asammdf reads files only.
NOT_ZIPPED = frozenset({".blf", ".db", ".mf4"})
IN_NO_FOLDER = frozenset({".csv", ".db"})
"""A folder may hold other files with these suffixes: one that is a bus log is named by itself."""
NEEDS_PACKAGE = "this format needs another package: pip install 'canfb[mf4]'"


def log_suffix(path: Path) -> tuple[str, bool]:
    """The suffix that says what format it is, in small letters, and whether it is compressed."""
    suffixes = [suffix.lower() for suffix in path.suffixes]
    zipped = bool(suffixes) and suffixes[-1] == GZIP
    rest = suffixes[:-1] if zipped else suffixes
    return rest[-1] if rest else "", zipped


def readable() -> list[str]:
    """What can be read."""
    return sorted(MESSAGE_READERS)


def writable() -> list[str]:
    """What can be written, and read again."""
    return sorted(set(MESSAGE_WRITERS) & set(MESSAGE_READERS))


def is_log(path: Path) -> bool:
    """Whether a file of a folder is a bus log, by its name."""
    suffix, zipped = log_suffix(path)
    return suffix in readable() and suffix not in IN_NO_FOLDER and not (zipped and suffix in NOT_ZIPPED)


def check_readable(path: Path) -> str:
    """The suffix. ConfigError for one that nobody reads."""
    return _checked(path, readable())


def check_writable(path: Path) -> str:
    """The suffix. ConfigError for one that nobody writes."""
    return _checked(path, writable())


def _checked(path: Path, known: list[str]) -> str:
    suffix, zipped = log_suffix(path)
    if suffix in known and not (zipped and suffix in NOT_ZIPPED):
        return suffix
    what = f"unknown suffix {suffix!r}" if suffix else "no suffix"
    if zipped and suffix in NOT_ZIPPED:
        what = f"{suffix} cannot be compressed with gzip"
    raise ConfigError(f"{path}: {what}; bus logs end with {', '.join(known)}, or {GZIP} behind one of text")


@dataclass
class LogCounters:
    """All frames, those left out and why, and lines that are none.

    bytes_read       of the file, for the progress
    channels         whose frames were taken
    left_out         frames of other channels with 11-bit identifiers: by channel, by CAN-ID
    not_canopen      29-bit identifiers and CAN FD
    """

    frames: int = 0
    error_frames: int = 0
    not_canopen: int = 0
    damaged_lines: int = 0
    first_damaged_line: int = 0
    bytes_read: int = 0
    channels: set[str] = field(default_factory=set)
    left_out: dict[str, Counter[int]] = field(default_factory=dict)

    def leave_out(self, channel: str, can_ids: Counter[int]) -> None:
        """So many more frames of a channel that is not the chosen one."""
        self.left_out.setdefault(channel, Counter()).update(can_ids)


BLOCK_BYTES = 1 << 18
# (1700000000.123456) can0 190#0011AAFF, with R or T behind it from some versions.
USUAL = re.compile(rb"^\((\d+\.\d+)\) (\S+) ([0-9A-Fa-f]{3})#((?:[0-9A-Fa-f]{2}){0,8})(?: [RTrt])?\r?$", re.M)
# python-can reads any frame between blanks.
ANY = re.compile(rb"\s*\(([0-9.eE+-]+)\)\s+(\S+)\s+([0-9A-Fa-f]{1,8})#(#?)([0-9A-Fa-fRr]*)(?:\s+[RTrt])?\s*$")
ERROR_FLAG = 0x20000000
_IDS = {b"%03X" % can_id: can_id for can_id in range(0x800)}
_IDS |= {b"%03x" % can_id: can_id for can_id in range(0x800)}
_new = tuple.__new__  # makes a named tuple in half the time that its own constructor takes


def candump_frames(path: Path, channel: str | None, counters: LogCounters) -> Iterator[list[Frame]]:
    """Lists of the frames with 11-bit identifiers of one channel, None for all; the rest is counted.

    OSError or EOFError for a file that cannot be read (on).
    """
    selected = None if channel is None else channel.encode()
    lines = 0
    with path.open("rb") as raw, gzip.open(raw, "rb") if log_suffix(path)[1] else raw as file:
        for block in _blocks(file):
            usual = USUAL.findall(block)
            count = block.count(b"\n")
            if len(usual) == count:
                counters.frames += count
                yield _frames(usual, selected, counters)
            else:
                yield list(_one_by_one(block, lines, selected, counters))
            lines += count
            counters.bytes_read = raw.tell()


def _frames(lines: Sequence[tuple[bytes, ...]], selected: bytes | None, counters: LogCounters) -> list[Frame]:
    """Of lines that all are usual."""
    ids, frame = _IDS, Frame
    try:
        taken = [
            _new(frame, (ids[can_id], unhexlify(data), False, float(time_s)))
            for time_s, name, can_id, data in lines
            if selected is None or name == selected
        ]
        names = {name for _, name, _, _ in lines}
        for other in names if selected is not None else ():
            if other != selected:
                counters.leave_out(_text(other), Counter(ids[line[2]] for line in lines if line[1] == other))
    except KeyError:  # large and small letters in one identifier
        large = [(time_s, name, can_id.upper(), data) for time_s, name, can_id, data in lines]
        return _frames(large, selected, counters)
    counters.channels.update(_text(name) for name in names if selected in (None, name))
    return taken


def _text(name: bytes) -> str:
    return name.decode("utf-8", "replace")


def _blocks(file: IO[bytes] | gzip.GzipFile) -> Iterator[bytes]:
    """Whole lines, each with its end; one that is longer than a block is divided."""
    rest = b""
    while more := file.read(BLOCK_BYTES):
        whole, end, rest_of = (rest + more).rpartition(b"\n")
        rest = rest_of
        if end:
            yield whole + end
        if len(rest) > BLOCK_BYTES:
            yield rest + b"\n"
            rest = b""
    if rest:
        yield rest + b"\n"


def _one_by_one(block: bytes, before: int, selected: bytes | None, counters: LogCounters) -> Iterator[Frame]:
    """Lines of which some are not the usual ones; ``before`` lines stand before them."""
    for number, line in enumerate(block.split(b"\n")[:-1], before + 1):
        if not line.strip():
            continue
        try:
            frame = _frame_of_line(line, selected, counters)
        except ValueError:
            counters.damaged_lines += 1
            counters.first_damaged_line = counters.first_damaged_line or number
        else:
            if frame is not None:
                yield frame


def _frame_of_line(line: bytes, selected: bytes | None, counters: LogCounters) -> Frame | None:
    """The frame, if it is one that counts; ValueError for a line that is none."""
    found = ANY.match(line)
    if found is None:
        raise ValueError("no frame")
    time_text, name, can_id, fd, data = found.groups()
    remote = data[:1] in (b"R", b"r")
    time_s, number = float(time_text), int(can_id, 16)
    content = b"" if remote else unhexlify(data[1:] if fd else data)  # CAN FD has its flags first
    counters.frames += 1
    is_canopen = len(can_id) <= 3 and not fd
    if selected not in (None, name):
        if is_canopen:
            counters.leave_out(_text(name), Counter((number,)))
    elif is_canopen:
        counters.channels.add(_text(name))
        return Frame(number, content, remote, time_s)
    elif len(can_id) > 3 and number & ERROR_FLAG:
        counters.error_frames += 1
    else:
        counters.not_canopen += 1
    return None


BLF_HEADER_BYTES = 144
BLF_OBJECT, BLF_OBJECT_PLACES = b"LOBJ", 8  # an object begins in the first 4 bytes behind the one before
LOOK_FRAMES = 4096


class LogError(CanfbError):
    """A bus log that cannot be read at all; the text says which, and why."""


@dataclass
class BusLogFile:
    """The frames of a log with 11-bit identifiers on one ``channel``, once; None: on all of them.

    All are taken for one bus: some adapters give every sender a channel name of its own.
    ``counters`` are complete when the frames have been read. What comes behind a damaged place is left out
    in a format that cannot be read on from there, and ``trouble`` says so in one line; the lines of a
    candump log are independent, and only the damaged ones are left out. ConfigError for an unknown
    suffix, LogError for a file that cannot be read.
    """

    path: Path
    channel: str | None = None
    counters: LogCounters = field(default_factory=LogCounters)
    trouble: str | None = None

    def __post_init__(self) -> None:
        self.suffix = check_readable(self.path)
        try:
            with self.path.open("rb") as file:
                begin = file.read(BLF_HEADER_BYTES)
        except OSError as error:
            raise LogError(f"{self.path}: cannot be read: {reason(error)}") from None

        if self.suffix == ".blf" and (begin[:4] != b"LOGG" or len(begin) < BLF_HEADER_BYTES):
            raise LogError(f"{self.path}: this is no .blf log")  # python-can would leave it open
        self._bytes = max(1, self.path.stat().st_size)

    @property
    def part_read(self) -> float:
        """How much of it has been read, 0..1."""
        return min(1.0, self.counters.bytes_read / self._bytes)

    def __iter__(self) -> Iterator[Frame]:
        return chain.from_iterable(self.batches())

    def batches(self) -> Iterator[list[Frame]]:
        """The frames, many at a time: to hand on each by itself costs more than to read it.

        What readers raise has no common root: a damaged log is a finding, not the end.
        """
        frames: list[Frame] = []
        try:
            if self.suffix == ".log":
                yield from candump_frames(self.path, self.channel, self.counters)
            else:
                for frame in self._by_python_can():
                    frames.append(frame)
                    if len(frames) == LOOK_FRAMES:
                        yield frames
                        frames = []
        except CanfbError:
            raise
        except (NotImplementedError, ImportError) as error:
            raise LogError(f"{self.path}: {NEEDS_PACKAGE}") from error
        except Exception as error:
            said = reason(error)
            if not self.counters.frames:
                raise LogError(f"{self.path}: this is no {self.suffix} log: {said}") from error
            self.trouble = f"{self.path}: damaged behind frame {self.counters.frames}: {said}"
        yield frames

    def _by_python_can(self) -> Iterator[Frame]:
        counters = self.counters
        reader: Any = (_BlfReader if self.suffix == ".blf" else can.LogReader)(str(self.path))
        with contextlib.ExitStack() as closing:
            closing.callback(reader.stop)
            for message in reader:
                counters.frames += 1
                if not counters.frames % LOOK_FRAMES:
                    counters.bytes_read = _place(reader)
                if message.is_error_frame:  # some have no channel
                    counters.error_frames += 1
                elif message.is_extended_id or message.is_fd:
                    if self.channel in (None, str(message.channel)):
                        counters.not_canopen += 1
                elif self._is_taken(message.channel, message.arbitration_id):
                    data, remote = bytes(message.data), message.is_remote_frame
                    yield Frame(message.arbitration_id, data, remote, message.timestamp)

    def _is_taken(self, channel: object, can_id: int) -> bool:
        name = str(channel)
        if self.channel in (None, name):
            self.counters.channels.add(name)
            return True
        self.counters.leave_out(name, Counter((can_id,)))
        return False


class _BlfReader(can.BLFReader):
    """python-can reads an object that states a length of 0 again and again."""

    def _parse_data(self, data: bytes) -> Iterator[can.Message]:
        """What is before such an object; ValueError behind it."""
        place = data.find(BLF_OBJECT, 0, BLF_OBJECT_PLACES)
        while place >= 0:
            length = int.from_bytes(data[place + 8 : place + 12], "little")
            if not length and len(data) >= place + 12:
                yield from super()._parse_data(data[:place])
                raise ValueError("an object has no length")
            place += length
            place = data.find(BLF_OBJECT, place, place + BLF_OBJECT_PLACES)
        yield from super()._parse_data(data)


def _place(reader: Any) -> int:
    """Where a reader of python-can is in its file, 0 if it does not say so."""
    try:
        file = reader.file
        return int(getattr(file, "buffer", file).tell())
    except (AttributeError, OSError, ValueError):
        return 0
