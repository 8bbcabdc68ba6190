"""docs/nav.yaml: every page is in it once; what is wrong is said in one line each."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.site.made import MADE
from tools.site.markdown import words_of
from tools.site.nav import NAV, Group, Section, SiteError, faults_of, pages_of, read_nav
from tools.site.pages import adapted, dead_links, section_page, write_source

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


def test_a_page_that_is_there_twice_or_not_at_all_is_named(tmp_path: Path) -> None:
    sections = [
        Section.plain("One", "one", "", ("docs/a.md",)),
        Section.plain("Two", "two", "", ("docs/a.md", "made.md")),
    ]
    assert faults_of(sections, [], ["made.md"], tmp_path) == [
        f"{NAV}: docs/a.md is there twice",
        f"{NAV}: docs/a.md: there is no such page",
        f"{NAV}: docs/a.md: there is no such page",
    ]


def test_nothing_is_written_where_a_page_is_missing(tmp_path: Path) -> None:
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "new.md").write_text("# New\n", encoding="utf-8")
    (tmp_path / NAV).write_text("- {section: A, file: a, about: b, pages: []}\n", encoding="utf-8")
    with pytest.raises(SiteError, match=r"docs/new\.md is not in docs/nav\.yaml"):
        write_source(tmp_path, {}, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("text", ["", "text", "- {section: A}", "- 1", "a: ["])
def test_an_order_of_another_form_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "docs").mkdir()
    (tmp_path / NAV).write_text(text, encoding="utf-8")
    with pytest.raises(
        SiteError, match=r"docs/nav\.yaml: a list of section, file, about, pages or groups is required"
    ):
        read_nav(tmp_path)


def test_a_dead_link_is_named_with_its_line(tmp_path: Path) -> None:
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "here.md").touch()
    text = "# A\n\n[x](here.md#b) `[c](code.md)`\n\n```\n[d](fenced.md)\n```\n"
    text += "[e](https://e.org) [f](../gone.md)\n"
    assert dead_links("docs/a.md", text, tmp_path, []) == ["docs/a.md:8: there is no gone.md (../gone.md)"]


def test_a_link_to_a_file_outside_of_the_site_becomes_its_name() -> None:
    text = "[pages](b.md#c), [the EDS](../eds/x.eds), ![p](p.svg), [`eds/x.eds`](../eds/x.eds)"
    assert adapted("docs/a.md", text, Path(), ["docs/b.md"]) == (
        "[pages](b.md#c), the EDS (`eds/x.eds`), ![p](p.svg), `eds/x.eds`"
    )


def test_a_section_lists_its_pages_with_what_they_say() -> None:
    page = section_page(
        Section.plain("How-to", "how-to", "Tasks.", ("docs/a.md",)),
        {"docs/a.md": "# Do it\n\nIn [one](b.md) step. More.\n"},
    )
    assert "- [Do it](docs/a.md): In one step.\n" in page
    assert page.endswith("```{toctree}\n:hidden:\n\ndocs/a\n```\n")


def test_a_group_has_a_title_on_the_page_of_its_section() -> None:
    groups = (Group("Wire", "Cables.", ("docs/a.md",)), Group("Start", "Go.", ("docs/b.md",)))
    section = Section("How-to", "how-to", "Tasks.", groups)
    page = section_page(section, {"docs/a.md": "# A\n\nOne.\n", "docs/b.md": "# B\n\nTwo.\n"})
    assert section.pages == ("docs/a.md", "docs/b.md")
    wire, start = page.index("## Wire\n\nCables."), page.index("## Start\n\nGo.")
    assert wire < page.index("[A](docs/a.md): One.") < start < page.index("[B](docs/b.md): Two.")
