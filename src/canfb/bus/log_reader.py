"""Frames of a bus log, in any format that python-can reads."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import can

from canfb.bus.candump_log import candump_frames
from canfb.bus.log_suffixes import check_readable
from canfb.bus.logged import LogCounters
from canfb.cia301.frame import Frame
from canfb.errors import CanfbError, reason

BLF_HEADER_BYTES = 144
LOOK_FRAMES = 4096
ASAMMDF = "pip install 'canfb[mf4]'"
_new = tuple.__new__  # makes a named tuple in half the time that its own constructor takes


class LogError(CanfbError):
    """A bus log that cannot be read at all; the text says which, and why."""


@dataclass
class BusLogFile:
    """The frames of a log with 11-bit identifiers on one ``channel``, once; None: that of the first frame.

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
        if self.suffix == ".log":
            return self._guarded(lambda: candump_frames(self.path, self.channel, self.counters))
        return self._guarded(self._by_python_can)

    def _guarded(self, frames: Callable[[], Iterator[Frame]]) -> Iterator[Frame]:
        """What readers raise has no common root: a damaged log is a finding, not the end."""
        try:
            yield from frames()
        except CanfbError:
            raise
        except (NotImplementedError, ImportError) as error:
            raise LogError(f"{self.path}: this format needs another package: {ASAMMDF}") from error
        except Exception as error:
            said = reason(error)
            if not self.counters.frames:
                raise LogError(f"{self.path}: this is no {self.suffix} log: {said}") from error
            self.trouble = f"{self.path}: damaged behind frame {self.counters.frames}: {said}"

    def _by_python_can(self) -> Iterator[Frame]:
        counters, wanted = self.counters, self.channel
        reader: Any = can.LogReader(str(self.path))
        with contextlib.ExitStack() as closing:
            closing.callback(reader.stop)
            for message in reader:
                counters.frames += 1
                if not counters.frames % LOOK_FRAMES:
                    counters.bytes_read = _place(reader)
                channel = message.channel
                if wanted is None:
                    wanted = counters.channel = str(channel)
                if str(channel) != wanted:
                    counters.other_channels.add(str(channel))
                elif message.is_error_frame:
                    counters.error_frames += 1
                elif message.is_extended_id or message.is_fd:
                    counters.not_canopen += 1
                else:
                    yield _new(
                        Frame,
                        (
                            message.arbitration_id,
                            bytes(message.data),
                            message.is_remote_frame,
                            message.timestamp,
                        ),
                    )


def _place(reader: Any) -> int:
    """Where a reader of python-can is in its file, 0 if it does not say so."""
    try:
        file = reader.file
        return int(getattr(file, "buffer", file).tell())
    except (AttributeError, OSError, ValueError):
        return 0
