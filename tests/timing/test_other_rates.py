"""SYNC at another rate, or with others in between: the clock follows, and each sample counts once."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
import pytest

from canfb.timing.judge import Judge, Passed
from canfb.timing.sync_judge import RELOCK
from canfb.timing.sync_verdict import SyncVerdict

PERIOD_S, DELAY_S, BEFORE, AFTER = 1e-3, 0.2e-3, 100, 80
JITTER_S, LATENCY_S = 10e-6, 20e-6
WITNESSES = list(product((False, True), (0, 10, 240)))  # stamped, counter
RATES = (0.5, 0.6, 1.4, 1.5, 2.0, 3.0)


class Frame(NamedTuple):
    """A SYNC, or the answer to one."""

    time_s: float
    is_sync: bool
    counter: int | None = None


class Heard(NamedTuple):
    """What the judge said of a frame, and the period after it."""

    time_s: float
    said: SyncVerdict | Passed | object
    period_s: float


class Producer:
    """SYNCs with jitter and a counter, each with its answer, and those of a second one in between."""

    def __init__(self, overflow: int, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._overflow, self._sent = overflow, 0
        self.frames: list[Frame] = []
        self.now = 100.0

    def go_on(self, syncs: int, period_s: float) -> None:
        for _ in range(syncs):
            self.now += period_s
            self._send(self.now, self._sent % self._overflow + 1 if self._overflow else None)
            self._sent += 1

    def with_others(self, syncs: int, after: float) -> None:
        """So many periods with a SYNC without a counter in each, ``after`` the beginning."""
        for _ in range(syncs):
            self._send(self.now + after * PERIOD_S, None)
            self.go_on(1, PERIOD_S)

    def _send(self, time_s: float, counter: int | None) -> None:
        time_s += float(self._rng.uniform(-JITTER_S, JITTER_S))
        self.frames += Frame(time_s, True, counter), Frame(time_s + DELAY_S, False)

    def heard(self, stamped: bool) -> list[Heard]:
        judge, heard, last = Judge(), [], 0.0
        judge.syncs.overflow = self._overflow
        for time_s, is_sync, counter in sorted(self.frames):
            last = max(last, time_s + (0.0 if stamped else float(self._rng.uniform(0.0, LATENCY_S))))
            while judge.syncs.until <= last:
                judge.syncs.overdue(judge.syncs.until)
            said = judge.syncs.sync(last, stamped, counter) if is_sync else judge.answer(last, stamped)
            heard.append(Heard(time_s, said, judge.syncs.clock.period_s))
        return heard


def is_followed(heard: list[Heard], since_s: float, period_s: float, within: int) -> bool:
    """After so many SYNCs the period is that of the bus, nothing is missed, and each sample counts once."""
    later = [one for one in heard if one.time_s > since_s + (within + 0.5) * period_s]
    assert len(later) > 40
    return all(
        one.period_s == pytest.approx(period_s, rel=0.03)
        and (one.said.options == (1.0,) if isinstance(one.said, Passed) else one.said == SyncVerdict())
        for one in later
    )


@pytest.mark.parametrize(("stamped", "overflow"), WITNESSES)
def test_the_usual_rate_is_followed_again_after_others_in_the_middle(stamped: bool, overflow: int) -> None:
    """It stayed at half the period for seconds: every second SYNC was one that was missed."""
    taken_for_a_rate = 0
    for others, after in product((10, 25, 40), (0.45, 0.5)):
        producer = Producer(overflow, others)
        producer.go_on(BEFORE, PERIOD_S)
        producer.with_others(others, after)
        since_s = producer.now
        producer.go_on(AFTER, PERIOD_S)
        heard = producer.heard(stamped)
        taken_for_a_rate += any(one.period_s < 0.6 * PERIOD_S for one in heard[2 * BEFORE :])
        assert is_followed(heard, since_s, PERIOD_S, 2 * RELOCK), (others, after)
    assert taken_for_a_rate


@pytest.mark.parametrize(("stamped", "overflow"), WITNESSES)
@pytest.mark.parametrize("rate", RATES)
def test_another_rate_is_followed(rate: float, stamped: bool, overflow: int) -> None:
    producer = Producer(overflow, 1)
    producer.go_on(BEFORE, PERIOD_S)
    since_s = producer.now
    producer.go_on(AFTER, rate * PERIOD_S)
    assert is_followed(producer.heard(stamped), since_s, rate * PERIOD_S, 3 * RELOCK)


@pytest.mark.parametrize("overflow", [10, 240])
@pytest.mark.parametrize("stamped", [False, True])
def test_a_counter_that_counts_what_is_missed_leaves_the_rate(stamped: bool, overflow: int) -> None:
    producer = Producer(overflow, 1)
    producer.go_on(BEFORE + AFTER, PERIOD_S)
    lost = [n for n in range(2 * BEFORE, len(producer.frames)) if n // 2 % 3]
    producer.frames = [one for n, one in enumerate(producer.frames) if n not in lost]
    assert all(one.period_s == pytest.approx(PERIOD_S, rel=0.01) for one in producer.heard(stamped)[BEFORE:])


def test_answers_to_syncs_that_are_not_received_leave_the_rate() -> None:
    producer = Producer(0, 1)
    producer.go_on(BEFORE + AFTER, PERIOD_S)
    unheard = range(2 * BEFORE, len(producer.frames), 4)
    producer.frames = [one for n, one in enumerate(producer.frames) if n not in unheard]
    assert all(one.period_s == pytest.approx(PERIOD_S, rel=0.01) for one in producer.heard(True)[BEFORE:])
