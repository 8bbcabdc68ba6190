"""The usual sample in one piece gives what the parts of the chain give, called one by one."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from random import Random
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canfb.signal.chain import SignalChain
from canfb.signal.chain_config import ChainConfig, ChainLimits
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import Correction, CorrectionTable
from canfb.signal.front_end import Corners
from canfb.signal.sample import Feedback, Sample
from canfb.signal.second_position import SecondSensor
from canfb.signal.stages import Stages
from canfb.signal.supervision import SampleLimits
from ideal_tracks import counts_at

TABLE = CorrectionTable([k / 64 + 0.02 * math.sin(2 * math.pi * k / 64) for k in range(64)])
CONDITIONING = Conditioning(3.0, -2.0, 1.01, 0.98, 0.02)
DELAYED = Conditioning(3.0, -2.0, 1.01, 0.98, 0.02, 1e-4, 1e-3, harmonic_3_forward_real=0.02)
LIMITS = ChainLimits(
    sample=SampleLimits(2048, 410, 2048),
    cycles_per_revolution=2500,
    residual_limit=0.3,
    coast_samples=5,
    frozen_samples=4,
    coarse_limit_revolutions=0.01,
)


class Resolving(Stages):
    """Stages that take no sample for a usual one."""

    def _look_again(self, feedback: Feedback) -> None:
        super()._look_again(feedback)
        self._nothing_in_doubt = False


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
WEAKER = SampleLimits(2048, 300, 2048)
SECOND = SecondSensor(increments=4096, tolerance_revolutions=0.01)
CHANGES: dict[str, Callable[[SignalChain, float], object]] = {
    "missed": lambda chain, x: chain.miss(),
    "limits": lambda chain, x: chain.set_limits(
        replace(LIMITS, residual_limit=0.2 + 0.1 * abs(x), sample=WEAKER)
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
    jitter_ticks: int | None,
    happenings: list[tuple[str, float]],
    speed: float,
    bend: float,
    random: Random,
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
