"""The claims of the paper in short runs: each holds, and its figures are neither worse nor too good."""

from dataclasses import replace

import pytest

from tools.paper import reproduce
from tools.paper.claim import FAST, Claim, Verdict, verdict

NOT_PLAIN = {
    "table-1-misprint": Verdict.MISPRINT,
    "beyond-two-thirds": Verdict.LIMITED,
    "cables": Verdict.LIMITED,
}


@pytest.fixture(scope="module")
def found() -> list[Claim]:
    return list(reproduce.claims(FAST))


def test_every_claim_is_as_expected_and_as_the_page_has_it(found: list[Claim]) -> None:
    unexpected = {one.key: one.verdict for one in found if one.verdict is not Verdict.YES}
    assert unexpected == NOT_PLAIN
    assert [row[4] for row in reproduce.rows_of_the_page()] == [one.verdict for one in found]
    # Its figures are of the same kind; they come from the long runs.
    for row, claim in zip(reproduce.rows_of_the_page(), found, strict=True):
        words, others = ([word for word in text.split() if word.isalpha()] for text in (row[3], claim.ours))
        assert words == others


def test_a_claim_that_does_not_hold_fails(
    found: list[Claim], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(reproduce, "claims", lambda effort: iter(found))
    assert reproduce.main([]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(line.count(" | ") == 4 for line in lines[:-2])
    assert lines[-1] == f"{len(found)} claims, 0 do not hold"
    found[-1] = replace(found[-1], verdict=verdict(False, Verdict.LIMITED))
    assert reproduce.main([]) == 1
    assert capsys.readouterr().out.endswith(f"{len(found)} claims, 1 do not hold: cables\n")
