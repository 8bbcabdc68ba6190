"""What all SDO transfers have in common, and expedited transfer (CiA 301, 7.2.4.3)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.device.moment import NEVER
from canfb.device.od.entry import Entry

LARGEST_DOWNLOAD = 1 << 16
"""Bytes that a download to a DOMAIN or a string may have; more is aborted (05040005h)."""

Reply = Callable[[bytes], None]
"""Sends up to 8 bytes to the client, filled up with zeros."""

DOWNLOAD_SEGMENT = 0
INITIATE_DOWNLOAD = 1
INITIATE_UPLOAD = 2
UPLOAD_SEGMENT = 3
ABORT = 4
BLOCK_UPLOAD = 5
BLOCK_DOWNLOAD = 6
"""Client command specifiers: bits 5 to 7 of the first byte."""

ABORT_COMMAND = 0x80


class Transfer(Protocol):
    """One transfer that takes more than one frame of the client.

    `multiplexer` is index and sub-index as in the frames. `pause` is how long the server waits by
    itself before `proceed`, seconds; NEVER while it waits for the client.
    """

    multiplexer: bytes
    pause: float

    def accepts(self, command: int) -> bool:
        """Whether a frame with this first byte belongs to the transfer."""

    def handle(self, data: bytes) -> bool:
        """Take a frame of the client; False when the transfer is complete. SdoAbort to end it."""

    def proceed(self) -> None:
        """Go on sending after the pause."""


class Quiet:
    """A transfer in which the server only answers."""

    pause = NEVER

    def proceed(self) -> None:
        """Nothing to do without the client."""


def check_size(entry: Entry, size: int) -> None:
    """Refuse an announced size, bytes, that the entry cannot take, before any data comes."""
    expected = entry.byte_length
    if expected and size != expected:
        raise SdoAbort(AbortCode.TOO_LONG if size > expected else AbortCode.TOO_SHORT)
    if size > LARGEST_DOWNLOAD:
        raise SdoAbort(AbortCode.OUT_OF_MEMORY)


def check_received(entry: Entry, received: int, announced: int | None) -> None:
    """Refuse data, bytes, that already is more than announced, or than the entry can take."""
    limit = entry.byte_length if announced is None else announced
    if (limit or announced == 0) and received > limit:
        raise SdoAbort(AbortCode.TOO_LONG)
    if received > LARGEST_DOWNLOAD:
        raise SdoAbort(AbortCode.OUT_OF_MEMORY)


def finish_download(entry: Entry, data: bytes, announced: int | None) -> None:
    """Write the complete data. SdoAbort when its size is wrong or the entry refuses it."""
    if announced is not None and len(data) != announced:
        raise SdoAbort(AbortCode.TOO_LONG if len(data) > announced else AbortCode.TOO_SHORT)
    entry.download(data)


def expedited_upload(multiplexer: bytes, data: bytes) -> bytes:
    """The answer that carries 1 to 4 bytes itself."""
    return bytes([0x43 | (4 - len(data)) << 2]) + multiplexer + data


def expedited_data(entry: Entry, frame: bytes) -> bytes:
    """The data in an expedited download request; without a size, as much as the entry has."""
    size_indicated = frame[0] & 0x01
    size = 4 - (frame[0] >> 2 & 0x03) if size_indicated else min(entry.byte_length or 4, 4)
    return frame[4 : 4 + size]
