"""The claims of the paper in short runs: each holds, and its figures are neither worse nor too good."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tools.paper import plant, reproduce
from tools.paper.claim import COLUMNS, FAST, Claim, Verdict, cells, verdict
from tools.site.markdown import table

ROOT = Path(__file__).parents[2]
# Figures of each claim with their bounds; where both are the same, the figure is exact.
BOUNDS: dict[str, dict[str, tuple[float, float]]] = {
    "quad-counting": {
        "cycles": (300_000, 300_000),
        "frequency_hz": (15e6, 15e6),
        "ours_rpm": (0.0080, 0.0085),
        "ours_hz": (125e3, 125e3),
    },
    "conventional-plain": {
        "slow_1us": (600, 950),
        "fast_1us": (82_000, 85_000),
        "noise": (1, 300),
        "ours": (0, 0),
    },
    "conventional-fix": {
        "below": (0, 0),
        "bears": (0.247, 0.252),
        "bears_extreme": (0.105, 0.118),
        "beyond": (97_000, 103_000),
    },
    "table-1-error": {"error": (0.01130, 0.01133)},
    "table-1-continuous": {"slope_min": (0.785, 0.786), "slope_max": (1.570, 1.571)},
    "table-1-misprint": {"step": (-0.8751, -0.8748), "error": (0.874, 0.876)},
    "arc-tangent": {
        "ideal": (1e-6, 5e-5),
        "offset": (0.010, 0.013),
        "extreme": (0.12, 0.15),
        "individual": (5e-5, 1.2e-4),
        "bytes": (800, 800),
    },
    "reference-speed": {"speed_rpm": (24, 24)},
    "reference-50-samples": {"ideal": (1e-7, 2e-5), "usual": (1e-6, 1e-4), "extreme": (5e-6, 2e-4)},
    "reference-fluctuating": {"fluctuating": (3e-6, 2e-4)},
    "eq-10": {"formula": (785_398, 785_399), "found": (785_390, 785_399), "measured": (783_000, 785_300)},
    "servo-machines": {"margin": (39, 40), "slow_limit": (1256, 1257), "needed_hz": (4880, 4890)},
    "long-25khz": {
        "samples": (200_000, 200_000),
        "reversals": (40, 100),
        "top_speed": (3.333, 3.334),
        "wrong": (0, 0),
        "flagged": (0, 0),
        "peak_error": (1.5e-4, 4e-4),
    },
    "long-1khz": {
        "samples": (200_000, 200_000),
        "reversals": (40, 100),
        "top_speed": (83.33, 83.34),
        "wrong": (0, 0),
        "flagged": (0, 0),
        "peak_error": (1.5e-4, 4e-4),
    },
    "revolutions": {"counted": (3319, 3320), "true": (3319, 3320), "wrong": (0, 0), "left_over": (0, 0)},
    "no-speed-limit": {"top_speed": (104_999, 105_001), "wrong": (0, 0), "flagged": (0, 0)},
    "start-up": {"starts": (200, 200), "wrong": (0, 0), "flagged": (0.2, 0.4)},
    "start-up-too-fast": {"starts": (200, 200), "right": (0, 0), "alias": (200, 200), "silent": (0.55, 0.78)},
    "two-thirds": {"formula": (523_598, 523_599), "found": (523_590, 523_599), "part": (0.6666, 0.6667)},
    "between-limits": {"wrong": (0, 0), "flagged": (60, 60), "residual": (0.419, 0.421)},
    "beyond-half": {
        "flagged": (60, 60),
        "flags_before_wrong": (0, 5),
        "speed_error": (-60.01, -59.99),
        "residual": (0.419, 0.421),
    },
    "beyond-two-thirds": {"silent_sudden": (0.45, 0.7), "silent_gentle": (0, 0), "residual": (0.099, 0.101)},
    "never-forgets": {"growth": (999.99, 1000.01), "flagged": (1, 1), "first": (1, 1)},
    "common-amplitude": {"common": (0, 1e-15), "single": (0.011, 0.0125)},
    "resolution": {"steps": (5780, 5810)},
    "cables": {
        "sine dead": (0.9, 0.99),
        "cosine dead": (0.9, 0.99),
        "tracks joined": (0.9, 0.99),
        "tracks swapped": (0.45, 0.7),
        "sine inverted": (0.45, 0.7),
        "standing": (0.05, 0.3),
    },
}
NOT_PLAIN = {
    "table-1-misprint": Verdict.MISPRINT,
    "beyond-two-thirds": Verdict.LIMITED,
    "cables": Verdict.LIMITED,
}


@pytest.fixture(scope="module")
def found() -> dict[str, Claim]:
    return {claim.key: claim for claim in reproduce.claims(FAST)}


def test_every_claim_has_its_bounds(found: dict[str, Claim]) -> None:
    assert set(found) == set(BOUNDS)


@pytest.mark.parametrize("key", BOUNDS)
def test_claim(found: dict[str, Claim], key: str) -> None:
    claim = found[key]
    assert claim.verdict is NOT_PLAIN.get(key, Verdict.YES)
    assert set(claim.figures) == set(BOUNDS[key])
    outside = {
        name: value
        for name, value in claim.figures.items()
        if not BOUNDS[key][name][0] <= value <= BOUNDS[key][name][1]
    }
    assert outside == {}


def test_the_page_has_the_claims_as_the_tool_writes_them(found: dict[str, Claim]) -> None:
    """All but the figures, which come from the long runs there."""
    page = (ROOT / "docs" / "paper.md").read_text(encoding="utf-8").splitlines()
    rows = [line.split(" | ") for line in page if line.startswith("| ")]
    written = [line.split(" | ") for line in table(COLUMNS, map(cells, found.values()))]
    assert [row[:3] + row[4:] for row in rows] == [row[:3] + row[4:] for row in written]


def test_way_is_exact_and_keeps_its_limits() -> None:
    way = plant.Way.random(50_000, 83.3, 0.3, np.random.default_rng(1))
    change = np.diff(way.units, 2) / plant.UNIT
    assert len(way) == 50_000
    assert 0.25 < np.abs(change).max() <= 0.3
    assert 83.0 < way.top_speed < 83.301
    assert way.reversals > 5
    assert not way.error(way.cycles, way.phase).any()
    assert way.error(way.cycles + 1, way.phase).tolist() == [1.0] * len(way)
    there_and_back = plant.Way.from_steps([0.0, 0.25, 0.0, -0.25, -0.25, 0.0, 0.25])
    assert there_and_back.units[0] == there_and_back.units[-1]


def test_score_counts_wrong_cycles_and_flags() -> None:
    way = plant.Way.from_steps(np.concatenate([[0.0], np.full(100, 0.2), np.zeros(400_000)]))
    result = plant.followed(plant.IDEAL, way, None)
    assert plant.score(way, result).wrong == 0
    result.cycles[300_000:300_007] += 1
    result.ok[5] = False
    got = plant.score(way, result)
    assert (got.samples, got.wrong, got.flagged) == (400_101, 7, 1)
    assert 1e-5 < got.peak_error < 2e-4


@pytest.fixture
def two_claims(found: dict[str, Claim], monkeypatch: pytest.MonkeyPatch) -> list[Claim]:
    two = [found["eq-10"], found["resolution"]]
    monkeypatch.setattr(reproduce, "claims", lambda effort: iter(two))
    return two


def test_a_table(two_claims: list[Claim], capsys: pytest.CaptureFixture[str]) -> None:
    assert reproduce.main([]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "| place | claim | the paper | ours | agrees |"
    assert lines[2].startswith(
        "| section 3, eq. 10 | largest acceleration with 2500 cycles at 25 kHz | 785 000 rad"
    )
    assert all(line.count(" | ") == 4 for line in lines[:4])
    assert lines[4:] == ["", "2 claims, 0 do not hold"]


def test_a_claim_that_does_not_hold_fails(
    two_claims: list[Claim], capsys: pytest.CaptureFixture[str]
) -> None:
    two_claims[1] = replace(two_claims[1], verdict=verdict(False, Verdict.LIMITED))
    assert reproduce.main([]) == 1
    assert capsys.readouterr().out.endswith("2 claims, 1 do not hold: resolution\n")
