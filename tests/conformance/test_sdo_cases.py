"""SDO 01 to SDO 30."""

from __future__ import annotations

import pytest
from conformance_kit import (
    COMMAND,
    NO_INDEX,
    NO_READ,
    NO_SUB,
    NO_WRITE,
    SAVE,
    G,
    Tester,
    filled,
    little,
    m,
)

from sdo_client import crc

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


TWO_BYTES = [(GUARD_TIME, "E8 03"), (HEARTBEAT, "10 27")]


@pytest.mark.parametrize(("multiplexer", "value"), TWO_BYTES)
def test_sdo_14_and_15_segmented_download(tester: Tester, multiplexer: str, value: str) -> None:
    tester.accept(f"21 {multiplexer} 02")
    assert tester.ask(f"0B {value}") == filled("20")
    assert tester.ask(f"40 {multiplexer}") == filled(f"4B {multiplexer} {value}")


def test_sdo_16_segmented_upload(tester: Tester) -> None:
    assert tester.upload(NAME) == the_name(tester)
    tester.aborted(tester.ask("60"), None, "05040001")  # the transfer is over: it belongs to none


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


@pytest.mark.parametrize("with_crc", [False, True])
def test_sdo_20_to_25_block_transfers(tester: Tester, with_crc: bool) -> None:
    for multiplexer, value in TWO_BYTES:
        assert tester.block_download(multiplexer, bytes.fromhex(value), with_crc=with_crc) == "ok"
        assert tester.ask(f"40 {multiplexer}") == filled(f"4B {multiplexer} {value}")
    assert tester.block_upload(NAME, with_crc=with_crc) == the_name(tester)


@pytest.mark.parametrize("size", ["80", "FF", "00"])
def test_sdo_26_block_size_out_of_range(tester: Tester, size: str) -> None:
    tester.refuse(f"A0 00 10 00 {size}", "05040002")


@pytest.mark.parametrize("sequence", ["80", "FF", "05"])
def test_sdo_27_acknowledge_of_a_segment_never_sent(tester: Tester, sequence: str) -> None:
    tester.begin_block_upload(NAME)
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
