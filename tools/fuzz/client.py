"""A good SDO client that goes on with whatever transfer runs: so a fuzzer, or a load, gets to their ends."""

from __future__ import annotations

from binascii import crc_hqx

_SEGMENT, LARGEST_BLOCK = 7, 127
_START, _ACKNOWLEDGE, _END = 0xA3, 0xA2, 0xA1


class Follower:
    """`heard` takes the answers of the server, `requests` says what a client sends next.

    `content` is what it writes in a download; `spoil` is added to the CRC of a block download.
    """

    def __init__(self) -> None:
        self.content = b""
        self.spoil = 0
        self._last = b""
        self._streamed = 0  # segments of the block that comes now
        self._streams = False
        self._toggle = 0
        self._sent = 0  # bytes, or segments of a block download

    def heard(self, data: bytes) -> None:
        if self._streams and data[0] & 0x7F == self._streamed + 1:
            self._streamed += 1
            return
        self._streams = False
        self._last = data

    def is_within_block(self, data: bytes) -> bool:
        """After this answer more segments come by themselves."""
        return self._streams and self._streamed < LARGEST_BLOCK and not data[0] & 0x80

    def requests(self) -> list[bytes]:
        """The next frames; none where nothing runs that could go on."""
        if self._streams:
            return self._acknowledge()
        last = self._last
        self._last = b""
        if not last:
            return []
        command = last[0]
        if command in (0xC2, 0xC6):
            self._streams, self._streamed = True, 0
            return [bytes([_START]) + bytes(7)]
        if command & 0xE3 == 0xC1:
            return [bytes([_END]) + bytes(7)]
        if command in (0xA0, 0xA4):
            self._sent = 0
            return self._block(last[4])
        if command == 0xA2:
            self._sent += last[1]
            return self._block(last[2])
        if command == 0x41 or command <= 0x1F:
            return self._ask(command)
        if command == 0x60 or command & 0xEF == 0x20:
            return self._give(command)
        return []

    def _acknowledge(self) -> list[bytes]:
        streamed, self._streamed = self._streamed, 0
        return [bytes([_ACKNOWLEDGE, streamed, LARGEST_BLOCK]) + bytes(5)]

    def _ask(self, command: int) -> list[bytes]:
        if command != 0x41 and command & 1:
            return []
        self._toggle = 0 if command == 0x41 else self._toggle ^ 0x10
        return [bytes([0x60 | self._toggle]) + bytes(7)]

    def _give(self, command: int) -> list[bytes]:
        if command == 0x60:
            self._toggle, self._sent = 0, 0
        elif self._sent >= len(self.content):
            return []
        else:
            self._toggle ^= 0x10
        segment = self.content[self._sent : self._sent + _SEGMENT]
        self._sent += _SEGMENT
        last = self._sent >= len(self.content)
        head = self._toggle | (_SEGMENT - len(segment)) << 1 | last
        return [bytes([head]) + segment.ljust(_SEGMENT, b"\x00")]

    def _block(self, size: int) -> list[bytes]:
        """The next segments of a block download; its end when all of them have been taken."""
        total = max(1, -(-len(self.content) // _SEGMENT))
        if self._sent >= total:
            unused = total * _SEGMENT - len(self.content)
            crc = crc_hqx(self.content, 0) + self.spoil & 0xFFFF
            return [bytes([0xC1 | unused << 2]) + crc.to_bytes(2, "little") + bytes(5)]
        frames = []
        for number in range(1, min(size, total - self._sent) + 1):
            place = (self._sent + number - 1) * _SEGMENT
            last = 0x80 if self._sent + number == total else 0
            segment = self.content[place : place + _SEGMENT].ljust(_SEGMENT, b"\x00")
            frames.append(bytes([last | number]) + segment)
        return frames
