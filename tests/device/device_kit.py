"""A node on a bench: sends frames to it, keeps the time, speaks SDO as a client would; one that can save."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import sample_eds
from sample_eds import I16, U8, U32

from canfb.cia301.codes import AbortCode
from canfb.cia301.frame import Frame
from canfb.device.core import Application, ProcessData
from canfb.device.node import Node
from canfb.device.od.dictionary import Dictionary
from canfb.device.storage.kept import ParameterGroup
from canfb.device.storage.storage import Store

ID = 32
OK = "ok"


def hexes(frames: list[Frame]) -> list[str]:
    """Frames as `ID#DATA`."""
    return [f"{frame.can_id:03X}#{frame.data.hex().upper()}" for frame in frames]


METHODS = [name for one in (ProcessData, Application) for name in vars(one) if not name.startswith("_")]


class RecordingApplication(Application):
    """Keeps each call in ``calls``: (name of the method, arguments)."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, tuple[Any, ...]]] = []
        self._reactions: dict[str, Callable[..., Any]] = {
            name: partial(getattr(Application, name), self) for name in METHODS
        }
        for name in METHODS:
            setattr(self, name, partial(self._called, name))

    def told(self, method: str) -> list[Any]:
        """The arguments of each call of this method; of a single one the argument itself."""
        assert method in METHODS
        found = [arguments for name, arguments in self.calls if name == method]
        return [one[0] if len(one) == 1 else one for one in found]

    def react(self, **reactions: Callable[..., Any]) -> None:
        """Call these functions, by the names of the methods."""
        assert reactions.keys() <= set(METHODS)
        self._reactions |= reactions

    def _called(self, name: str, *arguments: Any) -> Any:
        self.calls.append((name, arguments))
        return self._reactions[name](*arguments)


ABORT_CODES = {int(code): code for code in AbortCode}


class Bench:
    def __init__(self, dictionary: Dictionary, node_id: int = ID, **options: Any) -> None:
        self.dictionary = dictionary
        self.application = RecordingApplication()
        self.node = Node(dictionary, node_id, self.application, **options)
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
        (answer,) = [text for text in self.send(0x600 + ID, data) if text.startswith(response)]
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


SAVE, LOAD, VERIFY = 0x1010, 0x1011, 0x1020
SAVE_WORD, LOAD_WORD = 0x65766173, 0x64616F6C
ALL, COMMUNICATION, APPLICATION, MANUFACTURER = 1, 2, 3, 4
RESET_NODE, RESET_COMMUNICATION = 129, 130

ROWS = [
    *sample_eds.ROWS,
    *((index, 0, U8, "ro", "4", 0) for index in (SAVE, LOAD)),
    *((index, sub, U32, "rw", "", 0) for index in (SAVE, LOAD) for sub in (1, 2, 3, 4)),
    (VERIFY, 0, U8, "ro", "2", 0),
    *((VERIFY, sub, U32, "rw", "0", 0) for sub in (1, 2)),
    (0x6000, None, I16, "rw", "-7", 0),
    (0x6001, None, U32, "ro", "", 0),
]


def write_eds(path: Path, identity: tuple[int, ...] = ()) -> Path:
    """The EDS of the device; `identity` are vendor-ID, product code and so on, if they are to be there."""
    rows = [row for row in ROWS if not identity or row[0] != 0x1018]
    if identity:
        rows.append((0x1018, 0, U8, "ro", str(len(identity)), 0))
    rows += [(0x1018, sub, U32, "ro", f"0x{number:X}", 0) for sub, number in enumerate(identity, 1)]
    return sample_eds.write(path, sorted(rows, key=lambda row: (row[0], row[1] or 0)))


class StoringBench(Bench):
    """As Bench, powered on, and speaking with node 32; other node-IDs are read by `value`."""

    def __init__(self, path: Path, store: Store | None, node_id: int = ID, **options: Any) -> None:
        super().__init__(Dictionary.load(path, node_id), node_id, store=store, **options)
        self.faults: list[dict[ParameterGroup, str]] = []
        self.application.react(parameters_refused=lambda faults, now: self.faults.append(dict(faults)))
        self.first = self.start()

    def save(self, subindex: int = ALL) -> object:
        return self.write(SAVE, subindex, SAVE_WORD, 4)

    def load(self, subindex: int = ALL) -> object:
        return self.write(LOAD, subindex, LOAD_WORD, 4)

    def value(self, index: int, subindex: int = 0) -> object:
        return self.dictionary.entry(index, subindex).value
