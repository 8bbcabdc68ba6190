"""Late, uneven and missing frames, on a desktop and at starts in motion: nothing that is valid is wrong."""

import math
import random
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import example, given, strategies as st
from module_bench import Bench

from canfb import FeedbackModule, Frame, ModuleConfig, objects as od
from canfb.cli.config_file import EXAMPLE
from canfb.configuration import parse_config
from canfb.signal.supervision import LOST, VALID
from drawing import examples
from ideal_tracks import adc_pdo, counts_at
from judged_session import Judge, TrueMotion

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
STARTS = {name: [Cycle(one) for one in apart] for name, apart in UNEVEN.items()} | {
    "first SYNC heard late": [Cycle(16.0, -5.9, 6.2), Cycle(4.0)]
}


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


# A machine that turns already when its module starts, and sample times at a SYNC that jitters.

N, PERIOD_S, JITTER_S, SEEDS = 2500, 1e-3, 80e-6, 12
RAD_S2 = 2.0 * math.pi / N / PERIOD_S**2  # of one cycle per period^2


@dataclass
class Start:
    """What is known at a start, and what does not come of it: numbers of samples."""

    nominal: bool = False
    stamps: bool = False
    counter: bool = False
    heard_before: int = 0
    lost: tuple[int, ...] = ()
    flagged: tuple[int, ...] = ()


def wrong_and_right(
    start: Start, acceleration: float, seed: int, samples: int = 40
) -> tuple[list[int], bool]:
    """Samples whose position is valid and wrong, counted from 1, and whether it is right at the end."""
    rng = np.random.default_rng(seed)
    config = ModuleConfig(
        node_id=32, encoder_interface=16, times=True, max_acceleration_rad_s2=acceleration * RAD_S2
    )
    module = FeedbackModule(config)
    module.start(0.0)
    if start.nominal:  # 1006h by SDO
        module.receive(Frame(0x620, struct.pack("<BHBI", 0x23, 0x1006, 0, round(PERIOD_S * 1e6))), 0.5)
    speed = float(rng.uniform(2.0, 125.0)) * float(rng.choice((-1.0, 1.0)))
    bend = 0.5 * acceleration * float(rng.uniform(-1.0, 1.0))
    ticks_before = int(rng.integers(1 << 32))
    first, wrong, right = None, [], False
    for number in range(-start.heard_before, samples):
        at_s = 1.0 + number * PERIOD_S + float(rng.uniform(-JITTER_S, JITTER_S))
        if number == 0:
            module.receive(Frame(0x000, bytes([1, 32])), 1.0 - 0.5 * PERIOD_S)
        sampled_s = at_s + 20e-6
        time = (sampled_s - 1.0) / PERIOD_S
        position = 0.3 + speed * time + 0.5 * bend * time * time
        host_s = rng.uniform(10e-6, 80e-6, 2)
        while (due := module.deadline()) is not None and due < at_s + host_s[0]:
            module.tick(due)
        counter = bytes([number % 240 + 1]) if start.counter else b""
        module.receive(Frame(0x080, counter, timestamp=at_s if start.stamps else None), at_s + host_s[0])
        if number in start.lost or number < 0:
            continue
        size = 0.0 if number in start.flagged else 1500.0
        tracks = [size * turn(2.0 * math.pi * position) for turn in (math.sin, math.cos)]
        noisy = [round(one + rng.normal(0.0, 0.5)) for one in tracks]
        data = struct.pack("<hhI", *noisy, (int(sampled_s * 1e7) + ticks_before) % 2**32)
        came_s = sampled_s + 200e-6
        pdo = Frame(0x190, data, timestamp=came_s if start.stamps else None)
        for frame in module.receive(pdo, came_s + host_s[1]):
            if frame.can_id != 0x1A0 or not struct.unpack_from("<H", frame.data, 4)[0] & VALID:
                continue
            feedback = module.feedback
            assert feedback is not None
            off = round(feedback.cycles + feedback.phase - position)
            first = off if first is None else first
            right = off == first
            if not right:
                wrong.append(number + 1)
    return wrong, right


@pytest.mark.parametrize(
    "start",
    [
        *(Start(), Start(stamps=True), Start(nominal=True), Start(counter=True, lost=(1,))),
        *(Start(heard_before=3), Start(heard_before=20), Start(lost=(1,)), Start(lost=(2, 3))),
        *(Start(nominal=True, lost=(2, 3)), Start(nominal=True, lost=(6,))),
        *(Start(flagged=(0,)), Start(flagged=(1,))),
    ],
    ids=str,
)
def test_no_start_in_motion_is_valid_before_its_speed_is_known(start: Start) -> None:
    """The first interval is even where it is the unit of all others: it proves nothing."""
    for seed in range(SEEDS):
        wrong, _ = wrong_and_right(start, (0.01, 0.05, 0.1)[seed % 3], seed)
        assert not wrong, f"start {seed}: wrong at sample {wrong[0]}"


@pytest.mark.parametrize(
    ("start", "acceleration", "least"),
    [(Start(), 0.01, SEEDS), (Start(nominal=True, lost=(6,)), 0.05, SEEDS - 1)],
    ids=str,
)
def test_a_start_in_motion_is_right_soon(start: Start, acceleration: float, least: int) -> None:
    """Where no period was known, and with the count of the first sample where one was missed."""
    assert sum(wrong_and_right(start, acceleration, seed, 80)[1] for seed in range(SEEDS)) >= least


@pytest.mark.parametrize("speed", [0.0, 3.0])
def test_a_start_that_is_about_to_be_confirmed_is_no_emergency(speed: float) -> None:
    """Sample times contradict the start of a machine that turns: that one is reported."""
    rng = np.random.default_rng(3)
    config = ModuleConfig(
        node_id=32, encoder_interface=16, times=True, autostart=True, max_acceleration_rad_s2=0.01 * RAD_S2
    )
    module = FeedbackModule(config)
    module.start(0.0)
    emergencies, statuses = [], []
    for number in range(40):
        at_s = 1.0 + number * PERIOD_S + float(rng.uniform(-JITTER_S, JITTER_S))
        pdo = adc_pdo(0.3 + speed * at_s / PERIOD_S, time_s=at_s)
        sent = module.receive(Frame(0x080, b""), at_s) + module.receive(pdo, at_s + 1e-4)
        emergencies += [frame.data[:2] for frame in sent if frame.can_id == 0xA0]
        assert module.feedback is not None
        statuses.append(module.feedback.status)
    assert not statuses[3] & VALID
    assert statuses[-1] & VALID
    assert bool(emergencies) is (speed != 0.0)


# ADC PDOs that come behind later SYNCs, as 2010:0E declares: each is the sample of its own.

SPREAD_S, SYNC_JITTER_S, SPEED = 60e-6, 5e-6, 3.3
SYNCS, LEARNED = 200, 40
UNITS_PER_CYCLE = 8192


def cycles_at(at_s: float) -> float:
    """From standstill to SPEED, cycles per period, at no more than 0.03 cycles per period squared."""
    periods = max(0.0, at_s / PERIOD_S - LEARNED)
    return SPEED * (periods + 120.0 * math.expm1(-periods / 120.0))


def session(
    seed: int, delay: float, lost: float, answered: int = SYNCS, **fields: Any
) -> tuple[list[int], list[float]]:
    """Status words of TPDO1, and how far valid positions are off, cycles."""
    draw, frames = random.Random(seed), []
    declared_s = delay * PERIOD_S + SPREAD_S + draw.uniform(0.0, 0.5) * PERIOD_S
    module = FeedbackModule(ModuleConfig(node_id=32, autostart=True, answer_delay_s=declared_s, **fields))
    module.start(0.0)
    for number in range(SYNCS):
        synced_s = (number + 1) * PERIOD_S + draw.uniform(-SYNC_JITTER_S, SYNC_JITTER_S)
        answered_s = synced_s + delay * PERIOD_S + draw.uniform(0.0, SPREAD_S)
        if draw.random() >= lost:
            frames.append((synced_s, synced_s, Frame(0x80, b"")))
        if draw.random() >= lost and number < answered:
            answer = adc_pdo(cycles_at(synced_s), time_s=synced_s if module.config.times else None)
            frames += [(answered_s, synced_s, answer)] * (1 + (number == LEARNED // 2))
    statuses, errors = [], []
    for at_s, synced_s, frame in sorted(frames, key=lambda one: one[0]):
        while (due_s := module.deadline() or math.inf) < at_s:
            module.tick(due_s)
        for sent in module.receive(frame._replace(timestamp=at_s), at_s):
            kind, (position,) = sent.can_id & 0x780, struct.unpack_from("<I", sent.data)
            status = module.feedback.status if module.feedback else 0
            statuses += [status] * (kind == 0x180)
            # TPDO1 is of the sample, TPDO2 of the SYNC; where one is missing it may not be extrapolated.
            if (kind == 0x180 and frame.data) or (kind == 0x280 and not lost):
                errors += [abs(position / UNITS_PER_CYCLE - cycles_at(synced_s))] * (status & VALID)
    return statuses, errors


@examples(40)
@given(st.integers(0), st.floats(0.02, 2.5), st.booleans(), st.sampled_from([0.0, 0.02, 0.1]))
def test_no_answer_is_that_of_another_sync(seed: int, delay: float, times: bool, lost: float) -> None:
    statuses, errors = session(seed, delay, lost, times=times, predict=1)
    assert all(error < 0.5 for error in errors)
    if not lost:
        while_syncs_come = statuses[:-4]
        assert not any(status & LOST for status in while_syncs_come)
        assert all(status & VALID for status in while_syncs_come[LEARNED:])


@pytest.mark.parametrize("times", [False, True])
@pytest.mark.parametrize("delay", [0.1, 0.98, 1.6])
def test_answers_that_stop_are_missed(delay: float, times: bool) -> None:
    statuses, errors = session(1, delay, 0.0, SYNCS - 10, times=times, predict=1)
    assert [bool(status & VALID) for status in statuses] == [at < SYNCS - 10 for at in range(len(statuses))]
    assert statuses[-1] & LOST
    assert all(error < 0.5 for error in errors)


# The first session of the README, where any program on the computer may stand still for any time.

CONFIG = parse_config(EXAMPLE)
SESSION_PERIOD_S, SECONDS = 0.01, 10.0


def late_s(draw: random.Random, load: float) -> float:
    return draw.expovariate(50.0 if draw.random() < load else 2000.0)


def frames(draw: random.Random, load: float) -> list[tuple[float, float | None]]:
    """When each is sent: a SYNC, or the PDO of a sample taken at the second of the times."""
    sent: list[tuple[float, float | None]] = []
    due_s = at_s = 0.5
    while due_s < SECONDS:
        at_s = max(due_s, at_s + 1e-4) + late_s(draw, load)
        sampled_s = at_s + draw.expovariate(20000.0)
        sent_s = sampled_s + draw.expovariate(5000.0) + (late_s(draw, load) if draw.random() < 0.05 else 0.0)
        at_s += draw.expovariate(1e4)
        sent += [(at_s, None), (max(at_s + 5e-5, sent_s + draw.expovariate(1e4)), sampled_s)]
        at_s = sent[-1][0]
        due_s += SESSION_PERIOD_S * max(1, math.floor((at_s - due_s) / SESSION_PERIOD_S))
    return sent


@examples(15)
@example(1_413_611_192_142, 0.1, False, True)
@given(st.integers(0), st.sampled_from([0.01, 0.03, 0.1]), st.booleans(), st.booleans())
def test_no_position_is_valid_and_wrong(seed: int, load: float, stamped: bool, lost: bool) -> None:
    """With receive times one sample time in 50 is wrong by half a period to three, or the clock is set."""
    draw, module, judge = random.Random(seed), FeedbackModule(CONFIG.modules[0]), Judge(TrueMotion(CONFIG))
    module.start(0.0)
    module.receive(Frame(0, b"\x01\x00"), 0.1)
    begin_s, now_s, set_ticks, fault = None, 0.1, 0, random.Random(seed + 1)
    for sent_s, sampled_s in frames(draw, load):
        if lost and draw.random() < 0.02:
            continue
        while (due_s := module.deadline() or math.inf) < sent_s:
            now_s = max(now_s, due_s)
            judge.take_all(module.tick(now_s), now_s)
        now_s = max(now_s, sent_s) + (late_s(draw, load) if draw.random() < 0.3 else 1e-5)
        data = b""
        if sampled_s is not None:
            begin_s = begin_s or sampled_s
            counts = counts_at(judge.truth.at(sampled_s - begin_s) / judge.truth.units_per_cycle)
            ticks, wrong = round(sampled_s * 1e7), round(fault.uniform(0.5, 3.0) * fault.choice([-1e5, 1e5]))
            judge.take(0x190, struct.pack("<hhI", *counts, ticks), now_s)
            happens = fault.choices([0, 1, 2], [98, stamped, stamped])[0]
            set_ticks += wrong * (happens == 2)
            data = struct.pack("<hhI", *counts, (ticks + set_ticks + wrong * (happens == 1)) % 2**32)
        frame = Frame(0x190 if data else 0x80, data, False, sent_s if stamped else None)
        judge.take_all(module.receive(frame, now_s), now_s)
    assert judge.samples > 300
    assert judge.wrong == 0
