"""Whole SDO transfers as a client makes them, by segments and by block, in which frames may be lost."""

import binascii
from collections.abc import Callable, Container, Mapping, Sequence

ABORT = 0x80
Ask = Callable[[bytes], list[bytes]]
"""Send a request of up to 8 bytes; what the server says upon it."""


def crc(data: bytes) -> int:
    """CRC of block transfers: polynomial 1021h, start 0."""
    return binascii.crc_hqx(data, 0)


def segments(data: bytes) -> list[bytes]:
    """The contents of the segments; at least one."""
    return [data[start : start + 7] for start in range(0, max(len(data), 1), 7)]


def upload(ask: Ask, multiplexer: bytes) -> bytes:
    """A whole object, expedited or segmented."""
    (first,) = ask(b"\x40" + multiplexer)
    assert first[1:4] == multiplexer, first.hex()
    if first[0] & 0xF3 == 0x43:
        return first[4 : 8 - (first[0] >> 2 & 3)]
    assert first[0] == 0x41, first.hex()
    size, data, toggle = int.from_bytes(first[4:], "little"), b"", 0x00
    for part in segments(bytes(size)):
        (answer,) = ask(bytes([0x60 | toggle]))
        is_last = len(data) + len(part) == size
        assert answer[0] == toggle | (7 - len(part)) << 1 | is_last
        assert not any(answer[1 + len(part) :])
        data += answer[1 : 1 + len(part)]
        toggle ^= 0x10
    return data


def download_steps(multiplexer: bytes, data: bytes, *, announced: bool = True) -> list[tuple[bytes, bytes]]:
    """The requests of a download by segments, and the answer to each."""
    size = (len(data) if announced else 0).to_bytes(4, "little")
    steps = [(bytes([0x20 | announced]) + multiplexer + size, b"\x60" + multiplexer)]
    parts = segments(data)
    for number, part in enumerate(parts, 1):
        toggle = 0x00 if number % 2 else 0x10
        head = toggle | (7 - len(part)) << 1 | (number == len(parts))
        steps.append((bytes([head]) + part, bytes([0x20 | toggle])))
    return steps


def download(ask: Ask, multiplexer: bytes, data: bytes, *, announced: bool = True) -> bytes:
    """By segments; the abort, or nothing."""
    for request, confirmed in download_steps(multiplexer, data, announced=announced):
        (answer,) = ask(request)
        if answer[0] == ABORT:
            return answer
        assert answer == confirmed.ljust(8, b"\0")
    return b""


def block_upload(
    ask: Ask,
    multiplexer: bytes,
    *,
    sizes: Sequence[int] = (127,),
    lost: Mapping[int, int] | None = None,
    with_crc: bool = True,
) -> bytes:
    """A whole object in blocks of these sizes in turn; of a block all is ``lost`` from a segment on."""
    (first,) = ask(bytes([0xA4 if with_crc else 0xA0]) + multiplexer + bytes([sizes[0]]))
    assert first[:4] == bytes([0xC6 if with_crc else 0xC2]) + multiplexer
    size = int.from_bytes(first[4:], "little")
    data, block, last = b"", 0, False
    answers = ask(b"\xa3")
    while not last:
        expected = min(sizes[block % len(sizes)], len(segments(bytes(size - len(data)))))
        assert [answer[0] & 0x7F for answer in answers] == list(range(1, expected + 1))
        good = answers[: (lost or {}).get(block, 128) - 1]
        data += b"".join(answer[1:] for answer in good)
        last = bool(good and good[-1][0] & 0x80)
        block += 1
        answers = ask(bytes([0xA2, len(good), sizes[block % len(sizes)]]))
    whole, unused = data[:size], len(data) - size
    checksum = crc(whole) if with_crc else 0
    assert answers == [bytes([0xC1 | unused << 2, *checksum.to_bytes(2, "little"), *bytes(5)])]
    assert ask(b"\xa1") == []
    return whole


def block_download(
    ask: Ask,
    multiplexer: bytes,
    data: bytes,
    *,
    lost: Container[int] = (),
    with_crc: bool = True,
    announced: bool = True,
) -> bytes:
    """The abort, or nothing; the segments with the numbers ``lost``, from 1, arrive if they end a block."""
    size = (len(data) if announced else 0).to_bytes(4, "little")
    (answer,) = ask(bytes([0xC0 | 0x04 * with_crc | 0x02 * announced]) + multiplexer + size)
    if answer[0] == ABORT:
        return answer
    assert answer[:4] == bytes([0xA4 if with_crc else 0xA0]) + multiplexer
    parts, block, sent = segments(data), answer[4], 0
    while parts:
        assert 1 <= block <= 127
        count = min(block, len(parts))
        missing = [number for number in range(1, count) if sent + number in lost]
        for number, part in enumerate(parts[:count], 1):
            if number in missing:
                continue
            answers = ask(bytes([0x80 * (number == len(parts)) | number]) + part)
            if answers and answers[0][0] == ABORT:
                return answers[0]
            assert len(answers) == (number == count)
        acknowledged = missing[0] - 1 if missing else count
        assert answers[0][:2] == bytes([0xA2, acknowledged])
        parts, block, sent = parts[acknowledged:], answers[0][2], sent + count
    checksum = (crc(data) if with_crc else 0).to_bytes(2, "little")
    (answer,) = ask(bytes([0xC1 | (7 * len(segments(data)) - len(data)) << 2]) + checksum)
    assert answer[0] == ABORT or answer == b"\xa1" + bytes(7)
    return answer if answer[0] == ABORT else b""
