"""A session on a desktop: master, interface and module are late now and then; sample times know when."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import pytest
from hypothesis import given, strategies as st
from module_bench import Bench

from canfb import objects as od
from canfb.cia301.frame import Frame
from canfb.cli.config_file import EXAMPLE
from canfb.configuration import parse_config
from canfb.module.feedback_module import FeedbackModule
from canfb.signal.supervision import LOST, VALID
from drawing import examples
from ideal_tracks import adc_pdo

SPARE_CYCLES = 0.1
ACCELERATION_RAD_S2 = 0.2


class Cycle(NamedTuple):
    """One SYNC: since the one before, ms; to its sample, from there to the PDO, ms."""

    apart_ms: float
    sampled_ms: float = 0.1
    sent_ms: float = 0.2


class Desktop:
    """The module of the example, and a machine that accelerates from standstill."""

    def __init__(self, started: bool = True, stamped: bool = True, sloppy_ms: float = 0.0) -> None:
        (config,) = parse_config(EXAMPLE).modules
        self.stamped, self.set_ticks, self.sloppy_ms = stamped, 0, sloppy_ms
        self.module, self.cycles_per_revolution = FeedbackModule(config), config.cycles_per_revolution
        self.synced_s = self.began_s = 1.5
        self.statuses: list[int] = []
        self.wrong = self.answers = self.origin = 0
        self.module.start(0.0)
        if started:
            self.module.receive(Frame(0, b"\x01\x00"), 1.0)

    def cycles_at(self, at_s: float) -> float:
        turned = 0.5 * ACCELERATION_RAD_S2 * (at_s - self.began_s) ** 2
        return turned * self.cycles_per_revolution / math.tau

    def play(self, cycles: Iterable[Cycle]) -> list[int]:
        """The status words of the PDOs after each sample."""
        frames: list[tuple[float, Frame, float | None]] = []
        for one in cycles:
            self.synced_s += 1e-3 * one.apart_ms
            frames.append((self.synced_s, Frame(0x80, b""), None))
            sampled_s = self.synced_s + 1e-3 * (one.sampled_ms + self.sloppy_ms * (len(frames) % 4 // 2))
            pdo = adc_pdo(self.cycles_at(sampled_s), time_s=sampled_s + 1e-7 * self.set_ticks)
            frames.append((sampled_s + 1e-3 * one.sent_ms, pdo, sampled_s))
        before = len(self.statuses)
        for at_s, frame, sample_s in sorted(frames, key=lambda entry: entry[0]):
            while (due := self.module.deadline()) is not None and due < at_s:
                self.judge(self.module.tick(due), None)
            stamp = at_s if self.stamped else None
            self.judge(self.module.receive(frame._replace(timestamp=stamp), at_s), sample_s)
        return self.statuses[before:]

    def judge(self, frames: Sequence[Frame], sampled_s: float | None) -> None:
        for frame in frames:
            if frame.can_id != 0x1A0:
                continue
            (status,) = struct.unpack_from("<H", frame.data, 4)
            self.statuses.append(status)
            feedback = self.module.feedback
            if status & VALID and sampled_s is not None and feedback is not None:
                position = feedback.cycles + feedback.phase
                if not self.answers:
                    self.origin = round(position - self.cycles_at(sampled_s))
                self.answers += 1
                self.wrong += abs(position - self.cycles_at(sampled_s) - self.origin) > SPARE_CYCLES

    def counter(self, place: tuple[int, int]) -> int:
        return int(self.module.dictionary.entry(*place).value)


EVEN = [Cycle(10.0)] * 60
AS_RECORDED = {
    "late sample": [Cycle(11.3, 0.6), Cycle(7.5, 4.5), Cycle(10.0, 0.1), Cycle(10.0, 0.1)],
    "late PDO, SYNC unheard": [Cycle(10.0, 0.1, 6.3), Cycle(19.0, 0.3, 0.2), Cycle(10.3)],
    "crowded samples": [Cycle(9.9, 2.2), Cycle(14.4, 0.8), Cycle(6.7, 9.2), Cycle(9.7, 0.1), Cycle(9.2)],
    "stall of 20 ms": [Cycle(30.75), Cycle(0.96), Cycle(8.39)],
    "stall, burst": [Cycle(41.0), Cycle(0.3), Cycle(0.3), Cycle(8.4)],
    "stall of 60 ms": [Cycle(60.6, 0.9), Cycle(6.0)],
    "stall, SYNC nearer to the next": [Cycle(36.2), Cycle(3.8), Cycle(10.1)],
    "SYNC heard late": [Cycle(19.0, -8.9, 9.2), Cycle(1.0)],
    "early SYNCs": [Cycle(18.0), Cycle(1.8), Cycle(10.2), Cycle(16.0), Cycle(7.9, 4.0), Cycle(7.9)],
}
UNEVEN = {
    "uneven": [14.3, 6.2, 6.7, 13.4, 11.7, 5.6, 9.4, 12.2, 9.5, 9.6, 8.7],
    "short first": [4.8, 10.8, 10.0, 9.9],
    "very short first": [0.6, 9.9, 0.3, 6.4, 10.3, 29.7, 1.7, 6.1, 8.0],
    "long first": [29.7, 1.7, 6.1, 8.0, 12.1, 14.5, 1.4],
    "producer that leaves out": [47.1, 9.9, 20.4, 9.8, 30.2, 10.1],
}
STARTS = {name: [Cycle(one) for one in apart] for name, apart in UNEVEN.items()}
STARTS["first SYNC heard late"] = [Cycle(16.0, -5.9, 6.2), Cycle(4.0)]


def turning(begin_s: float, stamped: bool = True, sloppy_ms: float = 0.0) -> Desktop:
    """A module that has followed its machine from standstill to its speed after so many seconds."""
    desktop = Desktop(stamped=stamped, sloppy_ms=sloppy_ms)
    desktop.play([Cycle(10.0)] * (10 + round(begin_s / 0.01)))
    return desktop


@pytest.mark.parametrize("host", [(True,), (False,), (True, 0.2)], ids=["stamped", "unstamped", "sloppy"])
@pytest.mark.parametrize("begin_s", [0.0, 2.0, 20.0], ids=lambda one: f"{one:g}s")
def test_what_sample_times_determine_is_not_lost(begin_s: float, host: tuple[Any, ...]) -> None:
    """At standstill, and at up to 30 cycles for each interval: only one that is late is ever in doubt."""
    desktop = turning(begin_s, *host)
    for name, cycles in AS_RECORDED.items():
        if not begin_s:
            desktop = turning(0.0, *host)
        for _ in range(3):
            statuses = desktop.play([*cycles, *EVEN])
            assert not any(status & LOST for status in statuses), (name, statuses)
        assert all(status & VALID for status in statuses[-30:]), name
        assert desktop.wrong == 0, name
    assert desktop.answers > 100


@pytest.mark.parametrize("start", [[Cycle(20.0)], *STARTS.values()], ids=["even", *STARTS])
def test_the_valid_bit_of_a_start_comes_once(start: list[Cycle]) -> None:
    """From the first sample on, whose interval says in which unit 2010:02 is; a start at standstill holds."""
    desktop = Desktop()
    statuses = desktop.play([*start, *EVEN])
    valid = [bool(status & VALID) for status in statuses]
    assert valid == sorted(valid)
    assert not valid[0]
    assert all(valid[-40:])
    assert not any(status & LOST for status in statuses)
    assert desktop.wrong == 0


@pytest.mark.parametrize("acceleration", [0.0, 1e-3])
@examples(60)
@given(late=st.lists(st.floats(0.0, 0.7), min_size=12, max_size=12))
def test_even_samples_hold_a_start_whose_syncs_are_heard_unevenly(
    acceleration: float, late: list[float]
) -> None:
    """The sample times are those of a busy host's own count: what it hears late makes them no less even."""
    bench = Bench(times=True)
    bench.sdo[0x2010][2].raw = acceleration
    bench.sdo[0x2010][6].raw = 200
    bench.start()
    now = bench.bus.now
    for number, part in enumerate(late):
        now = max(now + 1e-5, bench.bus.now + 1e-5, (number + 1 + part) * bench.interval_s)
        bench.bus.run_until(now)
        bench.sent(Frame(0x80, b"", timestamp=now))
        data = struct.pack("<hhI", 700, 1200, number * 10_000)
        _, status, _ = bench.position(bench.sent(Frame(0x190, data, timestamp=now)))
        about_to_tell = acceleration > 0.0 and number <= 6  # the next time may be uneven
        assert bool(status & VALID) is not about_to_tell, number
        assert not status & LOST


def test_crowded_samples_are_not_missed() -> None:
    """The answers to two SYNCs that are nearly one: the second one is left out, and nothing is missed."""
    desktop = turning(1.0)
    missed = desktop.counter(od.COUNTER_MISSED)
    assert all(status & VALID for status in desktop.play([Cycle(19.4), Cycle(0.6), *EVEN]))
    assert desktop.counter(od.COUNTER_MISSED) == missed


@pytest.mark.parametrize("stamped", [True, False])
@examples(40)
@given(
    ticks=st.one_of(st.integers(-100_000, -50_000), st.integers(50_000, 300_000), st.integers(2**19, 2**31)),
    cycles=st.integers(1, 3),
)
def test_a_clock_that_is_set_costs_no_cycle_unseen(stamped: bool, ticks: int, cycles: int) -> None:
    """By half an interval or more, in which the machine goes whole cycles: phases alone do not show it."""
    rate = ACCELERATION_RAD_S2 * Desktop().cycles_per_revolution / math.tau  # cycles/s^2
    desktop = turning(max(0.2, cycles / (rate * abs(ticks) * 1e-7)), stamped)
    desktop.set_ticks = ticks
    desktop.play(EVEN[:16])
    assert desktop.wrong == 0


@pytest.mark.parametrize("rate", [0.8, 0.6, 0.4, 0.2])
def test_synchronous_pdos_follow_every_sync_of_a_faster_master(rate: float) -> None:
    """Whatever the sampling makes of them."""
    bench = Bench()
    bench.sdo[0x1800][2].raw = 1
    bench.start()
    for _ in range(40):
        bench.sync()
        bench.counts(1500, 0)
    bench.interval_s *= rate
    for _ in range(20):
        sent = bench.sync()
        assert [frame.can_id for frame in sent].count(0x1A0) == 1
        bench.counts(1500, 0)


@pytest.mark.parametrize("counted", [True, False])
def test_no_pdo_follows_a_sync_that_is_the_one_before_again(counted: bool) -> None:
    """The same counter again, or no time for a frame between; each is counted."""
    bench = Bench()
    bench.sdo[0x1800][2].raw = 1
    if counted:
        bench.sdo[0x1019].raw = 20
    bench.start()
    for number in range(40):
        bench.bus.run_until(bench.bus.now + bench.interval_s)
        sync = Frame(0x80, bytes([number % 20 + 1]) if counted else b"", timestamp=bench.bus.now)
        assert any(frame.can_id == 0x1A0 for frame in bench.sent(sync))
        assert not any(frame.can_id == 0x1A0 for frame in bench.sent(sync)) or number < 8
        bench.counts(1500, 0)
    assert bench.sdo[0x2012][13].raw >= 30


def test_the_period_is_known_from_pre_operational_on() -> None:
    desktop = Desktop(started=False)
    desktop.play([Cycle(10.0)] * 8)
    assert desktop.module.interval_s == pytest.approx(0.01, rel=0.01)
