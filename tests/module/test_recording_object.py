"""Object 2050h of the module: what comes is kept, and nothing else changes."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from module_bench import Bench

from canfb.cia301.frame import Frame
from canfb.objects import MISSED_COUNTS

MISSED = (MISSED_COUNTS, MISSED_COUNTS)
START, STOP = 1, 2


def command(bench: Bench, value: int) -> None:
    bench.sdo[0x2050][1].raw = value


def pairs(data: bytes) -> list[tuple[int, int]]:
    return list(struct.iter_unpack("<hh", data))


def recorded(bench: Bench) -> list[tuple[int, int]]:
    data = bench.sdo.upload(0x2050, 3)
    assert bench.sdo[0x2050][2].raw == len(data) // 4
    return pairs(data)


def interval(bench: Bench, counts: tuple[int, int] | None) -> list[Frame]:
    """A SYNC and its sample, or none."""
    frames = bench.sync()
    return frames if counts is None else frames + bench.counts(*counts)


def small_memory(bench: Bench, samples: int) -> None:
    bench.module._recorder._recording.capacity = samples


def test_before_anything_there_is_nothing(bench: Bench) -> None:
    assert [bench.sdo[0x2050][n].raw for n in (1, 2, 5)] == [0, 0, 1_000_000]
    assert recorded(bench) == []


def test_start_read_stop_read_start(bench: Bench) -> None:
    interval(bench, (1, 1500))
    command(bench, START)
    assert bench.sdo[0x2050][1].raw == 1
    for n in range(2, 12):
        interval(bench, (n, 1500))
    assert recorded(bench) == [(n, 1500) for n in range(2, 12)], "read while it records"
    interval(bench, (12, -1500))
    command(bench, STOP)
    interval(bench, (13, 1500))
    assert bench.sdo[0x2050][1].raw == 0
    assert recorded(bench) == [*((n, 1500) for n in range(2, 12)), (12, -1500)]
    command(bench, STOP)
    assert len(recorded(bench)) == 11
    command(bench, START)
    assert recorded(bench) == []
    interval(bench, (14, 1500))
    command(bench, START)
    interval(bench, (15, 1500))
    assert recorded(bench) == [(15, 1500)], "a second start begins anew"


@given(st.lists(st.one_of(st.none(), st.tuples(*[st.integers(-2048, 2047)] * 2)), max_size=60))
def test_every_interval_has_its_place_and_publication_is_as_without_recording(samples) -> None:
    benches = Bench(), Bench()
    for bench in benches:
        bench.start()
        interval(bench, (0, 1500))  # a miss is seen once samples come
    command(benches[1], START)
    benches[1].heard.clear()
    benches[0].heard.clear()
    for counts in samples:
        assert interval(benches[0], counts) == interval(benches[1], counts)
    assert benches[0].module.feedback == benches[1].module.feedback
    interval(benches[1], (0, 1500))  # closes the last interval
    assert recorded(benches[1]) == [*(counts or MISSED for counts in samples), (0, 1500)]


def test_the_memory_is_bounded_and_says_so(bench: Bench) -> None:
    small_memory(bench, 5)
    command(bench, START)
    for n in range(4):
        interval(bench, (n, 1500))
    assert bench.sdo[0x2050][1].raw == 1
    for n in range(4, 9):
        interval(bench, (n, 1500))
    assert bench.sdo[0x2050][1].raw == 0, "it has ended by itself"
    assert recorded(bench) == [(n, 1500) for n in range(5)]
    command(bench, START)
    interval(bench, (7, 7))
    assert recorded(bench) == [(7, 7)]


def test_faulty_samples_are_recorded_as_they_came_invalid_ones_are_none(bench: Bench) -> None:
    bench.map_rpdo2(0x20000608)
    command(bench, START)
    for counts, flags in (((2047, 2047), 0), ((0, 3), 0), ((5, 1500), 2), ((6, 1500), 0)):
        bench.sync()
        bench.sent(Frame(0x290, bytes([flags])))
        bench.counts(*counts)
    assert recorded(bench) == [(2047, 2047), (0, 3), MISSED, (6, 1500)]


def test_started_before_it_is_operational_it_begins_with_the_first_sample() -> None:
    bench = Bench()
    command(bench, START)
    interval(bench, (1, 1500))
    assert recorded(bench) == []
    bench.start()
    for counts in (None, (2, 1500), (3, 1500)):
        interval(bench, counts)
    assert recorded(bench) == [(2, 1500), (3, 1500)], "nothing is missed before the first sample"


@pytest.mark.parametrize("state", ["PRE-OPERATIONAL", "STOPPED", "RESET COMMUNICATION"])
def test_it_ends_where_time_would_be_lost(bench: Bench, state: str) -> None:
    command(bench, START)
    interval(bench, (1, 1500))
    bench.remote.nmt.state = state
    bench.start()
    interval(bench, (2, 1500))
    assert bench.sdo[0x2050][1].raw == 0
    assert recorded(bench) == [(1, 1500)]


def test_the_rate_is_that_of_the_syncs(bench: Bench) -> None:
    assert bench.sdo[0x2050][4].raw == 0, "not known"
    for n in range(5):
        interval(bench, (n, 1500))
    assert bench.sdo[0x2050][4].raw == 1000
    for said_us, rate_hz in ((800, 1250), (500, 1000)):  # SYNC shows that 500 is wrong
        bench.sdo[0x1006].raw = said_us
        assert bench.sdo[0x2050][4].raw == rate_hz
