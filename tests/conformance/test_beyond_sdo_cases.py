"""Beyond 01 to 10: what an SDO server does with clients that go wrong."""

import struct

import pytest
from conformance_kit import HEARTBEAT, NAME, Tester, filled, hexes, little, only

from sdo_client import crc

EDS_FILE, TABLE = "21 10 00", "20 20 01"
ANY_SEGMENT = "05040001"
IDENTITY = b"".join(struct.pack("<f", n / 128) for n in range(128))
"""512 bytes for 2020h:01: several blocks."""


def is_idle(tester: Tester, segment: str = "60") -> None:
    """The server waits for nothing, and serves the next request."""
    tester.aborted(tester.ask(segment), None, ANY_SEGMENT)
    assert tester.upload(NAME) == tester.name


@pytest.mark.parametrize("length", range(8))
def test_beyond_01_short_requests_are_ignored(tester: Tester, length: int) -> None:
    request = bytes.fromhex(filled("2B 17 10 00 64"))[:length]
    assert only(tester.send(0x600 + tester.id, hexes(request)), 0x580 + tester.id) == []
    assert tester.read(0x1017) == 0
    tester.ask(f"40 {NAME}")
    first = tester.ask("60")
    assert tester.send(0x600 + tester.id, hexes(bytes.fromhex(filled("70"))[:length])) == []
    second = tester.ask("70")
    assert (bytes.fromhex(first)[1:] + bytes.fromhex(second)[1:]) == tester.name[:14]


@pytest.mark.parametrize("segment", ["60", "70", "00 11 22 33 44 55 66 77", "0B E8 03", "1B E8 03"])
def test_beyond_02_a_segment_without_a_transfer(tester: Tester, segment: str) -> None:
    is_idle(tester, segment)


def test_beyond_02_an_abort_without_a_transfer(tester: Tester) -> None:
    assert tester.sdo("80 17 10 00 00 00 04 05", wait=2.0) == []
    assert tester.upload(NAME) == tester.name


# The object of a transfer; its first request, the second one, how long its answers take, and how they begin.
STARTS: dict[str, tuple[str, str, str, float, list[str]]] = {
    "segmented upload": (NAME, "40 {}", "60", 0.0, [""]),
    "segmented download": (HEARTBEAT, "21 {} 02", "", 0.0, []),
    "block download": (HEARTBEAT, "C6 {} 02", "", 0.0, []),
    "end of a block download": (HEARTBEAT, "C6 {} 02", "81 E8 03", 0.0, ["A2 01"]),
    "block upload": (EDS_FILE, "A0 {} 7F", "", 0.0, []),
    "amid a block of an upload": (EDS_FILE, "A0 {} 7F", "A3", 0.0, [""]),  # the server is still sending
    "end of a block of an upload": (EDS_FILE, "A0 {} 04", "A3", 0.2, [""] * 4),
}


def begin(tester: Tester, start: str) -> str:
    multiplexer, first, second, wait_s, begins = STARTS[start]
    assert tester.ask(first.format(multiplexer))[3:11] == multiplexer
    if second:
        answers = tester.sdo(second, wait_s)
        assert len(answers) == len(begins) or "amid" in start
        assert [answer[: len(one)] for answer, one in zip(answers, begins, strict=False)] == begins
    return multiplexer


@pytest.mark.parametrize("start", STARTS)
def test_beyond_03_abort_by_the_client(tester: Tester, start: str) -> None:
    multiplexer = begin(tester, start)
    assert tester.sdo(f"80 {multiplexer} 00 00 04 05") == []
    assert tester.wait(5.0) == []
    assert tester.read(0x1017) == 0
    is_idle(tester)


@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("request_", ["40 00 10 00", "2B 17 10 00 E8 03", "40 08 10 00", "A4 08 10 00 14"])
def test_beyond_03_a_new_request_amid_a_transfer(tester: Tester, start: str, request_: str) -> None:
    begin(tester, start)
    answer = tester.sdo(request_)[-1]
    served = answer[3:11] == request_[3:11] and answer[:2] != "80"
    if not served:
        tester.aborted(answer, None, ANY_SEGMENT)
    tester.sdo("80", wait=3.0)
    is_idle(tester)


def test_beyond_04_lost_segments_are_sent_again(module: Tester) -> None:
    for lost in ({1}, {3}, {72}, {2, 33, 34, 35, 70}):  # of 74, in blocks of 31
        assert module.block_download(TABLE, IDENTITY, lost=lost) == "ok"
    checksum = module.read(0x2020, 2)
    module.write(0x2020, 3, checksum, 4)
    assert module.block_upload(TABLE) == IDENTITY


def test_beyond_05_wrong_crc(tester: Tester) -> None:
    tester.begin_block_download(HEARTBEAT, 2)
    tester.ask("81 E8 03")
    wrong = crc(bytes.fromhex("E8 03")) ^ 0x0001
    tester.aborted(tester.ask(f"D5 {little(wrong, 2)}"), HEARTBEAT, "05040004")
    assert tester.read(0x1017) == 0


LONG, SHORT = ("06070010", "06070012"), ("06070010", "06070013")


@pytest.mark.parametrize(("announced", "data", "codes"), [
    (3, "E8 03 00", LONG), (1, "E8", SHORT), (2, "E8 03 00", LONG), (2, "E8", SHORT),
    (None, "E8 03 00", LONG), (None, "E8", SHORT),
])  # fmt: skip
def test_beyond_05_wrong_sizes(
    tester: Tester, announced: int | None, data: str, codes: tuple[str, ...]
) -> None:
    raw = bytes.fromhex(data)
    # segmented
    first = "20" if announced is None else "21"
    answer = tester.ask(f"{first} {HEARTBEAT} {little(announced or 0, 4)}")
    if answer[:2] == "60":
        answer = tester.ask(f"{(7 - len(raw)) << 1 | 1:02X} {data}")
    tester.aborted(answer, HEARTBEAT, *codes)
    # by block
    answer = tester.begin_block_download(HEARTBEAT, announced)
    if answer[:2] != "80":
        answer = tester.ask(f"81 {data}")
    if answer[:2] != "80":
        unused = 7 - len(raw)
        answer = tester.ask(f"{0xC1 | unused << 2:02X} {little(crc(raw), 2)}")
    tester.aborted(answer, HEARTBEAT, *codes)
    assert tester.read(0x1017) == 0
    is_idle(tester)


def test_beyond_06_segments_after_a_gap_are_sent_again(tester: Tester) -> None:
    sizes, lost = [10, 3, 127, 64], {0: 10, 1: 2, 2: 1, 5: 3, 10: 126}
    assert tester.block_upload(EDS_FILE, sizes=sizes, lost=lost) == tester.upload(EDS_FILE)


@pytest.mark.parametrize("size", ["00", "80", "FF"])
def test_beyond_06_another_block_size_out_of_range(tester: Tester, size: str) -> None:
    tester.begin_block_upload(EDS_FILE, 4)
    tester.sdo("A3", wait=0.2)
    tester.aborted(tester.ask(f"A2 04 {size}"), EDS_FILE, "05040002")
    is_idle(tester)


@pytest.mark.parametrize("threshold", [0, 1, 4, 20, 255])
def test_beyond_07_protocol_switch_threshold(tester: Tester, threshold: int) -> None:
    for multiplexer, size in (("00 10 00", 4), (NAME, len(tester.name))):
        answer = tester.ask(f"A4 {multiplexer} 14 {threshold:02X}")
        if size > threshold:
            assert answer == filled(f"C6 {multiplexer} {little(size, 4)}")
        else:
            assert answer[:2] in ("C6", "43", "41")
        if answer[:2] == "41":
            assert tester.ask("60")[:2] == "00"
        tester.sdo("80")
    is_idle(tester)


@pytest.mark.parametrize("start", STARTS)
def test_beyond_08_a_silent_client(tester: Tester, start: str) -> None:
    multiplexer = begin(tester, start)
    heard = only(tester.wait(30.0), 0x580 + tester.id)
    aborts = [data for data in heard if data[:11] == f"80 {multiplexer}"]
    assert aborts == [f"80 {multiplexer} 00 00 04 05"]
    assert heard[-1] == aborts[0]
    for late in ("60", "0B E8 03"):
        tester.aborted(tester.ask(late), None, ANY_SEGMENT)
    assert tester.read(0x1017) == 0
    is_idle(tester)


def test_beyond_09_two_servers_at_the_same_time(module: Tester) -> None:
    module.second_server()
    second = module.ask_second
    # a segmented upload on the first, a block download and then a segmented upload on the second
    assert module.ask(f"40 {NAME}")[:2] == "41"
    assert second(f"C6 {HEARTBEAT} 02")[0][:11] == f"A4 {HEARTBEAT}"
    assert module.ask("60")[:2] == "00"
    assert second("81 E8 03")[0][:5] == "A2 01"
    assert module.ask("70")[:2] == "10"
    assert second(f"D5 {little(crc(bytes.fromhex('E8 03')), 2)}") == [filled("A1")]
    assert second(f"40 {NAME}")[0][:2] == "41"
    got: dict[int, bytes] = {0: module.name[:14], 1: b""}
    toggles = {0: 0x00, 1: 0x00}
    while len(got[1]) < len(module.name):
        for client, ask in enumerate((module.sdo, second)):
            if len(got[client]) < len(module.name):
                (answer,) = ask(f"{0x60 | toggles[client]:02X}")
                raw = bytes.fromhex(answer)
                assert raw[0] & 0xF0 == toggles[client]
                got[client] += raw[1 : 8 - (raw[0] >> 1 & 7)]
                toggles[client] ^= 0x10
    assert got == {0: module.name, 1: module.name}
    assert module.read(0x1017) == 1000


def test_beyond_09_a_time_out_of_one_leaves_the_other_alone(module: Tester) -> None:
    module.second_server()
    module.ask_second(f"40 {NAME}")
    module.ask(f"40 {NAME}")
    toggle, heard = 0, []
    for _ in range(3):
        heard += module.wait(0.5)
        assert module.ask(f"{0x60 | toggle:02X}")[:2] == f"{toggle:02X}"
        toggle ^= 0x10
    assert only(heard, 0x540) == [f"80 {NAME} 00 00 04 05"]
    assert only(heard, 0x5A0) == []


@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("command", ["81", "82", "02"])
def test_beyond_10_reset_or_stop_amid_a_transfer(tester: Tester, start: str, command: str) -> None:
    begin(tester, start)
    heard = tester.nmt(command) + tester.wait(5.0)
    assert only(heard, 0x580 + tester.id) == []
    if command == "02":
        assert tester.sdo("81 E8 03", wait=2.0) == []
        tester.nmt("80")
    assert tester.read(0x1017) == 0
    is_idle(tester)
