"""SDO transfers (CiA 301, 7.2.4.3): their common base, segmented and block transfer."""

from __future__ import annotations

from abc import ABC, abstractmethod
from binascii import crc_hqx
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
    """A transfer with more than one client frame.

    `multiplexer` is index and sub-index as in the frames; `target` is the entry that a download writes, None
    for an upload. `pause` is the time until the server calls `proceed`, seconds; NEVER while it waits for the
    client.
    """

    target: Entry | None = None
    pause = NEVER

    def __init__(self, multiplexer: bytes, reply: Reply) -> None:
        self.multiplexer = multiplexer
        self._reply = reply

    @abstractmethod
    def accepts(self, command: int) -> bool:
        """Whether a frame with this first byte belongs to this transfer."""

    @abstractmethod
    def handle(self, data: bytes) -> bool:
        """Process a frame; False: complete. SdoAbort ends it."""

    def proceed(self) -> None:  # noqa: B027  (most never pause)
        """Continue to send after the pause."""


def check_received(entry: Entry, received: int, announced: int | None) -> None:
    """Refuse more bytes than were announced, or than the entry accepts."""
    limit = entry.byte_length if announced is None else announced
    if (limit or announced == 0) and received > limit:
        raise SdoAbort(AbortCode.TOO_LONG)
    if received > LARGEST_DOWNLOAD:
        raise SdoAbort(AbortCode.OUT_OF_MEMORY)


def finish_download(entry: Entry, data: bytes, announced: int | None) -> None:
    if announced is not None and len(data) != announced:
        raise SdoAbort(AbortCode.TOO_LONG if len(data) > announced else AbortCode.TOO_SHORT)
    entry.download(data)


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
    """Client to server; the entry is written when all data is there."""

    def __init__(self, multiplexer: bytes, entry: Entry, announced: int | None, reply: Reply) -> None:
        if announced is not None and announced < entry.byte_length:
            raise SdoAbort(AbortCode.TOO_SHORT)
        check_received(entry, announced or 0, None)
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


LARGEST_BLOCK = 127  # Largest number of segments in a block (CiA 301).

# Segments per block that the server requests: sequence numbers below 20h (A0h in the last segment) differ
# from the first byte of every new request.
DOWNLOAD_BLOCK = 31

BURST = 4  # Segments of an upload that are sent at once.
PAUSE_S = 0.001  # Pause after a burst, seconds: PDOs must not wait for a whole block.

_LAST_OF_BLOCK = 0x80
_SEQUENCE = 0x7F
_UPLOAD_ANSWER = 0xC2  # block upload response with the size indicated
_UPLOAD_END = 0xC1
_DOWNLOAD_ANSWER = 0xA0
_DOWNLOAD_ACKNOWLEDGE = 0xA2
_DOWNLOAD_END = 0xA1

# Flag in the first frame of both sides. The server sets it only if the client did: some clients check a CRC
# that they did not request.
CRC_SUPPORTED = 0x04


# Client subcommands of an upload; `_expected` is the next one.
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
            self._sequence = 0
            self._expected = _ACKNOWLEDGE
            self.pause = PAUSE_S
            self.proceed()
        return True

    def proceed(self) -> None:
        for _ in range(BURST):
            start = self._confirmed + self._sequence * _SEGMENT
            self._sequence += 1
            last = start + _SEGMENT >= len(self._data)
            command = self._sequence | (_LAST_OF_BLOCK if last else 0)
            self._reply(bytes([command]) + self._data[start : start + _SEGMENT])
            if last or self._sequence == self._block_size:
                self.pause = NEVER
                return

    def _acknowledge(self, sequence: int, block_size: int) -> None:
        if sequence > self._sequence:
            raise SdoAbort(AbortCode.SEQUENCE_NUMBER)
        _check_block_size(block_size)
        self._block_size = block_size
        confirmed = self._confirmed + sequence * _SEGMENT
        if self._with_crc:  # portion by portion: PDOs must not wait for the CRC of a megabyte
            self._crc = crc_hqx(self._data[self._confirmed : confirmed], self._crc)
        self._confirmed = confirmed
        if sequence and confirmed >= len(self._data):
            self._expected = _END
            unused = -len(self._data) % _SEGMENT if self._data else _SEGMENT
            self._reply(bytes([_UPLOAD_END | unused << 2]) + self._crc.to_bytes(2, "little"))


class BlockDownload(Download):
    """Client to server. Segments after a gap are requested again."""

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
        sequence, last = data[0] & _SEQUENCE, bool(data[0] & _LAST_OF_BLOCK)
        if not sequence:
            raise SdoAbort(AbortCode.SEQUENCE_NUMBER)
        if sequence == self._sequence + 1:
            self._sequence = sequence
            self._received += data[1:]
            # the last segment may be padding in part, or entirely if there is no data
            check_received(self.target, len(self._received) - _SEGMENT, self._announced)
            self._complete = last
        if last or sequence == DOWNLOAD_BLOCK:
            self._reply(bytes([_DOWNLOAD_ACKNOWLEDGE, self._sequence, DOWNLOAD_BLOCK]))
            self._sequence = 0
        return True

    def _end(self, unused: int, crc: int) -> None:
        content = bytes(self._received[: len(self._received) - unused])
        if self._with_crc and crc != crc_hqx(content, 0):
            raise SdoAbort(AbortCode.CRC)
        finish_download(self.target, content, self._announced)
        self._reply(bytes([_DOWNLOAD_END]))


def _check_block_size(block_size: int) -> None:
    if not 1 <= block_size <= LARGEST_BLOCK:
        raise SdoAbort(AbortCode.BLOCK_SIZE)
