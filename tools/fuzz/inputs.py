"""Bytes of a fuzzer -> frames with times. Every row of bytes means something, none is refused.

The first byte chooses the device, then each step is one byte for its kind and what that kind takes; missing
bytes are 0. A change of the kinds or of a table changes what kept inputs mean.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from canfb.cia301.frame import Frame
from canfb.signal.correction import CorrectionTable

NODE_ID = 32
SERVER, SECOND_SERVER, SECOND_ANSWER = 0x600 + NODE_ID, 0x6C0, 0x6D0
LSS = 0x7E5
LSS_COMMANDS = [0x04, 0x11, 0x13, 0x15, 0x17, 0x40, 0x41, 0x42, 0x43, 0x46, 0x4C, 0x51, 0x5A, 0x5E]
MOST_STEPS = 400

INDICES = [0x1000, 0x1001, 0x1003, 0x1005, 0x1006, 0x1007, 0x1008, 0x100C, 0x100D, 0x1010, 0x1011, 0x1012]
INDICES += [0x1014, 0x1015, 0x1016, 0x1017, 0x1018, 0x1019, 0x1020, 0x1021, 0x1029, 0x1200, 0x1201, 0x1400]
INDICES += [0x1401, 0x1600, 0x1601, 0x1800, 0x1801, 0x1802, 0x1803, 0x1A00, 0x1A01, 0x1A02, 0x1A03, 0x1F80]
INDICES += [0x2000, 0x2001, 0x2002, 0x2010, 0x2011, 0x2012, 0x2020, 0x2030, 0x2050, 0x6000, 0x6001, 0x6002]
INDICES += [0x6003, 0x6004, 0x6008, 0x600C, 0x6401, 0x6503, 0x6509, 0x650A, 0x7777]
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
    """Frames that come at once, then a pause, seconds. `punctual`: ticks come when the deadline says.

    Then a good client goes on with the transfer that runs, for `follow` rounds; `content` is what it writes,
    and `spoil` what it adds to the CRC.
    """

    frames: tuple[Frame, ...] = ()
    pause_s: float = 0.0
    punctual: bool = False
    follow: int = 0
    content: bytes = b""
    spoil: int = 0


class Reader:
    """Takes bytes from the front; zeros when there are no more."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._place = 0

    @property
    def is_empty(self) -> bool:
        return self._place >= len(self._data)

    def take(self, count: int) -> bytes:
        taken = self._data[self._place : self._place + count]
        self._place += count
        return taken.ljust(count, b"\x00")

    def byte(self) -> int:
        return self.take(1)[0]

    def word(self) -> int:
        return int.from_bytes(self.take(2), "little")

    def choose(self, choices: list[int]) -> int:
        return choices[self.byte() % len(choices)]


def steps(reader: Reader, *, transfers_only: bool = False) -> Iterator[Step]:
    """The steps of an input, at most MOST_STEPS; only those of TRANSFERS if asked."""
    kinds = TRANSFERS if transfers_only else KINDS
    for _ in range(MOST_STEPS):
        if reader.is_empty:
            return
        yield kinds[reader.byte() % len(kinds)](reader)


Kind = Callable[[Reader], Step]
Part = bytes | Callable[[Reader], bytes]


def take(count: int) -> Part:
    return lambda reader: reader.take(count)


def pick(choices: list[int], size: int = 1) -> Part:
    return lambda reader: reader.choose(choices).to_bytes(size, "little")


def number(limit: int = 256, *, least: int = 0, times: int = 1, size: int = 1) -> Part:
    return lambda reader: ((least + reader.byte() % limit) * times).to_bytes(size, "little")


def frame(can_id: int, *parts: Part) -> Callable[[Reader], Frame]:
    """A frame whose data are these parts, some of them from the input."""
    return lambda reader: Frame(
        can_id, b"".join(part if isinstance(part, bytes) else part(reader) for part in parts)
    )


def request(*parts: Part) -> Callable[[Reader], Frame]:
    return frame(SERVER, *parts)


def step(*frames: Callable[[Reader], Frame], pause_s: float = 0.0) -> Kind:
    return lambda reader: Step(tuple(one(reader) for one in frames), pause_s)


def multiplexer(reader: Reader) -> bytes:
    return reader.choose(INDICES).to_bytes(2, "little") + bytes([reader.byte() % 16])


def _any_frame(reader: Reader) -> Step:
    head = reader.word()
    length = reader.byte() % 10
    return Step((Frame(head & 0x7FF, reader.take(length), bool(head & 0x8000)),))


def _known_frame(reader: Reader) -> Step:
    can_id, length = reader.choose(KNOWN_IDS), reader.byte()
    return Step((Frame(can_id, reader.take(length % 10), length >= 240),))


def _write(reader: Reader) -> Step:
    place, size = multiplexer(reader), reader.byte() % 5
    value = reader.choose(VALUES).to_bytes(4, "little")
    command = 0x23 | (4 - size) << 2 if size else 0x22
    return Step((Frame(SERVER, bytes([command]) + place + value),))


def _write_bytes(reader: Reader) -> Step:
    place, size = multiplexer(reader), reader.byte() % 4
    return Step((Frame(SERVER, bytes([0x23 | size << 2]) + place + reader.take(4)),))


def _segments(reader: Reader) -> Step:
    """Requests with commands that count or toggle, as a good client sends them."""
    kind, count, filler = reader.byte(), reader.byte() % 40 + 1, reader.byte()
    frames = []
    for number in range(count):
        toggle = 0x10 * (number & 1)
        last = number == count - 1 and kind & 0x80
        command = [toggle | bool(last), 0x60 | toggle, (number % 127 + 1) | (0x80 if last else 0)][kind % 3]
        frames.append(Frame(SERVER, bytes([command]) + bytes([filler]) * 7))
    return Step(tuple(frames))


def _sync(reader: Reader) -> Step:
    counter = reader.byte()
    return Step((Frame(0x080, bytes([counter]) if counter else b""),))


def _cycles(reader: Reader) -> Step:
    count, sample = reader.byte() % 32 + 1, reader.take(4)
    return Step((Frame(0x080, b""), Frame(0x190, sample)) * count, 0.001)


def _remote(reader: Reader) -> Step:
    can_id, length = reader.choose(KNOWN_IDS), reader.byte() % 9
    return Step((Frame(can_id, bytes(length), True),))


def _pause(reader: Reader) -> Step:
    choice = reader.byte()
    return Step((), PAUSES_S[choice % len(PAUSES_S)], choice >= 128)


def _mapping(reader: Reader) -> Step:
    """Off, other objects, on: the whole sequence of a mapping."""
    pdo, count = reader.choose([0x1400, 0x1401, 0x1800, 0x1801, 0x1802, 0x1803]), reader.byte() % 9
    off = reader.choose(VALUES)
    return _mapped(pdo, off, [reader.choose(VALUES) for _ in range(count)], reader.byte())


def _sample_layout(reader: Reader) -> Step:
    layout = LAYOUTS[reader.byte() % len(LAYOUTS)]
    return _mapped(0x1400, 0x190, layout, reader.byte())


def _mapped(pdo: int, cob_id: int, objects: Sequence[int], kind: int) -> Step:
    writes = [(pdo, 1, cob_id | 1 << 31), (pdo + 0x200, 0, 0)]
    writes += [(pdo + 0x200, sub, value) for sub, value in enumerate(objects, start=1)]
    writes += [(pdo + 0x200, 0, len(objects)), (pdo, 2, kind), (pdo, 1, cob_id & ~(1 << 31))]
    frames = []
    for index, sub, value in writes:
        is_byte = sub == 0 or (index, sub) == (pdo, 2)
        head = b"\x2f" if is_byte else b"\x23"
        frames.append(Frame(SERVER, head + struct.pack("<HBI", index, sub, value)))
    return Step(tuple(frames))


def _follow(reader: Reader) -> Step:
    rounds, content, spoil = reader.byte() % 40 + 1, CONTENTS[reader.byte() % len(CONTENTS)], reader.byte()
    return Step((), 0.0, True, rounds, content, 1 if spoil > 250 else 0)


def _timing(reader: Reader) -> Step:
    """A TPDO with transmission type, inhibit time, event timer and SYNC start value."""
    tpdo, kind = reader.byte() % 4, reader.choose([1, 2, 240, 252, 253, 254, 255, 0])
    head, cob_id = bytes([tpdo, 0x18]), 0x1A0 + 0x100 * tpdo
    inhibit, timer = ((reader.byte() * 10).to_bytes(2, "little") for _ in range(2))
    frames = [
        b"\x23" + head + b"\x01" + (cob_id | 1 << 31).to_bytes(4, "little"),
        b"\x2f" + head + b"\x02" + bytes([kind, 0, 0, 0]),
        b"\x2b" + head + b"\x03" + inhibit + bytes(2),
        b"\x2b" + head + b"\x05" + timer + bytes(2),
        b"\x2f" + head + b"\x06" + bytes([reader.byte(), 0, 0, 0]),
        b"\x23" + head + b"\x01" + cob_id.to_bytes(4, "little"),
    ]
    return Step(tuple(Frame(SERVER, one) for one in frames))


def _storage(reader: Reader) -> Step:
    index, command = reader.choose([0, 1]), reader.choose([0, 1])
    place = bytes([0x10 + index, 0x10, reader.byte() % 5])
    return Step((Frame(SERVER, b"\x23" + place + (b"save", b"load")[command]),))


def _lss(reader: Reader) -> Step:
    """The LSS master: state, node-ID, bit rate, store, identification, fastscan."""
    command = reader.choose(LSS_COMMANDS)
    if command == 0x11:
        data = bytes([command, reader.choose(NODE_IDS)])
    elif command in (0x04, 0x13):
        data = bytes([command, reader.byte() % 3, reader.byte() % 10])
    else:
        data = bytes([command]) + reader.take(2)
    return Step((Frame(LSS, data.ljust(8, b"\x00")),))


TRANSFER_COMMANDS = [0xA3, 0xA2, 0xA1, 0xC1, 0xD5, 0x80, 0x60, 0x70, 0x00, 0x10, 0x01, 0x0D, 0x81]
_request = step(request(take(8)))
_read = step(request(b"\x40", multiplexer, bytes(4)))
_begin = step(request(pick([0x21, 0x20, 0xC6, 0xC2, 0xC0, 0xC4, 0xA0, 0xA4]), multiplexer, take(2), bytes(2)))
_transfer_command = step(request(pick(TRANSFER_COMMANDS), take(2), bytes(5)))
_activate = step(request(b"\x23\x20\x20\x03", pick(CHECKSUMS, 4)))
KINDS: tuple[Kind, ...] = (
    *(_any_frame, _known_frame, _request, step(frame(SECOND_SERVER, take(8))), _write, _write_bytes),
    *(_read, _begin, _segments, _transfer_command),
    step(frame(0x000, pick(NMT_COMMANDS), pick(NMT_NODES))),
    _sync,
    step(frame(0x190, take(4))),
    *(_cycles, _remote, _pause),
    step(  # makes the second SDO channel valid, as a master would
        request(b"\x23\x01\x12\x01", SECOND_SERVER.to_bytes(4, "little")),
        request(b"\x23\x01\x12\x02", SECOND_ANSWER.to_bytes(4, "little")),
    ),
    *(_mapping, _sample_layout),
    step(frame(0x080), frame(0x190, take(8)), pause_s=0.001),
    *(_follow, _activate),
    step(  # SYNC, heartbeat and TIME of others watched, SYNC of its own, with times that are near
        request(b"\x23\x06\x10\x00", number(times=100, size=4)),
        request(b"\x23\x16\x10\x01", number(), b"\x00\x47\x00"),
        request(b"\x23\x12\x10\x00\x00\x01\x00\x80"),
        request(b"\x23\x05\x10\x00\x80\x00\x00\x40"),
    ),
    step(frame(0x747, pick([0, 4, 5, 127, 1])), frame(0x100, take(6))),
    *(_timing, _storage, _lss),
    step(  # another node-ID, and what puts it in force: configuration, store, waiting, reset
        frame(LSS, b"\x04\x01", bytes(6)),
        frame(LSS, b"\x11", pick(NODE_IDS), bytes(6)),
        frame(LSS, b"\x17", bytes(7)),
        frame(LSS, b"\x04\x00", bytes(6)),
        frame(0x000, number(2, least=129), b"\x00"),
    ),
)
TRANSFERS = (_request, _write, _write_bytes, _read, _begin, _segments, _transfer_command, _follow, _activate)
"""Kinds of step of an SDO client, good and bad."""
