"""docs/local-adc.md: its speeds are those of the plan."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from canfb.cli.main import main
from canfb.planning import plan_rows

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "local-adc.md").read_text(encoding="utf-8")


PLAN = re.findall(r"^    canfb (plan .*)$", PAGE, re.M)[0].split()


def holds(rpm: float, cycles: int, phase_error: float, capsys: pytest.CaptureFixture[str]) -> bool:
    words = PLAN[: PLAN.index("--rpm")]
    code = main([*words, f"--rpm={rpm}", f"--cycles={cycles}", f"--phase-error={phase_error}", "--json"])
    result = json.loads(capsys.readouterr().out)
    assert code == (0 if result["holds"] else 1)
    assert result["holds"] or result["tightest"]["limit"] in ("residual", "acceleration", "speed")
    return bool(result["holds"])


def test_the_speeds_are_those_of_the_plan(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """0.0125 + v (e + d / 2) cycles: each speed holds, and one a tenth higher does not."""
    assert main(PLAN) == 0
    # The faults that are simulated have no part in whether it holds, and take nearly all of the time.
    monkeypatch.setattr(plan_rows, "fault_coverage", lambda window: [])
    capsys.readouterr()
    rows = re.findall(r"^\| (\d+) µs \| (\d+) µs \| (\d+) \| (\d+) \|", PAGE, re.M)
    assert len(rows) == 6
    for jitter_us, delay_us, *speeds in rows:
        for rpm, cycles in zip(speeds, (2500, 512), strict=True):
            for times, allowed in ((1.0, True), (1.1, False)):
                speed = times * float(rpm)
                sampled = speed / 60 * cycles * (float(jitter_us) + float(delay_us) / 2) * 1e-6
                assert holds(speed, cycles, 0.0125 + sampled, capsys) is allowed, (rpm, cycles, times)


def test_the_noise_of_the_residual_tells_the_jitter() -> None:
    """Second differences weigh independent errors by sqrt(1 + 4 + 1)."""
    (factor,) = re.findall(r"65536 \* ([\d.]+) \* v", PAGE)
    assert float(factor) == pytest.approx(6**0.5, abs=0.005)
