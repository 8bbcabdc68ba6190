"""EMCY 01 to 06 and SYNC 01 to 09; SYNC 08 and 10 stand with saving and restoring."""

import pytest
from conformance_kit import RPDO1, SYNC, G, Tester, filled, only

PRODUCER_ON, PRODUCER_OFF = "23 05 10 00 80 00 00 40", "23 05 10 00 80 00 00 00"


def test_emcy_04_to_06_rpdo_without_data_register_and_history(tester: Tester) -> None:
    tester.operational()
    heard = tester.send(RPDO1) + tester.nmt("80") + tester.wait(0.5)
    (emergency,) = only(heard, 0x80 + tester.id)
    assert len(emergency) == 23
    assert emergency[:5] == "10 82"
    assert int(emergency[6:8], 16) & 0x11 == 0x11  # generic, communication
    assert tester.ask("40 01 10 00") == filled("4F 01 10 00 " + emergency[6:8])
    assert tester.ask("40 03 10 00") == filled("4F 03 10 00 01")
    assert tester.ask("40 03 10 01") == f"43 03 10 01 {emergency[:5]} {emergency[9:14]}"
    tester.accept("2F 03 10 00 00")
    tester.refuse("40 03 10 01", "08000024", G)


@pytest.mark.parametrize("state", ["80", "01"])
def test_sync_02_and_06_producer_without_counter(tester: Tester, state: str) -> None:
    tester.nmt(state)
    tester.accept("2F 19 10 00 00")
    tester.accept("23 06 10 00 A0 86 01 00")
    heard = tester.send(0x600 + tester.id, PRODUCER_ON) + tester.wait(10.0)
    syncs = only(heard, SYNC)
    assert 99 <= len(syncs) <= 101
    assert set(syncs) == {""}
    tester.accept(PRODUCER_OFF)
    assert only(tester.wait(2.0), SYNC) == []


def test_sync_03_every_tenth_sync(tester: Tester) -> None:
    can_ids = [tester.set_up_tpdo(tpdo, "0A") for tpdo in tester.valid_tpdos]
    assert can_ids
    tester.operational()
    heard = tester.repeat(100, 0.1, lambda: tester.send(SYNC))
    assert [len(only(heard, can_id)) for can_id in can_ids] == [10 for _ in can_ids]


def test_sync_07_producer_with_counter(tester: Tester) -> None:
    tester.accept(PRODUCER_OFF)
    tester.accept("23 06 10 00")
    tester.accept("2F 19 10 00 05")
    tester.accept("23 06 10 00 40 0D 03 00")
    heard = tester.send(0x600 + tester.id, PRODUCER_ON) + tester.wait(2.5)
    assert only(heard, SYNC)[:10] == ["01", "02", "03", "04", "05"] * 2
