"""SDO block transfer (CiA 301, 7.2.4.3.8 to 7.2.4.3.16)."""

from __future__ import annotations

from binascii import crc_hqx

from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.device.core import NEVER
from canfb.device.od.dictionary import Entry
from canfb.device.sdo.transfer import (
    ABORT_COMMAND,
    BLOCK_DOWNLOAD,
    BLOCK_UPLOAD,
    Download,
    Reply,
    Transfer,
    check_received,
    finish_download,
)

LARGEST_BLOCK = 127  # Segments of a block at most (CiA 301).

# Segments of a block that the server asks for. Not more, so that the first byte of a new request (20h and up,
# A0h and up) cannot be taken for the sequence number of a segment.
DOWNLOAD_BLOCK = 31

BURST = 4  # Segments of an upload that are sent at once ...
PAUSE_S = 0.001  # ... and the time to the next, seconds: PDOs must not wait behind a whole block.

_SEGMENT = 7
_LAST = 0x80
_SEQUENCE = 0x7F
_UPLOAD_ANSWER = 0xC2  # with the size
_UPLOAD_END = 0xC1
_DOWNLOAD_ANSWER = 0xA0
_DOWNLOAD_ACKNOWLEDGE = 0xA2
_DOWNLOAD_END = 0xA1

# In the first frame of either side. The server sets it only when the client did: some clients check a CRC
# that they did not ask for.
CRC_SUPPORTED = 0x04


def crc16(data: bytes) -> int:
    """The CRC of block transfers: polynomial 1021h, start 0."""
    return crc_hqx(data, 0)


# Client subcommands of an upload: the one that is expected is its phase.
_END, _ACKNOWLEDGE, _START = 1, 2, 3


class BlockUpload(Transfer):
    """Server to client."""

    def __init__(
        self, multiplexer: bytes, data: bytes, block_size: int, *, with_crc: bool, reply: Reply
    ) -> None:
        _check_block_size(block_size)
        super().__init__(multiplexer, reply)
        self._data = data
        self._block_size = block_size
        self._with_crc = with_crc
        self._crc = 0
        self._expected = _START
        self._confirmed = 0
        self._sequence = 0
        answer = _UPLOAD_ANSWER | (CRC_SUPPORTED if with_crc else 0)
        reply(bytes([answer]) + multiplexer + len(data).to_bytes(4, "little"))

    def accepts(self, command: int) -> bool:
        return command >> 5 == BLOCK_UPLOAD and bool(command & 0x03)

    def handle(self, data: bytes) -> bool:
        subcommand = data[0] & 0x03
        if subcommand != self._expected:
            raise SdoAbort(AbortCode.COMMAND)
        if subcommand == _END:
            return False
        if subcommand == _ACKNOWLEDGE:
            self._acknowledge(data[1], data[2])
        if self._expected != _END:
            self._begin_block()
        return True

    def proceed(self) -> None:
        for _ in range(BURST):
            self._send_segment()
            if self._sequence == self._block_size or self._is_last(self._sequence):
                self.pause = NEVER
                return

    def _begin_block(self) -> None:
        self._sequence = 0
        self._expected = _ACKNOWLEDGE
        self.pause = PAUSE_S
        self.proceed()

    def _acknowledge(self, sequence: int, block_size: int) -> None:
        if sequence > self._sequence:
            raise SdoAbort(AbortCode.SEQUENCE_NUMBER)
        _check_block_size(block_size)
        complete = sequence > 0 and self._is_last(sequence)
        self._block_size = block_size
        confirmed = self._confirmed + sequence * _SEGMENT
        if self._with_crc:  # portion by portion: PDOs must not wait for that of a megabyte
            self._crc = crc_hqx(self._data[self._confirmed : confirmed], self._crc)
        self._confirmed = confirmed
        if complete:
            self._send_end()

    def _is_last(self, sequence: int) -> bool:
        return self._confirmed + sequence * _SEGMENT >= len(self._data)

    def _send_segment(self) -> None:
        start = self._confirmed + self._sequence * _SEGMENT
        self._sequence += 1
        last = _LAST if self._is_last(self._sequence) else 0
        self._reply(bytes([last | self._sequence]) + self._data[start : start + _SEGMENT])

    def _send_end(self) -> None:
        self._expected = _END
        self.pause = NEVER
        unused = -len(self._data) % _SEGMENT if self._data else _SEGMENT
        self._reply(bytes([_UPLOAD_END | unused << 2]) + self._crc.to_bytes(2, "little"))


class BlockDownload(Download):
    """Client to server. Segments after a gap are asked for again."""

    def __init__(
        self,
        multiplexer: bytes,
        entry: Entry,
        announced: int | None,
        *,
        with_crc: bool,
        reply: Reply,
    ) -> None:
        super().__init__(multiplexer, entry, announced, reply)
        self._with_crc = with_crc
        self._sequence = 0
        self._complete = False
        answer = _DOWNLOAD_ANSWER | (CRC_SUPPORTED if with_crc else 0)
        reply(bytes([answer]) + multiplexer + bytes([DOWNLOAD_BLOCK]))

    def accepts(self, command: int) -> bool:
        if self._complete:
            return command >> 5 == BLOCK_DOWNLOAD and bool(command & 0x01)
        return command != ABORT_COMMAND and command & _SEQUENCE <= DOWNLOAD_BLOCK

    def handle(self, data: bytes) -> bool:
        if self._complete:
            self._end(data[0] >> 2 & 0x07, int.from_bytes(data[1:3], "little"))
            return False
        self._segment(data[0] & _SEQUENCE, bool(data[0] & _LAST), data[1:])
        return True

    def _segment(self, sequence: int, last: bool, content: bytes) -> None:
        if not sequence:
            raise SdoAbort(AbortCode.SEQUENCE_NUMBER)
        in_order = sequence == self._sequence + 1
        if in_order:
            self._sequence = sequence
            self._received += content
            # the last segment may be unused in part, or whole where there is no data
            check_received(self.target, len(self._received) - _SEGMENT, self._announced)
            self._complete = last
        if last or sequence == DOWNLOAD_BLOCK:
            self._reply(bytes([_DOWNLOAD_ACKNOWLEDGE, self._sequence, DOWNLOAD_BLOCK]))
            self._sequence = 0

    def _end(self, unused: int, crc: int) -> None:
        content = bytes(self._received[: len(self._received) - unused])
        if self._with_crc and crc != crc16(content):
            raise SdoAbort(AbortCode.CRC)
        finish_download(self.target, content, self._announced)
        self._reply(bytes([_DOWNLOAD_END]))


def _check_block_size(block_size: int) -> None:
    if not 1 <= block_size <= LARGEST_BLOCK:
        raise SdoAbort(AbortCode.BLOCK_SIZE)
