"""Object 2050h of the module: what comes is kept, and nothing else changes."""

import struct

from hypothesis import example, given, strategies as st
from module_bench import Bench

from canfb.cia301.frame import Frame
from canfb.objects import MISSED_COUNTS
from drawing import examples

MISSED = (MISSED_COUNTS, MISSED_COUNTS)
START, STOP = 1, 2


def command(bench: Bench, value: int) -> None:
    bench.sdo[0x2050][1].raw = value


def recorded(bench: Bench) -> list[tuple[int, int]]:
    data = bench.sdo.upload(0x2050, 3)
    assert bench.sdo[0x2050][2].raw == len(data) // 4
    return list(struct.iter_unpack("<hh", data))


def interval(bench: Bench, counts: tuple[int, int] | None) -> list[Frame]:
    """A SYNC and its sample, or none."""
    frames = bench.sync()
    return frames if counts is None else frames + bench.counts(*counts)


STATES = ["PRE-OPERATIONAL", "STOPPED", "RESET COMMUNICATION"]
STEPS: st.SearchStrategy[int | str] = st.sampled_from([START, STOP, "sample", "sample", "sample", *STATES])


@examples(50)
@given(st.lists(STEPS, max_size=30), st.integers(1, 6))
@example([START, *["sample"] * 9, START, "sample", START, "sample"], 5)
@example([START, "sample", STOP, "sample", STOP, START, "sample"], 5)
@example([START, "sample", "STOPPED", "sample"], 5)
def test_it_records_from_a_start_to_a_stop_a_full_memory_or_a_pause(
    steps: list[int | str], capacity: int
) -> None:
    """A start begins anew; it is read at any time, while it records, too."""
    bench = Bench()
    assert [bench.sdo[0x2050][n].raw for n in (1, 2, 5)] == [0, 0, 1_000_000]
    bench.module._recorder._recording.capacity = capacity
    bench.start()
    interval(bench, (0, 1500))  # so that a missing one would be seen
    kept: list[tuple[int, int]] = []
    records = False
    for number, step in enumerate(steps, 1):
        if step == "sample":
            interval(bench, (number, 1500))
            if records:
                kept.append((number, 1500))
            records = records and len(kept) < capacity
        elif isinstance(step, int):
            command(bench, step)
            records, kept = step == START, [] if step == START else kept
        else:
            bench.start(step)
            records = False
        assert recorded(bench) == kept
        assert bench.sdo[0x2050][1].raw == records


@examples(30)
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


def test_another_input_ends_it_and_a_reference_measurement(bench: Bench) -> None:
    command(bench, START)
    bench.sdo[0x2030][1].raw = START
    interval(bench, (1, 1500))
    for bit_31 in (1 << 31, 0):  # other objects may be mapped meanwhile
        bench.sdo[0x1400][1].raw = bit_31 | 0x190
    interval(bench, (2, 1500))
    assert (bench.sdo[0x2050][1].raw, recorded(bench)) == (0, [(1, 1500)])
    assert [bench.sdo[0x2030][n].raw for n in (2, 7)] == [4, 10]  # refused: interrupted


def test_the_rate_is_that_of_the_syncs(bench: Bench) -> None:
    assert bench.sdo[0x2050][4].raw == 0, "not known"
    for n in range(5):
        interval(bench, (n, 1500))
    assert bench.sdo[0x2050][4].raw == 1000
    for said_us, rate_hz in ((800, 1250), (500, 1000)):  # SYNC shows that 500 is wrong
        bench.sdo[0x1006].raw = said_us
        assert bench.sdo[0x2050][4].raw == rate_hz
