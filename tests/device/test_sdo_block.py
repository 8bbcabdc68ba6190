"""SDO block transfers. What any device must do is in tests/conformance."""

from __future__ import annotations

import binascii

import pytest
from device_kit import ID, OK, Bench

from canfb.cia301.codes import AbortCode
from canfb.device.sdo.block import BURST, DOWNLOAD_BLOCK, PAUSE_S, crc16

TABLE = "202000"


def abort(multiplexer: str, code: AbortCode) -> list[str]:
    return [f"80{multiplexer}" + code.to_bytes(4, "little").hex().upper()]


def content_of(size: int) -> bytes:
    return bytes((place * 31 + place // 256) & 0xFF for place in range(size))


def sent_by(bench: Bench, request: str, channel: int = 0x600 + ID) -> list[bytes]:
    """The answer with all segments that follow it."""
    frames = bench.sdo(request, channel)
    frames += [text.split("#")[1] for _, text in bench.run(0.9)]
    return [bytes.fromhex(text) for text in frames]


class Uploader:
    """A client that loses the segments it is told to lose."""

    def __init__(self, bench: Bench, multiplexer: str = TABLE, *, crc: bool = True) -> None:
        self.bench = bench
        self.multiplexer = multiplexer
        self.crc = crc
        self.data = bytearray()

    def run(self, sizes: list[int], lost: dict[int, int] | None = None) -> bytes:
        """Upload with these block sizes in turn; `lost` is which segment of which block is lost."""
        lost = lost or {}
        first = f"{0xA4 if self.crc else 0xA0:02X}{self.multiplexer}{sizes[0]:02X}"
        (answer,) = sent_by(self.bench, first)
        assert answer[0] == (0xC6 if self.crc else 0xC2)
        size = int.from_bytes(answer[4:], "little")
        request, block, done = "A3", 0, False
        while not done:
            segments = sent_by(self.bench, request)
            expected = min(sizes[block % len(sizes)], -(-max(size - len(self.data), 1) // 7))
            assert [segment[0] & 0x7F for segment in segments] == list(range(1, expected + 1))
            good = segments[: lost[block] - 1] if block in lost else segments
            for segment in good:
                self.data += segment[1:]
                done = bool(segment[0] & 0x80)
            block += 1
            request = f"A2{len(good):02X}{sizes[block % len(sizes)]:02X}"
        (end,) = sent_by(self.bench, request)
        assert end[0] & 0xE3 == 0xC1
        unused = end[0] >> 2 & 7
        data = bytes(self.data[: len(self.data) - unused])
        assert int.from_bytes(end[1:3], "little") == (crc16(data) if self.crc else 0)
        assert self.bench.sdo("A1") == []
        assert self.bench.node.deadline() is None
        assert len(data) == size
        return data


def download(
    bench: Bench,
    data: bytes,
    *,
    multiplexer: str = TABLE,
    crc: int | None = None,
    announced: int | None = -1,
    lost: set[int] = frozenset(),  # type: ignore[assignment]
) -> str:
    """A block download; `lost` are the numbers of frames that do not arrive. The last answer."""
    announced = len(data) if announced == -1 else announced
    first = 0xC0 | (0x02 if announced is not None else 0) | (0x04 if crc is not None else 0)
    size = (announced or 0).to_bytes(4, "little").hex()
    (answer,) = bench.sdo(f"{first:02X}{multiplexer}{size}")
    if answer[:2] == "80":
        return answer
    assert answer[:2] == ("A0" if crc is None else "A4")
    block = int(answer[8:10], 16)
    parts = [data[place : place + 7] for place in range(0, len(data), 7)] or [b""]
    position = frame = 0
    while position < len(parts):
        count = min(block, len(parts) - position)
        answers: list[str] = []
        for sequence in range(1, count + 1):
            last = 0x80 if position + sequence == len(parts) else 0
            frame += 1
            if frame not in lost:
                segment = bytes([last | sequence]) + parts[position + sequence - 1]
                answers += bench.sdo(segment.hex())
        if answers[0][:2] == "80":
            return answers[0]
        (answer,) = answers
        assert answer[:2] == "A2"
        position += int(answer[2:4], 16)
        block = int(answer[4:6], 16)
    unused = 7 - len(parts[-1])
    (answer,) = bench.sdo(f"{0xC1 | unused << 2:02X}" + (crc or 0).to_bytes(2, "little").hex())
    return OK if answer == "A1" + "00" * 7 else answer


def test_the_crc() -> None:
    assert crc16(b"123456789") == 0x31C3
    assert crc16(b"") == 0


@pytest.mark.parametrize("size", [0, 1, 6, 7, 8, 14, 888, 889, 890, 16384])
@pytest.mark.parametrize("crc", [False, True])
def test_upload_of_any_size(bench: Bench, size: int, crc: bool) -> None:
    bench.dictionary.entry(0x2020).value = content_of(size)
    assert Uploader(bench, crc=crc).run([127]) == content_of(size)


@pytest.mark.parametrize("sizes", [[1], [2], [127, 1], [5, 9, 3]])
def test_upload_with_changing_block_sizes(bench: Bench, sizes: list[int]) -> None:
    bench.dictionary.entry(0x2020).value = content_of(500)
    assert Uploader(bench).run(sizes) == content_of(500)


@pytest.mark.parametrize("lost", [{0: 1}, {0: 4}, {0: 10}, {2: 3, 3: 1, 4: 2}, {0: 1, 1: 1}])
def test_upload_with_lost_segments(bench: Bench, lost: dict[int, int]) -> None:
    bench.dictionary.entry(0x2020).value = content_of(300)
    assert Uploader(bench).run([10, 7], lost) == content_of(300)


def test_segments_are_paced(bench: Bench) -> None:
    bench.dictionary.entry(0x2020).value = content_of(700)
    bench.sdo(f"A0{TABLE}7F")
    assert len(bench.sdo("A3")) == BURST
    assert bench.node.deadline() == PAUSE_S
    times = [time for time, _ in bench.run(0.5)]
    assert len(times) == 100 - BURST
    assert times[-1] == pytest.approx(24 * PAUSE_S)


@pytest.mark.parametrize("early", ["A1", "A20114"])
def test_out_of_turn(bench: Bench, early: str) -> None:
    bench.sdo("A008100014")
    assert bench.sdo(early) == abort("081000", AbortCode.COMMAND)
    assert bench.sdo(early)[0].endswith("01000405")


@pytest.mark.parametrize(
    ("request_", "multiplexer", "code"),
    [
        ("A022200014", "222000", AbortCode.WRITE_ONLY),
        ("A004100014", "041000", AbortCode.NO_OBJECT),
        ("C208100010", "081000", AbortCode.READ_ONLY),
        ("C204100010", "041000", AbortCode.NO_OBJECT),
        ("C217100003", "171000", AbortCode.TOO_LONG),
        ("C217100001", "171000", AbortCode.TOO_SHORT),
        ("C220200001000100", "202000", AbortCode.OUT_OF_MEMORY),
        ("A1", "000000", AbortCode.COMMAND),
        ("C1", "000000", AbortCode.COMMAND),
    ],
)
def test_refusals(bench: Bench, request_: str, multiplexer: str, code: AbortCode) -> None:
    assert bench.sdo(request_) == abort(multiplexer, code)


@pytest.mark.parametrize("size", [0, 1, 7, 8, 7 * DOWNLOAD_BLOCK, 7 * DOWNLOAD_BLOCK + 1, 16384])
@pytest.mark.parametrize("crc", [False, True])
@pytest.mark.parametrize("announce", [False, True])
def test_download_of_any_size(bench: Bench, size: int, crc: bool, announce: bool) -> None:
    data = content_of(size)
    given = binascii.crc_hqx(data, 0) if crc else None
    assert download(bench, data, crc=given, announced=-1 if announce else None) == OK
    assert bench.dictionary.entry(0x2020).value == data
    assert bench.node.deadline() is None


@pytest.mark.parametrize("lost", [{1}, {3}, {30}, {1, 32, 63}, {5, 6, 7}, {40, 66, 67}, set(range(2, 31))])
def test_download_with_lost_segments(bench: Bench, lost: set[int]) -> None:
    data = content_of(600)
    assert download(bench, data, crc=crc16(data), lost=lost) == OK
    assert bench.dictionary.entry(0x2020).value == data


def test_a_gap_frame_by_frame(bench: Bench) -> None:
    block = f"{DOWNLOAD_BLOCK:02X}0000000000"
    bench.sdo(f"C2{TABLE}1C")
    data = content_of(28)
    frames = [data[place : place + 7].hex() for place in range(0, 28, 7)]
    assert bench.sdo("01" + frames[0]) == []
    assert bench.sdo("02" + frames[1]) == []
    assert bench.sdo("84" + frames[3]) == [f"A202{block}"]
    assert bench.sdo("01" + frames[2]) == []
    assert bench.sdo("82" + frames[3]) == [f"A202{block}"]
    assert bench.sdo("C1") == ["A100000000000000"]
    assert bench.dictionary.entry(0x2020).value == data


def test_the_buffer_is_bounded(bench: Bench) -> None:
    answer = download(bench, bytes(70000), announced=None)
    assert answer == abort(TABLE, AbortCode.OUT_OF_MEMORY)[0]


def test_sequence_number_zero(bench: Bench) -> None:
    bench.sdo(f"C2{TABLE}0E")
    assert bench.sdo("00") == abort(TABLE, AbortCode.SEQUENCE_NUMBER)
