"""The other nodes of tools.bench.bus: SYNC producer, encoder interface and a load; times of frames.

The load is nothing, SDO block transfers, or PDOs of other nodes. The time of a frame sent on a pair of
sockets is taken just before the call; on SocketCAN the frame is received back with the time of the kernel.
Frames of the node have the time of the kernel on both.
"""

import contextlib
import math
import select
import socket
import struct
import sys
import time
import zlib
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import cycle

from canfb import objects as od
from canfb.bus.raw_can_bus import FrameReader
from canfb.cia301.frame import frame_bits
from tools.bench.bus_node import SYNCHRONOUS_PDO
from tools.bench.cycle import ADC_PDO, NODE_ID, POSITION_PDO, SYNC, UNITS_PER_CYCLE, adc_data, encoder_table
from tools.fuzz.sdo import LARGEST_BLOCK, Follower

SDO_REQUEST, SDO_ANSWER = 0x600 + NODE_ID, 0x580 + NODE_ID
OTHERS_ID = 0x3A0  # CAN-ID of a PDO that the module does not receive
ENTRIES, FEW_ENTRIES = 4096, 256  # entries of the tables of the load (the largest), and of the first one
DEPTHS = 0.0, 0.001  # amplitudes of the corrections of both tables, cycles
ABORT, END_OF_UPLOAD = 0x80, 0xA1  # first bytes of these SDO frames
CAN_FRAME = struct.Struct("=IB3x8s")
STEPS, PERIOD = 11, 100  # speed 11/100 cycle per sample: the phase repeats after 100 samples
STEPS_INVERSE = pow(STEPS, -1, PERIOD)
SYNC_FRAME = CAN_FRAME.pack(SYNC, 0, b"")
ADC_FRAMES = [CAN_FRAME.pack(ADC_PDO, len(data), data) for data in adc_data(PERIOD, STEPS / PERIOD)]
BIT_S = 1e-6
WARM_UP = 300
LONGEST_WARM_UP = 100
LONGEST_LAG = 0.3  # part of a period by which a SYNC may be late before SYNCs are skipped
ADC_S = frame_bits(4) * BIT_S  # the encoder interface sends at once

Transfer = tuple[bytes, bytes | None]
"""The first request, and what is written after it; None: nothing."""


class TransferFailed(RuntimeError):
    """The module has aborted a transfer."""


class Load:
    """Frames of other nodes that wait for room on the bus; here none."""

    def __init__(self, *frames: tuple[int, bytes]) -> None:
        self.frames = deque(frames)

    def sent(self) -> None:
        """The first waiting frame was sent."""

    def take(self, can_id: int, data: bytes) -> None:
        """Receive a frame of the module."""


class SdoClient(Load):
    """The requests of these transfers, each after the answer to the previous one."""

    def __init__(self, transfers: Iterator[Transfer]) -> None:
        super().__init__()
        self.done = False
        self._transfers = transfers
        self._client = Follower()
        self._begin()

    def sent(self) -> None:
        self.frames.popleft()

    def take(self, can_id: int, data: bytes) -> None:
        if can_id != SDO_ANSWER or self.done:
            return
        if data[0] == ABORT:
            raise TransferFailed(f"{data.hex(' ')} to {self._request.hex(' ')}")
        self._client.heard(data)
        if not self._client.is_within_block(data):
            following = self._client.requests()
            self.frames.extend((SDO_REQUEST, one) for one in following)
            if not following or following[-1][0] == END_OF_UPLOAD:  # the end of an upload has no answer
                self._begin()

    def _begin(self) -> None:
        transfer = next(self._transfers, None)
        self.done = transfer is None
        if transfer is not None:
            self._request, self._client.content = transfer
            self.frames.append((SDO_REQUEST, self._request))


def table_in_force(content: bytes) -> Iterator[Transfer]:
    """A block download (CiA 301, 7.2.4.3.8), and its activation."""
    yield struct.pack("<BHBI", 0xC6, *od.TABLE_STAGED, len(content)), content
    yield struct.pack("<BHBI", 0x23, *od.TABLE_ACTIVATE, zlib.crc32(content)), None


def set_up() -> Iterator[Transfer]:
    return table_in_force(encoder_table(FEW_ENTRIES, DEPTHS[0]).to_bytes())


def tables() -> Iterator[Transfer]:
    """Block download to 2020:01, activation, block upload, of two tables alternately, endless."""
    for content in cycle([encoder_table(ENTRIES, depth).to_bytes() for depth in DEPTHS]):
        yield from table_in_force(content)
        yield struct.pack("<BHBI", 0xA4, *od.TABLE_STAGED, LARGEST_BLOCK), None


LOADS: dict[str, Callable[[], Load]] = {
    "alone": Load,
    "sdo": lambda: SdoClient(tables()),
    "full": lambda: Load((OTHERS_ID, bytes(8))),
}


@dataclass
class Times:
    """Times of each sample, by its number, in seconds: of SYNC, ADC PDO, and the PDOs with its position.

    TPDO1 (type 254) follows the ADC PDO, TPDO2 (type 1) the next SYNC.
    """

    sync_s: dict[int, float] = field(default_factory=dict)
    adc_s: dict[int, float] = field(default_factory=dict)
    at_once_s: dict[int, float] = field(default_factory=dict)
    with_sync_s: dict[int, float] = field(default_factory=dict)

    def from_sync_us(self) -> list[float]:
        return [(at - self.sync_s[n + 1]) * 1e6 for n, at in self.with_sync_s.items() if n + 1 in self.sync_s]

    def from_adc_us(self) -> list[float]:
        return [(at - self.adc_s[n]) * 1e6 for n, at in self.at_once_s.items() if n in self.adc_s]

    def not_in_time(self, period_s: float) -> int:
        """Number of samples whose position was not received within a period after their ADC PDO."""
        return sum(self.at_once_s.get(n, math.inf) > at + period_s for n, at in self.adc_s.items())


class Others:
    """Plays SYNC producer and encoder interface on ``bus``, and a load within 1 Mbit/s."""

    def __init__(self, bus: socket.socket) -> None:
        self._bus = bus
        self._comes_back = bus.family != socket.AF_UNIX
        if self._comes_back:
            bus.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_RECV_OWN_MSGS, 1)
        self._read = FrameReader(bus).read
        self._load = Load()
        self._number = -1  # number of the newest sample
        self._position = -1  # last position of TPDO1, modulo a cycle
        self._free_s = 0.0  # time at which the bus is free
        self._on_the_way: dict[int, deque[int]] = {SYNC: deque(), ADC_PDO: deque()}
        self._times = Times()

    def warm_up(self, rate_hz: float, kind: str) -> None:
        """Play until the node answers steadily, a module with a correction table in force."""
        self.play(WARM_UP, rate_hz, Load())
        if kind in ("floor", "stock"):
            return
        load = SdoClient(set_up())
        for _ in range(LONGEST_WARM_UP):
            self.play(WARM_UP, rate_hz, load)
            if load.done:
                return
        sys.exit("the module does not take a table")

    def play(self, cycles: int, rate_hz: float, load: Load) -> Times:
        self._load, self._times = load, Times()
        next_s = time.monotonic()
        for _ in range(cycles):
            self._until(next_s)
            if time.monotonic() > next_s + LONGEST_LAG / rate_hz:  # skip late SYNCs: no unrealistic burst
                next_s = time.monotonic()
            next_s += 1.0 / rate_hz
            self._number += 1
            self._send_part(SYNC, SYNC_FRAME, self._times.sync_s)
            self._free_s = time.monotonic() + ADC_S
            self._until(self._free_s)
            self._send_part(ADC_PDO, ADC_FRAMES[self._number % len(ADC_FRAMES)], self._times.adc_s)
        self._until(next_s)
        return self._times

    def _send_part(self, can_id: int, frame: bytes, sent_s: dict[int, float]) -> None:
        if self._comes_back:
            self._on_the_way[can_id].append(self._number)
        else:
            sent_s[self._number] = time.time()
        self._bus.send(frame)

    def _until(self, moment_s: float) -> None:
        while (left_s := moment_s - time.monotonic()) > 0.0:
            if self._load.frames:
                busy_s = self._free_s - moment_s + left_s
                if busy_s <= 0.0:
                    self._send_load()
                    continue
                left_s = min(left_s, busy_s)
            if select.select([self._bus], [], [], left_s)[0]:
                frame = self._read()
                if frame is not None:
                    self._take(*frame)

    def _send_load(self) -> None:
        can_id, data = self._load.frames[0]
        self._free_s = time.monotonic() + frame_bits(len(data)) * BIT_S
        with contextlib.suppress(BlockingIOError):
            self._bus.send(CAN_FRAME.pack(can_id, len(data), data), socket.MSG_DONTWAIT)
            self._load.sent()

    def _take(self, can_id: int, data: bytes, stamp_s: float) -> None:
        if can_id == POSITION_PDO:
            self._position = _in_a_cycle(data)
            self._times.at_once_s.setdefault(self._number_of(self._position), stamp_s)
        elif can_id == SYNCHRONOUS_PDO:
            if _in_a_cycle(data) == self._position:  # different: it coasts
                self._times.with_sync_s.setdefault(self._number_of(self._position), stamp_s)
        elif can_id in self._on_the_way:
            times = self._times.sync_s if can_id == SYNC else self._times.adc_s
            times[self._on_the_way[can_id].popleft()] = stamp_s
        else:
            self._load.take(can_id, data)
        self._free_s += frame_bits(len(data)) * BIT_S

    def _number_of(self, position: int) -> int:
        """The newest sample with this phase; the cycle count may be lost on a busy machine."""
        place = round(position * PERIOD / UNITS_PER_CYCLE)
        return self._number - (self._number - place * STEPS_INVERSE) % PERIOD


def _in_a_cycle(data: bytes) -> int:
    return int.from_bytes(data[:2], "little") % UNITS_PER_CYCLE
