"""The frames of a bus log in any format that python-can reads: one reader for all commands."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from itertools import chain
from pathlib import Path

import can

from canfb.bus.frame_bus import ERROR, flagged_id
from canfb.cia301.frame import HIGHEST_ID, Frame
from canfb.errors import CanfbError, reason
from canfb.logfile.candump import USUAL, blocks_of, usual_frames
from canfb.logfile.in_order import InOrder
from canfb.logfile.log_files import NEEDS_PACKAGE, LogCounters, LogError, check_suffix, opened, readable
from canfb.logfile.python_can_logs import CandumpLines, messages_of

BATCH_FRAMES = 4096


@dataclass
class BusLogFile:
    """The frames of a log with 11-bit identifiers on one ``channel``, once; None: on all of them.

    Late frames get their place (:mod:`.in_order`). With ``others`` error frames, and frames with 29 bits or
    of CAN FD, are given as well, flagged (:func:`.flagged_id`).

    ``counters`` are complete at the end. Damaged lines are left out; where nothing more can be read,
    ``trouble`` says so. ConfigError for an unknown suffix, LogError for a file that cannot be read.
    """

    path: Path
    channel: str | None = None
    others: bool = False
    counters: LogCounters = field(default_factory=LogCounters)
    trouble: str | None = None

    def __post_init__(self) -> None:
        self.suffix = check_suffix(self.path, readable())
        try:
            with self.path.open("rb") as file:
                self._bytes = max(1, file.seek(0, 2))
        except OSError as error:
            raise LogError(f"{self.path}: cannot be read: {reason(error)}") from None

    @property
    def part_read(self) -> float:
        """How much of it has been read, 0..1."""
        return min(1.0, self.counters.bytes_read / self._bytes)

    def __iter__(self) -> Iterator[Frame]:
        return chain.from_iterable(self.batches())

    def batches(self) -> Iterator[list[Frame]]:
        """The frames, many at a time, which is faster."""
        order = InOrder()
        yield from order.sorted(self._as_written())
        self.counters.late = order.late

    def check_end(self, report: Callable[[str], None]) -> None:
        """Give to ``report`` which lines were left out. LogError if the end cannot be read."""
        for words in self.counters.lines_left_out():
            report(f"{self.path}: {words}")
        if self.trouble is not None:
            raise LogError(self.trouble)

    def _as_written(self) -> Iterator[list[Frame]]:
        """What readers raise has no common root: a damaged log is a finding, not the end."""
        try:
            yield from self._candump() if self.suffix == ".log" else self._by_python_can()
        except CanfbError:
            raise
        except (NotImplementedError, ImportError) as error:
            raise LogError(f"{self.path}: {NEEDS_PACKAGE}") from error
        except Exception as error:
            if not self.counters.frames:
                raise LogError(f"{self.path}: this is no {self.suffix} log: {reason(error)}") from error
            self.trouble = (
                f"{self.path}: damaged or incomplete: nothing can be read behind frame "
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
                    yield [frame for frame in map(self._frame, messages) if frame is not None]
                counters.bytes_read = raw.tell()

    def _by_python_can(self) -> Iterator[list[Frame]]:
        frames: list[Frame] = []
        try:
            for message in messages_of(self.path, self.suffix, self.counters):
                frame = self._frame(message)
                frames += [] if frame is None else [frame]
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
        if can_id & ERROR:  # some have no channel
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
