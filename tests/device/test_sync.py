from __future__ import annotations

from collections.abc import Sequence

import pytest
from device_kit import Bench

from canfb.device.application import FOLLOWED, IGNORED, REVOKED, HeldRpdo


def seen_by(bench: Bench) -> list[tuple[int | None, float]]:
    seen: list[tuple[int | None, float]] = []
    bench.application.react(sync_received=lambda counter, now: seen.append((counter, now)))
    return seen


def test_sync_received_only_in_operational(bench: Bench) -> None:
    seen = seen_by(bench)
    bench.sync()
    bench.operational()
    bench.now = 2.5
    bench.sync()
    bench.nmt(2)
    bench.sync()
    assert seen == [(None, 2.5)]


def test_the_order_within_a_sync(bench: Bench) -> None:
    """RPDO data, the application, then the TPDO is sampled (CiA 301, 7.2.5)."""
    bench.write(0x1400, 2, 0, 1)
    bench.operational()
    sine, out = bench.dictionary.entry(0x2000, 1), bench.dictionary.entry(0x2010, 1)
    order: list[object] = []
    answers = iter((REVOKED, REVOKED, FOLLOWED, IGNORED))

    def synchronise(counter: int | None, now: float, waiting: Sequence[HeldRpdo]) -> int:
        for rpdo in waiting:
            rpdo.synchronise(now)
        order.append(("sync", sine.value))
        out.value = sine.value * 2
        return next(answers)

    bench.application.react(
        synchronise=synchronise,
        rpdo_received=lambda number, now: order.append(("rpdo", number, sine.value)),
        tpdos_sampled=lambda: order.append("sampled"),
    )
    assert bench.send(0x190, "05000200") == []
    assert sine.value == 0
    assert bench.sync() == ["2A0#0A000000"]
    assert order == [("rpdo", 1, 5), ("sync", 5), "sampled"]
    assert [bench.sync() for _ in range(3)] == [["2A0#0A000000"], ["2A0#0A000000"], []]
    assert order[3:] == [("sync", 5), "sampled", ("sync", 5), ("sync", 5)]


def test_the_producer_acts_on_its_own_sync(bench: Bench) -> None:
    bench.write(0x1006, 0, 100_000, 4)
    bench.write(0x1005, 0, 0x40000080, 4)
    bench.operational()
    seen = seen_by(bench)
    assert bench.run(0.1) == [(0.1, "080#"), (0.1, "2A0#00000000")]
    assert len(seen) == 1
    assert bench.sync() == []
    assert len(seen) == 1


def test_a_late_tick_sends_one_sync(bench: Bench) -> None:
    bench.write(0x1006, 0, 1_000, 4)
    bench.write(0x1005, 0, 0x40000080, 4)
    bench.now = 5.0
    assert bench.tick() == ["080#"]
    assert bench.node.deadline() == pytest.approx(5.001)


def test_the_window_for_rpdos(bench: Bench) -> None:
    bench.write(0x1400, 2, 1, 1)
    bench.write(0x1007, 0, 10_000, 4)
    bench.operational()
    sine = bench.dictionary.entry(0x2000, 1)
    bench.send(0x190, "01000000")
    bench.sync()
    assert sine.value == 1
    bench.now = 0.009
    bench.send(0x190, "02000000")
    bench.now = 0.011
    bench.send(0x190, "03000000")
    bench.now = 0.1
    bench.sync()
    assert sine.value == 2
    assert bench.node.counters.late_rpdos == 1
    bench.now = 0.105
    bench.send(0x190, "04000000")
    bench.sync()
    assert sine.value == 4


def test_the_window_taken_away(bench: Bench) -> None:
    bench.write(0x1400, 2, 1, 1)
    bench.write(0x1007, 0, 10_000, 4)
    bench.operational()
    bench.sync()
    bench.write(0x1007, 0, 0, 4)
    bench.now = 1.0
    bench.send(0x190, "03000000")
    bench.sync()
    assert bench.dictionary.entry(0x2000, 1).value == 3


def test_the_end_of_the_window_belongs_to_it(bench: Bench) -> None:
    bench.write(0x1400, 2, 1, 1)
    bench.write(0x1007, 0, 500_000, 4)
    bench.operational()
    bench.now = 1.0
    bench.sync()
    bench.now = 1.5
    bench.send(0x190, "02000000")
    assert bench.node.counters.late_rpdos == 0
    bench.sync()
    assert bench.dictionary.entry(0x2000, 1).value == 2


def test_a_producer_with_a_counter_acts_on_its_own_sync(bench: Bench) -> None:
    bench.write(0x1019, 0, 2, 1)
    bench.write(0x1006, 0, 100_000, 4)
    bench.write(0x1005, 0, 0x40000080, 4)
    bench.operational()
    seen = seen_by(bench)
    bench.run(0.35)
    assert [counter for counter, _ in seen] == [1, 2, 1]


def test_an_error_of_length_ends_with_a_reset(bench: Bench) -> None:
    bench.operational()
    assert bench.sync(1) == ["0A0#4082110100000000"]
    assert bench.sync(2) == []
    assert bench.node.counters.malformed_frames == 2
    bench.nmt(130)
    bench.operational()
    assert bench.sync() == ["2A0#00000000"]
    assert len(bench.sync(1)) == 1
