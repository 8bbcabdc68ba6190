"""docs/index.md: every page is in it once; no link leads nowhere, no page is too long."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MOST_WORDS = 2500
PAGES = [*(ROOT / "docs").rglob("*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"]
FENCED = re.compile(r"^(```|~~~).*?^\1[^\n]*$|`[^`\n]+`", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)#\s]+)[^)\s]*\)")


def test_every_page_is_in_the_order_once() -> None:
    index = ROOT / "docs" / "index.md"
    listed = re.findall(r"^/?\w[\w/-]*$", index.read_text(encoding="utf-8"), re.MULTILINE)
    pages = [ROOT / f"docs/{name}.md" if name[0] != "/" else ROOT / f"{name[1:]}.md" for name in listed]
    assert Counter(pages) == Counter(page for page in PAGES if page != index)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_is_short_and_its_links_lead_somewhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert len(text.split()) <= MOST_WORDS or page.name == "CHANGELOG.md"
    targets = [one for one in LINK.findall(FENCED.sub("", text)) if not re.match(r"[a-z]+:", one)]
    assert not [one for one in targets if not (page.parent / one).is_file()]
