"""Without sample times a speed that comes near what the jitter of SYNC allows is warned of."""

from __future__ import annotations

import math
import random
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

import canfb
from canfb.cia301.frame import Frame
from ideal_tracks import counts_at

NODE, INTERFACE = 0x20, 0x10
PERIOD_S = 1e-3
N = 2500


def turning(
    rpm: float, jitter_us: float, syncs: int = 3000, stamped: bool = True, times: bool = False
) -> tuple[list[str], canfb.FeedbackModule]:
    """Warnings of a module whose encoder is sampled at SYNCs that jitter uniformly, up to speed in 1 s."""
    module = canfb.FeedbackModule(canfb.ModuleConfig(node_id=NODE, times=times, autostart=True))
    warnings: list[str] = []
    module.on_warning = warnings.append
    module.start(0.0)
    draw = random.Random(4)
    speed = rpm / 60.0 * N
    for k in range(1, syncs):
        now = k * PERIOD_S + draw.uniform(-jitter_us, jitter_us) * 1e-6
        cycles = speed * (now * now / 2.0 if now < 1.0 else now - 0.5)
        data = struct.pack("<hh", *counts_at(cycles))
        if times:
            data += struct.pack("<I", round(now * 1e7))
        for can_id, content, later in ((0x80, b"", 0.0), (0x180 + INTERFACE, data, 3e-4)):
            at = now + later
            module.receive(Frame(can_id, content, timestamp=at if stamped else None), at)
    return warnings, module


@pytest.mark.parametrize(("jitter_us", "rpm"), [(10.0, 160.0), (30.0, 52.0), (60.0, 27.0)])
def test_a_speed_near_the_limit_is_warned_of_once(jitter_us: float, rpm: float) -> None:
    warnings, module = turning(rpm, jitter_us)
    assert len(warnings) == 1
    assert "remedy: times: true" in warnings[0]
    assert module.feedback is not None
    assert module.feedback.valid


@pytest.mark.parametrize(
    ("rpm", "jitter_us", "stamped", "times"),
    [
        (60.0, 10.0, True, False),  # far below
        (160.0, 10.0, False, False),  # not measured: the time of the call says nothing of SYNC
        (1500.0, 100.0, True, True),  # sample times
    ],
)
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
    module = canfb.FeedbackModule(canfb.ModuleConfig(node_id=NODE))
    assert module.speed_limit().endswith("200 rpm at ±10 µs, 20 rpm at ±100 µs")
    assert canfb.FeedbackModule(canfb.ModuleConfig(node_id=NODE, times=True)).speed_limit() == ""
