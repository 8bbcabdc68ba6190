"""The usual sample in one piece gives what the parts of the chain give, called one by one."""

from __future__ import annotations

import math
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
from canfb.signal.feedback import Feedback
from canfb.signal.harmonics import Corners
from canfb.signal.sample import Sample
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


KINDS = (
    "run run run jump still weak clipped invalid zeros late time pulse coarse missed limits several table "
    "restart resume lose uncertain interval second front corner"
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


def same(ours: Feedback | None, theirs: Feedback | None) -> bool:
    """Bit for bit: repr tells -0.0 from 0.0 and takes NaN for equal."""
    return repr(ours) == repr(theirs)


@st.composite
def events(draw: st.DrawFn) -> list[tuple[str, float]]:
    """Runs of samples, and what happens between them."""
    kinds = st.sampled_from(KINDS.split())
    return draw(st.lists(st.tuples(kinds, st.floats(-1.0, 1.0, allow_nan=False)), min_size=3, max_size=20))


def happen(chain: SignalChain, kind: str, x: float, position: float, ticks: int) -> Feedback | None:
    """One thing that is no usual sample."""
    sine, cosine = counts_at(position)
    if kind == "jump":
        return chain.step(Sample(*counts_at(position + x)))
    if kind == "weak":
        return chain.step(Sample(*counts_at(position, 1500.0 * abs(x))))
    if kind == "clipped":
        return chain.step(Sample(*counts_at(position, 2047.0 + 30 * x)))
    if kind == "invalid":
        return chain.step(Sample(sine, cosine, invalid=True))
    if kind == "zeros":
        return chain.step(Sample(0, 0))
    if kind == "late":
        return chain.step(Sample(sine, cosine, elapsed=1.0 + 3.0 * abs(x)))
    if kind == "time":
        return chain.step(Sample(sine, cosine, time_100ns=ticks))
    if kind == "pulse":
        return chain.step(Sample(sine, cosine, zero_pulse=abs(x)))
    if kind == "coarse":
        return chain.step(Sample(sine, cosine, 1.0, False, *counts_at(position / 2500)))
    if kind == "missed":
        return chain.miss()
    if kind == "limits":
        chain.set_limits(
            replace(LIMITS, residual_limit=0.2 + 0.1 * abs(x), sample=SampleLimits(2048, 300, 2048))
        )
    elif kind == "several":
        chain.set_limits(replace(LIMITS, samples_per_sync=2 if x > 0 else 1))
    elif kind == "table":
        chain.activate(Correction(TABLE if x > 0 else None, CONDITIONING if abs(x) > 0.5 else Conditioning()))
    elif kind == "front":
        chain.activate(Correction(TABLE, DELAYED))
        chain.use_interval(0.001 * (1.0 + abs(x)))
    elif kind == "corner":
        chain.set_limits(replace(LIMITS, corners=Corners(500.0 * abs(x), 400.0)))
        chain.use_interval(0.001)
    elif kind == "restart":
        chain.restart(round(100 * x), x)
    elif kind == "resume":
        chain.resume(5.0 * abs(x))
    elif kind == "lose":
        return chain.lose()
    elif kind == "uncertain":
        return chain.uncertain(abs(x))
    elif kind == "interval":
        chain.sync_interval_s = 0.001 * (1.0 + abs(x))
    elif kind == "second":
        chain.use_second(
            SecondSensor(increments=4096, tolerance_revolutions=0.01, invalidates=x > 0.5) if x > 0 else None
        )
    return None


@pytest.mark.parametrize("jitter_ticks", [None, 0, 800])
@given(
    happenings=events(),
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
