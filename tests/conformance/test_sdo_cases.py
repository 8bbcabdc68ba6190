"""SDO 01 to SDO 30; those of single requests stand with the exchanges, 04 and 13 with OD 04 and 02."""

import pytest
from conformance_kit import HEARTBEAT, NAME, NO_INDEX, SAVE, G, Tester, filled, hexes, m

from sdo_client import crc

GUARD_TIME = "0C 10 00"


def test_crc_of_the_tester_itself() -> None:
    assert crc(b"123456789") == 0x31C3


def test_sdo_11_below_the_minimum(tester: Tester) -> None:
    # an unsigned entry with a LowLimit above zero
    entries = [(e, e.low or 0) for e in tester.eds.entries.values() if e.writable and (e.low or 0) > 0]
    assert entries
    for entry, low in entries:
        before = tester.upload(entry.m)
        request = tester.download(entry.index, entry.sub, low - 1, entry.size)
        tester.refuse(request, "06090030", "06090032", G)
        assert tester.upload(entry.m) == before


def test_sdo_16_and_18_segmented_upload(tester: Tester) -> None:
    assert tester.upload(NAME) == tester.name
    tester.aborted(tester.ask("60"), None, "05040001")  # the transfer is over: it belongs to none


def test_sdo_17_wrong_toggle_bit(tester: Tester) -> None:
    tester.ask(f"40 {NAME}")
    tester.aborted(tester.ask("70"), NAME, "05030000")
    assert tester.upload(NAME) == tester.name


def test_sdo_19_block_upload_of_four_bytes(tester: Tester) -> None:
    assert tester.ask("A0 00 10 00 14 00")[3:] == filled("C2 00 10 00 04")[3:]
    assert tester.sdo("A3", wait=0.2) == [filled(f"81 {hexes(tester.eds[0x1000, 0].default)}")]
    assert tester.ask("A2 01 14") == filled("CD 00 00")
    assert tester.sdo("A1", wait=2.0) == []


@pytest.mark.parametrize("with_crc", [False, True])
def test_sdo_20_to_25_block_transfers(tester: Tester, with_crc: bool) -> None:
    for multiplexer, value in [(GUARD_TIME, "E8 03"), (HEARTBEAT, "10 27")]:
        assert tester.block_download(multiplexer, bytes.fromhex(value), with_crc=with_crc) == "ok"
        assert tester.ask(f"40 {multiplexer}") == filled(f"4B {multiplexer} {value}")
    assert tester.block_upload(NAME, with_crc=with_crc) == tester.name


@pytest.mark.parametrize("sequence", ["80", "FF", "05"])
def test_sdo_27_acknowledge_of_a_segment_never_sent(tester: Tester, sequence: str) -> None:
    tester.begin_block_upload(NAME)
    tester.sdo("A3", wait=0.2)
    tester.aborted(tester.ask(f"A2 {sequence} 14"), NAME, "05040003")
    assert tester.sdo("A1") != [filled("A1")]  # given up; the server is free again
    assert tester.upload(NAME) == tester.name


def test_sdo_28_further_servers(tester: Tester) -> None:
    for index in range(0x1201, 0x1280):
        if tester.eds.has(index, 1):
            assert tester.upload(m(index, 1)) == tester.eds[index, 1].default
        else:
            tester.refuse(f"40 {m(index, 1)}", *NO_INDEX)


def test_sdo_29_a_further_server_is_back_at_its_default(tester: Tester) -> None:
    if not tester.eds.has(0x1201, 1):
        tester.refuse("40 01 12 01", *NO_INDEX)
        return
    before = [tester.ask("40 01 12 01"), tester.ask("40 01 12 02")]
    tester.second_server()
    (answer,) = tester.ask_second("40 00 10 00")
    assert answer[:11] == "43 00 10 00"
    tester.nmt("82")
    assert [tester.ask("40 01 12 01"), tester.ask("40 01 12 02")] == before
    assert tester.send(0x6C0, filled("40 00 10 00")) == []


def test_sdo_30_clients_keep_what_was_saved(tester: Tester) -> None:
    if not tester.eds.has(0x1280, 1):
        tester.refuse("40 80 12 01", *NO_INDEX)
        return
    tester.accept("23 80 12 01 C0 06")
    tester.accept(f"23 10 10 01 {SAVE}")
    tester.wait(0.5)
    tester.nmt("82")
    assert tester.read(0x1280, 1) == 0x6C0
