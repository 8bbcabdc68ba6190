"""SDO transfers by segments and by block, of any size. What any device must do is in tests/conformance,
and hostile clients are in tests/tools/test_fuzz.py.
"""

from functools import partial
from pathlib import Path

import pytest
from device_kit import ID, Bench
from hypothesis import example, given, strategies as st

from canfb.cia301.codes import AbortCode
from canfb.device.od.dictionary import Dictionary
from canfb.device.sdo.transfer import BURST, DOWNLOAD_BLOCK, PAUSE_S
from drawing import examples
from sdo_client import Ask, block_download, block_upload, download, upload

TABLE = "202000"
PLACE = bytes.fromhex(TABLE)


def abort(multiplexer: str, code: AbortCode) -> list[str]:
    return [f"80{multiplexer}" + code.to_bytes(4, "little").hex().upper()]


def content_of(size: int) -> bytes:
    return bytes((place * 31 + place // 256) & 0xFF for place in range(size))


def asking(bench: Bench) -> Ask:
    """A client that hears what the server sends of itself before it goes on."""

    def ask(request: bytes) -> list[bytes]:
        answers = bench.sdo(request.hex()) + [text.split("#")[1] for _, text in bench.run(0.9)]
        return [bytes.fromhex(answer) for answer in answers]

    return ask


@pytest.fixture(scope="session")
def started(sample_path: Path) -> Bench:
    """One device for all examples."""
    bench = Bench(Dictionary.load(sample_path, ID))
    bench.start()
    return bench


SIZES = st.integers(0, 300) | st.sampled_from([0, 1, 6, 7, 8, 14, 888, 889, 890])
LOST = st.dictionaries(st.integers(0, 9), st.integers(1, 20))


@given(SIZES, st.booleans(), st.lists(st.integers(1, 127), min_size=1, max_size=4), LOST)
@example(16384, True, [127], {})
@example(0, True, [5], {0: 1})
@examples(50)
def test_an_upload_gives_what_is_there(
    started: Bench, size: int, crc: bool, sizes: list[int], lost: dict[int, int]
) -> None:
    started.dictionary.entry(0x2020).value = content_of(size)
    ask = asking(started)
    assert block_upload(ask, PLACE, sizes=sizes, lost=lost, with_crc=crc) == content_of(size)
    assert upload(ask, PLACE) == content_of(size)
    assert started.node.deadline() is None


@given(SIZES, st.booleans(), st.booleans(), st.sets(st.integers(1, 150)))
@example(7 * DOWNLOAD_BLOCK, True, True, set())
@example(16384, True, False, {1, 32, 63})
@examples(50)
def test_a_download_arrives_whole(
    started: Bench, size: int, crc: bool, announced: bool, lost: set[int]
) -> None:
    data, entry, ask = content_of(size), started.dictionary.entry(0x2020), asking(started)
    for transfer in (download, partial(block_download, lost=lost, with_crc=crc)):
        entry.value = b"before"
        assert transfer(ask, PLACE, data, announced=announced) == b""
        assert entry.value == data
        assert started.node.deadline() is None


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
        bench.sdo("40262000")  # a transfer that the request gives up
        assert bench.sdo(request) == abort(request[2:8], code)
        assert bench.node.counters.sdo_aborts == number


@pytest.mark.parametrize(("begin", "wrong", "code"), [
    ("40081000", "00", AbortCode.COMMAND),
    ("A008100014", "A1", AbortCode.COMMAND),
    ("A008100014", "A20114", AbortCode.COMMAND),
    ("2121200009000000", "10", AbortCode.TOGGLE),
    ("2121200005000000", "0B6162", AbortCode.TOO_SHORT),
    ("2121200005000000", "0061626364656667", AbortCode.TOO_LONG),
    ("2121200000000000", "0061626364656667", AbortCode.TOO_LONG),
    (f"C2{TABLE}0E", "00", AbortCode.SEQUENCE_NUMBER),
])  # fmt: skip
def test_what_ends_a_transfer(bench: Bench, begin: str, wrong: str, code: AbortCode) -> None:
    bench.sdo(begin)
    assert bench.sdo(wrong) == abort(begin[2:8], code)
    assert bench.sdo("60")[0].endswith("01000405")
    assert bench.dictionary.entry(0x2021).value == "text"


def test_the_buffer_is_bounded(bench: Bench) -> None:
    for transfer in (download, block_download):
        answer = transfer(asking(bench), PLACE, bytes(70000), announced=False)
        assert [answer.hex().upper()] == abort(TABLE, AbortCode.OUT_OF_MEMORY)


def test_the_upload_is_a_snapshot(bench: Bench) -> None:
    bench.dictionary.entry(0x2026).value = 0x0807060504030201
    bench.sdo("40262000")
    bench.dictionary.entry(0x2026).value = 0
    assert bench.sdo("60") == ["0001020304050607"]
    assert bench.sdo("70") == ["1D08000000000000"]
    assert bench.sdo("A02620007F08") == ["4126200008000000"]  # short enough for segments
    assert bench.nmt(2) == bench.nmt(128) == []
    assert bench.sdo("60")[0].endswith("01000405")  # STOPPED has given it up


def test_a_raising_program_leaves_the_server_usable(bench: Bench) -> None:
    def broken(value: int) -> None:
        raise RuntimeError("a mistake in the program")

    bench.dictionary.entry(0x2025).on_check = broken
    with pytest.raises(RuntimeError):
        bench.sdo("2F25200009")
    assert bench.read(0x1000) == 0x40191


def test_expedited_without_a_size(bench: Bench) -> None:
    assert bench.sdo("2221200061626364") == ["6021200000000000"]
    assert bench.dictionary.entry(0x2021).value == "abcd"
    assert bench.sdo("220C1000E8030000") == ["600C100000000000"]  # two bytes of it
    assert bench.read(0x100C) == 1000
