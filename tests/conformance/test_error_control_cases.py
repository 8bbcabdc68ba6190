"""Guard 01 to 06, HB 01 to 07, HvG 01 to 07; State 03 where guarding fails."""

from itertools import pairwise

import pytest
from conformance_kit import Heard, Tester, filled, little, m

WATCHED = 0x47


def guarded(tester: Tester, guard_ms: int = 100, factor: int = 3) -> None:
    tester.write(0x100C, 0, guard_ms, 2)
    tester.write(0x100D, 0, factor, 1)


@pytest.mark.parametrize(("command", "state"), [("80", 0x7F), ("01", 0x05), ("02", 0x04)])
def test_guard_02_and_hvg_03_the_answer_tells_the_state_without_heartbeat(
    tester: Tester, command: str, state: int
) -> None:
    tester.accept("2B 17 10 00 00 00")
    guarded(tester)
    tester.nmt(command)
    assert tester.guard() == f"{state:02X}"
    assert tester.guard() == f"{state | 0x80:02X}"


def test_guard_03_toggle_bit(tester: Tester) -> None:
    guarded(tester, factor=0)
    assert [tester.guard() for _ in range(4)] == ["7F", "FF", "7F", "FF"]
    assert tester.guard() == "7F"
    for reset in ("81", "82"):
        tester.nmt(reset)
        assert [tester.guard() for _ in range(3)] == ["7F", "FF", "7F"]


def test_guard_04_only_the_own_id_answers(tester: Tester) -> None:
    guarded(tester, factor=0)
    for node_id in range(1, 0x78):
        heard = tester.remote(0x700 + node_id)
        assert bool(heard) == (node_id == tester.id)


@pytest.mark.parametrize(("behaviour", "state"), [(None, "7F"), ("00", "7F"), ("01", "05"), ("02", "04")])
def test_guard_06_and_state_03_life_guarding(tester: Tester, behaviour: str | None, state: str) -> None:
    guarded(tester, 100, 3)
    if behaviour is not None:
        tester.accept(f"2F 29 10 01 {behaviour}")
    tester.operational()
    assert tester.emergencies(tester.wait(5.0)) == []  # not armed before the first remote frame
    regular = tester.repeat(20, 0.25, lambda: tester.remote(0x700 + tester.id))
    assert tester.emergencies(regular) == []
    assert {int(data, 16) & 0x7F for data in tester.beats(regular)} == {0x05}
    silence = tester.wait(0.2)
    assert tester.emergencies(silence) == ["8130"]
    assert tester.state() == state
    if state != "04":  # nothing but NMT and error control in Stopped
        assert tester.emergencies(tester.repeat(1, 0.1, lambda: tester.remote(0x700 + tester.id))) == []


def test_hb_02_and_hvg_04_heartbeat_every_100_ms_without_guarding(tester: Tester) -> None:
    guarded(tester, 0, 0)
    heard = tester.send(0x600 + tester.id, filled("2B 17 10 00 64 00")) + tester.wait(10.0)
    assert 99 <= len(tester.beats(heard)) <= 102
    assert set(tester.beats(heard)) == {"7F"}
    times = [frame.time for frame in heard if frame.can_id == 0x700 + tester.id]
    assert all(b - a == pytest.approx(0.1) for a, b in pairwise(times))


def test_hb_03_and_hvg_02_heartbeat_off(tester: Tester) -> None:
    for before_ms in ("00 00", "64 00"):
        tester.accept(f"2B 17 10 00 {before_ms}")
        tester.wait(0.55)
        tester.accept("2B 17 10 00 00 00")
        assert tester.beats(tester.wait(10.0)) == []


def subs(tester: Tester) -> range:
    return range(1, tester.read(0x1016) + 1)


def beat(tester: Tester) -> list[Heard]:
    return tester.send(0x700 + WATCHED, "05")


def clear_consumers(tester: Tester) -> None:
    for sub in subs(tester):
        tester.accept(f"23 {m(0x1016, sub)} 00 00 00 00")


def consume(tester: Tester, sub: int) -> None:
    tester.accept(f"23 {m(0x1016, sub)} E8 03 {WATCHED:02X} 00")


def test_hb_05_good_heartbeats(tester: Tester) -> None:
    tester.accept("2B 17 10 00 E8 03")
    for sub in subs(tester):
        tester.nmt("80")
        clear_consumers(tester)
        consume(tester, sub)
        tester.operational()
        heard = tester.repeat(11, 0.95, lambda: beat(tester))
        assert tester.emergencies(heard) == []
        assert set(tester.beats(heard)) == {"05"}
        assert len(tester.beats(heard)) >= 10


def test_hb_06_no_heartbeat_at_all_and_slow_ones(tester: Tester) -> None:
    for sub in subs(tester):
        clear_consumers(tester)
        consume(tester, sub)
        assert tester.emergencies(tester.wait(10.0)) == []
        first = beat(tester) + tester.wait(1.2)
        assert tester.emergencies(first) == ["8130"]
        second = beat(tester)
        assert tester.emergencies(second) == ["0000"]
        assert tester.emergencies(tester.wait(1.2)) == ["8130"]
        clear_consumers(tester)


def test_hb_07_the_error_leads_to_pre_operational(tester: Tester) -> None:
    for sub in subs(tester):
        tester.nmt("81")
        tester.accept("2B 17 10 00 E8 03")
        tester.accept(f"23 {m(0x1016, sub)} {little(WATCHED << 16 | 1000, 4)}")
        tester.operational()
        silence = tester.wait(10.0)
        assert set(tester.beats(silence)) == {"05"}
        good = tester.repeat(11, 0.95, lambda: beat(tester))
        assert set(tester.beats(good)) == {"05"}
        assert tester.emergencies(silence + good) == []
        slow = beat(tester) + tester.wait(2.1)
        assert tester.emergencies(slow) == ["8130"]
        assert tester.beats(slow)[-1] == "7F"


def test_hvg_06_with_both_there_is_the_heartbeat(tester: Tester) -> None:
    guarded(tester)
    tester.accept("2B 17 10 00 64 00")
    heard = tester.wait(5.05)
    assert tester.beats(heard) == ["7F"] * len(tester.beats(heard))  # toggle bit 0
    assert len(tester.beats(heard)) >= 50
    assert tester.emergencies(heard) == []


@pytest.mark.parametrize("guarding", [(0, 0), (100, 3)], ids=["hvg-05", "hvg-07"])
def test_hvg_05_and_07_a_remote_frame_does_not_disturb_the_heartbeat(
    tester: Tester, guarding: tuple[int, int]
) -> None:
    guarded(tester, *guarding)
    tester.accept("2B 17 10 00 64 00")
    tester.wait(0.05)
    heard = tester.repeat(10, 0.1, lambda: tester.remote(0x700 + tester.id))
    assert tester.beats(heard) == ["7F"] * 10
    assert tester.emergencies(heard + tester.wait(2.0)) == []
