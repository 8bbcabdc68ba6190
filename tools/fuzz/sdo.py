"""SDO as observed on the bus (CiA 301, 7.2.4.3): permitted answers of a server; a client that continues."""

from binascii import crc_hqx

from canfb.cia301.codes import AbortCode

ABORT = 0x80
ABORT_CODES = {int(code) for code in AbortCode}
LARGEST_BLOCK = 127
# Permitted answers to a request, by the command specifiers (bits 5 to 7) of both, in addition to an abort.
ANSWERS = {0: {1}, 1: {3}, 2: {2}, 3: {0}, 4: set[int](), 5: {2, 6}, 6: {5}, 7: set[int]()}
CLIENT_ABORTS = 4
BLOCK_UPLOAD, START, ACKNOWLEDGE = 5, 3, 2
_SEGMENT = 7
_START, _ACKNOWLEDGE, _END = 0xA3, 0xA2, 0xA1


class Broken(AssertionError):
    """The device violated a rule."""


def demand(good: object, text: str) -> None:
    """Raise Broken with the text unless `good`."""
    if not good:
        raise Broken(text)


class SdoWatcher:
    """Follows one channel: `request` for each frame of the client, `answer` for each of the server."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        self._request = bytes(8)
        self._left = 0  # number of answers that the server may still give
        self._next = 0  # sequence number of the next segment of a block upload, 0 outside of one
        self._in_block_download = False
        self._size: int | None = None  # size of a segmented upload, announced by the server
        self._uploaded = 0

    def request(self, data: bytes) -> None:
        """A frame of the client; if it is not 8 bytes long, it is not a request."""
        if len(data) != 8:
            return
        self._request = data
        self._next = int(data[0] >> 5 == BLOCK_UPLOAD and data[0] & 3 in (START, ACKNOWLEDGE))
        self._left = 0 if data[0] >> 5 == CLIENT_ABORTS and not self._in_block_download else 1

    def waiting(self) -> None:
        """Time passes: the server may send one time-out abort to a silent client."""
        self._left = 1

    def answer(self, data: bytes) -> None:
        demand(len(data) == 8, f"an answer of {len(data)} bytes")
        if self._next and data[0] & 0x7F == self._next:
            last = data[0] & 0x80 or self._next == LARGEST_BLOCK
            self._next = 0 if last else self._next + 1
            return
        demand(self._left > 0, f"{data.hex()} is one answer too many to {self._request.hex()}")
        self._left -= 1
        self._next = 0
        if data[0] == ABORT:
            code = int.from_bytes(data[4:], "little")
            demand(code in ABORT_CODES, f"unknown abort code {code:08X}h")
            self._in_block_download = False
            return
        acknowledges = self._in_block_download and data[0] == 0xA2
        fits = acknowledges or data[0] >> 5 in ANSWERS[self._request[0] >> 5]
        demand(fits, f"{data.hex()} is no answer to {self._request.hex()}")
        checks = (self._segment, self._download_segment, self._upload, self._download)
        check = checks[data[0] >> 5] if data[0] >> 5 < len(checks) else self._block
        check(data)

    def _demand_same_object(self, data: bytes) -> None:
        demand(data[1:4] == self._request[1:4], f"{data.hex()} is about another object")

    def _segment(self, data: bytes) -> None:
        unused = data[0] >> 1 & 7
        demand(not any(data[8 - unused :]) or not unused, f"{data.hex()} has something in unused bytes")
        demand(data[0] & 0x10 == self._request[0] & 0x10, f"{data.hex()} has another toggle bit")
        demand(self._size is not None, f"{data.hex()} is a segment of nothing")
        self._uploaded += 7 - unused
        size, last = self._size or 0, data[0] & 1
        right = self._uploaded == size if last else self._uploaded < size
        demand(right, f"{self._uploaded} bytes came, {size} were announced")
        self._size = None if last else size

    def _download_segment(self, data: bytes) -> None:
        demand(data[0] & 0x0F == 0 and not any(data[1:]), f"{data.hex()} has reserved bits set")
        demand(data[0] & 0x10 == self._request[0] & 0x10, f"{data.hex()} has another toggle bit")

    def _upload(self, data: bytes) -> None:
        self._demand_same_object(data)
        if data[0] == 0x41:
            self._size, self._uploaded = int.from_bytes(data[4:], "little"), 0
            return
        demand(data[0] & 0xF3 == 0x43, f"{data.hex()} is no answer to an upload")
        unused = data[0] >> 2 & 3
        demand(not unused or not any(data[8 - unused :]), f"{data.hex()} has something in unused bytes")

    def _download(self, data: bytes) -> None:
        self._demand_same_object(data)
        demand(data[0] == 0x60 and not any(data[4:]), f"{data.hex()} has reserved bits set")

    def _block(self, data: bytes) -> None:
        if data[0] in (0xA0, 0xA4):
            self._demand_same_object(data)
            demand(1 <= data[4] <= LARGEST_BLOCK and not any(data[5:]), f"bad block size in {data.hex()}")
            self._in_block_download = True
        elif data[0] == 0xA2:
            demand(data[1] <= LARGEST_BLOCK, f"bad sequence number in {data.hex()}")
            demand(1 <= data[2] <= LARGEST_BLOCK and not any(data[3:]), f"bad block size in {data.hex()}")
        elif data[0] == 0xA1:
            demand(not any(data[1:]), f"{data.hex()} has reserved bytes set")
            self._in_block_download = False
        elif data[0] in (0xC2, 0xC6):
            self._demand_same_object(data)
        else:
            demand(data[0] & 0xE3 == 0xC1 and not any(data[3:]), f"{data.hex()} is no end of a block upload")


class Follower:
    """A correct client that continues any running transfer, so that a fuzzer, or a load, completes it.

    `heard` processes the answers of the server, `requests` gives the next frames of the client.

    `content` is the data of a download, None if the first request contained it; `spoil` is added to the
    CRC of a block download.
    """

    def __init__(self) -> None:
        self.content: bytes | None = b""
        self.spoil = 0
        self._last = b""
        self._streamed: int | None = None  # segments received of the present block
        self._toggle = 0
        self._sent = 0  # segments sent

    def heard(self, data: bytes) -> None:
        if self._streamed is not None and data[0] & 0x7F == self._streamed + 1:
            self._streamed += 1
        else:
            self._streamed, self._last = None, data

    def is_within_block(self, data: bytes) -> bool:
        """Whether more segments follow this answer without a request."""
        return self._streamed is not None and self._streamed < LARGEST_BLOCK and not data[0] & 0x80

    def requests(self) -> list[bytes]:
        """The next frames; none if no transfer can continue."""
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
        """The next segments of a block download, or its end when all were accepted."""
        content, left = self.content or b"", self._segments - self._sent
        if left <= 0:
            crc = crc_hqx(content, 0) + self.spoil & 0xFFFF
            unused = self._segments * _SEGMENT - len(content)
            return [bytes([0xC1 | unused << 2]) + crc.to_bytes(2, "little") + bytes(5)]
        return [
            bytes([number | 0x80 * (number == left)]) + self._segment(self._sent + number - 1).ljust(7, b"\0")
            for number in range(1, min(size, left) + 1)
        ]
