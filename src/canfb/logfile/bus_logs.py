"""Reading of bus logs in any format of python-can, for all commands; recording of a bus, or of what replayed
modules send, in these formats.

Logs of candump -L are read in blocks, by a regular expression over many lines at once, because python-can
takes longer for a line than the module for its frame. python-can reads blocks with unusual lines.
"""

from __future__ import annotations

import contextlib
import gzip
import logging
import math
import re
import time
from binascii import unhexlify
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from itertools import accumulate, chain, repeat
from operator import itemgetter, le
from pathlib import Path
from typing import Any, Self

import can
from can.io import MESSAGE_WRITERS

from canfb.bus.frame_bus import ERROR, MULTICAST, Reception, brings_own_frames_back, flagged_id
from canfb.cia301.frame import HIGHEST_ID, Frame
from canfb.errors import CanfbError, ConfigError, reason, saying
from canfb.files import check_writable, replacing, writing
from canfb.logfile.log_files import (
    GZIP,
    NEEDS_PACKAGE,
    READABLE,
    UNREADABLE,
    WRITABLE,
    CandumpLines,
    LogCounters,
    LogError,
    check_suffix,
    messages_of,
    opened,
)
from canfb.rows import those

# A frame that is later is not sorted in; it gets the newest stamp before it.
WINDOW_S = 1.0
MOST_LATE = 100  # frames after a step back beyond WINDOW_S that may all be late
LOOK_BEHIND = 8  # older frames before a step among which late ones are searched
MOST_HELD = 1 << 16  # most frames held back without a decision, e.g. if stamps do not advance


def in_order(batches: Iterable[list[Frame]], counters: LogCounters) -> Iterator[list[Frame]]:
    """The frames in the order of their stamps, though some were written late.

    In the result stamps (seconds, any clock) decrease only where the clock was set. Frames of equal stamp
    keep their order, and those whose stamp is not a number their place.

    The frames after a step back decide, until their stamps have risen by half of the step or the log ends.
    The clock was set if none of them reaches the newest stamp, if they are fewer than the frames with a later
    stamp before the step, and if half of them repeat a CAN-ID of those. Beyond WINDOW_S the first condition
    suffices, for MOST_LATE frames.
    """
    held: list[Frame] = []
    for batch, end in chain(zip(batches, repeat(False)), [([], True)]):
        held += batch
        again = True
        while held and again:
            ready, held, again = _ready(held, end, counters)
            yield ready


def _ready(frames: list[Frame], end: bool, counters: LogCounters) -> tuple[list[Frame], list[Frame], bool]:
    """Frames in order, frames held back, and whether the clock was set before the first of the latter."""
    stamps = _stamps(frames)
    if all(map(le, stamps, stamps[1:])) or _bring_back(frames, stamps, counters):
        cut = len(frames) if end else bisect_left(stamps, stamps[-1] - WINDOW_S)
        return frames[:cut], frames[cut:], False
    newest, looked_to = -math.inf, 0
    for n, stamp in enumerate(stamps):
        if stamp < newest and n >= looked_to:
            was_set, looked_to = _clock_was_set(frames, stamps, n, newest)
            if looked_to == len(frames) and not end and len(frames) - n < MOST_HELD:  # undecided
                ready, held = _sorted(frames[:n], stamps[:n], newest - WINDOW_S, counters)
                return ready, held + frames[n:], False
            if was_set:
                return _sorted(frames[:n], stamps[:n], math.inf, counters)[0], frames[n:], True
        newest = max(newest, stamp)
    ready, held = _sorted(frames, stamps, math.inf if end else newest - WINDOW_S, counters)
    return ready, held, False


def _bring_back(frames: list[Frame], stamps: list[float], counters: LogCounters) -> bool:
    """Give single frames far ahead the stamp of the next one; True if all are in order then."""
    line = -math.inf
    for n, stamp in enumerate(stamps):
        if stamp > line + WINDOW_S:
            behind = stamps[n + 1 : n + 1 + MOST_LATE]
            back = [one for one in behind if one < stamp - WINDOW_S]
            if 2 * len(back) > len(behind) and behind.index(back[0]) < LOOK_BEHIND:
                frames[n], stamps[n] = frames[n]._replace(timestamp=back[0]), back[0]
                counters.late += 1
                continue
        line = max(line, stamp)
    return all(map(le, stamps, stamps[1:]))


def _sorted(
    frames: list[Frame], stamps: list[float], limit_s: float, counters: LogCounters
) -> tuple[list[Frame], list[Frame]]:
    ready, held = [], []
    for frame, stamp, newest in zip(frames, stamps, accumulate(stamps, max), strict=True):
        if newest - stamp > WINDOW_S:
            frame, stamp = frame._replace(timestamp=newest), newest
        if stamp < limit_s:
            counters.late += stamp < newest
            ready.append((stamp, frame))
        else:
            held.append(frame)
    return [frame for _, frame in sorted(ready, key=itemgetter(0))], held


def _stamps(frames: list[Frame]) -> list[float]:
    stamps = [-math.inf if frame[3] is None else frame[3] for frame in frames]
    if not all(map(math.isfinite, stamps)):
        before = next(filter(math.isfinite, stamps), 0.0)
        for n, stamp in enumerate(stamps):
            before = stamps[n] = stamp if math.isfinite(stamp) else before
    return stamps


def _clock_was_set(frames: list[Frame], stamps: list[float], begin: int, newest: float) -> tuple[bool, int]:
    """Whether the clock was set before frame ``begin``, and the end of the frames that decide it.

    The end is ``len(frames)`` if they are too few.
    """
    back_s = newest - stamps[begin]
    is_long = back_s > WINDOW_S
    before: dict[int, float] = {}
    older = 0
    for n in range(begin - 1, -1, -1):
        older += stamps[n] < stamps[begin]
        if is_long or older > LOOK_BEHIND:
            break
        before[frames[n][0]] = max(stamps[n], before.get(frames[n][0], stamps[n]))
    later, again = begin - n - older, 0
    for n in range(begin, len(frames)):
        stamp = stamps[n]
        if stamp >= newest:
            return False, n
        again += before.get(frames[n][0], -math.inf) > stamp
        if is_long and n - begin == MOST_LATE:
            return True, n
        if not is_long and stamp - stamps[begin] >= back_s / 2.0 and n > begin:
            return 2 * again >= n - begin and (later > n - begin or not older), n
    return is_long or (2 * again > n - begin and later > n - begin + 1), len(frames)


BLOCK_BYTES = 1 << 18
# (1700000000.123456) can0 190#0011AAFF; some versions append R or T.
USUAL = re.compile(rb"^\((\d+\.\d+)\) (\S+) ([0-9A-Fa-f]{3})#((?:[0-9A-Fa-f]{2}){0,8})(?: [RTrt])?\r?$", re.M)
_new = tuple.__new__  # makes a named tuple in half the time that its own constructor takes


def usual_frames(
    lines: Sequence[tuple[bytes, ...]], channel: str | None, counters: LogCounters
) -> list[Frame]:
    """The frames of one channel (None: all) in the matches of :data:`USUAL`."""
    frame, selected = Frame, None if channel is None else channel.encode()
    taken = [
        _new(frame, (int(can_id, 16), unhexlify(data), False, float(time_s)))
        for time_s, name, can_id, data in lines
        if selected is None or name == selected
    ]
    for name in {name for _, name, _, _ in lines}:
        text = name.decode("utf-8", "replace")
        if selected in (None, name):
            counters.channels.add(text)
        else:
            ids = (int(can_id, 16) for _, other, can_id, _ in lines if other == name)
            counters.left_out[text] += Counter(ids)
    counters.frames += len(lines)
    return taken


def blocks_of(file: Any, counters: LogCounters) -> Iterator[tuple[int, bytes]]:
    """Blocks of whole lines, with the number of lines before each; a line longer than a block is divided.

    An incomplete last line is left out. Raises UNREADABLE errors of the file.
    """
    rest = whole = b""
    number, failure = 0, None
    while failure is None:
        try:
            more = file.read1(BLOCK_BYTES)  # read() would lose the data before an error
        except UNREADABLE as error:
            failure, more = error, b""
        if not more:
            break
        before, end, rest = (rest + more).rpartition(b"\n")
        if len(rest) > BLOCK_BYTES:
            before, end, rest = before + end + rest, b"\n", b""
        if end:
            whole = before + end
            yield number, whole
            number += whole.count(b"\n")
    if rest and (failure is not None or _is_cut(rest, whole)):
        counters.damaged(number + 1)
    elif rest:
        yield number, rest + b"\n"
    if failure is not None:
        raise failure


def _is_cut(line: bytes, before: bytes) -> bool:
    """Whether a last line without line end is shorter than the previous one with the same CAN-ID."""
    place = line.find(b"#")
    begin = line.rfind(b" ", 0, max(0, place))
    same = before.rfind(line[begin : place + 1])
    return begin >= 0 and same >= 0 and len(line) - begin < len(before[same:].partition(b"\n")[0])


BATCH_FRAMES = 4096


@dataclass
class BusLogFile:
    """The frames of a log with 11-bit identifiers on one ``channel`` (None: all); iterate once.

    Late frames are sorted in (:func:`in_order`). With ``others`` error frames, frames with 29-bit identifiers
    and of CAN FD are included, flagged (:func:`.flagged_id`).

    ``counters`` are complete at the end. Damaged lines are left out; if the rest is unreadable, ``trouble``
    says so. ConfigError for an unknown suffix, LogError for an unreadable file.
    """

    path: Path
    channel: str | None = None
    others: bool = False
    counters: LogCounters = field(default_factory=LogCounters)
    trouble: str | None = None

    def __post_init__(self) -> None:
        self.suffix = check_suffix(self.path, READABLE)
        with saying(LogError, f"{self.path}: cannot be read", OSError), self.path.open("rb") as file:
            self._bytes = max(1, file.seek(0, 2))

    @property
    def part_read(self) -> float:
        """Part of the file that has been read, 0..1."""
        return min(1.0, self.counters.bytes_read / self._bytes)

    def __iter__(self) -> Iterator[Frame]:
        return chain.from_iterable(self.batches())

    def batches(self) -> Iterator[list[Frame]]:
        """The frames in batches, which is faster."""
        yield from in_order(self._as_written(), self.counters)

    def check_end(self, report: Callable[[str], None]) -> None:
        """Report the lines that were left out. LogError if the end cannot be read."""
        for words in self.counters.lines_left_out():
            report(f"{self.path}: {words}")
        if self.trouble is not None:
            raise LogError(self.trouble)

    def no_frame(self, what: str = "frame") -> LogError:
        """The error for a log without ``what``; says what it contains instead."""
        words = [
            f"{self.path}: there is no {what} in it",
            *those((self.counters.left_out, f"there are {', '.join(sorted(self.counters.left_out))}")),
            *self.counters.lines_left_out(),
            *those(
                (self.suffix == ".log" and self.counters.damaged_lines, "record it with candump -L (UTF-8)"),
                (
                    self.suffix == ".csv" and self.counters.damaged_lines,
                    "are these samples? (calibrate --samples)",
                ),
            ),
        ]
        return LogError("; ".join(words))

    def _as_written(self) -> Iterator[list[Frame]]:
        """The frames in the order of the file. Damage, for which readers raise anything, ends them."""
        try:
            yield from self._candump() if self.suffix == ".log" else self._by_python_can()
        except (NotImplementedError, ImportError) as error:
            raise LogError(f"{self.path}: {NEEDS_PACKAGE}") from error
        except Exception as error:
            if not self.counters.frames:
                raise LogError(f"{self.path}: this is no {self.suffix} log: {reason(error)}") from error
            self.trouble = (
                f"{self.path}: damaged or incomplete: nothing can be read after frame "
                f"{self.counters.frames}: {reason(error)}"
            )

    def _candump(self) -> Iterator[list[Frame]]:
        counters = self.counters
        with opened(self.path) as (file, raw):
            for number, block in blocks_of(file, counters):
                usual = USUAL.findall(block)
                if len(usual) == block.count(b"\n"):
                    yield usual_frames(usual, self.channel, counters)
                else:
                    messages = CandumpLines(BytesIO(block), counters, number).messages()
                    yield [*filter(None, map(self._frame, messages))]
                counters.bytes_read = raw.tell()

    def _by_python_can(self) -> Iterator[list[Frame]]:
        frames: list[Frame] = []
        try:
            for frame in filter(None, map(self._frame, messages_of(self.path, self.suffix, self.counters))):
                frames.append(frame)
                if len(frames) == BATCH_FRAMES:
                    yield frames
                    frames = []
        except Exception:
            yield frames
            raise
        yield frames

    def _frame(self, message: can.Message) -> Frame | None:
        counters, can_id, name = self.counters, flagged_id(message), str(message.channel)
        counters.frames += 1
        if can_id & ERROR:  # before the channel: some error frames have none
            counters.error_frames += 1
        elif self.channel not in (None, name):
            if can_id <= HIGHEST_ID:
                counters.left_out[name][can_id] += 1
            return None
        elif can_id > HIGHEST_ID:
            counters.not_canopen += 1
        else:
            counters.channels.add(name)
        if can_id > HIGHEST_ID and not self.others:
            return None
        return Frame(can_id, bytes(message.data), message.is_remote_frame, message.timestamp)


log = logging.getLogger(__name__)

LONGEST_WAIT_S = 0.1  # longest delay until a signal or the end is noticed
ROTATED = frozenset({".asc", ".blf", ".log"})  # suffixes of python-can's SizedRotatingLogger


class BusLog:
    """Writes what a bus receives into a file until :meth:`stop`. Use it as a context manager.

    A bus that fails is tried again; an interface that was removed and re-created is opened again.

    With ``max_bytes`` a file of this size is renamed, and the next one begins. ConfigError for an impossible
    suffix, size or folder, and for an existing file unless ``overwrite``; CanfbError when the file fails.

    ``clock`` and ``sleep`` are arguments for tests.
    """

    def __init__(
        self,
        path: Path,
        max_bytes: int = 0,
        overwrite: bool = False,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.path = self.place = path
        self.frames = self.error_frames = 0
        self._max_bytes = max_bytes
        self._clock, self._sleep = clock, sleep
        self._stopped = False
        self._suffix = check_suffix(path, WRITABLE)
        if max_bytes and path.suffix.lower() not in ROTATED:
            raise ConfigError(
                f"--max-size: python-can divides {', '.join(sorted(ROTATED))}, not {path.suffix}"
            )
        check_writable(path)
        if path.exists() and (not overwrite or not path.is_file()):
            raise ConfigError(f"{path}: exists; take another name, or --force")

    def __enter__(self) -> Self:
        name, most = str(self.place), self._max_bytes
        try:
            with writing(self.path):
                # Opened here as python-can does, which accepts no further dot in the name of a .gz.
                file: Any = gzip.open(name, "wt") if self.path.suffix.lower() == GZIP else name
                self._writer = (
                    can.SizedRotatingLogger(name, max_bytes=most)
                    if most
                    else MESSAGE_WRITERS[self._suffix](file)
                )
        except (NotImplementedError, ImportError) as error:
            raise CanfbError(f"{self.path}: {NEEDS_PACKAGE}") from error
        return self

    def __exit__(self, *raised: object) -> None:
        with writing(self.path):
            self._writer.stop()

    def stop(self) -> None:
        self._stopped = True

    def record(self, bus: can.BusABC, seconds: float | None = None) -> None:
        """Write received frames for ``seconds``; None: until :meth:`stop`.

        On udp_multicast every sender chooses its channel name; here all frames get the same.
        """
        name = MULTICAST if brings_own_frames_back(bus) else None
        reception = Reception(bus, log.warning, self._clock, self._sleep, lasts=True)
        end = None if seconds is None else self._clock() + seconds
        while not self._stopped:
            left = LONGEST_WAIT_S if end is None else end - self._clock()
            if left <= 0.0:
                return
            message = reception.receive(min(left, LONGEST_WAIT_S))
            if message is not None:
                message.channel = name or message.channel
                self.write(message)

    def write(self, message: can.Message) -> None:
        with writing(self.path):
            self._writer.on_message_received(message)
        # python-can writes only classic data frames into a .trc.
        kept = self._suffix != ".trc" or not (
            message.is_error_frame or message.is_remote_frame or message.is_fd
        )
        self.frames += kept
        self.error_frames += kept and message.is_error_frame

    def take(self, frame: Frame) -> None:
        self.write(
            can.Message(frame.timestamp or 0.0, frame.can_id, False, frame.rtr, channel=0, data=frame.data)
        )


@contextlib.contextmanager
def replacing_log(path: Path) -> Iterator[BusLog]:
    """A log that replaces ``path`` at the end if nothing failed."""
    log = BusLog(path, overwrite=True)
    with replacing(path) as log.place, log:
        yield log
