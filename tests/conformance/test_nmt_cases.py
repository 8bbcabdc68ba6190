"""State 01 to 04 and Trans 01 to 04."""

from random import Random

import pytest
from conformance_kit import STATES, SYNC, Tester, filled, m, only


def answers_sdo(tester: Tester) -> bool:
    return tester.sdo("40 00 10 00")[0][:11] == "43 00 10 00"


@pytest.mark.parametrize("seed", range(5))
def test_state_01_random_writes_and_reset(tester: Tester, seed: int) -> None:
    random = Random(seed)
    assert "00" not in tester.beats(tester.wait(0.1))
    tester.accept("2B 17 10 00 F4 01")
    assert set(tester.beats(tester.wait(1.1))) == {"7F"}
    entries = [entry for entry in tester.eds.entries.values() if entry.index < 0x2000]
    for entry in entries:
        if entry.writable and 1 <= entry.size <= 4:
            value = random.choice((0, 1, 1 << 8 * entry.size - 1, random.randrange(1 << 8 * entry.size)))
            (answer,) = tester.sdo(tester.download(entry.index, entry.sub, value, entry.size))
            assert answer == filled(f"60 {entry.m}") or answer[:11] == f"80 {entry.m}"
    tester.nmt("81")
    for entry in entries:
        if entry.default and entry.readable:
            assert tester.upload(entry.m) == entry.default, entry


def set_up_services(tester: Tester) -> list[int]:
    """Heartbeat, SYNC producer of 6 ms, TPDOs of type FEh each second. CAN-IDs of the TPDOs."""
    tester.accept("2B 17 10 00 F4 01")
    tester.accept("23 06 10 00 70 17")
    tester.accept("23 05 10 00 80 00 00 40")
    return [tester.set_up_tpdo(tpdo, "FE", timer_ms=1000) for tpdo in tester.valid_tpdos]


def guarding_works(tester: Tester, state: str) -> None:
    """Without a heartbeat, and with it again afterwards."""
    tester.accept("2B 17 10 00 00 00")
    assert tester.state() == state
    tester.accept("2B 17 10 00 F4 01")


def test_state_02_pre_operational(tester: Tester) -> None:
    asked: list[int] = []
    for tpdo in tester.valid_tpdos:  # type FDh where it may be asked for
        if tester.read(tpdo, 1) >> 30 & 1:
            tester.refuse(f"2F {m(tpdo, 2)} FD", "06090030")
        else:
            asked.append(tester.set_up_tpdo(tpdo, "FD"))
    for can_id in asked:
        assert tester.remote(can_id) == []
    can_ids = set_up_services(tester)
    guarding_works(tester, "7F")
    heard = tester.wait(3.0)
    assert answers_sdo(tester)
    assert set(tester.beats(heard)) == {"7F"}
    assert 498 <= len(only(heard, SYNC)) <= 502
    assert not any(only(heard, can_id) for can_id in can_ids)


def test_state_03_operational(tester: Tester) -> None:
    can_ids = set_up_services(tester)
    begin = tester.now
    tester.operational()
    guarding_works(tester, "05")
    heard = tester.wait(3.05)
    assert answers_sdo(tester)
    assert set(tester.beats(heard)) == {"05"}
    assert 500 <= len(only(heard, SYNC)) <= 510
    for can_id in can_ids:
        times = [frame.time - begin for frame in heard if frame.can_id == can_id]
        assert times[0] == pytest.approx(1.0)
        assert len(times) == 3


def test_state_04_stopped(tester: Tester) -> None:
    can_ids = set_up_services(tester)
    tester.nmt("02")
    heard = tester.wait(3.0)
    assert tester.sdo("40 00 10 00", wait=1.0) == []
    assert set(tester.beats(heard)) == {"04"}
    assert only(heard, SYNC) == []
    assert not any(only(heard, can_id) for can_id in can_ids)
    tester.nmt("80")
    assert answers_sdo(tester)


@pytest.mark.parametrize("line", ["81 01 82", "01 80 02 80", "01 02 01", "02 01 02"])
def test_trans_01_to_04_each_command_leads_to_its_state(tester: Tester, line: str) -> None:
    """By guarding, then by heartbeats."""
    commands = [(command, STATES.get(command, "7F")) for command in line.split()]
    for command, expected in commands:
        tester.nmt(command)
        assert tester.state() == expected
    for command, expected in [("81", "7F"), *commands]:
        tester.nmt(command)
        if command in ("81", "82"):
            tester.accept("2B 17 10 00 F4 01")
        assert set(tester.beats(tester.wait(1.6))) == {expected}
