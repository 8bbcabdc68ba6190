"""Inputs of a fuzzer, or hypothesis, for a device: strategies of frames with times, and inputs as text.

A line of tests/tools/fuzz_corpus.txt is the device in hex (then the damage of its store), and steps: frames
as `620#40001000` (R instead of #: remote), joined by + if simultaneous, *N: repeated; a pause as `_0.1` (s),
or `~0.1` with ticks when due; `>ROUNDS:CONTENT:SPOIL`: a client continues.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from hypothesis import strategies as st

from canfb import CorrectionTable, Frame, eds_path
from canfb.device.od.dictionary import Dictionary

NODE_ID = 32
SERVER, SECOND_SERVER, SECOND_ANSWER = 0x600 + NODE_ID, 0x6C0, 0x6D0
LSS = 0x7E5
LSS_COMMANDS = [0x04, 0x11, 0x13, 0x15, 0x17, 0x40, 0x41, 0x42, 0x43, 0x46, 0x4C, 0x51, 0x5A, 0x5E]
MOST_STEPS = 60

DICTIONARIES = [Dictionary.load(eds_path(name), NODE_ID) for name in ("canfb-module", "encoder-interface")]
INDICES = [*sorted({entry.index for one in DICTIONARIES for entry in one}), 0x7777]
VALUES = [0, 1, 2, 8, 100, 240, 254, 255, 0x80, 0x40000080, 0x190, 0x80000190, 0x400001A0, 0xC00001A0]
VALUES += [0x2A0, 0x800002A0, 0x680, 0x6C0, 0x20000110, 0x20000210, 0x20000520, 0x20000608, 0x20110110]
VALUES += [0x60080040, 0x60040020, 0x00050008, 0x00070020, 0xFFFFFFFF, 0x65766173, 0x64616F6C, 0x00470001]
VALUES += [0x7FC00000, 0x7F800000, 0x3F800000, 0x800006C0, 0x5C0, 0x800005C0, 0x100, 0x80000100, 0x40000000]
PAUSES_S = [0.0, 0.0001, 0.001, 0.002, 0.01, 0.1, 0.5, 1.0, 3.0, 100.0, 1e6]
NMT_COMMANDS = [1, 2, 128, 129, 130, 0, 3, 255]
NMT_NODES = [NODE_ID, 0, NODE_ID + 1]
NODE_IDS = [1, 127, 255, NODE_ID, 16, 0, 128]
KNOWN_IDS = [0x000, 0x080, 0x100, 0x190, 0x1A0, 0x2A0, 0x320, 0x720, 0x747, 0x7E5, SERVER, SECOND_SERVER]
TABLE = CorrectionTable.identity(16)
CONTENTS = [TABLE.to_bytes(), b"", b"a", b"1234567", b"canfb and more", bytes(64), bytes(70_000)]
CHECKSUMS = [0, TABLE.crc32, 1]
LAYOUTS = [(0x20000110, 0x20000210), (0x20000110, 0x20000210, 0x20000310, 0x20000410)]
LAYOUTS += [(0x20000110, 0x20000210, 0x20000520), (0x20000110, 0x20000210, 0x20000608, 0x20000710)]
LAYOUTS += [(0x20000110, 0x20000210, 0x00050008, 0x20000608), (0x20000510,), ()]


@dataclass(frozen=True)
class Step:
    """Simultaneous frames, then a pause, seconds. `punctual`: ticks at the deadlines.

    Then a correct client continues the running transfer for `follow` rounds; it writes `content` of CONTENTS,
    and adds `spoil` to the CRC.
    """

    frames: tuple[Frame, ...] = ()
    pause_s: float = 0.0
    punctual: bool = False
    follow: int = 0
    content: int = 0
    spoil: int = 0

    def __str__(self) -> str:
        if self.follow:
            return f">{self.follow}:{self.content}:{self.spoil}"
        frames = "+".join(f"{one.can_id:03X}{'#R'[one.rtr]}{one.data.hex().upper()}" for one in self.frames)
        is_paused = self.pause_s or self.punctual or not frames
        return frames + (f"{'_~'[self.punctual]}{self.pause_s:g}" if is_paused else "")


@dataclass(frozen=True)
class Input:
    """A device, steps, and damage of its store (:func:`tools.fuzz.body.damage`)."""

    device: int
    steps: Sequence[Step] = ()
    place: int = 0
    change: int = 1

    def __str__(self) -> str:
        return " ".join([f"{self.device:02X}:{self.place}:{self.change}", *map(str, self.steps)])

    @classmethod
    def parse(cls, text: str) -> Input:
        device, *steps = text.split()
        choice, *damage = device.split(":")
        return cls(int(choice, 16), [_step(one) for one in steps], *map(int, damage))


def _step(text: str) -> Step:
    if text[0] == ">":
        rounds, content, spoil = map(int, text[1:].split(":"))
        return Step((), 0.0, True, rounds, content, spoil)
    frames, mark, pause = re.fullmatch(r"([^_~]*)([_~]?)(.*)", text).groups()  # type: ignore[union-attr]
    once, _, times = frames.partition("*")
    found = [
        Frame(int(one[:3], 16), bytes.fromhex(one[4:]), one[3] == "R")
        for one in filter(None, once.split("+"))
    ]
    return Step(tuple(found * int(times or 1)), float(pause or 0.0), mark == "~")


Bytes = st.SearchStrategy[bytes]
Steps = st.SearchStrategy[Step]


def take(count: int) -> Bytes:
    return st.binary(min_size=count, max_size=count)


def pick(choices: Sequence[int], size: int = 1) -> Bytes:
    return st.sampled_from([one.to_bytes(size, "little") for one in choices])


def number(most: int = 255, *, least: int = 0, times: int = 1, size: int = 1) -> Bytes:
    return st.integers(least, most).map(lambda one: (one * times).to_bytes(size, "little"))


def frame(can_id: int, *parts: bytes | Bytes) -> st.SearchStrategy[Frame]:
    """A frame whose data consists of these parts."""
    drawn = st.tuples(*(st.just(part) if isinstance(part, bytes) else part for part in parts))
    return drawn.map(lambda data: Frame(can_id, b"".join(data)))


def _frames(can_ids: st.SearchStrategy[int]) -> st.SearchStrategy[Frame]:
    return st.builds(lambda *one: Frame(*one), can_ids, st.binary(max_size=9), st.booleans())


request = partial(frame, SERVER)


def step(*frames: st.SearchStrategy[Frame], pause_s: float = 0.0) -> Steps:
    return st.tuples(*frames).map(lambda drawn: Step(drawn, pause_s))


def _segments(kind: int, count: int, is_last: bool, filler: bytes) -> Step:
    """Segments with commands that count or toggle, as from a correct client."""
    frames = []
    for n in range(count):
        toggle, last = 0x10 * (n & 1), is_last and n == count - 1
        command = (toggle | last, 0x60 | toggle, n % 127 + 1 | last << 7)[kind]
        frames.append(Frame(SERVER, bytes([command]) + filler * 7))
    return Step(tuple(frames))


def _writes(*writes: tuple[int, int, int, int]) -> Step:
    """SDO writes: command, index, sub-index and value of each."""
    return Step(tuple(Frame(SERVER, struct.pack("<BHBI", *one)) for one in writes))


def _mapped(pdo: int, cob_id: int, objects: Sequence[int], kind: int) -> Step:
    """The whole sequence of a mapping: PDO off, other objects, PDO on."""
    mapping = pdo + 0x200
    return _writes(
        *((0x23, pdo, 1, cob_id | 1 << 31), (0x2F, mapping, 0, 0)),
        *((0x23, mapping, sub, value) for sub, value in enumerate(objects, start=1)),
        *((0x2F, mapping, 0, len(objects)), (0x2F, pdo, 2, kind), (0x23, pdo, 1, cob_id & ~(1 << 31))),
    )


def _timing(tpdo: int, kind: int, inhibit: int, timer: int, start: int) -> Step:
    """A TPDO with transmission type, inhibit time, event timer and SYNC start value."""
    pdo, cob_id = 0x1800 + tpdo, 0x1A0 + 0x100 * tpdo
    return _writes(
        *((0x23, pdo, 1, cob_id | 1 << 31), (0x2F, pdo, 2, kind), (0x2B, pdo, 3, 10 * inhibit)),
        *((0x2B, pdo, 5, 10 * timer), (0x2F, pdo, 6, start), (0x23, pdo, 1, cob_id)),
    )


BYTE = st.integers(0, 255)
PLACE = st.tuples(pick(INDICES, 2), number(15)).map(b"".join)
TRANSFER_COMMANDS = [0xA3, 0xA2, 0xA1, 0xC1, 0xD5, 0x80, 0x60, 0x70, 0x00, 0x10, 0x01, 0x0D, 0x81]
TRANSFERS: tuple[Steps, ...] = (
    step(request(take(8))),
    step(request(pick([0x22, 0x23, 0x27, 0x2B, 0x2F]), PLACE, pick(VALUES, 4))),
    step(request(pick([0x23, 0x27, 0x2B, 0x2F]), PLACE, take(4))),
    step(request(b"\x40", PLACE, bytes(4))),
    step(request(pick([0x21, 0x20, 0xC6, 0xC2, 0xC0, 0xC4, 0xA0, 0xA4]), PLACE, take(2), bytes(2))),
    st.builds(_segments, st.integers(0, 2), st.integers(1, 40), st.booleans(), take(1)),
    step(request(pick(TRANSFER_COMMANDS), take(2), bytes(5))),
    st.builds(
        lambda rounds, content, spoil: Step((), 0.0, True, rounds, content, int(spoil == 0)),
        st.integers(1, 40),
        st.integers(0, len(CONTENTS) - 1),
        st.integers(0, 50),
    ),
    step(request(b"\x23\x20\x20\x03", pick(CHECKSUMS, 4))),
)
"""Kinds of step of an SDO client, good and bad."""
KINDS: tuple[Steps, ...] = (
    *TRANSFERS,
    step(_frames(st.integers(0, 0x7FF))),
    step(_frames(st.sampled_from(KNOWN_IDS))),
    step(frame(SECOND_SERVER, take(8))),
    step(frame(0x000, pick(NMT_COMMANDS), pick(NMT_NODES))),
    step(frame(0x080, st.binary(max_size=1))),
    step(frame(0x190, take(4))),
    st.builds(
        lambda count, sample: Step((Frame(0x080, b""), Frame(0x190, sample)) * count, 0.001),
        st.integers(1, 32),
        take(4),
    ),
    st.builds(Step, st.just(()), st.sampled_from(PAUSES_S), st.booleans()),
    step(  # enables the second SDO channel, as a master would
        request(b"\x23\x01\x12\x01", SECOND_SERVER.to_bytes(4, "little")),
        request(b"\x23\x01\x12\x02", SECOND_ANSWER.to_bytes(4, "little")),
    ),
    st.builds(
        _mapped,
        st.sampled_from([0x1400, 0x1401, 0x1800, 0x1801, 0x1802, 0x1803]),
        st.sampled_from(VALUES),
        st.lists(st.sampled_from(VALUES), max_size=8),
        BYTE,
    ),
    st.builds(_mapped, st.just(0x1400), st.just(0x190), st.sampled_from(LAYOUTS), BYTE),
    step(frame(0x080), frame(0x190, take(8)), pause_s=0.001),
    step(  # consumes SYNC, heartbeat and TIME, produces SYNC, with short times
        request(b"\x23\x06\x10\x00", number(times=100, size=4)),
        request(b"\x23\x16\x10\x01", number(), b"\x00\x47\x00"),
        request(b"\x23\x12\x10\x00\x00\x01\x00\x80"),
        request(b"\x23\x05\x10\x00\x80\x00\x00\x40"),
    ),
    step(frame(0x747, pick([0, 4, 5, 127, 1])), frame(0x100, take(6))),
    st.builds(
        _timing, st.integers(0, 3), st.sampled_from([1, 2, 240, 252, 253, 254, 255, 0]), BYTE, BYTE, BYTE
    ),
    step(request(b"\x23", pick([0x10, 0x11]), b"\x10", number(4), st.sampled_from([b"save", b"load"]))),
    step(frame(LSS, pick(LSS_COMMANDS), take(2), bytes(5))),
    step(frame(LSS, b"\x11", pick(NODE_IDS), bytes(6))),
    step(frame(LSS, pick([0x04, 0x13]), number(2), number(9), bytes(5))),
    step(  # sets another node-ID by LSS: configuration, store, waiting, reset
        frame(LSS, b"\x04\x01", bytes(6)),
        frame(LSS, b"\x11", pick(NODE_IDS), bytes(6)),
        frame(LSS, b"\x17", bytes(7)),
        frame(LSS, b"\x04\x00", bytes(6)),
        frame(0x000, number(130, least=129), b"\x00"),
    ),
)


def _inputs(kinds: Sequence[Steps]) -> st.SearchStrategy[Input]:
    any_step = st.one_of(kinds)
    steps = st.integers(0, MOST_STEPS).flatmap(lambda n: st.lists(any_step, min_size=n, max_size=n))
    return st.builds(Input, BYTE, steps, BYTE, BYTE)


INPUTS = {"frames": _inputs(KINDS), "sdo": _inputs(TRANSFERS)}
