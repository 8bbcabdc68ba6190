"""SYNCs that the module did not hear: their samples are missed, or the position is lost."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from module_bench import Bench

from canfb.cia301.frame import Frame
from canfb.objects import StatusBit
from ideal_tracks import counts_at

SPEED = 0.3  # cycles per SYNC


class Counted(Bench):
    """A machine at constant speed whose SYNC has a counter, 1 to ``overflow``."""

    def __init__(self, overflow: int = 20, **fields: Any) -> None:
        super().__init__(**fields)
        self.overflow, self.timed = overflow, fields.get("times", False)
        self.sdo[0x1019].raw = overflow
        self.number = 0
        self.start()
        for _ in range(8):
            self.cycle()

    def cycle(self, heard: bool = True, answered: bool = False) -> tuple[int, int] | None:
        """The next SYNC and its sample, 6004h and status word; None where the module hears neither.

        ``answered``: it hears the sample in any case.
        """
        self.number += 1
        self.bus.run_until(self.bus.now + self.interval_s)
        if heard:
            self.sent(Frame(0x80, bytes([(self.number - 1) % self.overflow + 1])))
        elif not answered:
            return None
        time = round(self.number * self.interval_s * 1e7)
        sample = struct.pack("<hhI", *counts_at(SPEED * self.number), time)
        return self.position(self.sent(Frame(0x190, sample if self.timed else sample[:4])))[:2]

    def count(self) -> float:
        return self.sdo[0x2011][4].raw + self.sdo[0x2011][3].raw / 2**32


@given(st.lists(st.booleans(), max_size=30), st.integers(2, 40))
@example([False] * 3, 20)
@example([False] * 5, 20)
@example([False] * 18, 20)
def test_every_sync_that_was_not_heard_is_counted(heard: list[bool], overflow: int) -> None:
    """A few are stepped over; many lose the position, and it is told."""
    bench = Counted(overflow)
    before = bench.count() - SPEED * bench.number
    longest = max((len(run) for run in "".join("01"[one] for one in heard).split("1")), default=0)
    for one in heard:
        bench.cycle(one)
    found = [bench.cycle() for _ in range(16)]
    if longest >= overflow:
        return
    assert bench.sdo[0x2012][1].raw == heard.count(False)
    for number, cycle in enumerate(found, bench.number - len(found) + 1):
        assert cycle is not None
        if cycle[1] & StatusBit.VALID:
            assert longest < 5
            assert cycle[0] / 8192 - before == pytest.approx(SPEED * number, abs=0.03)  # no table
    if longest >= 5:
        assert bench.sdo[0x2011][1].raw & StatusBit.LOST
        assert 0x7300 in bench.emergencies()
        assert bench.sdo[0x6503].raw == 1
    elif heard.count(False) <= 3 and overflow >= 20:
        assert bench.sdo[0x2011][1].raw == StatusBit.VALID


@given(before=st.integers(0, 40), overflow=st.integers(2, 40), unheard=st.integers(1, 3))
def test_samples_with_their_time_need_no_sync(before: int, overflow: int, unheard: int) -> None:
    """The interface has answered SYNCs that the module did not hear."""
    bench = Counted(overflow, times=True)
    begin = bench.count() - SPEED * bench.number
    for _ in range(before):
        bench.cycle()
    status = 0
    for n in range(unheard + 16):
        found = bench.cycle(n >= unheard, answered=True)
        assert found is not None
        status = found[1]
        assert not status & StatusBit.LOST
    assert status == StatusBit.VALID
    assert bench.count() - begin == pytest.approx(SPEED * bench.number, abs=0.03)  # no table


def test_a_module_that_stays_operational_without_a_bus_has_lost_its_position() -> None:
    bench = Counted()
    bench.sdo[0x1029][1].raw = 1
    for frame in bench.module.bus_off(bench.bus.now):
        bench.bus.send(frame)
    assert bench.module.state == 5
    bench.number += 500
    bench.cycle()
    bench.module.bus_back(bench.bus.now)
    for _ in range(30):
        found = bench.cycle()
        assert found is not None
        assert found[1] & StatusBit.LOST
        assert not found[1] & StatusBit.VALID
    bench.remote.nmt.state = "PRE-OPERATIONAL"
    bench.start()
    for _ in range(3):
        found = bench.cycle()
    assert found is not None
    assert found[1] == StatusBit.LOST, "it turns"
