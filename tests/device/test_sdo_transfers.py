"""SDO transfers by segments and by block, of any size. What any device must do is in tests/conformance."""

from __future__ import annotations

import binascii
from pathlib import Path

import pytest
from device_kit import ID, OK, Bench
from hypothesis import example, given
from hypothesis import strategies as st

from canfb.cia301.codes import AbortCode
from canfb.device.od.dictionary import Dictionary
from canfb.device.sdo.transfer import BURST, DOWNLOAD_BLOCK, PAUSE_S
from drawing import examples

TABLE = "202000"


def abort(multiplexer: str, code: AbortCode) -> list[str]:
    return [f"80{multiplexer}" + code.to_bytes(4, "little").hex().upper()]


def content_of(size: int) -> bytes:
    return bytes((place * 31 + place // 256) & 0xFF for place in range(size))


def parts_of(data: bytes) -> list[bytes]:
    return [data[place : place + 7] for place in range(0, len(data), 7)] or [b""]


def upload_segments(bench: Bench) -> bytes:
    """Up to 4 bytes come with the answer."""
    first = bytes.fromhex(bench.sdo(f"40{TABLE}")[0])
    if first[0] & 0x02:
        return first[4 : 8 - (first[0] >> 2 & 3)]
    assert first[:4] == bytes.fromhex(f"41{TABLE}")
    size, data, toggle = int.from_bytes(first[4:], "little"), b"", 0
    while True:
        raw = bytes.fromhex(bench.sdo(f"{0x60 | toggle:02X}")[0])
        assert raw[0] & 0xF0 == toggle
        data += raw[1 : 8 - (raw[0] >> 1 & 7)]
        toggle ^= 0x10
        if raw[0] & 1:
            assert len(data) == size
            return data


def download_segments(bench: Bench, data: bytes, *, announce: bool = True) -> str:
    """The last answer."""
    size = len(data).to_bytes(4, "little").hex()
    assert bench.sdo(f"21{TABLE}{size}" if announce else f"20{TABLE}") == [f"60{TABLE}00000000"]
    parts = parts_of(data)
    for number, part in enumerate(parts):
        toggle, last = 0x10 * (number & 1), number == len(parts) - 1
        (answer,) = bench.sdo(bytes([toggle | (7 - len(part)) << 1 | last, *part]).hex())
        if answer[:2] != f"{0x20 | toggle:02X}":
            return answer
    return OK


def upload_block(bench: Bench, sizes: list[int], lost: dict[int, int], *, crc: bool) -> bytes:
    """By a client that asks for blocks of these sizes in turn, and loses all from a segment of a block on."""

    def sent(request: str) -> list[bytes]:
        """The answer, and the segments that the server sends after it, at its pace."""
        answers = bench.sdo(request)
        return [bytes.fromhex(text) for text in answers + [text.split("#")[1] for _, text in bench.run(0.9)]]

    (answer,) = sent(f"{0xA4 if crc else 0xA0:02X}{TABLE}{sizes[0]:02X}")
    assert answer[0] == (0xC6 if crc else 0xC2)
    size = int.from_bytes(answer[4:], "little")
    data, request, block, done = bytearray(), "A3", 0, False
    while not done:
        segments = sent(request)
        expected = min(sizes[block % len(sizes)], -(-max(size - len(data), 1) // 7))
        assert [segment[0] & 0x7F for segment in segments] == list(range(1, expected + 1))
        good = segments[: lost.get(block, 128) - 1]
        data += b"".join(segment[1:] for segment in good)
        done = bool(good and good[-1][0] & 0x80)
        block += 1
        request = f"A2{len(good):02X}{sizes[block % len(sizes)]:02X}"
    (end,) = sent(request)
    assert end[0] & 0xE3 == 0xC1
    whole = bytes(data[: len(data) - (end[0] >> 2 & 7)])
    assert int.from_bytes(end[1:3], "little") == (binascii.crc_hqx(whole, 0) if crc else 0)
    assert bench.sdo("A1") == []
    assert len(whole) == size
    return whole


def download_block(
    bench: Bench, data: bytes, lost: set[int], *, crc: bool = True, announce: bool = True
) -> str:
    """The last answer; of the frames with the numbers ``lost`` only those arrive that end a block."""
    first = 0xC0 | (0x02 if announce else 0) | (0x04 if crc else 0)
    size = (len(data) if announce else 0).to_bytes(4, "little").hex()
    (answer,) = bench.sdo(f"{first:02X}{TABLE}{size}")
    assert answer[:2] == ("A4" if crc else "A0")
    block, parts, frame = int(answer[8:10], 16), parts_of(data), 0
    while parts:
        count = min(block, len(parts))
        answers: list[str] = []
        for sequence, part in enumerate(parts[:count], 1):
            frame += 1
            if frame not in lost or sequence == count:
                last = 0x80 if sequence == len(parts) else 0
                answers += bench.sdo((bytes([last | sequence]) + part).hex())
        (answer,) = answers[:1]
        if answer[:2] == "80":
            return answer
        assert answer[:2] == "A2"
        parts, block = parts[int(answer[2:4], 16) :], int(answer[4:6], 16)
    checksum = binascii.crc_hqx(data, 0) if crc else 0
    (answer,) = bench.sdo(
        f"{0xC1 | -len(data) % 7 << 2 if data else 0xDD:02X}{checksum.to_bytes(2, 'little').hex()}"
    )
    return OK if answer == "A1" + "00" * 7 else answer


@pytest.fixture(scope="session")
def started(sample_path: Path) -> Bench:
    """One device for all examples."""
    bench = Bench(Dictionary.load(sample_path, ID))
    bench.start()
    return bench


SIZES = st.integers(0, 300) | st.sampled_from([0, 1, 6, 7, 8, 14, 888, 889, 890])


@given(
    SIZES,
    st.booleans(),
    st.lists(st.integers(1, 127), min_size=1, max_size=4),
    st.dictionaries(st.integers(0, 9), st.integers(1, 20)),
)
@example(16384, True, [127], {})
@examples(50)
def test_an_upload_gives_what_is_there(
    started: Bench, size: int, crc: bool, sizes: list[int], lost: dict[int, int]
) -> None:
    started.dictionary.entry(0x2020).value = content_of(size)
    assert upload_block(started, sizes, lost, crc=crc) == content_of(size)
    assert upload_segments(started) == content_of(size)
    assert started.node.deadline() is None


@given(SIZES, st.booleans(), st.booleans(), st.sets(st.integers(1, 150)))
@example(7 * DOWNLOAD_BLOCK, True, True, set())
@example(16384, True, False, {1, 32, 63})
@examples(50)
def test_a_download_arrives_whole(
    started: Bench, size: int, crc: bool, announce: bool, lost: set[int]
) -> None:
    data, entry = content_of(size), started.dictionary.entry(0x2020)
    for download in (
        lambda: download_segments(started, data, announce=announce),
        lambda: download_block(started, data, lost, crc=crc, announce=announce),
    ):
        entry.value = b"before"
        assert download() == OK
        assert entry.value == data
        assert started.node.deadline() is None


@given(st.lists(st.binary(min_size=8, max_size=8), max_size=60))
@examples(50)
def test_a_hostile_client_does_not_spoil_the_next_one(sample_path: Path, requests: list[bytes]) -> None:
    bench = Bench(Dictionary.load(sample_path, ID))
    bench.start()
    for request in [*requests, b"\x80" + bytes(7)]:
        bench.send(0x600 + ID, request)
    assert bench.read(0x1000) == 0x40191


def test_segments_are_paced(bench: Bench) -> None:
    bench.dictionary.entry(0x2020).value = content_of(700)
    bench.sdo(f"A0{TABLE}7F")
    assert len(bench.sdo("A3")) == BURST
    assert bench.node.deadline() == PAUSE_S
    times = [time for time, _ in bench.run(0.5)]
    assert len(times) == 100 - BURST
    assert times[-1] == pytest.approx(24 * PAUSE_S)


REFUSALS = {
    AbortCode.READ_ONLY: ("2108100010000000", "C208100010"),
    AbortCode.WRITE_ONLY: ("A022200014",),
    AbortCode.TOO_LONG: ("2117100003000000", "C217100003"),
    AbortCode.TOO_SHORT: ("2117100001000000", "C217100001"),
    AbortCode.OUT_OF_MEMORY: ("2120200001000100", "C220200001000100"),
    AbortCode.NO_OBJECT: ("40000500", "A004100014", "C204100010"),
    AbortCode.COMMAND: ("A1000000", "C1000000"),
}


@pytest.mark.parametrize("code", REFUSALS)
def test_refusals(bench: Bench, code: AbortCode) -> None:
    for number, request in enumerate(REFUSALS[code], 1):
        assert bench.sdo(request) == abort(request[2:8], code)
        assert bench.node.counters.sdo_aborts == number


@pytest.mark.parametrize(
    ("begin", "wrong", "code"),
    [
        ("40081000", "00", AbortCode.COMMAND),
        ("A008100014", "A1", AbortCode.COMMAND),
        ("A008100014", "A20114", AbortCode.COMMAND),
        ("2121200009000000", "10", AbortCode.TOGGLE),
        (f"C2{TABLE}0E", "00", AbortCode.SEQUENCE_NUMBER),
    ],
)
def test_a_command_out_of_turn_ends_the_transfer(
    bench: Bench, begin: str, wrong: str, code: AbortCode
) -> None:
    bench.sdo(begin)
    assert bench.sdo(wrong) == abort(begin[2:8], code)
    assert bench.sdo("60")[0].endswith("01000405")
    assert bench.dictionary.entry(0x2021).value == "text"


def test_the_buffer_is_bounded(bench: Bench) -> None:
    full = abort(TABLE, AbortCode.OUT_OF_MEMORY)[0]
    assert download_segments(bench, bytes(70000), announce=False) == full
    assert download_block(bench, bytes(70000), set(), announce=False) == full


def test_the_upload_is_a_snapshot(bench: Bench) -> None:
    bench.dictionary.entry(0x2026).value = 0x0807060504030201
    bench.sdo("40262000")
    bench.dictionary.entry(0x2026).value = 0
    assert bench.sdo("60") == ["0001020304050607"]
    assert bench.sdo("70") == ["1D08000000000000"]


def test_a_raising_program_leaves_the_server_usable(bench: Bench) -> None:
    def broken(value: int) -> None:
        raise RuntimeError("a mistake in the program")

    bench.dictionary.entry(0x2025).on_check = broken
    with pytest.raises(RuntimeError):
        bench.sdo("2F25200009")
    assert bench.read(0x1000) == 0x40191


def test_expedited_text_without_a_size(bench: Bench) -> None:
    assert bench.sdo("2221200061626364") == ["6021200000000000"]
    assert bench.dictionary.entry(0x2021).value == "abcd"
