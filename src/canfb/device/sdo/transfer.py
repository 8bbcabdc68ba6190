"""SDO transfers (CiA 301, 7.2.4.3): what all have in common, expedited, and segmented ones."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable

from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.device.core import NEVER
from canfb.device.od.dictionary import Entry

# Bytes that a download to a DOMAIN or a string may have; more is aborted (05040005h).
LARGEST_DOWNLOAD = 1 << 16

Reply = Callable[[bytes], None]  # Sends up to 8 bytes to the client, filled up with zeros.

DOWNLOAD_SEGMENT = 0
INITIATE_DOWNLOAD = 1
INITIATE_UPLOAD = 2
UPLOAD_SEGMENT = 3
ABORT = 4
BLOCK_UPLOAD = 5
BLOCK_DOWNLOAD = 6  # Client command specifiers: bits 5 to 7 of the first byte.

ABORT_COMMAND = 0x80


class Transfer(ABC):
    """One transfer that takes more than one frame of the client.

    `multiplexer` is index and sub-index as in the frames; `target` is the entry that a download writes, None
    for an upload. `pause` is how long the server waits by itself before `proceed`, seconds; NEVER while it
    waits for the client.
    """

    target: Entry | None = None
    pause = NEVER

    def __init__(self, multiplexer: bytes, reply: Reply) -> None:
        self.multiplexer = multiplexer
        self._reply = reply

    @abstractmethod
    def accepts(self, command: int) -> bool:
        """Whether this first byte belongs to it."""

    @abstractmethod
    def handle(self, data: bytes) -> bool:
        """Take a frame; False: complete. SdoAbort ends it."""

    def proceed(self) -> None:  # noqa: B027  (most never pause)
        """Go on sending after the pause."""


def check_size(entry: Entry, size: int) -> None:
    """Refuse an announced size, bytes, before any data comes."""
    expected = entry.byte_length
    if expected and size != expected:
        raise SdoAbort(AbortCode.TOO_LONG if size > expected else AbortCode.TOO_SHORT)
    if size > LARGEST_DOWNLOAD:
        raise SdoAbort(AbortCode.OUT_OF_MEMORY)


def check_received(entry: Entry, received: int, announced: int | None) -> None:
    """Refuse more data, bytes, than was announced, or than the entry takes."""
    limit = entry.byte_length if announced is None else announced
    if (limit or announced == 0) and received > limit:
        raise SdoAbort(AbortCode.TOO_LONG)
    if received > LARGEST_DOWNLOAD:
        raise SdoAbort(AbortCode.OUT_OF_MEMORY)


def finish_download(entry: Entry, data: bytes, announced: int | None) -> None:
    if announced is not None and len(data) != announced:
        raise SdoAbort(AbortCode.TOO_LONG if len(data) > announced else AbortCode.TOO_SHORT)
    entry.download(data)


def expedited_upload(multiplexer: bytes, data: bytes) -> bytes:
    return bytes([0x43 | (4 - len(data)) << 2]) + multiplexer + data


def expedited_data(entry: Entry, frame: bytes) -> bytes:
    """The data of an expedited request; without a size, as the entry has."""
    size_indicated = frame[0] & 0x01
    size = 4 - (frame[0] >> 2 & 0x03) if size_indicated else min(entry.byte_length or 4, 4)
    return frame[4 : 4 + size]


_SEGMENT = 7
_TOGGLE = 0x10
_LAST = 0x01


class SegmentedUpload(Transfer):
    """Server to client."""

    def __init__(self, multiplexer: bytes, data: bytes, reply: Reply) -> None:
        super().__init__(multiplexer, reply)
        self._data = data
        self._position = 0
        self._toggle = 0
        reply(b"\x41" + multiplexer + len(data).to_bytes(4, "little"))

    def accepts(self, command: int) -> bool:
        return command >> 5 == UPLOAD_SEGMENT

    def handle(self, data: bytes) -> bool:
        if data[0] & _TOGGLE != self._toggle:
            raise SdoAbort(AbortCode.TOGGLE)
        segment = self._data[self._position : self._position + _SEGMENT]
        self._position += len(segment)
        last = self._position >= len(self._data)
        command = self._toggle | (_SEGMENT - len(segment)) << 1 | (_LAST if last else 0)
        self._toggle ^= _TOGGLE
        self._reply(bytes([command]) + segment)
        return not last


class Download(Transfer):
    """Client to server; written when all is there."""

    def __init__(self, multiplexer: bytes, entry: Entry, announced: int | None, reply: Reply) -> None:
        if announced is not None:
            check_size(entry, announced)
        super().__init__(multiplexer, reply)
        self.target: Entry = entry
        self._announced = announced
        self._received = bytearray()


class SegmentedDownload(Download):
    """Segments of seven bytes, acknowledged."""

    def __init__(self, multiplexer: bytes, entry: Entry, announced: int | None, reply: Reply) -> None:
        super().__init__(multiplexer, entry, announced, reply)
        self._toggle = 0
        reply(b"\x60" + multiplexer)

    def accepts(self, command: int) -> bool:
        return command >> 5 == DOWNLOAD_SEGMENT

    def handle(self, data: bytes) -> bool:
        command = data[0]
        if command & _TOGGLE != self._toggle:
            raise SdoAbort(AbortCode.TOGGLE)
        unused = command >> 1 & 0x07
        self._received += data[1 : 1 + _SEGMENT - unused]
        check_received(self.target, len(self._received), self._announced)
        last = bool(command & _LAST)
        if last:
            finish_download(self.target, bytes(self._received), self._announced)
        self._reply(bytes([0x20 | self._toggle]))
        self._toggle ^= _TOGGLE
        return not last
