"""PDO 01 to PDO 20: parameters, and when a TPDO is sent, by type and NMT state."""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import pytest
from conformance_kit import SYNC, Heard, Tester, hexes, m, only

STOPPED, PRE_OPERATIONAL = "02", "80"


def have_their_cob_ids(tester: Tester, pdos: list[int]) -> None:
    for index in pdos:
        entry = tester.eds[index, 1]
        assert tester.ask(f"40 {entry.m}") == f"43 {entry.m} {hexes(entry.default)}"


def test_pdo_01_cob_ids_of_the_rpdos(tester: Tester) -> None:
    have_their_cob_ids(tester, tester.rpdos)


def test_pdo_02_cob_ids_of_the_tpdos(tester: Tester) -> None:
    have_their_cob_ids(tester, tester.tpdos)


def set_up(tester: Tester, kind: str, state: str, **options: Any) -> list[int]:
    """Every TPDO valid by default with this type and these options; then the NMT state. The CAN-IDs."""
    can_ids = [tester.set_up_tpdo(index, kind, **options) for index in tester.valid_tpdos]
    assert can_ids
    tester.nmt(state)
    return can_ids


def set_up_counted(tester: Tester, kind: str, start: int, state: str) -> list[int]:
    """As `set_up`, with a SYNC counter and the counter value to start at."""
    tester.write(0x1006, 0, 0, 4)
    tester.write(0x1019, 0, 10, 1)
    return set_up(tester, kind, state, start=start)


def lengths_of(tester: Tester) -> dict[int, int]:
    """Bytes of each TPDO that is valid, from its mapping, by its CAN-ID."""
    lengths = {}
    for index in tester.valid_tpdos:
        objects = range(1, tester.read(index + 0x200) + 1)
        bits = sum(tester.read(index + 0x200, n) & 0xFF for n in objects)
        lengths[tester.read(index, 1) & 0x7FF] = bits // 8
    return lengths


@pytest.mark.parametrize("kind", ["default type", "FD"])
def test_pdo_03_remote_frame(tester: Tester, kind: str) -> None:
    lengths = lengths_of(tester)
    assert lengths
    for index in tester.valid_tpdos:  # some forbid it by default (bit 30)
        default = f"{tester.read(index, 2):02X}"
        tester.set_up_tpdo(index, "FD" if kind == "FD" else default, remote=True)
    tester.operational()
    for can_id, length in lengths.items():
        (data,) = only(tester.remote(can_id), can_id)
        assert len(bytes.fromhex(data)) == length


def test_pdo_04_and_05_event_timer(tester: Tester) -> None:
    can_ids = set_up(tester, "FE", "01", timer_ms=100)
    begin = tester.now
    heard = tester.wait(10.0)
    for can_id in can_ids:
        times = [frame.time for frame in heard if frame.can_id == can_id]
        assert 99 <= len(times) <= 101
        assert times[0] - begin <= 0.11
        assert all(0.09 < b - a < 0.11 for a, b in pairwise(times))


def test_pdo_06_every_sync(tester: Tester) -> None:
    can_ids = set_up(tester, "01", "01")
    before = tester.wait(1.0)
    assert [only(before, can_id) for can_id in can_ids] == [[] for _ in can_ids]
    heard = tester.send(SYNC) + tester.wait(0.1)
    assert [len(only(heard, can_id)) for can_id in can_ids] == [1 for _ in can_ids]
    assert not any(only(tester.wait(1.0), can_id) for can_id in can_ids)


def test_pdo_07_sync_after_an_event(tester: Tester) -> None:
    can_ids = set_up(tester, "00", "01")
    for _ in range(2):
        heard = tester.cause_event() + tester.wait(0.1)
        assert not any(only(heard, can_id) for can_id in can_ids)
        heard = tester.send(SYNC) + tester.wait(0.1)
        assert [len(only(heard, can_id)) for can_id in can_ids] == [1 for _ in can_ids]


def test_pdo_08_sync_start_value(tester: Tester) -> None:
    can_ids = set_up_counted(tester, "03", 4, "01")
    sent_at: dict[int, list[int]] = {can_id: [] for can_id in can_ids}
    counters = [*range(2, 11), *range(1, 11)]  # the tester begins anywhere
    for place, counter in enumerate(counters):
        heard = tester.send(SYNC, f"{counter:02X}") + tester.wait(0.01)
        for can_id in can_ids:
            sent_at[can_id] += [place] * len(only(heard, can_id))
    first = counters.index(4)
    for can_id in can_ids:
        assert sent_at[can_id] == list(range(first, len(counters), 3))


def no_pdo(tester: Tester, can_ids: list[int], frames: list[Heard]) -> None:
    assert not any(only(frames, can_id) for can_id in can_ids)


def check_no_remote(tester: Tester, state: str) -> None:
    for kind in ("FD", "01"):
        can_ids = set_up(tester, kind, state, remote=True)
        for can_id in can_ids:
            assert tester.remote(can_id) == []
        no_pdo(tester, can_ids, tester.wait(0.5))
        tester.nmt(PRE_OPERATIONAL)


def check_no_timer(tester: Tester, state: str) -> None:
    can_ids = set_up(tester, "FE", state, timer_ms=100)
    no_pdo(tester, can_ids, tester.wait(2.0))
    no_pdo(tester, can_ids, tester.cause_event() + tester.wait(1.0))


def check_no_sync(tester: Tester, state: str) -> None:
    """Every SYNC, and SYNCs after an event."""
    for kind in ("01", "00"):
        can_ids = set_up(tester, kind, state)
        for _ in range(3):
            heard = tester.cause_event() + tester.send(SYNC) + tester.wait(0.1)
            no_pdo(tester, can_ids, heard)
        tester.nmt(PRE_OPERATIONAL)


def check_no_start(tester: Tester, state: str) -> None:
    can_ids = set_up_counted(tester, "01", 2, state)
    for counter in (1, 2, 3, 4):
        no_pdo(tester, can_ids, tester.send(SYNC, f"{counter:02X}") + tester.wait(0.1))


@pytest.mark.parametrize("state", [STOPPED, PRE_OPERATIONAL])
@pytest.mark.parametrize("check", [check_no_remote, check_no_timer, check_no_sync, check_no_start])
def test_pdo_09_to_20_no_pdo_in_these_states(
    tester: Tester, check: Callable[[Tester, str], None], state: str
) -> None:
    check(tester, state)


def test_a_tpdo_has_the_length_of_its_mapping(tester: Tester) -> None:
    lengths = lengths_of(tester)
    set_up(tester, "01", "01")
    heard = tester.send(SYNC)
    for can_id, length in lengths.items():
        assert [len(bytes.fromhex(data)) for data in only(heard, can_id)] == [length], m(can_id)
