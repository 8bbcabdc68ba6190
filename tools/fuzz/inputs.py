"""Bytes of a fuzzer -> frames with times. Every row of bytes means something, none is refused.

The first byte chooses the device, then each step is one byte for its kind and what that kind takes; missing
bytes are 0. A change of the kinds or of a table changes what kept inputs mean.
"""

from __future__ import annotations

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


def _any_frame(reader: Reader) -> Step:
    head = reader.word()
    length = reader.byte() % 10
    return Step((Frame(head & 0x7FF, reader.take(length), bool(head & 0x8000)),))


def _known_frame(reader: Reader) -> Step:
    can_id, length = reader.choose(KNOWN_IDS), reader.byte()
    return Step((Frame(can_id, reader.take(length % 10), length >= 240),))


def _request(reader: Reader) -> Step:
    return Step((Frame(SERVER, reader.take(8)),))


def _second_request(reader: Reader) -> Step:
    return Step((Frame(SECOND_SERVER, reader.take(8)),))


def _multiplexer(reader: Reader) -> bytes:
    return reader.choose(INDICES).to_bytes(2, "little") + bytes([reader.byte() % 16])


def _write(reader: Reader) -> Step:
    multiplexer, size = _multiplexer(reader), reader.byte() % 5
    value = reader.choose(VALUES).to_bytes(4, "little")
    command = 0x23 | (4 - size) << 2 if size else 0x22
    return Step((Frame(SERVER, bytes([command]) + multiplexer + value),))


def _write_bytes(reader: Reader) -> Step:
    multiplexer, size = _multiplexer(reader), reader.byte() % 4
    return Step((Frame(SERVER, bytes([0x23 | size << 2]) + multiplexer + reader.take(4)),))


def _read(reader: Reader) -> Step:
    return Step((Frame(SERVER, b"\x40" + _multiplexer(reader) + bytes(4)),))


def _begin(reader: Reader) -> Step:
    command = reader.choose([0x21, 0x20, 0xC6, 0xC2, 0xC0, 0xC4, 0xA0, 0xA4])
    return Step((Frame(SERVER, bytes([command]) + _multiplexer(reader) + reader.take(2) + bytes(2)),))


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


def _transfer_command(reader: Reader) -> Step:
    command = reader.choose([0xA3, 0xA2, 0xA1, 0xC1, 0xD5, 0x80, 0x60, 0x70, 0x00, 0x10, 0x01, 0x0D, 0x81])
    return Step((Frame(SERVER, bytes([command]) + reader.take(2) + bytes(5)),))


def _nmt(reader: Reader) -> Step:
    return Step((Frame(0x000, bytes([reader.choose(NMT_COMMANDS), reader.choose(NMT_NODES)])),))


def _sync(reader: Reader) -> Step:
    counter = reader.byte()
    return Step((Frame(0x080, bytes([counter]) if counter else b""),))


def _sample(reader: Reader) -> Step:
    return Step((Frame(0x190, reader.take(4)),))


def _cycles(reader: Reader) -> Step:
    count, sample = reader.byte() % 32 + 1, reader.take(4)
    return Step((Frame(0x080, b""), Frame(0x190, sample)) * count, 0.001)


def _remote(reader: Reader) -> Step:
    can_id, length = reader.choose(KNOWN_IDS), reader.byte() % 9
    return Step((Frame(can_id, bytes(length), True),))


def _pause(reader: Reader) -> Step:
    choice = reader.byte()
    return Step((), PAUSES_S[choice % len(PAUSES_S)], choice >= 128)


def _second_channel(reader: Reader) -> Step:
    writes = ((1, SECOND_SERVER), (2, SECOND_ANSWER))
    frames = [b"\x23\x01\x12" + bytes([sub]) + value.to_bytes(4, "little") for sub, value in writes]
    return Step(tuple(Frame(SERVER, frame) for frame in frames))


def _mapping(reader: Reader) -> Step:
    """Off, other objects, on: the whole sequence of a mapping."""
    pdo, count = reader.choose([0x1400, 0x1401, 0x1800, 0x1801, 0x1802, 0x1803]), reader.byte() % 9
    head, mapping = pdo.to_bytes(2, "little"), (pdo + 0x200).to_bytes(2, "little")
    off = reader.choose(VALUES)
    mapped = [reader.choose(VALUES) for _ in range(count)]
    return _sequence(head, mapping, off, mapped, reader.byte())


def _sequence(head: bytes, mapping: bytes, off: int, mapped: Sequence[int], kind: int) -> Step:
    frames = [b"\x23" + head + b"\x01" + (off | 1 << 31).to_bytes(4, "little")]
    frames.append(b"\x2f" + mapping + bytes(5))
    frames += [
        b"\x23" + mapping + bytes([sub]) + value.to_bytes(4, "little")
        for sub, value in enumerate(mapped, start=1)
    ]
    frames.append(b"\x2f" + mapping + b"\x00" + bytes([len(mapped), 0, 0, 0]))
    frames.append(b"\x2f" + head + b"\x02" + bytes([kind, 0, 0, 0]))
    frames.append(b"\x23" + head + b"\x01" + (off & ~(1 << 31)).to_bytes(4, "little"))
    return Step(tuple(Frame(SERVER, frame) for frame in frames))


def _sample_layout(reader: Reader) -> Step:
    layout = LAYOUTS[reader.byte() % len(LAYOUTS)]
    return _sequence(b"\x00\x14", b"\x00\x16", 0x190, layout, reader.byte())


def _long_sample(reader: Reader) -> Step:
    return Step((Frame(0x080, b""), Frame(0x190, reader.take(8))), 0.001)


def _follow(reader: Reader) -> Step:
    rounds, content, spoil = reader.byte() % 40 + 1, CONTENTS[reader.byte() % len(CONTENTS)], reader.byte()
    return Step((), 0.0, True, rounds, content, 1 if spoil > 250 else 0)


def _activate(reader: Reader) -> Step:
    checksum = reader.choose(CHECKSUMS).to_bytes(4, "little")
    return Step((Frame(SERVER, b"\x23\x20\x20\x03" + checksum),))


def _producer(reader: Reader) -> Step:
    """SYNC, heartbeat and TIME of others watched, SYNC of its own, with times that are near."""
    frames = [
        *(b"\x23\x06\x10\x00" + (reader.byte() * 100).to_bytes(4, "little"),),
        *(b"\x23\x16\x10\x01" + bytes([reader.byte(), 0, 0x47, 0]),),
        *(b"\x23\x12\x10\x00\x00\x01\x00\x80", b"\x23\x05\x10\x00\x80\x00\x00\x40"),
    ]
    return Step(tuple(Frame(SERVER, frame) for frame in frames))


def _heard(reader: Reader) -> Step:
    beat = Frame(0x747, bytes([reader.choose([0, 4, 5, 127, 1])]))
    return Step((beat, Frame(0x100, reader.take(6))))


def _timing(reader: Reader) -> Step:
    """A TPDO with transmission type, inhibit time, event timer and SYNC start value."""
    number, kind = reader.byte() % 4, reader.choose([1, 2, 240, 252, 253, 254, 255, 0])
    head = bytes([number, 0x18])
    cob_id = ([0x1A0, 0x2A0, 0x3A0, 0x4A0][number]).to_bytes(4, "little")
    inhibit, timer = ((reader.byte() * 10).to_bytes(2, "little") for _ in range(2))
    frames = [
        *(b"\x23" + head + b"\x01" + cob_id[:3] + b"\x80", b"\x2f" + head + b"\x02" + bytes([kind, 0, 0, 0])),
        *(b"\x2b" + head + b"\x03" + inhibit + bytes(2), b"\x2b" + head + b"\x05" + timer + bytes(2)),
        *(b"\x2f" + head + b"\x06" + bytes([reader.byte(), 0, 0, 0]), b"\x23" + head + b"\x01" + cob_id),
    ]
    return Step(tuple(Frame(SERVER, frame) for frame in frames))


def _storage(reader: Reader) -> Step:
    index, command = reader.choose([0, 1]), reader.choose([0, 1])
    multiplexer = bytes([0x10 + index, 0x10, reader.byte() % 5])
    return Step((Frame(SERVER, b"\x23" + multiplexer + (b"save", b"load")[command]),))


def _lss(reader: Reader) -> Step:
    """The LSS master: state, node-ID, bit rate, store, identification, fastscan."""
    command = reader.choose(LSS_COMMANDS)
    if command == 0x11:
        return Step((Frame(LSS, bytes([command, reader.choose(NODE_IDS)]) + bytes(6)),))
    if command in (0x04, 0x13):
        return Step((Frame(LSS, bytes([command, reader.byte() % 3, reader.byte() % 10]) + bytes(5)),))
    return Step((Frame(LSS, bytes([command]) + reader.take(2).ljust(7, b"\x00")),))


def _lss_node_id(reader: Reader) -> Step:
    """Another node-ID, and what puts it in force: configuration, store, waiting, reset."""
    frames = [b"\x04\x01", bytes([0x11, reader.choose(NODE_IDS)]), b"\x17", b"\x04\x00"]
    reset = Frame(0x000, bytes([129 + reader.byte() % 2, 0]))
    return Step((*(Frame(LSS, frame.ljust(8, b"\x00")) for frame in frames), reset))


KINDS: tuple[Callable[[Reader], Step], ...] = (
    *(_any_frame, _known_frame, _request, _second_request, _write, _write_bytes, _read, _begin, _segments),
    *(_transfer_command, _nmt, _sync, _sample, _cycles, _remote, _pause, _second_channel, _mapping),
    *(_sample_layout, _long_sample, _follow, _activate, _producer, _heard, _timing, _storage),
    *(_lss, _lss_node_id),
)

TRANSFERS = (_request, _write, _write_bytes, _read, _begin, _segments, _transfer_command, _follow, _activate)
"""Kinds of step of an SDO client, good and bad."""
