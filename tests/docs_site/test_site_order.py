"""docs/nav.yaml: every page is in it once; what is wrong is said in one line each."""

from __future__ import annotations

from pathlib import Path

from tools.site.made import MADE
from tools.site.markdown import words_of
from tools.site.nav import NAV, Section, faults_of, pages_of, read_nav
from tools.site.pages import dead_links

ROOT = Path(__file__).parents[2]
MOST_WORDS = 2500


def test_every_page_is_in_the_order_once() -> None:
    faults = faults_of(read_nav(ROOT), pages_of(ROOT), MADE, ROOT)
    assert not faults, "\n".join(faults)


def test_no_page_has_a_link_that_leads_nowhere() -> None:
    pages = [*pages_of(ROOT), "README.md", "CONTRIBUTING.md"]
    faults = [
        fault
        for page in pages
        for fault in dead_links(page, (ROOT / page).read_text(encoding="utf-8"), ROOT, MADE)
    ]
    assert not faults, "\n".join(faults)


def test_no_page_is_too_long() -> None:
    long = {
        page for page in pages_of(ROOT) if words_of((ROOT / page).read_text(encoding="utf-8")) > MOST_WORDS
    }
    assert not long, f"split pages above {MOST_WORDS} words"


def test_a_page_that_is_missing_in_the_order_is_named() -> None:
    section = Section.plain("One", "one", "", ("docs/a.md",))
    faults = faults_of([section], ["docs/a.md", "docs/new.md"], [], Path("nowhere"))
    assert f"docs/new.md is not in {NAV}: add it to the pages of a section" in faults


def test_a_dead_link_is_named_with_its_line(tmp_path: Path) -> None:
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "here.md").touch()
    text = "# A\n\n[x](here.md#b) `[c](code.md)`\n\n```\n[d](fenced.md)\n```\n"
    text += "[e](https://e.org) [f](../gone.md)\n"
    assert dead_links("docs/a.md", text, tmp_path, []) == ["docs/a.md:8: there is no gone.md (../gone.md)"]
