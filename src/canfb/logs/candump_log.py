"""Logs of candump -L, read in blocks: python-can takes more time for a line than the module for its frame."""

from __future__ import annotations

import gzip
import re
from binascii import unhexlify
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO

from canfb.cia301.frame import Frame
from canfb.logs.log_files import LogCounters, log_suffix

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
    with path.open("rb") as raw, _unzipped(path, raw) as file:
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


def _unzipped(path: Path, raw: IO[bytes]) -> IO[bytes]:
    return gzip.open(raw, "rb") if log_suffix(path)[1] else raw  # type: ignore[return-value]


def _blocks(file: IO[bytes]) -> Iterator[bytes]:
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
            frame = _frame(line, selected, counters)
        except ValueError:
            counters.damaged_lines += 1
            counters.first_damaged_line = counters.first_damaged_line or number
        else:
            if frame is not None:
                yield frame


def _frame(line: bytes, selected: bytes | None, counters: LogCounters) -> Frame | None:
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
