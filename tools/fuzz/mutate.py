"""Random changes of an input: of its bytes, its numbers, its words and its lines, whatever it means.

Files are text or binary, and a mutator that knows neither breaks both: it sets bytes and little-endian
numbers, writes another number where digits are, takes a word of another input, and drops, doubles and moves
lines.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from random import Random

MOST_CHANGES = 4
NUMBER = re.compile(rb"[-+]?(?:0x[0-9A-Fa-f]+|\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)")
WORD = re.compile(rb"[A-Za-z_$][A-Za-z0-9_$]*")
NUMBERS = [b"0", b"1", b"-1", b"2", b"127", b"128", b"255", b"256", b"32767", b"65535", b"65536", b"-32769"]
NUMBERS += [b"2147483648", b"4294967295", b"4294967296", b"-9223372036854775809", b"1e308", b"1e999", b"-0.0"]
NUMBERS += [b"0.5", b"1e-320", b"nan", b"inf", b"-inf", b"0x", b"0xFFFFFFFF", b"0x" + b"F" * 40]
NUMBERS += [b"9" * 400, b"9" * 5000, b"0b1", b"1_000", b"08", b"", b"\xd9\xa1", b".nan", b"$NODEID+0x10"]
MARKS = [
    *(bytes([one]) for one in b"[](){}<>:;,.#&*!%@`'\"|-+=~?/\\ \t\r\n\0\x7f\xff"),
    b"\r\n",
    b"\xef\xbb\xbf",
]
MARKS += [b"\xc3\xa9", b"\xed\xa0\x80", b"\xe2\x80\xa8", b"\xf0\x9f\x98\x80", b"..", b"%s", b"{0}", b"---\n"]
INTEGERS = [0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x10000, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF]


class Mutator:
    """Makes inputs of at most ``longest`` bytes. ``seeds`` are where its words come from."""

    def __init__(self, random: Random, seeds: Sequence[bytes], longest: int) -> None:
        self._random, self._longest = random, longest
        self._words = sorted({word for seed in seeds for word in WORD.findall(seed)})
        self._kinds: tuple[Callable[[bytes, bytes], bytes], ...] = (
            *(self._flip, self._insert, self._drop, self._double, self._repeat, self._integer, self._mark),
            *(
                self._number,
                self._number,
                self._word,
                self._word,
                self._drop_line,
                self._move_line,
                self._splice,
            ),
        )

    def mutated(self, data: bytes, other: bytes) -> bytes:
        """``data`` with some changes, perhaps with a part of ``other``."""
        for _ in range(self._random.randint(1, MOST_CHANGES)):
            data = self._random.choice(self._kinds)(data, other)[: self._longest]
        return data

    def _place(self, data: bytes) -> int:
        return self._random.randint(0, len(data))

    def _range(self, data: bytes) -> tuple[int, int]:
        """Short ones more often."""
        begin = self._place(data)
        longest = max(1, (len(data) - begin) >> self._random.randint(0, 10))
        return begin, begin + self._random.randint(1, longest)

    def _flip(self, data: bytes, other: bytes) -> bytes:
        at = self._place(data)
        return (
            data[:at]
            + bytes(byte ^ 1 << self._random.randrange(8) for byte in data[at : at + 1])
            + data[at + 1 :]
        )

    def _insert(self, data: bytes, other: bytes) -> bytes:
        at = self._place(data)
        return data[:at] + self._random.randbytes(self._random.randint(1, 8)) + data[at:]

    def _drop(self, data: bytes, other: bytes) -> bytes:
        begin, end = self._range(data)
        return data[:begin] + data[end:]

    def _double(self, data: bytes, other: bytes) -> bytes:
        (begin, end), at = self._range(data), self._place(data)
        return data[:at] + data[begin:end] + data[at:]

    def _repeat(self, data: bytes, other: bytes) -> bytes:
        """A few bytes very often: nesting, long lines, long lists."""
        begin = self._place(data)
        part = data[begin : begin + self._random.randint(1, 12)]
        return data[:begin] + part * (1 << self._random.randint(1, 13)) + data[begin:]

    def _integer(self, data: bytes, other: bytes) -> bytes:
        """Little-endian, as binary formats have their lengths."""
        at, size = self._place(data), self._random.choice((1, 2, 4, 8))
        value = self._random.choice(INTEGERS) + self._random.choice((0, 0, 1, -1))
        return data[:at] + (value % (1 << 8 * size)).to_bytes(size, "little") + data[at + size :]

    def _mark(self, data: bytes, other: bytes) -> bytes:
        at = self._place(data)
        return data[:at] + self._random.choice(MARKS) + data[at + self._random.randrange(2) :]

    def _number(self, data: bytes, other: bytes) -> bytes:
        return self._replaced(data, NUMBER, NUMBERS)

    def _word(self, data: bytes, other: bytes) -> bytes:
        return self._replaced(data, WORD, self._words)

    def _replaced(self, data: bytes, what: re.Pattern[bytes], by: Sequence[bytes]) -> bytes:
        """The first from a random place on."""
        found = what.search(data, self._place(data)) or what.search(data)
        if found is None or not by:
            return data
        return data[: found.start()] + self._random.choice(by) + data[found.end() :]

    def _drop_line(self, data: bytes, other: bytes) -> bytes:
        lines = data.splitlines(keepends=True)
        if lines:
            del lines[self._random.randrange(len(lines))]
        return b"".join(lines)

    def _move_line(self, data: bytes, other: bytes) -> bytes:
        """Or double it."""
        lines = data.splitlines(keepends=True)
        if lines:
            at = self._random.randrange(len(lines))
            line = lines[at] if self._random.randrange(2) else lines.pop(at)
            lines.insert(self._random.randint(0, len(lines)), line)
        return b"".join(lines)

    def _splice(self, data: bytes, other: bytes) -> bytes:
        begin, end = self._range(other)
        at, until = self._range(data)
        return data[:at] + other[begin:end] + data[until:]
