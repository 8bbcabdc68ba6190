"""Segmented SDO transfer (CiA 301, 7.2.4.3.2 to 7.2.4.3.7)."""

from __future__ import annotations

from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.device.od.entry import Entry
from canfb.device.sdo.transfer import (
    DOWNLOAD_SEGMENT,
    UPLOAD_SEGMENT,
    Quiet,
    Reply,
    check_received,
    check_size,
    finish_download,
)

_SEGMENT = 7
_TOGGLE = 0x10
_LAST = 0x01


class SegmentedUpload(Quiet):
    """Server to client. The data is what it was at the first frame."""

    def __init__(self, multiplexer: bytes, data: bytes, reply: Reply) -> None:
        self.multiplexer = multiplexer
        self._data = data
        self._reply = reply
        self._position = 0
        self._toggle = 0
        reply(b"\x41" + multiplexer + len(data).to_bytes(4, "little"))

    def accepts(self, command: int) -> bool:
        """Upload segment requests."""
        return command >> 5 == UPLOAD_SEGMENT

    def handle(self, data: bytes) -> bool:
        """Answer a request with the next segment."""
        if data[0] & _TOGGLE != self._toggle:
            raise SdoAbort(AbortCode.TOGGLE)
        segment = self._data[self._position : self._position + _SEGMENT]
        self._position += len(segment)
        last = self._position >= len(self._data)
        command = self._toggle | (_SEGMENT - len(segment)) << 1 | (_LAST if last else 0)
        self._toggle ^= _TOGGLE
        self._reply(bytes([command]) + segment)
        return not last


class SegmentedDownload(Quiet):
    """Client to server. The entry is written when all is there."""

    def __init__(self, multiplexer: bytes, entry: Entry, announced: int | None, reply: Reply) -> None:
        if announced is not None:
            check_size(entry, announced)
        self.multiplexer = multiplexer
        self._entry = entry
        self._announced = announced
        self._reply = reply
        self._received = bytearray()
        self._toggle = 0
        reply(b"\x60" + multiplexer)

    def accepts(self, command: int) -> bool:
        """Download segment requests."""
        return command >> 5 == DOWNLOAD_SEGMENT

    def handle(self, data: bytes) -> bool:
        """Take a segment; the last one writes the entry."""
        command = data[0]
        if command & _TOGGLE != self._toggle:
            raise SdoAbort(AbortCode.TOGGLE)
        unused = command >> 1 & 0x07
        self._received += data[1 : 1 + _SEGMENT - unused]
        check_received(self._entry, len(self._received), self._announced)
        last = bool(command & _LAST)
        if last:
            finish_download(self._entry, bytes(self._received), self._announced)
        self._reply(bytes([0x20 | self._toggle]))
        self._toggle ^= _TOGGLE
        return not last
