"""A good SDO client that goes on with whatever transfer runs: so a fuzzer, or a load, gets to their ends."""

from __future__ import annotations

from binascii import crc_hqx

_SEGMENT, LARGEST_BLOCK = 7, 127
_START, _ACKNOWLEDGE, _END = 0xA3, 0xA2, 0xA1


class Follower:
    """`heard` takes the answers of the server, `requests` says what a client sends next.

    `content` is what it writes in a download, None where the first request said all; `spoil` is added to the
    CRC of a block download.
    """

    def __init__(self) -> None:
        self.content: bytes | None = b""
        self.spoil = 0
        self._last = b""
        self._streamed: int | None = None  # segments of the block that comes now
        self._toggle = 0
        self._sent = 0  # segments

    def heard(self, data: bytes) -> None:
        if self._streamed is not None and data[0] & 0x7F == self._streamed + 1:
            self._streamed += 1
        else:
            self._streamed, self._last = None, data

    def is_within_block(self, data: bytes) -> bool:
        """After this answer more segments come by themselves."""
        return self._streamed is not None and self._streamed < LARGEST_BLOCK and not data[0] & 0x80

    def requests(self) -> list[bytes]:
        """The next frames; none where nothing runs that could go on."""
        if self._streamed is not None:
            streamed, self._streamed = self._streamed, 0
            return [bytes([_ACKNOWLEDGE, streamed, LARGEST_BLOCK]) + bytes(5)]
        last, self._last = self._last, b""
        command = last[0] if last else 0xFF
        if command in (0xC2, 0xC6):
            self._streamed = 0
            return [bytes([_START]) + bytes(7)]
        if command & 0xE3 == 0xC1:
            return [bytes([_END]) + bytes(7)]
        if command in (0xA0, 0xA4):
            self._sent = 0
            return self._block(last[4])
        if command == 0xA2:
            self._sent += last[1]
            return self._block(last[2])
        if command == 0x41 or (command <= 0x1F and not command & 1):
            self._toggle = 0 if command == 0x41 else self._toggle ^ 0x10
            return [bytes([0x60 | self._toggle]) + bytes(7)]
        if command == 0x60:
            self._toggle, self._sent = 0x10, 0
        if (command == 0x60 or command & 0xEF == 0x20) and self._sent < self._segments:
            return [self._next_segment()]
        return []

    @property
    def _segments(self) -> int:
        return 0 if self.content is None else max(1, -(-len(self.content) // _SEGMENT))

    def _segment(self, number: int) -> bytes:
        return (self.content or b"")[number * _SEGMENT : (number + 1) * _SEGMENT]

    def _next_segment(self) -> bytes:
        segment = self._segment(self._sent)
        self._sent += 1
        self._toggle ^= 0x10
        head = self._toggle | (_SEGMENT - len(segment)) << 1 | (self._sent == self._segments)
        return bytes([head]) + segment.ljust(_SEGMENT, b"\0")

    def _block(self, size: int) -> list[bytes]:
        """The next segments of a block download; its end when all of them have been taken."""
        content, left = self.content or b"", self._segments - self._sent
        if left <= 0:
            crc = crc_hqx(content, 0) + self.spoil & 0xFFFF
            unused = self._segments * _SEGMENT - len(content)
            return [bytes([0xC1 | unused << 2]) + crc.to_bytes(2, "little") + bytes(5)]
        return [
            bytes([number | 0x80 * (number == left)]) + self._segment(self._sent + number - 1).ljust(7, b"\0")
            for number in range(1, min(size, left) + 1)
        ]
