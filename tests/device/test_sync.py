"""SYNC and TIME, beyond the cases SYNC and Beyond 17, 18 of tests/conformance."""

from collections.abc import Sequence
from math import inf
from pathlib import Path
from typing import Any

import pytest
from device_kit import ID, OK, Bench
from hypothesis import given, strategies as st

from canfb.cia301.codes import AbortCode
from canfb.cia301.frame import Frame
from canfb.device.core import FOLLOWED, IGNORED, REVOKED, HeldRpdo
from canfb.device.od.dictionary import Dictionary

PRODUCES = 0x40000080
RPDO, TIME, TIME_DATA = 0x190, 0x100, "010000000200"


def test_the_order_within_a_sync(bench: Bench) -> None:
    """RPDO data, the application, then the TPDO is sampled (CiA 301, 7.2.5)."""
    bench.write(0x1400, 2, 0, 1)
    bench.operational()
    sine, out = bench.dictionary.entry(0x2000, 1), bench.dictionary.entry(0x2010, 1)
    order: list[object] = []
    answers = iter((REVOKED, REVOKED, FOLLOWED, IGNORED, FOLLOWED))

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
    assert (bench.send(RPDO, "05000200"), sine.value) == ([], 0)
    assert bench.sync() == ["2A0#0A000000"]
    assert order == [("rpdo", 1, 5), ("sync", 5), "sampled"]
    assert [bench.sync() for _ in range(3)] == [["2A0#0A000000"], ["2A0#0A000000"], []]
    assert order[3:] == [("sync", 5), "sampled", ("sync", 5), ("sync", 5)]
    assert bench.write(0x1005, 0, 0x81, 4) == OK
    assert (bench.sync(), bench.send(0x081)) == ([], ["2A0#0A000000"])
    assert bench.nmt(130) + bench.sync() == ["720#00"]  # at 80h again
    assert bench.application.told("idle_sync_received") == [None]


@pytest.mark.parametrize(("overflow", "counters"), [(0, [None] * 3), (2, [1, 2, 1])])
def test_the_producer_acts_on_its_own_sync(bench: Bench, overflow: int, counters: list[int | None]) -> None:
    counter = 0x1019, overflow, 1  # the same again while 1006h is set
    for index, value, size in (counter, (0x1006, 100_000, 4), (0x1005, PRODUCES, 4), counter):
        assert bench.write(index, 0, value, size) == OK
    assert bench.write(0x1019, 0, 241, 1) is AbortCode.INVALID_VALUE
    bench.operational()
    assert bench.run(0.1)[0][1] == ("080#01" if overflow else "080#")
    sent = bench.run(0.25)
    assert [text[:3] for _, text in sent] == ["080", "2A0"] * 2
    assert bench.sync(None if not overflow else 1) == [], "a producer hears no other one"
    assert [counter for counter, _ in bench.application.told("sync_received")] == counters
    assert bench.node.counters.malformed_frames == 1


def test_a_late_tick_sends_one_sync(bench: Bench) -> None:
    bench.write(0x1006, 0, 1_000, 4)
    bench.write(0x1005, 0, PRODUCES, 4)
    bench.now = 0.0015
    assert bench.tick() + bench.nmt(1) == ["080#"]
    assert bench.node.deadline() == pytest.approx(0.002)  # neither late nor restarted
    bench.now = 5.0
    assert bench.tick()[0] == "080#"
    assert bench.node.deadline() == pytest.approx(5.001)


TICK_US, TICK_S = 15_625, 1 / 64  # without rounding: a PDO may come at the end of the window itself
STEP = st.tuples(st.integers(0, 4), st.sampled_from(["sync", "pdo", "pdo", 0, 1, 2, 3]))


@given(st.lists(STEP, max_size=40))
def test_the_window_for_rpdos(sample_path: Path, steps: list[tuple[int, Any]]) -> None:
    """1007h, which counts from the next SYNC on; 0 ends it at once."""
    bench = Bench(Dictionary.load(sample_path, ID))
    bench.start()
    bench.write(0x1400, 2, 1, 1)
    bench.operational()
    window, end, held, late = 0, inf, 0, 0
    for number, (ticks, what) in enumerate(steps, 1):
        bench.now += ticks * TICK_S
        if what == "pdo":
            frame = Frame(RPDO, number.to_bytes(4, "little"), False, bench.now)
            bench.node.receive(frame, bench.now + TICK_S / 2.0)  # a late host
            held, late = (number, late) if bench.now <= end else (held, late + 1)
        elif what == "sync":
            bench.sync()
            assert bench.dictionary.entry(0x2000, 1).value == held
            end = bench.now + window * TICK_S if window else inf
        else:
            bench.write(0x1007, 0, what * TICK_US, 4)
            window, end = what, end if what else inf
    assert bench.nmt(2) == bench.nmt(1) == []
    bench.now += 1.0
    bench.send(RPDO, bytes(4))  # in time: the window begins with a SYNC
    assert bench.node.counters.late_rpdos == late


def test_the_time_is_told_if_it_is_one(bench: Bench) -> None:
    told = bench.application.told
    bench.send(TIME, TIME_DATA)
    assert (told("time_received"), bench.node.counters.unknown_cob_ids) == ([], 1), "not consumed by default"
    assert bench.write(0x1012, 0, 0x80000100, 4) == OK
    bench.now = 2.5
    assert [bench.send(TIME, data) for data in ("FF5B26050000", "01000000FFFF")] == [[], []]
    assert told("time_received") == [(0, 86_399_999, 2.5), (65535, 1, 2.5)]
    assert bench.node.counters.malformed_frames == 0
    wrong = ["", "00", "00" * 5, "00" * 7, "00" * 8, "005C26050000", "FFFFFF0F0100"]
    assert [bench.send(TIME, data) for data in wrong] == [[]] * len(wrong)
    assert bench.node.counters.malformed_frames == len(wrong)
    assert (bench.nmt(130), bench.send(TIME, TIME_DATA)) == (["720#00"], [])
    assert len(told("time_received")) == 2


def test_the_can_id_of_time_is_fixed_while_it_is_used(bench: Bench) -> None:
    values = 0x80000181, 0x80000181, 0x00000182, 0x80000100
    assert [bench.write(0x1012, 0, value, 4) for value in values] == [OK] * 4
    assert bench.write(0x1012, 0, 0x80000181, 4) is AbortCode.INVALID_VALUE
    assert bench.read(0x1012) == 0x80000100
    assert [bench.write(0x1012, 0, value, 4) for value in (0x00000181, 0x80000181)] == [OK] * 2
    bench.send(TIME, TIME_DATA)
    bench.send(0x181, TIME_DATA)
    assert bench.application.told("time_received") == [(2, 1, 0.0)]
