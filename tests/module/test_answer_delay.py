"""ADC PDOs that come behind later SYNCs, as 2010:0E declares: each is the sample of its own."""

from __future__ import annotations

import math
import random
import struct
from typing import Any

import pytest
from hypothesis import given, strategies as st

from canfb.cia301.frame import Frame
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.signal.supervision import LOST, VALID
from drawing import examples
from ideal_tracks import adc_pdo

PERIOD_S, SPREAD_S, JITTER_S, SPEED = 1e-3, 60e-6, 5e-6, 3.3
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
        synced_s = (number + 1) * PERIOD_S + draw.uniform(-JITTER_S, JITTER_S)
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
