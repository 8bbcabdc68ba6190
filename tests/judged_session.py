"""What the first session of the README has to do in real time, whatever else the machine has to do."""

from __future__ import annotations

from canfb.cli.config_file import EXAMPLE
from canfb.configuration import parse_config
from tools.faults.stalls import BACK_S, HOLDS_MS, Judge, TrueMotion

# A stall of less than HOLDS_MS, as the sample times show it, must not cost the position.
UNEVEN_INTERVALS_HOLD = True


def new_judge() -> Judge:
    """For a session with the example configuration; it must hear the first sample."""
    return Judge(TrueMotion(parse_config(EXAMPLE)))


def check(judge: Judge, said: str) -> None:
    """Never valid and wrong; soon valid again; lost only after a stall that is too long."""
    figures = f"{judge}\n{said}"
    assert judge.samples > 900, figures
    assert judge.wrong == 0, figures
    if judge.lost:
        assert judge.longest_interval_s > 1e-3 * HOLDS_MS or not UNEVEN_INTERVALS_HOLD, figures
    else:
        assert judge.valid > 0.5 * judge.samples, figures
        assert judge.longest_away_s < BACK_S + judge.longest_interval_s, figures
