"""The claims of the paper in short runs: each holds, and its figures are neither worse nor too good."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tools.paper import reproduce
from tools.paper.claim import COLUMNS, FAST, Claim, Verdict, cells, verdict
from tools.site.markdown import table

ROOT = Path(__file__).parents[2]
NOT_PLAIN = {
    "table-1-misprint": Verdict.MISPRINT,
    "beyond-two-thirds": Verdict.LIMITED,
    "cables": Verdict.LIMITED,
}


@pytest.fixture(scope="module")
def found() -> dict[str, Claim]:
    return {claim.key: claim for claim in reproduce.claims(FAST)}


def test_every_claim_is_as_expected(found: dict[str, Claim]) -> None:
    unexpected = {key: one.verdict for key, one in found.items() if one.verdict is not Verdict.YES}
    assert unexpected == NOT_PLAIN


def test_the_page_has_the_claims_as_the_tool_writes_them(found: dict[str, Claim]) -> None:
    """All but the figures, which come from the long runs there."""
    page = (ROOT / "docs" / "paper.md").read_text(encoding="utf-8").splitlines()
    rows = [line.split(" | ") for line in page if line.startswith("| ")]
    written = [line.split(" | ") for line in table(COLUMNS, map(cells, found.values()))]
    assert [row[:3] + row[4:] for row in rows] == [row[:3] + row[4:] for row in written]


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
