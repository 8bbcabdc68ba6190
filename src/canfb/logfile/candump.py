"""Logs of candump -L, read in blocks, by a regular expression over many lines at once.

python-can takes more time for a line than the module for its frame. It reads blocks in which a line is not a
usual one.
"""

from __future__ import annotations

import re
from binascii import unhexlify
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from canfb.cia301.frame import Frame
from canfb.logfile.log_files import UNREADABLE, LogCounters

BLOCK_BYTES = 1 << 18
# (1700000000.123456) can0 190#0011AAFF, with R or T behind it from some versions.
USUAL = re.compile(rb"^\((\d+\.\d+)\) (\S+) ([0-9A-Fa-f]{3})#((?:[0-9A-Fa-f]{2}){0,8})(?: [RTrt])?\r?$", re.M)
_IDS = {b"%03X" % can_id: can_id for can_id in range(0x800)}
_IDS |= {b"%03x" % can_id: can_id for can_id in range(0x800)}
_new = tuple.__new__  # makes a named tuple in half the time that its own constructor takes


def usual_frames(
    lines: Sequence[tuple[bytes, ...]], channel: str | None, counters: LogCounters
) -> list[Frame]:
    """The frames of one channel, None for all, in what :data:`USUAL` has found."""
    ids, frame, selected = _IDS, Frame, None if channel is None else channel.encode()
    try:
        taken = [
            _new(frame, (ids[can_id], unhexlify(data), False, float(time_s)))
            for time_s, name, can_id, data in lines
            if selected is None or name == selected
        ]
        for name in {name for _, name, _, _ in lines}:
            if selected in (None, name):
                counters.channels.add(_text(name))
            else:
                counters.left_out[_text(name)] += Counter(ids[line[2]] for line in lines if line[1] == name)
    except KeyError:  # large and small letters in one identifier
        large = [(time_s, name, can_id.upper(), data) for time_s, name, can_id, data in lines]
        return usual_frames(large, channel, counters)
    counters.frames += len(lines)
    return taken


def _text(name: bytes) -> str:
    return name.decode("utf-8", "replace")


def blocks_of(file: Any, counters: LogCounters) -> Iterator[tuple[int, bytes]]:
    """Whole lines, each with its end, and how many stand before; one that is longer than a block is divided.

    A last one that is not whole is left out. Raises what is UNREADABLE about the file.
    """
    rest = whole = b""
    number, failure = 0, None
    while failure is None:
        try:
            more = file.read1(BLOCK_BYTES)  # with read() an error takes along what came before it
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
    """Whether a last line without an end is shorter than the one before with the same CAN-ID."""
    place = line.find(b"#")
    begin = line.rfind(b" ", 0, max(0, place))
    same = before.rfind(line[begin : place + 1])
    return begin >= 0 and same >= 0 and len(line) - begin < len(before[same:].partition(b"\n")[0])
