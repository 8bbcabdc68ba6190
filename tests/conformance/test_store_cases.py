"""Group Other, and the cases of SYNC and Beyond in which parameters are saved."""

import pytest
from conformance_kit import LOAD, SAVE, WRONG, Tester, little, m, only

REFUSED = ("08000020",)
SET_UP = {0x1005: (0x200, 4), 0x1006: (5000, 4), 0x1015: (1000, 2), 0x1017: (20000, 2)}
"""What the list writes first, where the device has it: value and bytes."""
ALL, COMMUNICATION = 1, 2


def command(tester: Tester, index: int, sub: int, word: str) -> None:
    tester.accept(f"23 {m(index, sub)} {word}")
    tester.wait(0.5)


def save(tester: Tester, sub: int = ALL) -> None:
    assert tester.read(0x1010, sub) == 1
    command(tester, 0x1010, sub, SAVE)


def set_up(tester: Tester) -> None:
    for index, (value, size) in SET_UP.items():
        if tester.eds.has(index):
            tester.write(index, 0, value, size)


def values(tester: Tester) -> list[int]:
    return [tester.read(index) for index in SET_UP if tester.eds.has(index)]


def changed(tester: Tester) -> list[int]:
    return [value for index, (value, _) in SET_UP.items() if tester.eds.has(index)]


def saves(tester: Tester, sub: int) -> None:
    set_up(tester)
    save(tester, sub)
    tester.nmt("81")
    assert values(tester) == changed(tester)


EACH = pytest.mark.parametrize("sub", [ALL, COMMUNICATION])


@EACH
def test_other_01_and_05_a_wrong_signature_saves_nothing(tester: Tester, sub: int) -> None:
    set_up(tester)
    tester.refuse(f"23 {m(0x1010, sub)} {WRONG}", *REFUSED)
    tester.nmt("81")
    assert values(tester) != changed(tester)


@EACH
def test_other_02_and_06_and_other_03_and_07_what_is_saved_comes_back_also_after_a_wrong_signature(
    tester: Tester, sub: int
) -> None:
    saves(tester, sub)
    tester.refuse(f"23 {m(0x1011, sub)} {WRONG}", *REFUSED)
    tester.nmt("81")
    assert values(tester) == changed(tester)


@EACH
def test_other_04_and_08_defaults_come_with_the_reset(tester: Tester, sub: int) -> None:
    defaults = values(tester)
    saves(tester, ALL)
    command(tester, 0x1011, sub, LOAD)
    assert values(tester) == changed(tester)
    tester.nmt("81")
    assert values(tester) == defaults


def test_other_09_the_date_is_kept_until_a_parameter_changes(tester: Tester) -> None:
    tester.write(0x1020, 1, 15000, 4)
    tester.write(0x1020, 2, 36_000_000, 4)
    save(tester)
    tester.nmt("81")
    assert (tester.read(0x1020, 1), tester.read(0x1020, 2)) == (15000, 36_000_000)
    tester.write(0x1017, 0, 1500, 2)
    assert (tester.read(0x1020, 1), tester.read(0x1020, 2)) == (0, 0)


RESTRICTED = ((0x000, 0x07F), (0x101, 0x180), (0x581, 0x5FF), (0x601, 0x67F), (0x6E0, 0x6FF), (0x701, 0x7FF))


def test_other_10_restricted_can_ids(tester: Tester) -> None:
    for place in ((0x1005, 0), (0x1012, 0), (0x1014, 0), (0x1400, 1), (0x1800, 1)):
        if not tester.eds.has(*place):
            continue
        before = tester.read(*place)
        for first, last in RESTRICTED:
            for can_id in range(first, last + 1):
                tester.refuse(f"23 {m(*place)} {little(can_id, 4)}", "06090030")
        assert tester.read(*place) == before


def test_sync_08_a_saved_producer_begins_with_counter_1(tester: Tester) -> None:
    tester.write(0x1019, 0, 5, 1)
    tester.write(0x1006, 0, 100_000, 4)
    tester.write(0x1005, 0, 0x40000080, 4)
    tester.wait(0.35)
    save(tester)
    tester.nmt("81")
    assert only(tester.wait(0.35), 0x080) == ["01", "02", "03"]


def test_sync_10_a_counter_without_a_period_is_saved(tester: Tester) -> None:
    tester.write(0x1006, 0, 0, 4)
    tester.write(0x1019, 0, 5, 1)
    save(tester)
    tester.nmt("81")
    assert tester.read(0x1019) == 5


def test_beyond_13_a_saved_startup_needs_no_master(tester: Tester) -> None:
    tester.refuse(f"23 {m(0x1F80)} {little(1, 4)}", "06090030")
    tester.write(0x1F80, 0, 0, 4)
    save(tester)
    tester.nmt("81")
    tester.write(0x1017, 0, 100, 2)
    assert set(only(tester.wait(0.5), 0x700 + tester.id)) == {"05"}


def test_beyond_19_a_saved_heartbeat_begins_with_the_one_boot_up(tester: Tester) -> None:
    tester.write(0x1017, 0, 200, 2)
    save(tester)
    start = tester.now
    tester.nmt("81")
    heard = tester.wait(0.5)
    beats = [frame for frame in heard if frame.can_id == 0x700 + tester.id]
    assert [frame.data for frame in beats] == ["7F", "7F"]
    assert beats[0].time - start == pytest.approx(0.2)
