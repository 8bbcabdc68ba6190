"""What the first session of the README has to do in real time, whatever else the machine has to do.

Its example bridges a stall of HOLDS_MS, and the next one EVERY_S later: that is what `tools.faults.stalls`
plays and docs/time.md promises. A busy machine stalls for longer, or again before the position is back. Then
the position may be lost, but never valid and wrong. That it is kept is proven in simulated time, too, where
nothing stalls (tests/cli/test_example_on_a_bus.py).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from canfb.cli.config_file import EXAMPLE
from canfb.configuration import parse_config
from tools.faults.stalls import BACK_S, EVERY_S, HOLDS_MS, Judge, TrueMotion

PERIOD_S = 0.01
STALL_S = 2.0 * PERIOD_S
"""A longer pause between two frames of a node is a stall: one missed SYNC is none."""


@dataclass
class SessionJudge(Judge):
    """It also sees what the machine did: pauses between the samples, and between the positions."""

    machine_held: bool = True
    """No stall was too long, or too close to the one before."""
    _last_s: dict[int, float] = field(default_factory=dict)
    _stalled_s: float = -math.inf

    def take(self, can_id: int, data: bytes, at_s: float) -> None:
        """A frame that was received at ``at_s``, seconds."""
        super().take(can_id, data, at_s)
        if can_id not in (0x180 + self.interface, 0x180 + self.module):
            return
        began_s = self._last_s.get(can_id, at_s)
        self._last_s[can_id] = at_s
        if at_s - began_s > STALL_S:
            again = self._stalled_s < began_s < self._stalled_s + EVERY_S
            self.machine_held &= at_s - began_s <= 1e-3 * HOLDS_MS and not again
            self._stalled_s = at_s


def new_judge() -> SessionJudge:
    """For a session with the example configuration; it must hear the first sample."""
    return SessionJudge(TrueMotion(parse_config(EXAMPLE)))


def check(judge: SessionJudge, said: str) -> None:
    """Never valid and wrong; on a machine that held, never lost, and soon valid again."""
    figures = f"{judge}\n{said}"
    assert judge.samples > 900, figures
    assert judge.wrong == 0, figures
    if judge.machine_held:
        assert not judge.lost, figures
        assert judge.valid > 0.5 * judge.samples, figures
        assert judge.longest_away_s < BACK_S + judge.longest_interval_s, figures
