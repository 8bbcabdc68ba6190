"""What is on the bus beside SYNC and samples in tools.bench.bus: nothing, SDO block transfers, other PDOs."""

from __future__ import annotations

import struct
import zlib
from binascii import crc_hqx
from collections import deque
from collections.abc import Callable, Generator
from itertools import count

from canfb import objects as od
from tools.bench.cycle import NODE_ID, encoder_table

SDO_REQUEST, SDO_ANSWER = 0x600 + NODE_ID, 0x580 + NODE_ID
OTHERS_ID = 0x3A0  # of a PDO that the module does not listen to
ENTRIES, FEW_ENTRIES = 4096, 256  # of a table: the most there are, and of the one in force
DEPTHS = 0.0, 0.001  # of the tables, cycles
UPLOAD_BLOCK = 127  # segments, the most there are
TPDO2_OFF = 0x80000000 | 0x280 + NODE_ID

Frame = tuple[int, bytes]
Talk = Generator[list[bytes], bytes, None]
"""Requests of an SDO client; it is sent each answer."""


class TransferFailed(RuntimeError):
    """The module has aborted, or its answer is not that of the standard."""


class Load:
    """Frames of other nodes, one after the other as the bus has room: here none."""

    waits = False
    """Whether there is a frame to send."""
    frame: Frame = OTHERS_ID, bytes(8)
    """The frame to send now."""

    def sent(self) -> None:
        """It has been sent."""

    def take(self, can_id: int, data: bytes) -> None:
        """A frame of the module."""


class FullBus(Load):
    """There is always a frame: a PDO of 8 bytes between other nodes."""

    waits = True


class SdoClient(Load):
    """The requests of ``talk``, each when the one before is answered."""

    def __init__(self, talk: Talk) -> None:
        self.done = False
        self._talk = talk
        self._requests = deque(next(talk))

    @property
    def waits(self) -> bool:  # type: ignore[override]
        return bool(self._requests)

    @property
    def frame(self) -> Frame:  # type: ignore[override]
        return SDO_REQUEST, self._requests[0]

    def sent(self) -> None:
        self._requests.popleft()

    def take(self, can_id: int, data: bytes) -> None:
        if can_id == SDO_ANSWER and not self.done:
            try:
                self._requests.extend(self._talk.send(data))
            except StopIteration:
                self.done = True


def set_up(alone: bool) -> Talk:
    """A table in force; ``alone``: TPDO2 off, which a stock node does not have."""
    content = encoder_table(FEW_ENTRIES, DEPTHS[0]).to_bytes()
    yield from _download(*od.TABLE_STAGED, content, [])
    yield from _write_u32(*od.TABLE_ACTIVATE, zlib.crc32(content))
    if alone:
        yield from _write_u32(0x1801, 1, TPDO2_OFF)


def tables(entries: int = ENTRIES, rounds: int | None = None) -> Talk:
    """Block download to 2020:01, activation, block upload, of two tables in turns; None: for ever."""
    contents = [encoder_table(entries, depth).to_bytes() for depth in DEPTHS]
    last: list[bytes] = []  # has no answer, and goes with what comes next
    for _ in count() if rounds is None else range(rounds):
        for content in contents:
            yield from _download(*od.TABLE_STAGED, content, last)
            yield from _write_u32(*od.TABLE_ACTIVATE, zlib.crc32(content))
            last = yield from _upload(*od.TABLE_STAGED, content)
    yield last


LOADS: dict[str, Callable[[], Load]] = {"alone": Load, "sdo": lambda: SdoClient(tables()), "full": FullBus}


def _multiplexer(index: int, subindex: int) -> bytes:
    return struct.pack("<HB", index, subindex)


def _checked(answer: bytes, mask: int, expected: int) -> bytes:
    if answer[0] & mask != expected:
        raise TransferFailed(f"{answer.hex(' ')} where {expected:02X}h was expected")
    return answer


def _write_u32(index: int, subindex: int, value: int) -> Talk:
    answer = yield [b"\x23" + _multiplexer(index, subindex) + struct.pack("<I", value)]
    _checked(answer, 0xFF, 0x60)


def _download(index: int, subindex: int, content: bytes, before: list[bytes]) -> Talk:
    """CiA 301, 7.2.4.3.8 to 7.2.4.3.11; ``before`` is what is sent first."""
    begin = b"\xc6" + _multiplexer(index, subindex) + struct.pack("<I", len(content))
    block_size = _checked((yield [*before, begin]), 0xFB, 0xA0)[4]
    pieces = [content[at : at + 7].ljust(7, b"\0") for at in range(0, len(content), 7)]
    sent = 0
    while sent < len(pieces):
        block = pieces[sent : sent + block_size]
        segments = [bytes([number]) + piece for number, piece in enumerate(block, start=1)]
        if sent + len(block) == len(pieces):
            segments[-1] = bytes([segments[-1][0] | 0x80]) + segments[-1][1:]
        answer = _checked((yield segments), 0xFF, 0xA2)
        sent += answer[1]
        block_size = answer[2]
    end = bytes([0xC1 | (-len(content) % 7) << 2]) + struct.pack("<H", crc_hqx(content, 0)) + bytes(5)
    _checked((yield [end]), 0xFF, 0xA1)


def _upload(index: int, subindex: int, expected: bytes) -> Generator[list[bytes], bytes, list[bytes]]:
    """Block upload (CiA 301, 7.2.4.3.12 to 7.2.4.3.15) of ``expected``.

    Returns the last request, which has no answer.
    """
    request = [b"\xa4" + _multiplexer(index, subindex) + bytes([UPLOAD_BLOCK, 0, 0, 0])]
    _checked((yield request), 0xFB, 0xC2)
    request = [b"\xa3" + bytes(7)]
    content = b""
    while len(content) < len(expected):
        number = 0
        while number < UPLOAD_BLOCK and len(content) < len(expected):
            number += 1
            segment = _checked((yield request), 0x7F, number)
            content += segment[1:]
            request = []
        request = [bytes([0xA2, number, UPLOAD_BLOCK]) + bytes(5)]
    _checked((yield request), 0xE3, 0xC1)
    if content[: len(expected)] != expected:
        raise TransferFailed("what came is not the table that is active")
    return [b"\xa1" + bytes(7)]
