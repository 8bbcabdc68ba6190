from __future__ import annotations

import pytest
from device_kit import OK, Bench
from test_pdo_parameters import remap

from canfb.cia301.codes import AbortCode, SdoAbort

RPDO = 0x190


def sine(bench: Bench) -> int:
    return int(bench.dictionary.entry(0x2000, 1).value)


def calls_of(bench: Bench) -> list[object]:
    calls: list[object] = []
    bench.application.react(
        rpdo_received=lambda number, now: calls.append((number, now, sine(bench))),
        rpdo_too_short=lambda *arguments: calls.append(("bad", *arguments)),
    )
    return calls


@pytest.mark.parametrize("kind", [0, 1, 2, 240])
def test_at_the_next_sync(bench: Bench, kind: int) -> None:
    bench.write(0x1400, 2, kind, 1)
    bench.operational()
    calls = calls_of(bench)
    bench.send(RPDO, "01000000")
    bench.send(RPDO, "02000000")
    assert calls == []
    bench.sync()
    bench.sync()
    assert calls == [(1, 0.0, 2)]


@pytest.mark.parametrize("kind", [255, 1])
@pytest.mark.parametrize("length", [0, 1, 3])
def test_too_short(bench: Bench, kind: int, length: int) -> None:
    bench.write(0x1400, 2, kind, 1)
    bench.operational()
    calls = calls_of(bench)
    assert bench.send(RPDO, bytes(length)) == [f"0A0#10821101{length:02X}040000"]
    assert bench.send(RPDO, bytes(length)) == []
    bench.sync()
    assert calls == [("bad", 1, length, 4, 0.0)] * 2
    assert bench.node.counters.short_rpdos == 2
    assert bench.read(0x1001) == 0x11
    assert bench.read(0x1003, 1) == 0x8210 | 0x01 << 16 | length << 24
    assert bench.send(RPDO, "05000600") == ["0A0#0000000000000000"]
    bench.sync()
    assert sine(bench) == 5
    assert bench.read(0x1001) == 0
    assert len(bench.send(RPDO, bytes(length))) == 1


def test_the_error_outlives_operational(bench: Bench) -> None:
    bench.operational()
    (emergency,) = bench.send(RPDO, b"")
    assert bench.nmt(128) == []
    assert bench.read(0x1001) == int(emergency[8:10], 16)
    bench.operational()
    assert bench.send(RPDO, b"") == []
    assert bench.send(RPDO, "05000600") == ["0A0#0000000000000000"]


@pytest.mark.parametrize("kind", [255, 1])
def test_too_long(bench: Bench, kind: int) -> None:
    bench.write(0x1400, 2, kind, 1)
    bench.operational()
    calls = calls_of(bench)
    assert bench.send(RPDO, "05000600FFFFFFFF") == ["0A0#2082110108040000"]
    bench.sync()
    assert bench.send(RPDO, "0700060000") == []
    bench.sync()
    assert calls == [(1, 0.0, 5), (1, 0.0, 7)]
    assert bench.node.counters.long_rpdos == 2
    assert bench.read(0x1001) == 0x11
    assert bench.read(0x1003, 1) == 0x8220 | 0x01 << 16 | 8 << 24
    assert bench.send(RPDO, "05000600") == ["0A0#0000000000000000"]
    assert bench.send(RPDO, "05000600") == []
    assert bench.send(RPDO, "0500060000") == ["0A0#2082110105040000"]


def test_a_long_rpdo_is_in_time(bench: Bench) -> None:
    bench.write(0x1400, 5, 50, 2)
    bench.operational()
    bench.send(RPDO, "05000600")
    bench.run(1.0)
    assert [text[4:8] for text in bench.send(RPDO, "0500060007")] == ["2082", "0000"]
    bench.run(0.04)
    assert bench.send(RPDO, "0500060007") == []
    start = bench.now
    assert bench.run(1.0) == [(pytest.approx(start + 0.05), "0A0#5082110100000000")]


def test_a_short_rpdo_does_not_stop_the_time_out(bench: Bench) -> None:
    bench.write(0x1400, 5, 50, 2)
    bench.operational()
    bench.send(RPDO, "05000600")
    bench.run(0.04)
    bench.send(RPDO, "0500")
    assert bench.run(1.0) == [(0.05, "0A0#5082110100000000")]


def test_values_beyond_the_limits_are_kept_out(bench: Bench) -> None:
    bench.dictionary.entry(0x2000, 1).high = 100
    bench.operational()
    calls = calls_of(bench)
    bench.send(RPDO, "65000700")
    assert calls == [(1, 0.0, 0)]
    assert bench.dictionary.entry(0x2000, 2).value == 7
    assert bench.node.counters.refused_rpdo_values == 1


def test_mixed_mapping_with_dummies(bench: Bench) -> None:
    assert remap(bench, 0x1401, [0x00050008, 0x20000301, 0x20000518, 0x20000408]) == [OK] * 8
    bench.write(0x1401, 2, 255, 1)
    bench.operational()
    word = 0xAA | 1 << 8 | 0x123456 << 9 | 0x5A << 33
    bench.send(0x320, word.to_bytes(6, "little"))
    values = [bench.dictionary.entry(0x2000, sub).value for sub in (3, 4, 5)]
    assert values == [True, 0x5A, 0x123456]


def test_an_rpdo_without_mapping_is_not_there(bench: Bench) -> None:
    bench.write(0x1401, 1, 0x320, 4)
    bench.operational()
    bench.send(0x320, "00")
    assert bench.node.counters.unknown_cob_ids == 1


def test_two_rpdos_on_one_can_id(bench: Bench) -> None:
    remap(bench, 0x1401, [0x20000408])
    bench.write(0x1401, 2, 255, 1)
    bench.write(0x1401, 1, 0x80000190, 4)
    assert bench.write(0x1401, 1, RPDO, 4) == OK
    bench.operational()
    bench.send(RPDO, "05000600")
    assert (sine(bench), bench.dictionary.entry(0x2000, 4).value) == (5, 5)


def test_the_time_out(bench: Bench) -> None:
    assert bench.write(0x1400, 5, 50, 2) == OK
    bench.operational()
    assert bench.run(1.0) == []
    bench.send(RPDO, "01000200")
    bench.run(0.04)
    bench.send(RPDO, "01000200")
    assert bench.run(1.0) == [(1.09, "0A0#5082110100000000")]
    assert bench.send(RPDO, "01000200") == ["0A0#0000000000000000"]
    assert len(bench.run(1.0)) == 1


def test_the_time_out_written_in_operational(bench: Bench) -> None:
    bench.operational()
    bench.write(0x1400, 5, 50, 2)
    bench.send(RPDO, "01000200")
    assert len(bench.run(1.0)) == 1


def test_a_mapped_entry_may_refuse(bench: Bench) -> None:
    def refuse(value: int) -> None:
        raise SdoAbort(AbortCode.INVALID_VALUE)

    bench.dictionary.entry(0x2000, 1).on_check = refuse
    bench.operational()
    bench.send(RPDO, "05000600")
    assert sine(bench) == 0
    assert bench.node.counters.refused_rpdo_values == 1
