"""The first session of the README, where any program on the computer may stand still for any time."""

from __future__ import annotations

import math
import random
import struct

from hypothesis import example, given, strategies as st

from canfb.cia301.frame import Frame
from canfb.cli.config_file import EXAMPLE
from canfb.configuration import parse_config
from canfb.module.feedback_module import FeedbackModule
from drawing import examples
from ideal_tracks import counts_at
from judged_session import Judge, TrueMotion

CONFIG = parse_config(EXAMPLE)
PERIOD_S, SECONDS = 0.01, 10.0


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
        due_s += PERIOD_S * max(1, math.floor((at_s - due_s) / PERIOD_S))
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
