"""Bus logs as files: their suffixes, how they are opened, and what is counted while they are read."""

from __future__ import annotations

import contextlib
import gzip
import zlib
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from can.io import MESSAGE_READERS, MESSAGE_WRITERS

from canfb.errors import CanfbError, ConfigError
from canfb.rows import Row, those

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


READABLE = sorted(MESSAGE_READERS)
WRITABLE = sorted(set(MESSAGE_WRITERS) & set(MESSAGE_READERS))
"""What can be written, and read again."""


def is_log(path: Path) -> bool:
    """Whether a file of a folder is a bus log, by its name."""
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


UNREADABLE = (OSError, EOFError, zlib.error)
"""What reading a file raises, compressed or not."""


@contextlib.contextmanager
def opened(path: Path) -> Iterator[tuple[Any, IO[bytes]]]:
    """The content, unpacked, and the file itself for its place."""
    with path.open("rb") as raw:
        if log_suffix(path)[1]:
            with gzip.open(raw, "rb") as unpacked:
                yield unpacked, raw
        else:
            yield raw, raw


class LogError(CanfbError):
    """A bus log that cannot be read at all; the text says which, and why."""


@dataclass
class LogCounters:
    """All frames, those left out and why, and lines that are none.

    late             frames that got another place
    damaged_lines    lines that are no whole frame; ``empty_lines`` are comments of a candump log as well
    bytes_read       of the file, for the progress
    channels         whose frames were taken
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
        self.first_damaged_line = self.first_damaged_line or line

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
                (self.late, f"{self.late} frames that were written down late, put in their places"),
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
        left_out, taken = _names(self.left_out), _names(self.channels)
        several = len(self.channels) > 1 and not left_out
        return those(
            (
                left_out,
                f"{number} frames of channel {left_out} left out: --channel takes those of {taken} alone",
            ),
            (
                several,
                f"channels {taken} are taken as one bus; if they are several, --channel takes one",
            ),
        )


def _names(channels: Collection[str]) -> str:
    names = sorted(channels)
    more = len(names) - 6
    return ", ".join([*names[:6], *[f"and {more} more"] * (more > 0)])
