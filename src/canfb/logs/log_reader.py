"""Frames of a bus log, in any format that python-can reads."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

import can

from canfb.cia301.frame import Frame
from canfb.errors import CanfbError, reason
from canfb.logs.candump_log import candump_frames
from canfb.logs.log_files import NEEDS_PACKAGE, LogCounters, check_readable

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
                    yield _frame(message)

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


def _frame(message: can.Message) -> Frame:
    return Frame(message.arbitration_id, bytes(message.data), message.is_remote_frame, message.timestamp)


def _place(reader: Any) -> int:
    """Where a reader of python-can is in its file, 0 if it does not say so."""
    try:
        file = reader.file
        return int(getattr(file, "buffer", file).tell())
    except (AttributeError, OSError, ValueError):
        return 0
