from __future__ import annotations

import pytest
from device_kit import OK, Bench

from canfb.cia301.codes import AbortCode

TIME = 0x100


def times_of(bench: Bench) -> list[tuple[int, int, float]]:
    seen: list[tuple[int, int, float]] = []
    bench.application.react(time_received=lambda *told: seen.append(told))
    return seen


@pytest.fixture
def listening(bench: Bench) -> Bench:
    assert bench.write(0x1012, 0, 0x80000100, 4) == OK
    return bench


def test_days_and_milliseconds(listening: Bench) -> None:
    seen = times_of(listening)
    listening.now = 2.5
    assert listening.send(TIME, "FF5B26050000") == []
    assert listening.send(TIME, "01000000FFFF") == []
    assert seen == [(0, 86_399_999, 2.5), (65535, 1, 2.5)]
    assert listening.node.counters.malformed_frames == 0


@pytest.mark.parametrize("data", ["", "00", "0000000000", "00000000000000", "0000000000000000"])
def test_wrong_lengths(listening: Bench, data: str) -> None:
    seen = times_of(listening)
    assert listening.send(TIME, data) == []
    assert seen == []
    assert listening.node.counters.malformed_frames == 1


@pytest.mark.parametrize("data", ["005C26050000", "FFFFFF0F0100"])
def test_more_than_a_day(listening: Bench, data: str) -> None:
    seen = times_of(listening)
    listening.send(TIME, data)
    assert seen == []
    assert listening.node.counters.malformed_frames == 1


def test_not_consumed_by_default(bench: Bench) -> None:
    seen = times_of(bench)
    bench.send(TIME, "010000000200")
    assert seen == []
    assert bench.node.counters.unknown_cob_ids == 1


def test_the_can_id_is_fixed_while_it_is_used(listening: Bench) -> None:
    assert listening.write(0x1012, 0, 0x80000181, 4) is AbortCode.INVALID_VALUE
    assert listening.read(0x1012) == 0x80000100
    assert listening.write(0x1012, 0, 0x80000100, 4) == OK
    assert listening.write(0x1012, 0, 0x00000181, 4) == OK
    assert listening.write(0x1012, 0, 0x80000181, 4) == OK
    seen = times_of(listening)
    listening.send(TIME, "010000000200")
    assert seen == []
    listening.send(0x181, "010000000200")
    assert seen == [(2, 1, 0.0)]


def test_on_with_another_can_id(bench: Bench) -> None:
    assert bench.write(0x1012, 0, 0x80000181, 4) == OK
    assert bench.write(0x1012, 0, 0x00000182, 4) == OK


@pytest.mark.parametrize("value", [0x40000100, 0xC0000100, 0x20000100, 0xA0000100, 0x00000900])
def test_flags_that_are_not_meant(bench: Bench, value: int) -> None:
    assert bench.write(0x1012, 0, value, 4) is AbortCode.INVALID_VALUE
    assert bench.read(0x1012) == 0x100


def test_a_reset_ends_it(listening: Bench) -> None:
    seen = times_of(listening)
    listening.nmt(130)
    listening.send(TIME, "010000000200")
    assert seen == []
