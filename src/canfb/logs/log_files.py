"""Bus logs as files: which ones python-can reads and writes, by their suffix, and what there was in one."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from can.io import MESSAGE_READERS, MESSAGE_WRITERS

from canfb.errors import ConfigError

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
    suffix, zipped = log_suffix(path)
    if suffix not in readable() or (zipped and suffix in NOT_ZIPPED):
        raise ConfigError(f"{path}: {_unknown(suffix, zipped)}; bus logs end with {_words(readable())}")
    return suffix


def check_writable(path: Path) -> str:
    """The suffix. ConfigError for one that nobody writes."""
    suffix, zipped = log_suffix(path)
    if suffix not in writable() or (zipped and suffix in NOT_ZIPPED):
        raise ConfigError(f"{path}: {_unknown(suffix, zipped)}; bus logs end with {_words(writable())}")
    return suffix


def _unknown(suffix: str, zipped: bool) -> str:
    if zipped and suffix in NOT_ZIPPED:
        return f"{suffix} cannot be compressed with gzip"
    return f"unknown suffix {suffix!r}" if suffix else "no suffix"


def _words(suffixes: list[str]) -> str:
    return f"{', '.join(suffixes)}, or {GZIP} behind one of text"


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
