"""Bus logs as files: their suffixes, how they are opened, what is counted while they are read; and recording
a bus, or what replayed modules send, in the formats of python-can."""

from __future__ import annotations

import contextlib
import gzip
import logging
import time
import zlib
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Self

import can
from can.io import MESSAGE_READERS, MESSAGE_WRITERS
from can.io.generic import MessageWriter

from canfb.bus.frame_bus import Reception, brings_own_frames_back
from canfb.cia301.frame import Frame
from canfb.errors import CanfbError, ConfigError, reason
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
                (self.late, f"{self.late} frames with stamps out of order, put in their places"),
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


log = logging.getLogger(__name__)

LONGEST_WAIT_S = 0.1  # how late a signal or the end may be noticed
UDP_MULTICAST = "udp_multicast"
ROTATED = frozenset({".asc", ".blf", ".log"})  # python-can's SizedRotatingLogger


class BusLog:
    """Writes what a bus receives into a file until :meth:`stop`. Use it as a context manager.

    A bus that fails is tried again, and an interface that was removed and made again is opened.

    With ``max_bytes`` a file that has become as large is renamed, and the next one begins. ConfigError for a
    suffix, size or place that cannot be, and for a file that is there unless ``overwrite``; CanfbError when
    the file fails.

    ``clock`` and ``sleep`` are those of the system, but for tests.
    """

    def __init__(
        self,
        path: Path,
        max_bytes: int = 0,
        overwrite: bool = False,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.path = path
        self.frames = self.error_frames = 0
        self._max_bytes = max_bytes
        self._clock, self._sleep = clock, sleep
        self._stopped = False
        self._writer: MessageWriter | None = None
        suffix = check_suffix(path, WRITABLE)
        if max_bytes and "".join(path.suffixes[-1:]).lower() not in ROTATED:
            raise ConfigError(f"--max-size: python-can divides {', '.join(sorted(ROTATED))}, not {suffix}")
        if not path.parent.is_dir():
            raise ConfigError(f"{path}: there is no folder {path.parent}")
        if path.exists() and (not overwrite or not path.is_file()):
            raise ConfigError(f"{path}: is there already; take another name, or --force")

    def __enter__(self) -> Self:
        options: dict[str, Any] = {"max_bytes": self._max_bytes} if self._max_bytes else {}
        writer: Callable[..., MessageWriter] = can.SizedRotatingLogger if self._max_bytes else can.Logger
        try:
            self._writer = writer(str(self.path), **options)
        except (NotImplementedError, ImportError) as error:
            raise CanfbError(f"{self.path}: {NEEDS_PACKAGE}") from error
        except (OSError, ValueError) as error:
            raise CanfbError(f"{self.path}: cannot be written: {reason(error)}") from error
        return self

    def __exit__(self, *raised: object) -> None:
        with self._writing(suppress=raised[0] is not None):
            writer, self._writer = self._writer, None
            if writer is not None:
                writer.stop()

    @contextlib.contextmanager
    def _writing(self, *, suppress: bool = False) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            # What is in its buffer cannot be written either.
            writer, self._writer = self._writer, None
            with contextlib.suppress(OSError):
                if writer is not None:
                    writer.stop()
            if not suppress:
                raise CanfbError(f"{self.path}: cannot be written: {reason(error)}") from error

    def stop(self) -> None:
        self._stopped = True

    def record(self, bus: can.BusABC, seconds: float | None = None) -> None:
        """Write what comes for ``seconds``; None: until :meth:`stop`.

        The frames of udp_multicast, in which each sender names the channel as it likes, get one name.
        """
        name = UDP_MULTICAST if brings_own_frames_back(bus) else None
        reception = Reception(bus, log.warning, self._clock, self._sleep, lasts=True)
        end = None if seconds is None else self._clock() + seconds
        while not self._stopped:
            left = LONGEST_WAIT_S if end is None else end - self._clock()
            if left <= 0.0:
                return
            message = reception.receive(min(left, LONGEST_WAIT_S))
            if message is not None:
                if name is not None:
                    message.channel = name
                self.write(message)

    def write(self, message: can.Message) -> None:
        assert self._writer is not None
        with self._writing():
            self._writer.on_message_received(message)
        self.frames += 1
        self.error_frames += message.is_error_frame

    def take(self, frame: Frame) -> None:
        """A frame with its stamp."""
        can_id, data, rtr, stamp = frame
        self.write(can.Message(stamp or 0.0, can_id, False, rtr, channel=0, data=data))
