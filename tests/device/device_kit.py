"""A node on a bench: sends frames to it, keeps the time, speaks SDO as a client would."""

from __future__ import annotations

from recording_application import RecordingApplication

from canfb.cia301.codes import AbortCode
from canfb.cia301.frame import Frame
from canfb.device.node import Node
from canfb.device.od.dictionary import Dictionary

ID = 32
OK = "ok"


def hexes(frames: list[Frame]) -> list[str]:
    """Frames as `ID#DATA`."""
    return [f"{frame.can_id:03X}#{frame.data.hex().upper()}" for frame in frames]


ABORT_CODES = {int(code): code for code in AbortCode}


class Bench:
    def __init__(
        self, dictionary: Dictionary, *, autostart: bool = False, sdo_timeout_s: float = 1.0
    ) -> None:
        self.dictionary = dictionary
        self.application = RecordingApplication()
        self.node = Node(dictionary, ID, self.application, autostart=autostart, sdo_timeout_s=sdo_timeout_s)
        self.now = 0.0

    def start(self) -> list[str]:
        return hexes(self.node.start(self.now))

    def send(self, can_id: int, data: bytes | str = b"", *, rtr: bool = False) -> list[str]:
        raw = bytes.fromhex(data) if isinstance(data, str) else data
        return hexes(self.node.receive(Frame(can_id, raw, rtr), self.now))

    def nmt(self, command: int, node_id: int = ID) -> list[str]:
        return self.send(0, bytes([command, node_id]))

    def operational(self) -> Bench:
        self.nmt(1)
        return self

    def sync(self, counter: int | None = None) -> list[str]:
        return self.send(0x080, b"" if counter is None else bytes([counter]))

    def sdo(self, request: str, channel: int = 0x600 + ID) -> list[str]:
        """The answers to a request, filled up to 8 bytes, without trailing zero bytes."""
        answers = self.send(channel, bytes.fromhex(request).ljust(8, b"\x00"))
        return [text.split("#")[1] for text in answers]

    def write(self, index: int, subindex: int, value: int, size: int) -> AbortCode | str:
        """Expedited download; OK or the abort code."""
        head = bytes([0x23 | (4 - size) << 2, index & 0xFF, index >> 8, subindex])
        data = head + value.to_bytes(size, "little").ljust(4, b"\x00")
        response = f"{0x580 + ID:03X}#"
        answers = [text for text in self.send(0x600 + ID, data) if text.startswith(response)]
        (answer,) = answers
        raw = bytes.fromhex(answer.removeprefix(response))
        assert raw[1:4] == data[1:4]
        if raw[0] == 0x80:
            return ABORT_CODES[int.from_bytes(raw[4:], "little")]
        assert raw == b"\x60" + data[1:4] + bytes(4)
        return OK

    def read(self, index: int, subindex: int = 0) -> int | AbortCode:
        """Expedited upload; the number or the abort code."""
        request = bytes([0x40, index & 0xFF, index >> 8, subindex]).ljust(8, b"\x00")
        (answer,) = self.send(0x600 + ID, request)
        raw = bytes.fromhex(answer.split("#")[1])
        assert raw[1:4] == request[1:4]
        number = int.from_bytes(raw[4:], "little")
        if raw[0] == 0x80:
            return ABORT_CODES[number]
        assert raw[0] & 0xE3 == 0x43
        return number

    def tick(self) -> list[str]:
        return hexes(self.node.tick(self.now))

    def run(self, duration: float) -> list[tuple[float, str]]:
        """Let time pass from deadline to deadline; what was sent, with its time."""
        end = self.now + duration
        seen: list[tuple[float, str]] = []
        for _ in range(100_000):
            due = self.node.deadline()
            if due is None or due > end:
                break
            self.now = max(self.now, due)
            seen += [(round(self.now, 6), text) for text in self.tick()]
        else:
            raise AssertionError("the deadline does not move on")
        self.now = end
        return seen
