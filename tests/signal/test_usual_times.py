"""The usual sample time: what is taken at once is what the close look takes, with the same bits."""

from __future__ import annotations

import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canfb.signal.chain import SignalChain
from canfb.signal.chain_config import ChainConfig
from canfb.signal.sample import TICK_S, TICKS, Feedback, Sample
from ideal_tracks import counts_at

PERIOD_S = 1e-3
LEARNED = 60  # samples

errors_us = st.floats(-400.0, 400.0)
jitters_us = st.sampled_from([0.0, 0.1, 5.0, 60.0])


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
    jitters_us,
    st.sampled_from([None, False, True]),
    st.floats(-1.0, 1.0),
    st.lists(
        st.tuples(
            st.sampled_from(["good", "good", "off", "late", "rate", "twice", "lost", "miss", "bad"]),
            errors_us,
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
