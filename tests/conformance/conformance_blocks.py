"""Whole block transfers of a tester, raw."""

from __future__ import annotations

from collections.abc import Iterator

from conformance_kit import Tester, crc, filled, hexes, little


def segments(data: bytes) -> Iterator[bytes]:
    for start in range(0, max(len(data), 1), 7):
        yield data[start : start + 7]


def begin_upload(tester: Tester, multiplexer: str, block_size: int = 0x14, *, with_crc: bool = False) -> int:
    """The first frame of a block upload; the size of the object."""
    command, answer = ("A4", "C6") if with_crc else ("A0", "C2")
    got = tester.ask(f"{command} {multiplexer} {block_size:02X} 00")
    assert got[:11] in (
        {f"{answer} {multiplexer}"} if with_crc else {f"C2 {multiplexer}", f"C6 {multiplexer}"}
    )
    return int.from_bytes(bytes.fromhex(got[12:]), "little")


def block_upload(
    tester: Tester, multiplexer: str, *, block_size: int = 0x14, with_crc: bool = False
) -> tuple[bytes, str]:
    """A whole object, and the frame at the end."""
    size = begin_upload(tester, multiplexer, block_size, with_crc=with_crc)
    data = b""
    answers = tester.sdo("A3", wait=0.2)
    while True:
        assert 1 <= len(answers) <= block_size
        raw = [bytes.fromhex(answer) for answer in answers]
        assert [frame[0] & 0x7F for frame in raw] == list(range(1, len(raw) + 1))
        assert not any(frame[0] & 0x80 for frame in raw[:-1])
        data += b"".join(frame[1:] for frame in raw)
        answers = tester.sdo(f"A2 {len(raw):02X} {block_size:02X}", wait=0.2)
        if raw[-1][0] & 0x80:
            break
    (end,) = answers
    assert bytes.fromhex(end)[0] & 0xE3 == 0xC1
    unused = bytes.fromhex(end)[0] >> 2 & 7
    assert tester.sdo("A1", wait=0.2) == []
    data = data[: len(data) - unused]
    assert len(data) == size
    return data, end


def begin_download(
    tester: Tester, multiplexer: str, size: int | None, *, with_crc: bool = True
) -> tuple[str, int]:
    """The first frame of a block download: the answer and the block size."""
    command = 0xC0 | (4 if with_crc else 0) | (0 if size is None else 2)
    answer = tester.ask(f"{command:02X} {multiplexer} {little(size or 0, 4)}")
    return answer, int(answer[12:14], 16)


def end_frame(data: bytes, *, with_crc: bool = True) -> str:
    unused = -len(data) % 7 if data else 7
    return f"{0xC1 | unused << 2:02X} {little(crc(data) if with_crc else 0, 2)}"


def block_download(tester: Tester, multiplexer: str, data: bytes, *, with_crc: bool = True) -> str:
    """The last answer of a whole block download; "ok" when all went well."""
    answer, block_size = begin_download(tester, multiplexer, len(data), with_crc=with_crc)
    if answer[:11] not in (f"A0 {multiplexer}", f"A4 {multiplexer}"):
        return answer
    parts = list(segments(data))
    while parts:
        block, parts = parts[:block_size], parts[block_size:]
        for sequence, part in enumerate(block, 1):
            last = 0x80 if not parts and sequence == len(block) else 0
            answers = tester.sdo(f"{last | sequence:02X} {hexes(part)}")
            assert len(answers) == (sequence == len(block)), answers
        (answer,) = answers
        assert answer[:5] == f"A2 {len(block):02X}"
        block_size = int(answer[6:8], 16)
    answer = tester.ask(end_frame(data, with_crc=with_crc))
    return "ok" if answer == filled("A1") else answer
