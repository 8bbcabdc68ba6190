"""Time as the module sees it: frames with receive times, late, missing or twice; nothing wrong is valid."""

import math
import random
import struct
from collections.abc import Callable
from itertools import accumulate, pairwise
from typing import Any, NamedTuple

import pytest
from hypothesis import example, given, strategies as st
from module_bench import SYNC, Bench

import canfb
from canfb.cia301.frame import Frame
from canfb.signal.supervision import EXTRAPOLATED, LOST, VALID
from folding import each
from ideal_tracks import adc_pdo

NODE, INTERFACE = 0x20, 0x10
UNITS = 8192  # of a cycle: 6501h
PERIOD_S = 4e-3
ADC = 0.25  # periods from the SYNC to the ADC PDO
SPEED = 0.3  # cycles per period
TOLERANCE = 0.04  # cycle: the tracks without a table
BOTH = pytest.mark.parametrize("stamped", [True, False], ids=["stamped", "unstamped"])
Motion = Callable[[float], float]


class Position(NamedTuple):
    """A position PDO: when it was sent, periods; the status word; position and truth, cycles; what it shows.

    The truth is where the machine was at the SYNC of the last sample that was given.
    """

    at: float
    status: int
    cycles: float
    truth: float
    shown: float

    @property
    def valid(self) -> bool:
        return bool(self.status & VALID)


class Machine(Bench):
    """A module, and by hand the SYNCs and the samples of a machine whose position is known at any time."""

    def __init__(
        self,
        stamped: bool = True,
        motion: Motion = lambda at: SPEED * at,
        entries: dict[tuple[int, int], float] | None = None,
        times: bool = False,
        overflow: int = 0,
        ran: int = 1,  # those before this period have come
    ) -> None:
        super().__init__(times=times)
        self.times, self.overflow = times, overflow
        self.sdo[0x1019].raw = overflow
        for (index, subindex), value in (entries or {}).items():
            self.sdo[index][subindex].raw = value
        self.stamped, self.motion = stamped, motion
        self.positions: list[Position] = []
        self.sampled = 0.0  # the SYNC of the last sample
        self.bus.observers.append(self._note)
        self.start()
        self.run(1, ran)

    def until(self, at: float) -> None:
        """Serve the deadlines up to this time, periods."""
        self.bus.run_until(at * PERIOD_S)

    def give(self, frame: Frame, at: float) -> None:
        self.until(at)
        self.sent(frame)

    def _note(self, frame: Frame, now: float) -> None:
        if frame.can_id == 0x180 + NODE:
            feedback = self.module.feedback
            cycles = math.nan if feedback is None else feedback.cycles + feedback.phase
            units, status = struct.unpack_from("<iH", frame.data)
            truth = self.motion(self.sampled) - math.floor(self.motion(1))
            self.positions.append(Position(now / PERIOD_S, status, cycles, truth, units / UNITS))

    def sync_at(self, k: float, at: float | None = None) -> None:
        self.give(self.sync_pdo(k), float(k) if at is None else at)

    def sync_pdo(self, k: float) -> Frame:
        return Frame(0x80, bytes([int(k - 1) % self.overflow + 1]) if self.overflow else b"")

    def sample(self, k: float, at: float | None = None, off: float = 0.0, time: float | None = None) -> None:
        """The ADC PDO with the sample of SYNC k, usually a quarter of a period after it."""
        at = k + ADC if at is None else at
        self.until(at)
        self.give(self.adc_pdo(k, off, time), at)

    def adc_pdo(self, k: float, off: float = 0.0, time: float | None = None) -> Frame:
        self.sampled = k
        time_s = (k if time is None else time) * PERIOD_S
        return adc_pdo(self.motion(k) + off, time_s=time_s if self.times else None)

    def cycle(self, k: float, at: float | None = None) -> None:
        self.sync_at(k, at)
        self.sample(k, None if at is None else at + ADC)

    def give_all(self, frames: list[tuple[float, bool, float]]) -> None:
        """When each comes, whether it is a SYNC, and of an ADC PDO the SYNC that it answers."""
        for at, is_sync, k in sorted(frames):
            self.sync_at(at) if is_sync else self.sample(k, at)

    def run(self, first: int, after: int) -> list[Position]:
        before = len(self.positions)
        for k in range(first, after):
            self.cycle(k)
        return self.positions[before:]

    def status(self, at: float) -> int:
        """2011:01 by SDO."""
        self.until(at)
        return int(self.sdo[0x2011][1].raw)

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
    machine = Machine(stamped, entries={(0x2010, 6): periods, (0x1800, 5): 1}, ran=60)
    limit = 59.0 + periods
    assert machine.status(limit - 0.05) & VALID
    assert not machine.status(limit + 0.01) & VALID
    machine.until(limit + 50)
    after = [one for one in machine.positions if one.at > limit + 0.01]
    assert len(after) > 40
    assert not any(one.valid for one in after)
    assert after[-1].status & LOST
    assert 0x7300 in machine.emergencies()
    assert machine.right()


@BOTH
@pytest.mark.parametrize("off", [0.1, 0.4, 0.5])
def test_another_adc_pdo_for_the_same_sync_is_not_counted_as_a_sample(off: float, stamped: bool) -> None:
    """Of a second interface, or of a SYNC that only the interface heard: the position is not certain."""
    machine = Machine(stamped, ran=60)
    machine.cycle(60)
    machine.sample(60, 60 + ADC + 0.2, off)
    assert machine.sdo[0x2012][8].raw == 1
    assert not machine.positions[-1].valid
    machine.run(61, 120)
    assert machine.right()


@pytest.mark.parametrize("speed", [0.0, 3.3])
def test_another_answer_delay_leaves_open_which_sync_is_answered(speed: float) -> None:
    machine = Machine(True, ramped(speed), ran=100)
    machine.sdo[0x2010][0x0E].raw = 2.2 * PERIOD_S
    for k in range(100, 103):
        machine.sync_at(k)
    machine.run(103, 160)
    assert machine.positions[-1].valid is not bool(speed)
    assert machine.right()


def test_a_sample_refused_as_an_old_one_leaves_no_older_one_valid() -> None:
    """A SYNC comes twice, and both are answered behind the next one; TPDO1 follows SYNC."""
    machine = Machine(False, ramped(0.9), {(0x1800, 2): 1}, times=True, ran=100)
    machine.give_all([(100, True, 100), (100.25, False, 100), (100.62, True, 100.62)])
    machine.give_all([(101, True, 101), (101.02, False, 100.62), (101.4, False, 101)])
    machine.run(102, 140)
    assert machine.right()


def test_the_late_answer_to_an_earlier_sync_is_not_that_of_the_last_one() -> None:
    """Also where samples come at every other place of their clock, behind a second producer."""
    machine = Machine(True, ramped(0.7), {(0x1800, 2): 1, (0x2010, 6): 3}, times=True, ran=100)
    for k in range(100, 106):
        machine.cycle(k)
        machine.cycle(k + 0.5)
    assert machine.run(106, 140)[-1].valid
    machine.give_all([(140, True, 140), (141, True, 141), (141.02, False, 140), (142, True, 142)])
    assert not machine.positions[-1].valid


@pytest.mark.parametrize("overflow", [0, 20])
@pytest.mark.parametrize(
    ("delay", "entries"), [(1.3, {(0x2010, 0x0E): 1.6 * PERIOD_S}), (0.6, {(0x2013, 2): 1})]
)
def test_an_extrapolated_position_is_that_of_its_sync(
    delay: float, entries: dict[tuple[int, int], float], overflow: int
) -> None:
    """One SYNC is not received, and the next comes just after it was overdue."""
    machine = Machine(True, ramped(0.9), {(0x1800, 2): 1, (0x2013, 1): 1} | entries, True, overflow)
    for k in range(1, 104):
        if k != 100:
            machine.sync_at(k, k + 0.001 * (k == 101))
        answered = k - int(delay)
        machine.sample(answered, answered + delay)
    shown = {one.at: one.shown for one in machine.positions if one.valid and one.status & EXTRAPOLATED}
    assert {98, 99, 103} < {round(at) for at in shown}
    assert all(abs(cycles - machine.motion(at)) < 0.1 for at, cycles in shown.items() if at > 50)


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
        if what.isdecimal():  # the transmission type of RPDO1
            machine.sdo[0x1400][2].raw = int(what)
        if what not in ("sample", "none"):
            machine.sync_at(k)
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
    machine = Machine(True, ramped(speed), ran=100)
    play(machine, heard, 100)
    machine.run(100 + len(heard), 160)
    assert {subindex: machine.sdo[0x2012][subindex].raw for subindex in counted} == counted
    assert machine.right()
    assert all(one.valid for one in machine.positions[-20:])


@given(
    st.lists(st.sampled_from(["both", "sync", "sample", "none", "twice", "late", "1", "255"]), max_size=80),
    st.booleans(),
    st.sampled_from([0.0, 0.3, 3.3]),
)
@example(["both", "both", "sync", "sync", "sample"], False, 0.3)
@example(["none"] * 10, True, 0.3)
@example(["1", *["both"] * 5, "255"], True, 3.3)  # a sample of type 1 comes a SYNC later
def test_whatever_is_lost_no_position_is_wrong(heard: list[str], stamped: bool, speed: float) -> None:
    machine = Machine(stamped, ramped(speed))
    if not stamped:  # an answer after more than a period is beyond 2010:0E, and without its time not seen
        heard = [what for what in heard if what != "late"]
    machine.run(1, 100)
    play(machine, heard, 100)
    machine.run(100 + len(heard), 120 + len(heard))
    assert machine.right()


@given(st.floats(0.05, 0.24), st.integers(101, 105), st.floats(0.0, 0.4), st.floats(0.02, 0.4))
@example(0.18, 102, 0.15, 0.05)
def test_late_adc_pdos_while_it_gathers_speed(bend: float, k: int, early: float, left: float) -> None:
    """One comes when that of the next SYNC is due, and the next before a third."""
    declared = {(0x2010, 0x0D): 0.6 * PERIOD_S, (0x2010, 0x0B): 0x4000}  # 0.25 cycle per interval^2
    machine = Machine(True, lambda at: bend * max(0.0, at - 100) ** 2 / 2, declared, ran=k)
    machine.give_all([(k, True, k), (k + 1 - early, True, k + 1), (k + 1 - early + ADC, False, k)])
    machine.sample(k + 1, k + 2 - min(left, early + 0.7 - ADC))
    machine.run(k + 2, k + 20)
    assert machine.right()


@given(st.integers(1, 9), st.floats(0.02, 0.1), st.floats(0.0, 8.0))
@example(6, 0.0553, 0.86)
def test_a_machine_that_begins_to_move_while_nobody_hears(gap: int, bend: float, begin: float) -> None:
    """And the host is late: its sample times alone are later, as those of a clock that was set."""
    machine = Machine(False, lambda at: bend * max(0.0, at - 99 - begin) ** 2 / 2, times=True, ran=100)
    for n in range(100, 130):
        machine.give_all([(n, True, n), (n + ADC, False, n + gap)])
    del machine.positions[:-25]  # whole cycles at the first of them are not seen
    assert machine.right()


@given(st.lists(st.booleans(), max_size=30), st.integers(2, 40))
@example([False] * 3, 20)
@example([False] * 5, 20)
@example([False] * 18, 20)
def test_every_sync_that_was_not_heard_is_counted(heard: list[bool], overflow: int) -> None:
    """A few are stepped over; many lose the position, and it is told."""
    machine = Machine(False, overflow=overflow, ran=9)
    longest = max((len(run) for run in "".join("01"[one] for one in heard).split("1")), default=0)
    for k, one in enumerate(heard, 9):
        if one:
            machine.cycle(k)
    found = machine.run(9 + len(heard), 25 + len(heard))
    if longest >= overflow:
        return
    assert machine.sdo[0x2012][1].raw == heard.count(False)
    assert machine.right()
    assert longest < 5 or not any(one.valid for one in found)
    if longest >= 5:
        assert found[-1].status & LOST
        assert 0x7300 in machine.emergencies()
        assert machine.sdo[0x6503].raw == 1
    elif heard.count(False) <= 3 and overflow >= 20:
        assert found[-1].status == VALID


@given(before=st.integers(0, 40), overflow=st.integers(2, 40), unheard=st.integers(1, 3))
def test_samples_with_their_time_need_no_sync(before: int, overflow: int, unheard: int) -> None:
    """The interface has answered SYNCs that the module did not hear."""
    machine = Machine(False, times=True, overflow=overflow, ran=9 + before)
    for k in range(9 + before, 9 + before + unheard):
        machine.sample(k)
    machine.run(9 + before + unheard, 25 + before + unheard)
    assert not any(one.status & LOST for one in machine.positions)
    assert machine.positions[-1].status == VALID
    assert machine.right()


def test_a_module_that_stays_operational_without_a_bus_has_lost_its_position() -> None:
    machine = Machine(False, overflow=20, ran=9)
    machine.sdo[0x1029][1].raw = 1
    for frame in machine.module.bus_off(machine.bus.now):
        machine.bus.send(frame)
    assert machine.module.state == 5
    machine.cycle(9)
    machine.module.bus_back(machine.bus.now)
    assert all(one.status & LOST and not one.valid for one in machine.run(10, 40))
    machine.start("PRE-OPERATIONAL")
    assert machine.run(40, 43)[-1].status == LOST, "it turns"


def test_a_sample_that_was_missed_unseen_loses_the_position_without_sync() -> None:
    """The second of two: the next sample comes shortly before this would show."""

    def motion(at: float) -> float:
        braked = min(max(0.0, at - 202.0), 10.0)
        return ramped(1.0)(at - braked) + braked * (1.0 - braked / 20.0) - max(0.0, at - 212.0)

    machine = Machine(False, motion, {(0x2010, 2): 15.8}, ran=1)
    for k in [*range(1, 200), *range(202, 300)]:
        machine.sample(k, k + {199: 0.3, 202: 0.25}.get(k, 0.1))
    assert machine.right()
    assert machine.positions[-1].status & LOST


@pytest.mark.parametrize("bad_each", [2, 3, 7])
def test_an_alarm_that_comes_and_goes_sends_ten_pairs_of_emcy_a_second(bad_each: int) -> None:
    machine = Machine(True, lambda at: 0.2, ran=20)
    for k in range(20, 1020):
        machine.sync_at(k)
        if k % bad_each:
            machine.sample(k)
        else:
            machine.give(Frame(0x180 + INTERFACE, bytes(4)), k + ADC)
    seconds = 1000 * PERIOD_S
    codes = machine.emergencies()
    assert 0 < codes.count(0x7300) <= 10 * seconds + 2
    assert codes.count(0x0000) <= 10 * seconds + 1
    assert codes[0] == 0x7300
    twice = [one for one, other in pairwise(codes) if one == other]
    losses = machine.sdo[0x2012][5].raw
    assert twice == [0x7300] * losses, "in turn; a loss is reported on its own"
    assert losses <= 1, "it stays lost"


@BOTH
@pytest.mark.parametrize("gap", [1, 2, 3, 10])
def test_a_synchronous_rpdo_over_a_gap(gap: int, stamped: bool) -> None:
    """The sample of SYNC k is taken at SYNC k + 1: after a gap it is one that nobody can place."""
    machine = Machine(stamped, entries={(0x1400, 2): 1}, ran=60)
    assert machine.positions[-1].valid
    machine.run(60 + gap, 120)
    assert machine.right()
    assert machine.sdo[0x2012][8].raw == 0
    first = next(one for one in machine.positions if one.at >= 60)
    assert not first.valid
    if stamped and gap < 3:
        assert all(one.valid for one in machine.positions[-20:])


@pytest.mark.parametrize("stamped", [True, False])
def test_the_same_counts_after_the_next_sync_was_due_may_be_another_sample(stamped: bool) -> None:
    """At whole cycles per period the answer to a SYNC that was not received looks like the one before."""
    machine = Machine(stamped, ramped(6.0), ran=120)
    assert machine.status(119.5) & VALID
    machine.sample(119, 119.6)  # that one again: no SYNC was due
    assert machine.status(119.7) & VALID
    machine.sample(120, 120.1)
    assert not machine.status(120.12) & VALID
    machine.run(121, 140)
    assert machine.right()


@BOTH
@pytest.mark.parametrize("faster", [0.0005, 0.003, 0.01, -0.0005, -0.003, -0.01])
@pytest.mark.parametrize("speed", [1.0, 2.0, 3.3])
def test_an_interface_at_another_rate_than_sync_loses_the_position(
    speed: float, faster: float, stamped: bool
) -> None:
    """More samples come than SYNCs, or fewer: one is counted too little or too often when the delay wraps."""
    ramp = 50.0 * speed

    def motion(at: float) -> float:
        return 0.3 + 0.01 * min(max(0.0, at - 50.0), ramp) ** 2 + speed * max(0.0, at - 50.0 - ramp)

    machine = Machine(stamped, motion)
    end = 500 + round(0.75 / abs(faster))  # the delay wraps when it has changed by 0.4 or 0.6 period
    frames = [(float(k), True, 0.0) for k in range(1, end)]
    frames += [(at, False, at) for k in range(1, 2 * end) if (at := k / (1.0 + faster) + 0.6) < end]
    machine.give_all(frames)
    assert machine.positions[-1].status & LOST
    assert not [one for one in machine.positions if one.valid and abs(one.cycles - one.truth) > 0.5]


@BOTH
@given(
    times=st.booleans(),
    rate=st.sampled_from([0.025, 0.1, 0.25, 0.5, 0.7, 2, 3, 4, 10, 100]),
    late=st.booleans(),
)
def test_samples_go_on_at_another_rate(times: bool, rate: float, late: bool, stamped: bool) -> None:
    """``late``: some ADC PDOs come after the next SYNC at first, and were counted as missed before.

    At rest the position stays valid, but for the silence of a slower one.
    """
    machine, draw = Machine(stamped, lambda _at: 0.3, times=times), random.Random(1)
    frames: list[tuple[float, bool, float]] = []
    for first, apart in ((1.0, 1.0), (301.0, rate)):
        for k in range(300):
            at = first + k * apart
            delay = draw.uniform(0.3, 1.1) if late else ADC
            frames += [(at, True, at), (at + delay * min(apart, 1.0), False, at)]
    machine.give_all(frames)
    before = len(machine.positions)
    for k in range(300, 350):
        machine.sync_at(301 + k * rate)
        machine.sample(301 + k * rate, 301 + (k + ADC * min(1.0, 1.0 / rate)) * rate)
    assert len(machine.positions) - before >= 50 - late  # the first may be one too many for its SYNC
    most = 3 if times and stamped else 2  # times slower: without a silence of 2010:03
    assert late or rate > most or all(one.valid for one in machine.positions[before if times else -1 :])


@given(
    st.sampled_from([0.025, 0.1, 0.25, 0.5, 0.7, 2, 3, 10]),
    st.floats(-0.09, 0.09),
    st.floats(10, 66),
    st.floats(0, 60),
    st.booleans(),
    st.integers(60, 73),
    st.integers(-3, 3),
)
@example(2, 0.08, 10.0, 50.0, True, 63, -1)  # the count is in intervals of the new rate, the time of the old
@example(0.1, 0.02, 10.0, 50.0, False, 60, 1)
def test_a_machine_that_moves_when_sync_changes_its_rate(
    rate: float, bend: float, begin: float, turn: float, stamped: bool, wrong: int, off: int
) -> None:
    """It leaves its rest, and turns back: no place in which it seems to stand makes a wrong count valid.

    Nor does a sample time that is wrong by whole periods, at the place of its count by chance; without
    receive times not where SYNC becomes slower (docs/time.md).
    """
    stamped = stamped or rate > 1

    def motion(at: float) -> float:
        away, back = min(max(0.0, at - begin), turn), max(0.0, at - begin - turn)
        return 0.3 - bend / max(1.0, rate) ** 2 * (away * away / 2.0 + turn * back - back * back / 2.0)

    machine = Machine(stamped, motion, times=True)
    for n, k in enumerate((*range(1, 61), *(60.0 + k * rate for k in range(1, 150)))):
        machine.sync_at(k)
        machine.sample(k, k + ADC * min(1.0, rate), time=k + off * (n == wrong))
    assert not [one for one in machine.positions if one.valid and abs(one.cycles - one.truth) > 0.5]


@given(
    st.sampled_from([0.25, 1 / 3, 0.5, 2 / 3, 2, 3, 4, 5]),
    st.sampled_from([0.1, 0.3, 1.0, 3.3, 7.7]),
    st.sampled_from([0, 10, 240]),
    st.integers(-3, 14),
    st.lists(st.sampled_from([-1.0, 1.0, 0.0]), min_size=1, max_size=3),
    st.sampled_from([0.0, 30e-6]),
)
@example(2 / 3, 1.0, 0, 5, [1.0], 0.0)
@example(2, 1.0, 0, 13, [-1.0], 30e-6)
def test_a_steady_machine_whose_sample_times_are_at_the_count_of_another_rate(
    rate: float, speed: float, overflow: int, first: int, off: list[float], noise_s: float
) -> None:
    """Where a period more or less shows as much the same phase: the receptions say that they are wrong.

    Those that are not exact say it once a time was right on the new grid of SYNC.
    """
    first = max(first, 6) if noise_s else first
    machine = Machine(True, ramped(speed), times=True, overflow=overflow)
    for n, k in enumerate((*range(1, 91), *(90.0 + k * rate for k in range(1, 80))), -89):
        machine.sync_at(n + 90, k + random.Random(n).random() * noise_s / PERIOD_S)
        wrong = off[n - first] if 0 <= n - first < len(off) else 0.0
        machine.sample(k, k + ADC * min(1.0, rate), time=k + wrong)
    assert machine.right()


@given(
    st.lists(st.tuples(st.floats(1.0, 8.0), st.integers(1, 40), st.floats(0.0, 0.3)), min_size=3, max_size=6),
    st.sampled_from([0.3, 3.3, 7.7]),
)
@example([(1.0, 40, 0.0), (3.0, 10, 0.0), (2.0, 40, 0.0)], 7.7)
def test_an_interface_whose_clock_is_sync_may_be_in_slow_motion(
    paces: list[tuple[float, int, float]], speed: float
) -> None:
    """As that of ``canfb simulate --pace sync``: a period for each SYNC, which waits for all at first."""
    machine = Machine(True, lambda k: ramped(speed)(max(0, k - 30)), {(0x2010, 6): 200}, times=True)
    apart = [pace * (1.0 + rough * (n % 3)) for pace, syncs, rough in paces for n in range(syncs)]
    for k, at in enumerate(accumulate([1.0, 25.0, 25.0, *apart]), 1):
        machine.cycle(k, at)
    assert machine.right()
    assert not any(one.status & LOST for one in machine.positions)


@given(
    st.floats(0.03, 0.3), st.integers(1, 40), st.floats(0.0, 1.0), st.booleans(), st.booleans(), st.booleans()
)
@example(0.03, 1, 0.9375, False, False, False)  # four samples within 0.05 cycle of the phase before the pause
def test_a_machine_that_begins_to_move_in_a_pause_is_lost(
    speed: float, cycles: int, more: float, stamped: bool, times: bool, activated: bool
) -> None:
    """Its phase does not show it where it is whole cycles further when samples come again."""
    length = 2.0 * (cycles + more * (more > 0.5)) / speed

    def motion(at: float) -> float:
        moved = min(max(0.0, at - 100.0), length)
        return speed * (moved * moved / length / 2.0 + max(0.0, at - 100.0 - length))

    machine = Machine(stamped, motion, times=times, ran=100)
    machine.until(100)
    machine.remote.nmt.state = "PRE-OPERATIONAL"
    if activated:
        machine.sdo[0x2020][3].raw = 0
    machine.until(99.5 + length)
    machine.start()
    again = machine.run(100 + math.ceil(length), 130 + math.ceil(length))
    assert not [one for one in again if one.valid]


DISTURBED = (
    "SYNC lost", "PDO lost", "both lost", "PDO late", "PDO twice", "SYNC extra", "counter", "host late",
)  # fmt: skip


@given(
    st.integers(0),
    st.booleans(),
    st.sampled_from([1, 255]),
    st.booleans(),
    st.sampled_from([0, 20, 240]),
    st.sampled_from(DISTURBED),
)
def test_at_rest_only_silence_loses_the_position(
    seed: int, stamped: bool, kind: int, times: bool, overflow: int, disturbed: str
) -> None:
    """Not with an extra SYNC where RPDO1 is synchronous: its sample is taken at that."""
    entries: dict[tuple[int, int], float] = {} if disturbed == "SYNC extra" else {(0x1400, 2): kind}
    machine = Machine(stamped and disturbed != "host late", lambda _at: 0.3, entries, times, overflow)
    draw = random.Random(seed)
    host = 0.0  # until when no frame is read, though deadlines are served
    for k in range(1, 150):
        now = disturbed if k > 60 and not k % 20 else ""
        host = max(host, k + draw.uniform(0.1, 1.9) * (now == "host late"))
        number = k + draw.choice([1, 2, 5, -1]) * (now == "counter")
        if now not in ("SYNC lost", "both lost"):
            machine.sync_at(number, max(k, host))
        for _ in range((now not in ("PDO lost", "both lost")) + (now == "PDO twice")):
            late = draw.uniform(0.0, 0.6) * (now == "PDO late")
            machine.sample(k, max(k + ADC + late, host))
        if now == "SYNC extra":
            machine.sync_at(k + draw.uniform(0.3, 0.98))
    assert not [one for one in machine.positions if one.status & LOST]


FAST_S, N = 1e-3, 2500  # period of SYNC, cycles per revolution


def turning(
    rpm: float, jitter_us: float, syncs: int = 3000, stamped: bool = True, times: bool = False
) -> tuple[list[str], canfb.FeedbackModule]:
    """Warnings of a module whose encoder is sampled at SYNCs that jitter uniformly, up to speed in 1 s."""
    bench = Bench(times=times)
    bench.stamped = stamped
    warnings: list[str] = []
    bench.module.on_warning = warnings.append
    bench.start()
    draw = random.Random(4)
    speed = rpm / 60.0 * N
    for k in range(1, syncs):
        now = k * FAST_S + draw.uniform(-jitter_us, jitter_us) * 1e-6
        cycles = speed * (now * now / 2.0 if now < 1.0 else now - 0.5)
        bench.bus.run_until(now)
        bench.sent(SYNC)
        bench.bus.run_until(now + 3e-4)
        bench.sent(adc_pdo(cycles, time_s=now if times else None))
    return warnings, bench.module


@pytest.mark.parametrize(("jitter_us", "rpm"), [(10.0, 160.0), (30.0, 52.0), (60.0, 27.0)])
def test_a_speed_near_the_limit_is_warned_of_once(jitter_us: float, rpm: float) -> None:
    warnings, module = turning(rpm, jitter_us)
    assert len(warnings) == 1
    assert "remedy: times: true" in warnings[0]
    assert module.feedback is not None
    assert module.feedback.valid


@each("rpm, jitter_us, stamped, times", [
    (60.0, 10.0, True, False),  # far below
    (160.0, 10.0, False, False),  # not measured: the time of the call says nothing of SYNC
    (1500.0, 100.0, True, True),  # sample times
])  # fmt: skip
def test_nothing_is_said_without_need(rpm: float, jitter_us: float, stamped: bool, times: bool) -> None:
    assert turning(rpm, jitter_us, stamped=stamped, times=times)[0] == []


@given(st.floats(1.0, 1e5), st.floats(1e-7, 1e-2), st.floats(0.01, 0.5))
def test_the_largest_speed_uses_up_the_limit(cycles: float, jitter_s: float, limit: float) -> None:
    speed = canfb.max_speed(cycles, jitter_s, limit) * cycles / (2.0 * math.pi)  # cycles/s
    assert 4.0 * speed * jitter_s == pytest.approx(limit)


@pytest.mark.parametrize("bad", [(0.0, 1e-6), (2500, 0.0), (2500, math.nan), (math.inf, 1e-6)])
def test_what_is_no_machine_is_refused(bad: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="must be positive"):
        canfb.max_speed(*bad)
    with pytest.raises(ValueError, match="residual_limit"):
        canfb.max_speed(2500, 1e-6, 0.6)


def test_the_speeds_at_the_start_are_those_of_the_page() -> None:
    def words(**fields: Any) -> str:
        return canfb.FeedbackModule(canfb.ModuleConfig(node_id=32, **fields)).speed_limit()

    assert words().endswith("200 rpm at ±10 µs, 20 rpm at ±100 µs")
    assert words(max_acceleration_rad_s2=0.25).endswith("30 rpm at ±10 µs, 3 rpm at ±100 µs")  # L - a is 4 e
    assert words(times=True) == words(samples_per_sync=2) == ""
    assert turning(60.0, 0.0, 500)[1].max_speed_rad_s == math.inf, "the rounding of times is no jitter"


def creeping(speed: float) -> Motion:
    """From standstill to ``speed``, cycles per period, in 5 periods."""
    return lambda at: speed * (max(at - 1.0, 0.0) ** 2 / 10.0 if at < 6.0 else at - 3.5)


@pytest.mark.parametrize(("stamped", "overflow"), [(True, 0), (True, 2), (True, 10), (False, 0), (False, 10)])
def test_two_periods_before_theirs_is_known_lose_the_position(stamped: bool, overflow: int) -> None:
    machine = Machine(stamped, creeping(0.5), overflow=overflow)
    machine.module.dictionary.entry(0x1006).value = 0 if stamped else round(PERIOD_S * 1e6)
    machine.run(1, 6)
    for k in range(8, 60):
        machine.sync_at(k - 2, k)
        machine.sample(k)
    assert machine.right()


@pytest.mark.parametrize("times", [False, True])
@pytest.mark.parametrize("overflow", [0, 10])
def test_a_pause_that_waits_for_a_late_host_is_as_long_as_it_was(times: bool, overflow: int) -> None:
    """NMT stop and start, and all frames beside them, in one burst of a host that has slept 12 periods."""
    machine = Machine(False, creeping(0.1), times=times, overflow=overflow, ran=60)
    machine.bus.now = 72.0 * PERIOD_S  # and no deadline was served
    for k in range(60, 72):
        for command in {61: [2], 70: [1]}.get(k, []):
            machine.sent(Frame(0, bytes([command, NODE])))
        machine.sent(machine.sync_pdo(k))
        machine.sent(machine.adc_pdo(k))
    machine.run(72, 100)
    assert machine.right()


def test_an_answer_to_a_sync_before_the_start_is_none_after_it() -> None:
    """Behind 8 SYNCs, as 2010:0E declares; NMT stop and start just before it."""
    machine = Machine(True, creeping(0.1))
    machine.sdo[0x2010][14].raw = 8.65 * PERIOD_S
    for k in range(1, 160):
        if k == 100:
            machine.give(Frame(0, bytes([2, NODE])), k + 0.25)
            machine.give(Frame(0, bytes([1, NODE])), k + 0.27)
        if k > 8:
            machine.sample(k - 8, k + 0.3)
        machine.sync_at(k + 1)
    assert machine.right()


@pytest.mark.parametrize("ended_by", ["silence", "a late host", "bus-off", "another RPDO"])
def test_nothing_valid_is_sent_on_request_when_sync_has_stopped(ended_by: str) -> None:
    entries: dict[tuple[int, int], float] = {(0x1029, 1): 1, (0x1800, 1): 0x800001A0, (0x1800, 2): 252}
    machine = Machine(True, creeping(0.1), entries)
    machine.sdo[0x1800][1].raw = 0x1A0
    machine.run(1, 60)
    for at, answers in ((60.0, 1), (80.0, 0)):
        machine.until(at if ended_by == "silence" else 60.0)
        sent = machine.module.receive(Frame(0x180 + NODE, b"", True), at * PERIOD_S)
        assert sum(frame.can_id == 0x180 + NODE for frame in sent) == answers
        if ended_by == "bus-off":
            machine.module.bus_off(at * PERIOD_S)
        if ended_by == "another RPDO":
            machine.sdo[0x1400][1].raw = 0x80000190


def test_a_sync_off_the_grid_is_that_of_its_own_sample() -> None:
    """A synchronous RPDO: the sample that waits for it is of the SYNC before."""
    machine = Machine(True, ramped(0.8), entries={(0x1400, 2): 1})
    for k in (*range(1, 60), 60.3, 61.35, *range(62, 110)):
        machine.cycle(k)
    assert machine.right()
    assert machine.positions[-1].valid


def with_flags(motion: Motion, entries: dict[tuple[int, int], float] | None = None) -> Machine:
    """The flags of a sample come in RPDO2."""
    machine = Machine(True, motion, entries)
    machine.remote.nmt.state = "PRE-OPERATIONAL"
    machine.map_rpdo2(0x20000608)
    machine.start()
    return machine


def test_a_part_that_waits_for_sync_ends_its_sample_before_those_that_are_missing() -> None:
    machine = with_flags(creeping(0.25), {(0x2010, 3): 9, (0x2010, 6): 10, (0x1401, 2): 1})
    for k in (*range(1, 60), *range(63, 110)):
        machine.cycle(k)
        machine.sent(Frame(0x290, b"\0"))
    assert all(abs(one.cycles - one.truth) < 0.5 for one in machine.positions[70:] if one.valid)


@each("speed, times, overflow, syncs, counted", [
    # Between two places, nearer to the next; the next one is not at its place either.
    (0.9, False, 20, [(100, 100), (100.84, None), (101, 101), (102.16, 102)], (13, 1)),
    # It comes just before two periods without one are over: the sample that waited is of either.
    *((speed, True, 0, [(100.99, 101)], (1, 2)) for speed in (0.3, 0.9, 3.3)),
    # An extra one takes over the sample which the next one would have.
    (0.9, True, 0, [(100, 100), (100.4, None)], (1, 0)),
])  # fmt: skip
def test_the_position_goes_on_behind_disturbed_syncs(
    speed: float, times: bool, overflow: int, syncs: list[tuple[float, int | None]], counted: tuple[int, int]
) -> None:
    """Each with the sample behind it; those with times come in a synchronous RPDO."""
    machine = Machine(True, ramped(speed), {(0x1400, 2): 1} if times else {}, times, overflow, ran=100)
    for at, answered in syncs:
        machine.sync_at(at)
        if answered is not None:
            machine.sample(answered, at + ADC)
    assert machine.run(round(at) + 1, 140)[-1].valid
    assert machine.right()
    assert machine.sdo[0x2012][counted[0]].raw == counted[1]


def test_the_tracks_of_a_sample_twice_before_its_other_part_are_the_same_adc_pdo() -> None:
    """Which of them belong together is open, not how many intervals passed."""
    machine = with_flags(ramped(0.9))
    for k in range(1, 140):
        machine.cycle(k)
        if k == 100:
            machine.sample(k, k + 0.3)
        machine.sent(Frame(0x290, b"\0"))
    assert machine.right()
    assert machine.positions[-1].valid


@pytest.mark.parametrize("kind", [1, 255])
@pytest.mark.parametrize("speed", [0.1, 0.2, 0.3])
def test_one_sync_off_the_grid_does_not_lose_a_slow_machine_of_known_acceleration(
    speed: float, kind: int
) -> None:
    """Its sample is no good one where it is further off than 2010:0C, which no contradiction has to show."""
    rad_s2 = 1.3 * speed / 40.0 * 2.0 * math.pi / 2500.0 / PERIOD_S**2
    for late in (-0.35, -0.2, 0.13, 0.3):
        machine = Machine(True, ramped(speed), {(0x1400, 2): kind, (0x2010, 2): rad_s2}, ran=100)
        machine.sync_at(100, 100 + late)
        machine.sample(100 + late)
        assert machine.run(101, 140)[-1].valid
        machine.run(140, 160)
        assert machine.run(161, 190)[-1].valid  # a SYNC that was lost
        assert machine.right()
