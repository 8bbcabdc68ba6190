"""A replay of a module with two samples for each SYNC: margins are those of all, rows those of the newest."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from canfb.cia301.frame import Frame
from canfb.replay.sample_columns import Block
from ideal_tracks import counts_at
from replay_kit import ADC_ID, EPOCH_S, PERIOD_S, SYNC_ID, Planned, contents, live, replayed

SPEED = 0.035  # cycles from sample to sample
GLITCH_AT, GLITCH = 200, 0.05
WEAK_AT, WEAK_COUNTS = 300, 900.0


def session() -> list[Planned]:
    plan: list[Planned] = []
    for n in range(500):
        at = 0.1 + n * PERIOD_S
        newest = counts_at(2 * n * SPEED + (GLITCH if n == GLITCH_AT else 0.0))
        earlier = counts_at((2 * n - 1) * SPEED, WEAK_COUNTS if n == WEAK_AT else 1500.0)
        plan += [
            (at, Frame(SYNC_ID, b"")),
            (at + 2e-4, Frame(ADC_ID, struct.pack("<hhhh", *newest, *earlier))),
        ]
    return plan


def test_margins_of_all_samples() -> None:
    """Behind a glitch the residual is twice as large, and here that is an earlier sample."""
    fields: dict[str, Any] = {"autostart": True, "samples_per_sync": 2}
    log, sent = live(session(), **fields)
    rows: list[Block] = []
    replay, again = replayed(log, options={"takers": [rows.append]}, **fields)
    assert contents(again) == contents(sent)
    assert replay.samples.rows == sum(len(block["time_s"]) for block in rows) == 500
    assert min(float(np.min(block["amplitude_counts"][5:])) for block in rows) > 1490.0
    of_rows = max(float(np.max(block["residual"][5:])) for block in rows)
    residual, amplitude_low = (replay.margins.nearest[name] for name in ("residual", "amplitude_low"))
    assert residual.value == pytest.approx(2 * GLITCH, abs=0.03)
    assert residual.value > of_rows + 0.02
    assert residual.time_s == pytest.approx(EPOCH_S + 0.1 + (GLITCH_AT + 1.2) * PERIOD_S, abs=1e-4)
    assert amplitude_low.value == pytest.approx(WEAK_COUNTS, abs=2.0)
