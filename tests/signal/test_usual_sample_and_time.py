"""The usual sample in one piece, and the usual time: the bits of the parts and of the close look.

The usual time also in a burst of frames.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from random import Random
from typing import Any

import pytest
from hypothesis import example, given, strategies as st

from canfb import Conditioning, SecondSensor, SignalChain
from canfb.signal.chain_config import ChainConfig, ChainLimits
from canfb.signal.correction import Correction, CorrectionTable
from canfb.signal.front_end import Corners
from canfb.signal.sample import TICK_S, TICKS, Feedback, Sample
from canfb.signal.supervision import LOST, VALID, SampleLimits
from ideal_tracks import Resolving, counts_at

TABLE = CorrectionTable([k / 64 + 0.02 * math.sin(2 * math.pi * k / 64) for k in range(64)])
CONDITIONING = Conditioning(3.0, -2.0, 1.01, 0.98, 0.02)
DELAYED = Conditioning(3.0, -2.0, 1.01, 0.98, 0.02, 1e-4, 1e-3, harmonic_3_forward_real=0.02)
LIMITS = ChainLimits(
    sample=SampleLimits(2048, 410, 2048), cycles_per_revolution=2500, residual_limit=0.3,
    coast_samples=5, frozen_samples=4, coarse_limit_revolutions=0.01,
)  # fmt: skip


class Parts(SignalChain):
    """The same chain, without the short way."""

    def __init__(self, config: ChainConfig, table: CorrectionTable | None = None) -> None:
        super().__init__(config, table)
        self.stages.__class__ = Resolving


def same(ours: object, theirs: object) -> bool:
    """Bit for bit: repr tells -0.0 from 0.0 and takes NaN for equal."""
    return repr(ours) == repr(theirs)


# What is no usual sample: at a position, with a number of -1 to 1 and the sample time.
SAMPLES: dict[str, Callable[[float, float, int], Sample]] = {
    "jump": lambda at, x, ticks: Sample(*counts_at(at + x)),
    "weak": lambda at, x, ticks: Sample(*counts_at(at, 1500.0 * abs(x))),
    "clipped": lambda at, x, ticks: Sample(*counts_at(at, 2047.0 + 30 * x)),
    "invalid": lambda at, x, ticks: Sample(*counts_at(at), invalid=True),
    "zeros": lambda at, x, ticks: Sample(0, 0),
    "late": lambda at, x, ticks: Sample(*counts_at(at), elapsed=1.0 + 3.0 * abs(x)),
    "time": lambda at, x, ticks: Sample(*counts_at(at), time_100ns=ticks),
    "pulse": lambda at, x, ticks: Sample(*counts_at(at), zero_pulse=abs(x)),
    "coarse": lambda at, x, ticks: Sample(*counts_at(at), 1.0, False, *counts_at(at / 2500)),
}
SECOND = SecondSensor(increments=4096, tolerance_revolutions=0.01)
CHANGES: dict[str, Callable[[SignalChain, float], object]] = {
    "missed": lambda chain, x: chain.miss(),
    "limits": lambda chain, x: chain.set_limits(
        replace(LIMITS, residual_limit=0.2 + 0.1 * abs(x), sample=SampleLimits(2048, 300, 2048))
    ),
    "several": lambda chain, x: chain.set_limits(replace(LIMITS, samples_per_sync=2 if x > 0 else 1)),
    "table": lambda chain, x: chain.activate(
        Correction(TABLE if x > 0 else None, CONDITIONING if abs(x) > 0.5 else Conditioning())
    ),
    "front": lambda chain, x: chain.activate(Correction(TABLE, DELAYED)),
    "unit": lambda chain, x: chain.use_interval(0.001 * (1.0 + max(x, 0.0))),
    "corner": lambda chain, x: chain.set_limits(replace(LIMITS, corners=Corners(500.0 * abs(x), 400.0))),
    "restart": lambda chain, x: chain.restart(round(100 * x), x),
    "resume": lambda chain, x: chain.resume(5.0 * abs(x)),
    "lose": lambda chain, x: chain.lose(),
    "uncertain": lambda chain, x: chain.uncertain(abs(x)),
    "interval": lambda chain, x: setattr(chain, "sync_interval_s", 0.001 * (1.0 + abs(x))),
    "second": lambda chain, x: chain.use_second(replace(SECOND, invalidates=x > 0.5) if x > 0 else None),
}
KINDS = st.sampled_from(["run", "run", "run", "still", *SAMPLES, *CHANGES])
EVENTS = st.lists(st.tuples(KINDS, st.floats(-1.0, 1.0, allow_nan=False)), min_size=3, max_size=20)


def happen(chain: SignalChain, kind: str, x: float, position: float, ticks: int) -> object:
    return chain.step(SAMPLES[kind](position, x, ticks)) if kind in SAMPLES else CHANGES[kind](chain, x)


@pytest.mark.parametrize("jitter_ticks", [None, 0, 800])
@given(
    happenings=EVENTS,
    speed=st.floats(-0.4, 0.4),
    bend=st.floats(-0.01, 0.01),
    random=st.randoms(use_true_random=False),
)
@example(
    happenings=[("run", 0.0), ("interval", 0.75), ("time", 0.0), ("time", 0.0)],
    speed=0.25,
    bend=0.0078125,
    random=Random(0),
)
def test_same_bits_as_the_parts_called_one_by_one(
    jitter_ticks: int | None, happenings: list[tuple[str, float]], speed: float, bend: float, random: Random
) -> None:
    config = ChainConfig()
    ours, theirs = SignalChain(config, TABLE), Parts(config, TABLE)
    position, step, ticks = 0.1, 0.0, 0
    for chain in (ours, theirs) if random.random() < 0.5 else ():
        chain.use_interval(0.001)
    for kind, x in happenings:
        for k in range(8 if kind in ("run", "still") else 3):
            step += bend if abs(step) < abs(speed) else 0.0
            position += 0.0 if kind == "still" else step
            ticks += 10000
            if k == 0 and kind not in ("run", "still"):
                assert same(
                    happen(ours, kind, x, position, ticks), happen(theirs, kind, x, position, ticks)
                ), kind
            else:
                sample = Sample(*counts_at(position))
                if jitter_ticks is not None:
                    early = random.randint(-jitter_ticks, jitter_ticks)
                    sample = Sample(*counts_at(position + step * early / 10000), time_100ns=ticks + early)
                for chain in (ours, theirs):  # the other sensor says what it likes
                    chain.hear_second(1, round(position / 2500 * 4096 + 4096 * x))
                assert same(ours.step(sample), theirs.step(sample)), (kind, k)
        assert ours.lost == theirs.lost
        assert ours.between == theirs.between


@pytest.mark.parametrize("speed", [0.3, 0.0])
@pytest.mark.parametrize("jitter_ticks", [None, 0, 300])
def test_nearly_each_sample_of_a_healthy_machine_takes_the_short_way(
    speed: float, jitter_ticks: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    chain, random = SignalChain(ChainConfig(), TABLE), Random(1)
    resolve, resolved = chain.stages._resolve, 0

    def counted(*arguments: Any) -> Feedback:
        nonlocal resolved
        resolved += 1
        return resolve(*arguments)

    monkeypatch.setattr(chain.stages, "_resolve", counted)
    chain.sync_interval_s = 0.001
    chain.restart(0, speed)
    for k in range(1000):
        early = random.randint(-(jitter_ticks or 0), jitter_ticks or 0)
        pair = counts_at(0.1 + speed * (k + early / 10000))
        chain.step(Sample(*pair, time_100ns=None if jitter_ticks is None else 10000 * k + early))
    assert resolved < 20


# The usual sample time: what is taken at once.

PERIOD_S = 1e-3
LEARNED = 60  # samples


class Line:
    """An interface on a SYNC that jitters: sample time, and when it and its SYNC were received."""

    def __init__(self, seed: int, jitter_us: float, proved: bool | None, speed_cycles: float) -> None:
        self._seed, self._jitter_us, self._proved, self._speed = seed, jitter_us, proved, speed_cycles
        self.slot, self._base_s = 0, 0.0
        self.part = 1.0  # of the period

    def next(self, add_us: float = 0.0, late_us: float = 0.0) -> tuple[Sample, float | None, float | None]:
        n = self.slot
        self.slot += 1
        self._base_s += (self.part - 1.0) * PERIOD_S
        true_s = (
            self._base_s + (n + 1) * PERIOD_S + self._jitter_us * 1e-6 * math.sin(n * n * 0.7 + self._seed)
        )
        position = 0.3 + self._speed * max(0.0, true_s / PERIOD_S - 8.0) ** 2 / 200.0
        time = (round(true_s * 1.00004 / TICK_S) + round(add_us * 10.0) + self._seed) % TICKS
        sample = Sample(*counts_at(position, 1800.0), time_100ns=time)
        late_s = 20e-6 * abs(math.sin(n * 1.3)) + late_us * 1e-6
        if self._proved is None:
            return sample, None, None
        return sample, true_s + 2e-4 + late_s if self._proved else None, true_s + late_s


def at_once(chain: SignalChain, sample: Sample, received_s: float | None, synced_s: float | None) -> Feedback:
    """As the module takes it."""
    assert sample.time_100ns is not None
    usual = 0.0 if sample.invalid else chain.times.in_turn(sample.time_100ns, received_s, synced_s)
    known = sample.sine, sample.cosine, usual, True
    return chain.stages.take(*known) if usual else chain.step(sample, received_s, synced_s)


@given(
    st.integers(0, TICKS - 1),
    st.sampled_from([0.0, 0.1, 5.0, 60.0]),
    st.sampled_from([None, False, True]),
    st.floats(-1.0, 1.0),
    st.lists(
        st.tuples(
            st.sampled_from(["good", "good", "off", "late", "rate", "twice", "lost", "miss", "bad"]),
            st.floats(-400.0, 400.0),
        ),
        max_size=150,
    ),
)
@example(0, 0.0, None, 0.0, [("rate", 312.0), ("off", -339.0), ("off", 130.0)])
def test_same_bits_as_the_close_look(
    seed: int, jitter_us: float, proved: bool, speed: float, events: list[tuple[str, float]]
) -> None:
    line = Line(seed, jitter_us, proved, speed)
    chains = SignalChain(ChainConfig()), SignalChain(ChainConfig())
    for kind, error_us in [("good", 0.0)] * LEARNED + events:
        if kind == "miss":
            line.slot += 1
            assert repr(chains[0].miss()) == repr(chains[1].miss())
            continue
        line.slot += kind == "lost"
        line.part += kind == "rate" and error_us * 1e-4
        sample, received_s, synced_s = line.next(
            error_us if kind == "off" else 0.0, abs(error_us) if kind == "late" else 0.0
        )
        sample = sample._replace(invalid=kind == "bad")
        for _ in range(1 + (kind == "twice")):
            close_look = chains[1].step(sample, received_s, synced_s)
            assert repr(at_once(chains[0], sample, received_s, synced_s)) == repr(close_look)
    assert chains[0].unit_s == chains[1].unit_s


@pytest.mark.parametrize("proved", [None, False, True])
def test_most_times_of_a_healthy_machine_are_taken_at_once(proved: bool | None) -> None:
    line, chain, taken = Line(5, 5.0, proved, 0.1), SignalChain(ChainConfig()), 0
    for _ in range(LEARNED):
        at_once(chain, *line.next())
    for _ in range(200):
        sample, received_s, synced_s = line.next()
        taken += chain.times.in_turn(sample.time_100ns or 0, received_s, synced_s) > 0.0
        chain.step(sample, received_s, synced_s)
    assert taken > 150


# Frames wait for a host that stalls, and some are dropped: nobody says how long it was. The machine turns by
# whole cycles in each period, so that its phases fit any number of periods: the sample times may be those of
# a clock that was set meanwhile.

AT_REST, RAMP, STEADY = 80, 400, 60  # periods; then it turns by SPEED
SPEED = 4.0  # cycles per period


def position(at: float) -> float:
    """Cycles, ``at`` periods."""
    moving = max(0.0, at - AT_REST)
    ramp = min(moving, float(RAMP))
    return 0.3 + SPEED / RAMP * ramp * ramp / 2.0 + SPEED * max(0.0, moving - RAMP)


class Interface:
    """Sample ``n`` is taken at n periods, by a clock that was set by ``set_periods``."""

    def __init__(self) -> None:
        self.chain = SignalChain(ChainConfig(max_acceleration_cycles=0.012, coast_samples=40), None)
        self.set_periods = 0
        self.n = 0

    def sample(self, taken_s: float | None = None) -> Feedback:
        """The next one, whose SYNC the host takes then."""
        self.n += 1
        at = float(self.n)
        time_100ns = round((self.n + self.set_periods) * PERIOD_S / TICK_S) % TICKS
        sample = Sample(*counts_at(position(at), 1800.0), time_100ns=time_100ns)
        jitter_s = 20e-6 * abs(math.sin(1.3 * self.n))
        synced_s = self.n * PERIOD_S + jitter_s if taken_s is None else taken_s
        return at_once(self.chain, sample, None, synced_s)

    def error_cycles(self, feedback: Feedback) -> float:
        return abs(feedback.cycles + feedback.phase - position(self.n))

    def running(self) -> Interface:
        for _ in range(AT_REST + RAMP + STEADY):
            feedback = self.sample()
        assert feedback.status & VALID
        assert self.error_cycles(feedback) < 0.1
        return self


@given(st.integers(1, 20), st.integers(1, 8), st.integers(4, 20))
def test_frames_dropped_among_others_cost_the_position(waiting: int, dropped: int, behind: int) -> None:
    interface = Interface().running()
    end_s = (interface.n + waiting + dropped + behind + 1) * PERIOD_S + 1e-4
    for k in range(waiting):
        interface.sample(end_s + 16e-6 * k)
    interface.n += dropped
    got = [interface.sample(end_s + 16e-6 * (waiting + k)) for k in range(behind)]
    assert not any(one.status & VALID for one in got)
    assert got[-1].status & LOST


@given(st.integers(1, 20), st.integers(1, 20), st.integers(1, 20), st.booleans())
@example(5, 13, 1, True)
@example(5, 13, 3, True)
@example(5, 13, 9, True)
def test_a_clock_that_was_set_meanwhile_is_never_believed(
    waiting: int, behind: int, periods: int, once: bool
) -> None:
    interface = Interface().running()
    end_s = (interface.n + waiting + behind + 1) * PERIOD_S + 1e-4
    for k in range(waiting + behind + 40):
        interface.set_periods = periods if k == waiting or (k > waiting and not once) else 0
        feedback = interface.sample(end_s + 16e-6 * k if k < waiting + behind else None)
        assert not feedback.status & VALID or interface.error_cycles(feedback) < 0.1
        assert once or k < waiting + behind or not feedback.status & VALID
