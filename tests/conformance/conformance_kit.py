"""The tester: sends raw frames to a device, collects what it says, drives the clock. Nothing sleeps.

Frames are hexadecimal bytes as the list of cases has them. SDO requests are filled up to 8 bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar, NamedTuple

from conformance_eds import Eds

import sdo_client
from canfb import FeedbackModule, Frame, ModuleConfig
from canfb.device.storage.storage import MemoryStore
from canfb.interface.encoder_interface import EncoderInterface
from played import Still

MODULE, INTERFACE = "module", "interface"
DEVICES = (MODULE, INTERFACE)
MODULE_ID, INTERFACE_ID = 0x20, 0x10
RPDO1, SYNC = 0x180 + INTERFACE_ID, 0x080
INVALID = 0x80000000  # of a COB-ID
NAME, HEARTBEAT = "08 10 00", "17 10 00"  # 1008h is longer than 4 bytes
EDS = {MODULE: Eds("canfb-module.eds", MODULE_ID), INTERFACE: Eds("encoder-interface.eds", INTERFACE_ID)}

# Abort codes as the list writes them; G is accepted wherever the list says so.
G = "08000000"
NO_READ, NO_WRITE = ("06010000", "06010001", G), ("06010000", "06010002", G)
NO_SUB, NO_INDEX = ("06090011", G), ("06020000", G)
COMMAND = ("05040001", G)
SAVE, LOAD, WRONG = "73 61 76 65", "6C 6F 61 64", "6E 6F 72 77"
STATES = {"01": "05", "02": "04", "80": "7F"}
"""NMT states by the command that leads there."""


class Heard(NamedTuple):
    """A frame of the device, and when."""

    time: float
    can_id: int
    data: str


def hexes(data: bytes) -> str:
    return data.hex(" ").upper()


def filled(text: str) -> str:
    """An SDO frame with the trailing zero bytes that the list leaves out."""
    return hexes(bytes.fromhex(text).ljust(8, b"\x00"))


def m(index: int, sub: int = 0) -> str:
    """Index low, index high, sub-index."""
    return f"{index & 0xFF:02X} {index >> 8:02X} {sub:02X}"


def little(value: int, size: int) -> str:
    return hexes(value.to_bytes(size, "little"))


def only(frames: Iterable[Heard], can_id: int) -> list[str]:
    """Data of the frames with this CAN-ID."""
    return [frame.data for frame in frames if frame.can_id == can_id]


@dataclass
class Tester:
    __test__: ClassVar[bool] = False  # for pytest: its name is all it has of a test
    kind: str
    device: Any
    eds: Eds
    now: float = 0.0
    log: list[tuple[float, int, str, bool]] = field(default_factory=list)
    """All frames of both sides: time, CAN-ID, data, whether it is a remote frame."""

    @property
    def id(self) -> int:
        return self.eds.node_id

    @property
    def name(self) -> bytes:
        """1008h."""
        return self.eds[0x1008, 0].default

    @property
    def nn(self) -> str:
        """The node-ID as a byte."""
        return f"{self.id:02X}"

    # -- frames and time ------------------------------------------------------------------------

    def power_on(self) -> list[Heard]:
        return self._take(self.device.start(self.now))

    def send(self, can_id: int, data: str = "", *, rtr: bool = False) -> list[Heard]:
        """Put a frame on the bus; what the device says upon it at once."""
        raw = bytes.fromhex(data)
        self.log.append((self.now, can_id, hexes(raw), rtr))
        return self._take(self.device.receive(Frame(can_id, raw, rtr), self.now))

    def remote(self, can_id: int) -> list[Heard]:
        return self.send(can_id, rtr=True)

    def wait(self, seconds: float) -> list[Heard]:
        """Let time pass; what the device says meanwhile."""
        end = self.now + seconds
        heard: list[Heard] = []
        for _ in range(100_000):
            due = self.device.deadline()
            if due is None or due > end:
                self.now = end
                return heard
            self.now = max(self.now, due)
            heard += self._take(self.device.tick(self.now))
        raise AssertionError("the deadline of the device does not move on")

    def repeat(self, count: int, period: float, act: Callable[[], list[Heard]]) -> list[Heard]:
        """Do something `count` times, and let `period` seconds pass after each."""
        heard: list[Heard] = []
        for _ in range(count):
            heard += act()
            heard += self.wait(period)
        return heard

    def _take(self, frames: list[Frame]) -> list[Heard]:
        for frame in frames:
            assert 0 <= frame.can_id <= 0x7FF
            assert len(frame.data) <= 8
            assert not frame.rtr
            self.log.append((self.now, frame.can_id, hexes(frame.data), False))
        return [Heard(self.now, frame.can_id, hexes(frame.data)) for frame in frames]

    # -- SDO --------------------------------------------------------------------------------------

    def sdo(self, request: str, wait: float = 0.0) -> list[str]:
        """All answers of the SDO server to one frame, and those of the time after it."""
        answers = only(self.send(0x600 + self.id, filled(request)), 0x580 + self.id)
        if wait:
            answers += only(self.wait(wait), 0x580 + self.id)
        assert all(len(answer) == 23 for answer in answers), "an SDO frame has 8 bytes"
        return answers

    def ask(self, request: str) -> str:
        (answer,) = self.sdo(request)
        return answer

    def accept(self, request: str) -> None:
        """A download that must be answered with ok."""
        assert self.ask(request) == filled("60 " + request[3:11])

    def refuse(self, request: str, *codes: str) -> str:
        """A request that must be aborted with one of these codes; which one it was."""
        return self.aborted(self.ask(request), request[3:11], *codes)

    def aborted(self, answer: str, multiplexer: str | None, *codes: str) -> str:
        raw = bytes.fromhex(answer)
        assert raw[0] == 0x80, f"no abort: {answer}"
        assert multiplexer is None or hexes(raw[1:4]) == multiplexer
        code = f"{int.from_bytes(raw[4:], 'little'):08X}"
        assert code in codes
        return code

    def write(self, index: int, sub: int, value: int, size: int) -> None:
        """Expedited download, which must be answered with ok."""
        self.accept(self.download(index, sub, value, size))

    @staticmethod
    def download(index: int, sub: int, value: int, size: int) -> str:
        """The request of an expedited download."""
        return f"{0x23 | (4 - size) << 2:02X} {m(index, sub)} {little(value, size)}"

    def read(self, index: int, sub: int = 0) -> int:
        """Expedited upload of a number."""
        return int.from_bytes(self.upload(m(index, sub)), "little")

    def answers(self, request: bytes, wait: float = 0.0) -> list[bytes]:
        """As `sdo`, in bytes."""
        return [bytes.fromhex(answer) for answer in self.sdo(hexes(request), wait)]

    def upload(self, multiplexer: str) -> bytes:
        """A whole object, expedited or segmented."""
        return sdo_client.upload(self.answers, bytes.fromhex(multiplexer))

    def download_segmented(self, multiplexer: str, data: bytes) -> str:
        """The abort, or "ok"."""
        abort = sdo_client.download(self.answers, bytes.fromhex(multiplexer), data)
        return hexes(abort) or "ok"

    def block_upload(self, multiplexer: str, **options: Any) -> bytes:
        ask = partial(self.answers, wait=0.2)
        return sdo_client.block_upload(ask, bytes.fromhex(multiplexer), **options)

    def block_download(self, multiplexer: str, data: bytes, **options: Any) -> str:
        """The abort, or "ok"."""
        abort = sdo_client.block_download(self.answers, bytes.fromhex(multiplexer), data, **options)
        return hexes(abort) or "ok"

    def begin_block_upload(self, multiplexer: str, block_size: int = 0x14) -> None:
        answer = self.ask(f"A0 {multiplexer} {block_size:02X}")
        assert answer[:11] in (f"C2 {multiplexer}", f"C6 {multiplexer}")

    def begin_block_download(self, multiplexer: str, size: int | None) -> str:
        """The answer to the first frame of one with a CRC, of a size that may be announced."""
        return self.ask(f"{0xC4 if size is None else 0xC6:02X} {multiplexer} {little(size or 0, 4)}")

    # -- NMT ----------------------------------------------------------------------------------------

    def nmt(self, command: str) -> list[Heard]:
        """An NMT command to this node; a reset is waited for."""
        heard = self.send(0x000, f"{command} {self.nn}")
        if command in ("81", "82"):
            heard += [] if "00" in self.beats(heard) else self.wait(5.0)
            assert self.beats(heard) == ["00"], "one boot-up message within 5 s"
        return heard

    def beats(self, heard: list[Heard]) -> list[str]:
        """Boot-ups, heartbeats and answers to guarding."""
        return only(heard, 0x700 + self.id)

    def guard(self) -> str:
        """The answer to guarding: toggle bit and state."""
        (answer,) = self.beats(self.remote(0x700 + self.id))
        return answer

    def state(self) -> str:
        """The NMT state by guarding."""
        return f"{int(self.guard(), 16) & 0x7F:02X}"

    def emergencies(self, heard: list[Heard]) -> list[str]:
        """Codes of the EMCY frames."""
        return [data[3:5] + data[:2] for data in only(heard, 0x80 + self.id)]

    def prepare(self) -> Tester:
        """What the list calls preparation: reset, defaults restored, reset."""
        self.nmt("81")
        if self.eds.has(0x1011, 1):
            self.accept(f"23 {m(0x1011, 1)} {LOAD}")
            self.wait(0.5)
            self.nmt("81")
        return self

    def operational(self) -> list[Heard]:
        return self.nmt("01")

    # -- what the device has -------------------------------------------------------------------------

    @property
    def rpdos(self) -> list[int]:
        """Indices of their communication parameters; so are those of TPDOs."""
        return self.eds.pdos(0x1400)

    @property
    def tpdos(self) -> list[int]:
        return self.eds.pdos(0x1800)

    @property
    def valid_tpdos(self) -> list[int]:
        """TPDOs that are valid and mapped by default."""
        return [tpdo for tpdo in self.tpdos if not self.read(tpdo, 1) >> 31 and self.read(tpdo + 0x200)]

    def set_up_tpdo(
        self, index: int, kind: str, *, timer_ms: int = 0, start: int = 0, remote: bool | None = None
    ) -> int:
        """Transmission type of a TPDO as the list sets it: off, type, timer, SYNC start, on. Its CAN-ID."""
        cob_id = self.read(index, 1) & 0x7FFFFFFF
        if remote is not None:
            cob_id = cob_id & ~0x40000000 | (0 if remote else 0x40000000)
        self.write(index, 1, cob_id | 0x80000000, 4)
        self.accept(f"2F {m(index, 2)} {kind}")
        if timer_ms:
            self.write(index, 5, timer_ms, 2)
        if start:
            self.write(index, 6, start, 1)
        self.write(index, 1, cob_id, 4)
        return cob_id & 0x7FF

    def second_server(self) -> None:
        """A second SDO channel: requests with 6C0h, answers with 540h."""
        self.accept("23 01 12 01 C0 06")
        self.accept("23 01 12 02 40 05")

    def ask_second(self, request: str) -> list[str]:
        return only(self.send(0x6C0, filled(request)), 0x540)

    def cause_event(self) -> list[Heard]:
        """What makes the device want to send: a sample. The interface takes one at a SYNC by itself."""
        return self.send(0x180 + INTERFACE_ID, "2C 01 78 05") if self.kind == MODULE else []


def make_tester(kind: str) -> Tester:
    """A device just switched on, with a memory and its tester."""
    device: Any
    if kind == MODULE:
        config = ModuleConfig(node_id=MODULE_ID, encoder_interface=INTERFACE_ID)
        device = FeedbackModule(config, MemoryStore())
    else:
        device = EncoderInterface(INTERFACE_ID, Still(300, 1400), store=MemoryStore())
    tester = Tester(kind, device, EDS[kind])
    assert only(tester.power_on(), 0x700 + tester.id) == ["00"]
    return tester
