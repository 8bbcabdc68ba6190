"""Object 2013h: synchronous TPDOs carry the position at their SYNC."""

from __future__ import annotations

import struct
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st
from latency_bench import RANGE, UNITS_PER_CYCLE, Timeline

from canfb.cia301.frame import Frame
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.module.objects.prediction import ahead
from canfb.objects import StatusBit
from drawing import examples

VALID, EXTRAPOLATED = int(StatusBit.VALID), int(StatusBit.EXTRAPOLATED)
QUANTUM = 2e-5  # cycles: of the 16-bit converter, and of the position
NOISE = {1: 3, 2: 7}  # how often a formula takes an error of that size at most


def predicting(motion: Callable[[int], float], kind: int, rpdo: int = 255, tpdo: int = 1) -> Timeline:
    timeline = Timeline(motion, predict=kind)
    timeline.types(rpdo, tpdo)
    timeline.start()
    return timeline


def worst(timeline: Timeline, skip: int, periods: int) -> float:
    timeline.run(skip)
    sent = timeline.run(periods)
    assert all(one.status & VALID for one in sent)
    return max(map(abs, timeline.sync_errors(sent)))


def ramp(acceleration: float, periods: int, after: float = 0.0) -> Callable[[int], float]:
    """From standstill with one acceleration, then with another."""

    def position(k: int) -> float:
        first, then = min(k, periods), max(0, k - periods)
        return 0.3 + acceleration * (first**2 / 2 + periods * then) + after * then**2 / 2

    return position


def stopping(acceleration: float, periods: int) -> Callable[[int], float]:
    """From standstill up, and as fast down to the standstill at which it stays."""
    moving = ramp(acceleration, periods, -acceleration)
    return lambda k: moving(min(k, 2 * periods))


@examples(25)
@given(st.floats(-0.3, 0.3), st.integers(1, 2), st.sampled_from([1, 255]), st.sampled_from([0, 1]))
def test_at_constant_speed_nothing_is_left_of_the_age(
    acceleration: float, kind: int, rpdo: int, tpdo: int
) -> None:
    error = worst(predicting(ramp(acceleration, 40), kind, rpdo, tpdo), 45, 20)
    assert error < NOISE[kind] * QUANTUM


@given(st.integers(-(2**80), 2**80), st.integers(0, 2**30 - 1), st.integers(-(2**45), 2**45))
def test_the_way_is_exact(cycles: int, phase: int, way: int) -> None:
    """Sixteenths of a millionth, or so, as plain integers."""
    one = 1 << 30
    at, part = ahead(cycles, phase / one, way / one)
    assert isinstance(at, int)
    assert 0.0 <= part < 1.0
    assert at * one + round(part * one) == cycles * one + phase + way


@pytest.mark.parametrize("sequence", [4, 5])
@pytest.mark.parametrize("kind", [1, 2])
def test_wrap_and_code_sequence(sequence: int, kind: int) -> None:
    """Against integers: 2 x(k) - x(k-1), or 3 x(k) - 3 x(k-1) + x(k-2), of the measured positions."""
    timeline = predicting(ramp(0.02, 40, -0.03), kind)
    timeline.bench.sdo[0x6000].raw = sequence
    measured: list[int] = []
    seen = set()
    for k in range(130):
        sent = timeline.run(1)
        if k > 5:
            x, x1, x2 = measured[-1], measured[-2], measured[-3]
            expected = 2 * x - x1 if kind == 1 else 3 * x - 3 * x1 + x2
            assert 0 <= sent[0].position < RANGE
            assert abs((sent[0].position - expected + RANGE // 2) % RANGE - RANGE // 2) <= 7
            seen.add(sent[0].position > RANGE // 2)
        measured.append(timeline.bench.sdo[0x6004].raw)
    assert seen == {False, True}


def test_only_the_synchronous_pdo_is_extrapolated_and_says_so() -> None:
    timeline = predicting(ramp(0.1, 20), 1)
    sdo = timeline.bench.sdo
    timeline.run(30)
    (sent,) = timeline.run(1)
    assert sent.status == VALID | EXTRAPOLATED
    measured = timeline.bench.module.feedback
    assert measured is not None
    assert sdo[0x6004].raw == sdo[0x6008].raw == int((measured.cycles + measured.phase) * UNITS_PER_CYCLE)
    assert sdo[0x2011][1].raw == VALID
    timeline.types(255, 254)
    assert {one.status for one in timeline.run(5)} == {VALID}
    timeline.types(255, 253)
    assert {one.status for one in timeline.run(5, remote=True)} == {VALID}
    timeline.types(255, 252)
    assert {one.status for one in timeline.run(5, remote=True)[1:]} == {VALID | EXTRAPOLATED}


def test_the_event_timer_sends_the_measured_position() -> None:
    timeline = predicting(ramp(0.1, 20), 1, tpdo=254)
    timeline.bench.sdo[0x1800][5].raw = 1  # ms: between a SYNC and its ADC PDO, too
    timeline.missing = set(range(25, 60))
    assert not any(one.status & EXTRAPOLATED for one in timeline.run(40))


def test_it_is_switched_at_run_time_and_from_the_next_sync_on() -> None:
    timeline = predicting(ramp(0.1, 20), 0)
    sdo = timeline.bench.sdo
    timeline.run(30)
    for kind in (1, 0, 2, 0, 1, 2, 1):
        sdo[0x2013][1].raw = kind
        (sent,) = timeline.run(1)
        assert bool(sent.status & EXTRAPOLATED) == bool(kind)
        (error,) = timeline.sync_errors([sent])
        assert abs(error) == pytest.approx(0.0 if kind else 2.0, abs=3 * QUANTUM)


def test_while_coasting_it_goes_on_but_is_never_valid_and_lost_stays_as_counted() -> None:
    timeline = predicting(ramp(0.1, 20), 1)
    timeline.missing = set(range(30, 50))
    timeline.run(30)
    sent = timeline.run(20)
    assert sent[0].status == VALID | EXTRAPOLATED  # at SYNC 30 sample 29 is there
    coasting = [one for one in sent if one.status & StatusBit.COASTING]
    lost = [one for one in sent if one.status & StatusBit.LOST]
    assert len(coasting) == 3
    assert len(lost) == 16
    assert all(one.status & EXTRAPOLATED and not one.status & VALID for one in coasting)
    assert max(map(abs, timeline.sync_errors(coasting))) < 6 * QUANTUM
    assert not any(one.status & (EXTRAPOLATED | VALID) for one in lost)


def test_before_the_first_sample_and_after_a_pause_there_is_nothing_to_go_on_from() -> None:
    timeline = predicting(stopping(0.1, 20), 2)
    assert timeline.run(1)[0].status == 0
    timeline.run(70)
    timeline.bench.remote.nmt.state = "PRE-OPERATIONAL"
    timeline.start()
    assert timeline.run(1)[0].status == 0
    assert {one.status & ~EXTRAPOLATED for one in timeline.run(4)} == {StatusBit.COASTING}, "not confirmed"
    sent = timeline.run(10)
    assert {one.status for one in sent} == {VALID | EXTRAPOLATED}
    assert len({one.position for one in sent[1:]}) == 1


def test_of_several_samples_since_a_sync_nobody_knows_the_age() -> None:
    module = FeedbackModule(ModuleConfig(node_id=32, autostart=True, predict=True))
    entry = module.dictionary.entry
    entry(0x1400, 1).store(0x80000190)
    entry(0x1600, 0).store(0)
    entry(0x1600, 3).store(0x20000520)
    entry(0x1600, 0).store(3)
    entry(0x1400, 1).store(0x190)
    entry(0x1800, 2).store(1)
    entry(0x1006).store(1000)
    module.start(0.0)
    tick, now = 0, 0.0

    def statuses(per_sync: int) -> set[int]:
        nonlocal tick, now
        seen = set()
        for _ in range(4):
            now += 1e-3
            sent = [one.data for one in module.receive(Frame(0x80, b""), now) if one.can_id == 0x1A0]
            seen |= {struct.unpack_from("<H", data, 4)[0] & EXTRAPOLATED for data in sent}
            for _ in range(per_sync):
                tick += 10000
                module.receive(Frame(0x190, struct.pack("<hhI", 0, 1500, tick)), now)
        return seen

    statuses(1)
    assert statuses(1) == {EXTRAPOLATED}
    statuses(2)
    assert statuses(2) == {0}
