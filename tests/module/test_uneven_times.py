"""A session on a desktop: master, interface and module are late now and then; sample times know when."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import pytest

from canfb import objects as od
from canfb.cia301.frame import Frame
from canfb.cli.config_file import EXAMPLE
from canfb.configuration import parse_config
from canfb.module.feedback_module import FeedbackModule
from canfb.signal.supervision import LOST, VALID

SPARE_CYCLES = 0.1
ACCELERATION_RAD_S2 = 0.2


class Cycle(NamedTuple):
    """One SYNC: since the one before, ms; from it to its sample, and from there to the PDO, ms."""

    apart_ms: float
    sampled_ms: float = 0.1
    sent_ms: float = 0.2
    heard: bool = True
    """The module hears this SYNC."""


class Desktop:
    """The module of the example, and a machine that accelerates from standstill."""

    def __init__(self) -> None:
        (config,) = parse_config(EXAMPLE).modules
        self.module = FeedbackModule(config)
        self.cycles_per_revolution = config.cycles_per_revolution
        self.synced_s = self.began_s = 1.5
        self.statuses: list[int] = []
        self.wrong = self.answers = 0
        self.origin = 0.0
        self.module.start(0.0)
        self.module.receive(Frame(0, b"\x01\x00"), 1.0)

    def cycles_at(self, at_s: float) -> float:
        turned = 0.5 * ACCELERATION_RAD_S2 * (at_s - self.began_s) ** 2
        return turned * self.cycles_per_revolution / math.tau

    def play(self, cycles: Iterable[Cycle]) -> list[int]:
        """The status words of the PDOs after each sample."""
        frames: list[tuple[float, Frame, float | None]] = []
        for one in cycles:
            self.synced_s += 1e-3 * one.apart_ms
            if one.heard:
                frames.append((self.synced_s, Frame(0x80, b""), None))
            sampled_s = self.synced_s + 1e-3 * one.sampled_ms
            angle = math.tau * self.cycles_at(sampled_s)
            data = struct.pack(
                "<hhI",
                round(1500 * math.sin(angle)),
                round(1500 * math.cos(angle)),
                round(sampled_s * 1e7) % 2**32,
            )
            frames.append((sampled_s + 1e-3 * one.sent_ms, Frame(0x190, data), sampled_s))
        before = len(self.statuses)
        for at_s, frame, sampled_s in sorted(frames, key=lambda entry: entry[0]):
            while (due := self.module.deadline()) is not None and due < at_s:
                self.judge(self.module.tick(due), None)
            self.judge(self.module.receive(frame._replace(timestamp=at_s), at_s), sampled_s)
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
    # The interface was late with a sample, and the SYNC after it early: 11.7, 5.6, 10.1 ms.
    "late sample": [Cycle(11.3, 0.6), Cycle(7.5, 4.5), Cycle(10.0, 0.1), Cycle(10.0, 0.1)],
    # The PDO was late, and one SYNC was not heard.
    "late PDO, SYNC unheard": [Cycle(10.0, 0.1, 6.3), Cycle(19.0, 0.3, 0.2), Cycle(10.3)],
    "crowded samples": [Cycle(9.9, 2.2), Cycle(14.4, 0.8), Cycle(6.7, 9.2), Cycle(9.7, 0.1), Cycle(9.2)],
    "stall of 20 ms": [Cycle(30.75), Cycle(0.96), Cycle(8.39)],
    "stall, burst": [Cycle(41.0), Cycle(0.3), Cycle(0.3), Cycle(8.4)],
    "stall of 60 ms": [Cycle(60.6, 0.9), Cycle(6.0)],
    "early SYNCs": [Cycle(18.0), Cycle(1.8), Cycle(10.2), Cycle(16.0), Cycle(7.9, 4.0), Cycle(7.9)],
}
STARTS = {
    "uneven": [14.3, 6.2, 6.7, 13.4, 11.7, 5.6, 9.4, 12.2, 9.5, 9.6, 8.7],
    "short first": [4.8, 10.8, 10.0, 9.9],
    "very short first": [0.6, 9.9, 0.3, 6.4, 10.3, 29.7, 1.7, 6.1, 8.0],
    "long first": [29.7, 1.7, 6.1, 8.0, 12.1, 14.5, 1.4],
    "producer that leaves out": [47.1, 9.9, 20.4, 9.8, 30.2, 10.1],
}


def turning(begin_s: float) -> Desktop:
    """A module that has followed its machine from standstill to its speed after so many seconds."""
    desktop = Desktop()
    desktop.play([Cycle(10.0)] * (10 + round(begin_s / 0.01)))
    return desktop


@pytest.mark.parametrize("begin_s", [0.0, 2.0, 10.0, 28.0], ids=lambda one: f"{one:g}s")
@pytest.mark.parametrize("name", AS_RECORDED)
def test_what_sample_times_determine_is_not_lost(name: str, begin_s: float) -> None:
    """At standstill, and at up to 22 cycles for each interval: only one that is late is ever in doubt."""
    desktop = turning(begin_s)
    for _ in range(3):
        statuses = desktop.play([*AS_RECORDED[name], *EVEN])
        assert not any(status & LOST for status in statuses), statuses
        assert all(status & VALID for status in statuses[-30:])
    assert desktop.wrong == 0
    assert desktop.answers > 100


@pytest.mark.parametrize("name", STARTS)
def test_an_uneven_start_at_standstill_holds(name: str) -> None:
    desktop = Desktop()
    statuses = desktop.play([Cycle(one) for one in STARTS[name]] + EVEN)
    assert not any(status & LOST for status in statuses), statuses
    assert all(status & VALID for status in statuses[-40:]), statuses
    assert desktop.wrong == 0


def test_crowded_samples_are_not_missed() -> None:
    """The answers to two SYNCs that are nearly one: the second one is left out, and nothing is missed."""
    desktop = turning(1.0)
    missed = desktop.counter(od.COUNTER_MISSED)
    statuses = desktop.play([Cycle(19.4), Cycle(0.6), *EVEN])
    assert all(status & VALID for status in statuses)
    assert desktop.counter(od.COUNTER_MISSED) == missed
