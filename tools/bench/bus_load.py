"""What is on the bus beside SYNC and samples in tools.bench.bus: nothing, SDO block transfers, other PDOs."""

from __future__ import annotations

import struct
import zlib
from collections import deque
from collections.abc import Callable, Iterator
from itertools import cycle
from typing import NamedTuple

from canfb import objects as od
from tools.bench.cycle import NODE_ID, encoder_table
from tools.fuzz.client import LARGEST_BLOCK, Follower

SDO_REQUEST, SDO_ANSWER = 0x600 + NODE_ID, 0x580 + NODE_ID
OTHERS_ID = 0x3A0  # of a PDO that the module does not listen to
ENTRIES, FEW_ENTRIES = 4096, 256  # of a table: the most there are, and of the one in force
DEPTHS = 0.0, 0.001  # of the tables, cycles
WRITE_U32, ABORT, END_OF_UPLOAD = 0x23, 0x80, 0xA1  # first bytes

Frame = tuple[int, bytes]


class Transfer(NamedTuple):
    """The first request, and what is written where that does not hold it."""

    request: bytes
    content: bytes = b""

    @property
    def is_expedited(self) -> bool:
        return self.request[0] == WRITE_U32


class TransferFailed(RuntimeError):
    """The module has aborted."""


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
    """The requests of these transfers, each when the one before is answered."""

    def __init__(self, transfers: Iterator[Transfer]) -> None:
        self.done = False
        self._transfers = transfers
        self._client = Follower()
        self._requests = deque[bytes]()
        self._begin()

    @property
    def waits(self) -> bool:  # type: ignore[override]
        return bool(self._requests)

    @property
    def frame(self) -> Frame:  # type: ignore[override]
        return SDO_REQUEST, self._requests[0]

    def sent(self) -> None:
        self._requests.popleft()

    def take(self, can_id: int, data: bytes) -> None:
        if can_id != SDO_ANSWER or self.done:
            return
        if data[0] == ABORT:
            raise TransferFailed(f"{data.hex(' ')} to {self._transfer.request.hex(' ')}")
        if self._transfer.is_expedited:
            self._begin()
            return
        self._client.heard(data)
        if not self._client.is_within_block(data):
            following = self._client.requests()
            self._requests.extend(following)
            if not following or following[-1][0] == END_OF_UPLOAD:  # which has no answer
                self._begin()

    def _begin(self) -> None:
        transfer = next(self._transfers, None)
        self.done = transfer is None
        if transfer is not None:
            self._transfer, self._client.content = transfer, transfer.content
            self._requests.append(transfer.request)


def set_up() -> Iterator[Transfer]:
    """A table in force."""
    content = encoder_table(FEW_ENTRIES, DEPTHS[0]).to_bytes()
    yield _download(*od.TABLE_STAGED, content)
    yield _write_u32(*od.TABLE_ACTIVATE, zlib.crc32(content))


def tables() -> Iterator[Transfer]:
    """Block download to 2020:01, activation, block upload, of two tables in turns, for ever."""
    for content in cycle([encoder_table(ENTRIES, depth).to_bytes() for depth in DEPTHS]):
        yield _download(*od.TABLE_STAGED, content)
        yield _write_u32(*od.TABLE_ACTIVATE, zlib.crc32(content))
        yield Transfer(b"\xa4" + _multiplexer(*od.TABLE_STAGED) + bytes([LARGEST_BLOCK, 0, 0, 0]))


LOADS: dict[str, Callable[[], Load]] = {"alone": Load, "sdo": lambda: SdoClient(tables()), "full": FullBus}


def _multiplexer(index: int, subindex: int) -> bytes:
    return struct.pack("<HB", index, subindex)


def _write_u32(index: int, subindex: int, value: int) -> Transfer:
    return Transfer(bytes([WRITE_U32]) + _multiplexer(index, subindex) + struct.pack("<I", value))


def _download(index: int, subindex: int, content: bytes) -> Transfer:
    """A block download (CiA 301, 7.2.4.3.8)."""
    return Transfer(b"\xc6" + _multiplexer(index, subindex) + struct.pack("<I", len(content)), content)
