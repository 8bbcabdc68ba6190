"""SDO 01 to SDO 30."""

from __future__ import annotations

import pytest
from conformance_blocks import begin_download, begin_upload, block_upload
from conformance_kit import (
    COMMAND,
    NO_INDEX,
    NO_READ,
    NO_SUB,
    NO_WRITE,
    SAVE,
    G,
    Tester,
    crc,
    filled,
    little,
    m,
)

NAME = "08 10 00"  # 1008h: longer than 4 bytes
HEARTBEAT = "17 10 00"
GUARD_TIME = "0C 10 00"


def the_name(tester: Tester) -> bytes:
    return tester.eds[0x1008, 0].default.encode()


def test_crc_of_the_tester_itself() -> None:
    assert crc(b"123456789") == 0x31C3


def test_sdo_01_read_device_type(tester: Tester) -> None:
    device_type = tester.eds[0x1000, 0].raw(tester.eds[0x1000, 0].default)
    assert tester.ask("40 00 10 00") == "43 00 10 00 " + device_type.hex(" ").upper()


def test_sdo_02_read_and_write_back(tester: Tester) -> None:
    answer = tester.ask("40 17 10 00")
    assert answer[:11] == "4B 17 10 00"
    tester.accept("2B 17 10 00 " + answer[12:17])


def test_sdo_03_write_a_read_only_entry(tester: Tester) -> None:
    before = tester.ask("40 00 10 00")
    tester.refuse("23 00 10 00 " + before[12:], *NO_WRITE)
    assert tester.ask("40 00 10 00") == before


def test_sdo_04_read_a_write_only_entry(tester: Tester) -> None:
    entries = [entry for entry in tester.eds.entries.values() if entry.access == "wo"]
    assert entries
    for entry in entries:
        tester.refuse(f"40 {entry.m}", *NO_READ)


def test_sdo_05_no_such_subindex(tester: Tester) -> None:
    tester.refuse("40 00 10 01", *NO_SUB)


def test_sdo_06_no_such_index(tester: Tester) -> None:
    assert not tester.eds.has(0x1004)
    tester.refuse("40 04 10 00", *NO_INDEX)


def test_sdo_07_unknown_command_specifier(tester: Tester) -> None:
    tester.aborted(tester.ask("E0 00 10 00 00 00 00 00"), None, *COMMAND)


def test_sdo_08_too_many_bytes(tester: Tester) -> None:
    tester.refuse("23 03 10 00", "06070010", "06070012", G)
    tester.refuse("23 17 10 00", "06070010", "06070012", G)


def test_sdo_09_too_few_bytes(tester: Tester) -> None:
    tester.refuse("2F 05 10 00 80", "06070010", "06070013", G)
    tester.refuse("2F 17 10 00 80", "06070010", "06070013", G)


def test_sdo_10_above_the_maximum(tester: Tester) -> None:
    tester.refuse("2F 03 10 00 FF", "06090030", "06090031", G)
    tester.refuse("2F 03 10 00 01", "06090030")  # CiA 301, 7.5.2.4: this code, and no maximum in the EDS


def test_sdo_11_below_the_minimum(tester: Tester) -> None:
    # an unsigned entry with a LowLimit above zero
    entries = [e for e in tester.eds.entries.values() if e.writable and e.low and e.integer(e.low) > 0]
    assert entries
    for entry in entries:
        before = tester.upload(entry.m)
        request = tester.download(entry.index, entry.sub, entry.integer(entry.low) - 1, entry.size)
        tester.refuse(request, "06090030", "06090032", G)
        assert tester.upload(entry.m) == before


def test_sdo_12_the_channel_of_the_server(tester: Tester) -> None:
    assert tester.ask("40 00 12 01") == "43 00 12 01 " + little(0x600 + tester.id, 4)
    assert tester.ask("40 00 12 02") == "43 00 12 02 " + little(0x580 + tester.id, 4)


def test_sdo_13_upload_with_a_client_ready_for_segments(tester: Tester) -> None:
    entry = tester.eds[0x1000, 0]
    assert tester.upload("00 10 00") == entry.raw(entry.default)


GUARD_TIME_AND_HEARTBEAT = pytest.mark.parametrize(
    ("multiplexer", "value"), [(GUARD_TIME, "E8 03"), (HEARTBEAT, "10 27")]
)


@GUARD_TIME_AND_HEARTBEAT
def test_sdo_14_and_15_segmented_download(tester: Tester, multiplexer: str, value: str) -> None:
    tester.accept(f"21 {multiplexer} 02")
    assert tester.ask(f"0B {value}") == filled("20")
    assert tester.ask(f"40 {multiplexer}") == filled(f"4B {multiplexer} {value}")


def test_sdo_16_segmented_upload(tester: Tester) -> None:
    data = the_name(tester)
    assert tester.ask(f"40 {NAME}") == filled(f"41 {NAME} {little(len(data), 4)}")
    toggle, got = 0, b""
    while len(got) < len(data):
        answer = bytes.fromhex(tester.ask(f"{0x60 | toggle:02X}"))
        unused = max(0, 7 - (len(data) - len(got)))
        last = len(data) - len(got) <= 7
        assert answer[0] == toggle | unused << 1 | last
        assert answer[8 - unused :] == bytes(unused)
        got += answer[1 : 8 - unused]
        toggle ^= 0x10
    assert got == data
    # the transfer is over: a further request belongs to none
    tester.aborted(tester.ask(f"{0x60 | toggle:02X}"), None, "05040001")


def test_sdo_17_wrong_toggle_bit(tester: Tester) -> None:
    tester.ask(f"40 {NAME}")
    tester.aborted(tester.ask("70"), NAME, "05030000")
    assert tester.upload(NAME) == the_name(tester)


def test_sdo_18_segmented_upload_to_the_end(tester: Tester) -> None:
    assert tester.upload(NAME) == the_name(tester)


def test_sdo_19_block_upload_of_four_bytes(tester: Tester) -> None:
    entry = tester.eds[0x1000, 0]
    assert tester.ask("A0 00 10 00 14 00")[3:] == filled("C2 00 10 00 04")[3:]
    value = entry.raw(entry.default).hex(" ").upper()
    assert tester.sdo("A3", wait=0.2) == [filled(f"81 {value}")]
    assert tester.ask("A2 01 14") == filled("CD 00 00")
    assert tester.sdo("A1", wait=2.0) == []


def block_download_of_two(tester: Tester, multiplexer: str, value: str, *, with_crc: bool) -> None:
    command, answer = ("C6", "A4") if with_crc else ("C2", "A0")
    first = tester.ask(f"{command} {multiplexer} 02")
    assert first[:11] in (f"{answer} {multiplexer}", f"A4 {multiplexer}")
    assert 1 <= int(first[12:14], 16) <= 127
    second = tester.ask(f"81 {value}")
    assert second[:5] == "A2 01"
    assert 1 <= int(second[6:8], 16) <= 127
    checksum = little(crc(bytes.fromhex(value)), 2) if with_crc else "00 00"
    assert tester.ask(f"D5 {checksum}") == filled("A1")
    assert tester.ask(f"40 {multiplexer}") == filled(f"4B {multiplexer} {value}")


@GUARD_TIME_AND_HEARTBEAT
def test_sdo_20_and_21_block_download(tester: Tester, multiplexer: str, value: str) -> None:
    block_download_of_two(tester, multiplexer, value, with_crc=False)


@GUARD_TIME_AND_HEARTBEAT
def test_sdo_24_and_25_block_download_with_crc(tester: Tester, multiplexer: str, value: str) -> None:
    block_download_of_two(tester, multiplexer, value, with_crc=True)


def test_sdo_22_block_upload(tester: Tester) -> None:
    data, end = block_upload(tester, NAME)
    assert data == the_name(tester)
    assert end == filled(f"{0xC1 | (-len(data) % 7) << 2:02X}")  # no CRC asked for, none given


def test_sdo_23_block_upload_with_crc(tester: Tester) -> None:
    data, end = block_upload(tester, NAME, with_crc=True)
    assert data == the_name(tester)
    assert end[3:8] == little(crc(data), 2)


@pytest.mark.parametrize("size", ["80", "FF", "00"])
def test_sdo_26_block_size_out_of_range(tester: Tester, size: str) -> None:
    tester.refuse(f"A0 00 10 00 {size}", "05040002")


@pytest.mark.parametrize("sequence", ["80", "FF", "05"])
def test_sdo_27_acknowledge_of_a_segment_never_sent(tester: Tester, sequence: str) -> None:
    begin_upload(tester, NAME)
    tester.sdo("A3", wait=0.2)
    tester.aborted(tester.ask(f"A2 {sequence} 14"), NAME, "05040003")
    assert tester.sdo("A1") != [filled("A1")]  # given up; the server is free again
    assert tester.upload(NAME) == the_name(tester)


def test_sdo_28_further_servers(tester: Tester) -> None:
    for index in range(0x1201, 0x1280):
        if tester.eds.has(index, 1):
            assert tester.read(index, 1) == tester.eds[index, 1].integer(tester.eds[index, 1].default)
        else:
            tester.refuse(f"40 {m(index, 1)}", *NO_INDEX)


def test_sdo_29_a_further_server_is_back_at_its_default(tester: Tester) -> None:
    if not tester.eds.has(0x1201, 1):
        tester.refuse("40 01 12 01", *NO_INDEX)
        return
    before = [tester.ask("40 01 12 01"), tester.ask("40 01 12 02")]
    tester.accept("23 01 12 01 C0 06")
    tester.accept("23 01 12 02 40 05")
    assert only_answer(tester, 0x6C0, "40 00 10 00", 0x540)[:11] == "43 00 10 00"
    tester.nmt("82")
    assert [tester.ask("40 01 12 01"), tester.ask("40 01 12 02")] == before
    assert tester.send(0x6C0, filled("40 00 10 00")) == []


def only_answer(tester: Tester, request_id: int, request: str, response_id: int) -> str:
    (heard,) = tester.send(request_id, filled(request))
    assert heard.can_id == response_id
    return heard.data


def test_sdo_30_clients_keep_what_was_saved(tester: Tester) -> None:
    if not tester.eds.has(0x1280, 1):
        tester.refuse("40 80 12 01", *NO_INDEX)
        return
    tester.accept("23 80 12 01 C0 06")
    tester.accept(f"23 10 10 01 {SAVE}")
    tester.wait(0.5)
    tester.nmt("82")
    assert tester.read(0x1280, 1) == 0x6C0


def test_a_block_download_names_its_block_size(tester: Tester) -> None:
    answer, block_size = begin_download(tester, HEARTBEAT, 2)
    assert answer[:11] == f"A4 {HEARTBEAT}"
    assert 1 <= block_size <= 127
