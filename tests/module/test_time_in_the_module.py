"""Time as the module sees it: frames with receive times, late, missing or twice; nothing wrong is valid."""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canfb.cia301.frame import Frame
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.signal.supervision import LOST, VALID
from ideal_tracks import counts_at

NODE, INTERFACE = 0x20, 0x10
PERIOD_S = 4e-3
ADC = 0.25  # periods from the SYNC to the ADC PDO
SPEED = 0.3  # cycles per period
TOLERANCE = 0.04  # cycle: the tracks without a table
UPLOAD_STATUS = Frame(0x600 + NODE, bytes.fromhex("4011200100000000"))
BOTH = pytest.mark.parametrize("stamped", [True, False], ids=["stamped", "unstamped"])
Motion = Callable[[float], float]


class Position(NamedTuple):
    """A position PDO: when it was sent, periods; the status word; position and truth, cycles.

    The truth is where the machine was at the SYNC of the last sample that was given.
    """

    at: float
    status: int
    cycles: float
    truth: float

    @property
    def valid(self) -> bool:
        return bool(self.status & VALID)


class Machine:
    """A module, and by hand the SYNCs and the samples of a machine whose position is known at any time."""

    def __init__(
        self,
        stamped: bool = True,
        motion: Motion = lambda at: SPEED * at,
        entries: dict[tuple[int, int], int] | None = None,
        times: bool = False,
    ) -> None:
        self.module = FeedbackModule(ModuleConfig(node_id=NODE, times=times))
        self.sample_bytes = 8 if times else 4
        for place, value in (entries or {}).items():
            self.module.dictionary.entry(*place).value = value
        self.stamped, self.motion = stamped, motion
        self.positions: list[Position] = []
        self.sampled = 0.0  # the SYNC of the last sample
        self.emergencies: list[tuple[float, int]] = []
        self.module.start(0.0)
        self.nmt(1, 0.0)

    def until(self, at: float) -> None:
        """Serve the deadlines up to this time, periods."""
        while (due := self.module.deadline()) is not None and due <= at * PERIOD_S:
            self._note(self.module.tick(due), due)

    def give(self, frame: Frame, at: float) -> list[Frame]:
        self.until(at)
        now = at * PERIOD_S
        sent = self.module.receive(frame._replace(timestamp=now if self.stamped else None), now)
        self._note(sent, now)
        return sent

    def _note(self, frames: list[Frame], now: float) -> None:
        for frame in frames:
            if frame.can_id == 0x180 + NODE:
                feedback = self.module.feedback
                cycles = math.nan if feedback is None else feedback.cycles + feedback.phase
                status = struct.unpack_from("<H", frame.data, 4)[0]
                truth = self.motion(self.sampled) - math.floor(self.motion(1))
                self.positions.append(Position(now / PERIOD_S, status, cycles, truth))
            elif frame.can_id == 0x80 + NODE:
                self.emergencies.append((now, struct.unpack_from("<H", frame.data)[0]))

    def nmt(self, command: int, at: float) -> None:
        self.give(Frame(0, bytes([command, NODE])), at)

    def sync(self, k: float) -> None:
        self.give(Frame(0x80, b""), float(k))

    def sample(self, k: float, at: float | None = None, off: float = 0.0) -> None:
        """The ADC PDO with the sample of SYNC k, usually a quarter of a period after it."""
        data = struct.pack("<hhI", *counts_at(self.motion(k) + off), round(k * PERIOD_S * 1e7))
        at = k + ADC if at is None else at
        self.until(at)
        self.sampled = k
        self.give(Frame(0x180 + INTERFACE, data[: self.sample_bytes]), at)

    def cycle(self, k: int) -> None:
        self.sync(k)
        self.sample(k)

    def give_all(self, frames: list[tuple[float, bool, float]]) -> None:
        """When each comes, whether it is a SYNC, and of an ADC PDO the SYNC that it answers."""
        for at, is_sync, k in sorted(frames):
            self.sync(at) if is_sync else self.sample(k, at)

    def run(self, first: int, after: int) -> list[Position]:
        before = len(self.positions)
        for k in range(first, after):
            self.cycle(k)
        return self.positions[before:]

    def status(self, at: float) -> int:
        """2011:01 by SDO."""
        (answer,) = (frame for frame in self.give(UPLOAD_STATUS, at) if frame.can_id == 0x580 + NODE)
        return int(struct.unpack_from("<H", answer.data, 4)[0])

    def counter(self, subindex: int) -> int:
        return int(self.module.dictionary.entry(0x2012, subindex).value)

    def right(self) -> bool:
        """No valid position is wrong."""
        return all(abs(one.cycles - one.truth) < TOLERANCE for one in self.positions if one.valid)


def ramped(speed: float) -> Motion:
    """From standstill to ``speed``, cycles per period, in 40 periods."""
    return lambda at: speed * (at * at / 80 if at < 40 else at - 20)


@BOTH
@pytest.mark.parametrize("periods", [2, 3, 5, 20])
def test_when_sync_stops_nothing_is_valid_after_so_many_periods(periods: int, stamped: bool) -> None:
    """Not in a TPDO of the event timer, and not by SDO."""
    machine = Machine(stamped, entries={(0x2010, 6): periods, (0x1800, 5): 1})
    machine.run(1, 60)
    limit = 59.0 + periods
    assert machine.status(limit - 0.05) & VALID
    assert not machine.status(limit + 0.01) & VALID
    machine.until(limit + 50)
    after = [one for one in machine.positions if one.at > limit + 0.01]
    assert len(after) > 40
    assert not any(one.valid for one in after)
    assert after[-1].status & LOST
    assert 0x7300 in [code for _, code in machine.emergencies]
    assert machine.right()


@BOTH
@pytest.mark.parametrize("off", [0.1, 0.4, 0.5])
def test_another_adc_pdo_for_the_same_sync_is_not_counted_as_a_sample(off: float, stamped: bool) -> None:
    """Of a second interface, or of a SYNC that only the interface heard: the position is not certain."""
    machine = Machine(stamped)
    machine.run(1, 60)
    machine.cycle(60)
    machine.sample(60, 60 + ADC + 0.2, off)
    assert machine.counter(8) == 1
    assert not machine.positions[-1].valid
    machine.run(61, 120)
    assert machine.right()


# What comes of a SYNC and its sample, SYNC by SYNC; and what is counted then, by sub-index of 2012h.
LOST_FRAMES = {
    "SYNC that nobody heard": (["none"], {1: 1}),
    "three of them": (["none"] * 3, {1: 3}),
    "SYNC that only the interface heard": (["sample"], {14: 1}),
    "two of them": (["sample"] * 2, {14: 2}),
    "three that only it heard": (["sample"] * 3, {14: 3}),
    "the same ADC PDO twice": (["twice"] * 30, {8: 30}),
    "an ADC PDO behind the next SYNC": (["sync", "late"], {8: 1}),
}


def play(machine: Machine, heard: list[str], first: int) -> None:
    for k, what in enumerate(heard, first):
        if what not in ("sample", "none"):
            machine.sync(k)
        if what == "late":
            machine.sample(k - 1, k + 0.02)
        if what not in ("sync", "none"):
            machine.sample(k)
        if what == "twice":
            machine.sample(k, k + ADC + 0.1)


@pytest.mark.parametrize("speed", [0.0, 0.3, 3.3])
@pytest.mark.parametrize("name", LOST_FRAMES)
def test_a_few_lost_or_doubled_frames_are_counted_and_the_position_goes_on(name: str, speed: float) -> None:
    heard, counted = LOST_FRAMES[name]
    machine = Machine(True, ramped(speed))
    machine.run(1, 100)
    play(machine, heard, 100)
    machine.run(100 + len(heard), 160)
    assert {subindex: machine.counter(subindex) for subindex in counted} == counted
    assert machine.right()
    assert all(one.valid for one in machine.positions[-20:])


@given(
    st.lists(st.sampled_from(["both", "sync", "sample", "none", "twice", "late"]), max_size=80),
    st.booleans(),
    st.sampled_from([0.0, 0.3, 3.3]),
)
@example(["both", "both", "sync", "sync", "sample"], False, 0.3)
@example(["none"] * 10, True, 0.3)
def test_whatever_is_lost_no_position_is_wrong(heard: list[str], stamped: bool, speed: float) -> None:
    machine = Machine(stamped, ramped(speed))
    if not stamped:  # an answer after more than a period is beyond 2010:0E, and without its time not seen
        heard = [what for what in heard if what != "late"]
    machine.run(1, 100)
    play(machine, heard, 100)
    machine.run(100 + len(heard), 120 + len(heard))
    assert machine.right()


@pytest.mark.parametrize("bad_each", [2, 3, 7])
def test_an_alarm_that_comes_and_goes_sends_ten_pairs_of_emcy_a_second(bad_each: int) -> None:
    machine = Machine(True, lambda at: 0.2)
    machine.run(1, 20)
    for k in range(20, 1020):
        machine.sync(k)
        if k % bad_each:
            machine.sample(k)
        else:
            machine.give(Frame(0x180 + INTERFACE, bytes(4)), k + ADC)
    seconds = 1000 * PERIOD_S
    codes = [code for _, code in machine.emergencies]
    assert 0 < codes.count(0x7300) <= 10 * seconds + 2
    assert codes.count(0x0000) <= 10 * seconds + 1
    assert codes[0] == 0x7300
    twice = [one for one, other in pairwise(codes) if one == other]
    losses = machine.counter(5)
    assert twice == [0x7300] * losses, "in turn; a loss is reported on its own"
    assert losses <= 1, "it stays lost"


@BOTH
@pytest.mark.parametrize("gap", [1, 2, 3, 10])
def test_a_synchronous_rpdo_over_a_gap(gap: int, stamped: bool) -> None:
    """The sample of SYNC k is taken at SYNC k + 1: after a gap it is one that nobody can place."""
    machine = Machine(stamped, entries={(0x1400, 2): 1})
    machine.run(1, 60)
    assert machine.positions[-1].valid
    machine.run(60 + gap, 120)
    assert machine.right()
    assert machine.counter(8) == 0
    first = next(one for one in machine.positions if one.at >= 60)
    assert not first.valid
    if stamped and gap < 3:
        assert all(one.valid for one in machine.positions[-20:])


@pytest.mark.parametrize("stamped", [True, False])
def test_the_same_counts_after_the_next_sync_was_due_may_be_another_sample(stamped: bool) -> None:
    """At whole cycles per period the answer to a SYNC that was not received looks like the one before."""
    machine = Machine(stamped, ramped(6.0))
    machine.run(1, 120)
    assert machine.status(119.5) & VALID
    machine.sample(119, 119.6)  # that one again: no SYNC was due
    assert machine.status(119.7) & VALID
    machine.sample(120, 120.1)
    assert not machine.status(120.12) & VALID
    machine.run(121, 140)
    assert machine.right()


@pytest.mark.parametrize("faster", [0.0005, 0.003, 0.01])
def test_an_interface_faster_than_sync_loses_the_position(faster: float) -> None:
    """More samples come than SYNCs: one of them is counted too little when the delay passes zero."""
    machine = Machine(motion=lambda at: 0.3 + 1e-3 * max(0.0, at - 50.0) ** 2)
    frames = [(float(k), True, 0.0) for k in range(1, 2000)]
    frames += [(at, False, at) for k in range(1, 2010) if (at := k / (1.0 + faster) + 0.6) < 2000.0]
    machine.give_all(frames)
    assert machine.positions[-1].status & LOST
    assert not [one for one in machine.positions if one.valid and abs(one.cycles - one.truth) > 0.5]


@BOTH
@given(times=st.booleans(), rate=st.sampled_from([0.025, 0.1, 0.5, 0.7, 2, 4, 10, 100]), late=st.booleans())
def test_samples_go_on_at_another_rate(times: bool, rate: float, late: bool, stamped: bool) -> None:
    """``late``: some ADC PDOs come after the next SYNC at first, and were counted as missed before."""
    machine, draw = Machine(stamped, lambda _at: 0.3, times=times), random.Random(1)
    frames: list[tuple[float, bool, float]] = []
    for first, apart in ((1.0, 1.0), (401.0, rate)):
        for k in range(300):
            at = first + k * apart
            delay = draw.uniform(0.3, 1.1) if late else ADC
            frames += [(at, True, at), (at + delay * min(apart, 1.0), False, at)]
    machine.give_all(frames)
    before = len(machine.positions)
    for k in range(300, 350):
        machine.sync(401 + k * rate)
        machine.sample(401 + k * rate, 401 + (k + ADC * min(1.0, 1.0 / rate)) * rate)
    assert len(machine.positions) - before >= 50 - late  # the first may be one too many for its SYNC
