"""The source of the site: pages of the repository as they stand, made ones, and the pages of the sections.

The folder has the layout of the repository, so that the links between pages are those that a reader of the
repository follows.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path, PurePosixPath

from tools.site.markdown import FENCED, LINK, first_sentence, title_of
from tools.site.nav import NAV, Section, SiteError, faults_of, pages_of, read_nav

PICTURES = (".svg", ".png")
INTRODUCTION = """# canfb

A sine/cosine encoder becomes a CANopen position. canfb is a CANopen drive feedback module in Python: sine
and cosine samples of a remote encoder interface come in by PDO, a calibrated and supervised absolute
position goes out by PDO.

![data flow](docs/data-flow.svg)
"""


def write_source(root: Path, made: Mapping[str, str], to: Path) -> None:
    """Everything that Sphinx reads. SiteError, a line for each fault, before anything is written."""
    sections = read_nav(root)
    faults = faults_of(sections, pages_of(root), made, root)
    written = {
        page: (root / page).read_text(encoding="utf-8")
        for page in _listed(sections)
        if page not in made and (root / page).is_file()
    }
    for page, text in written.items():
        faults += dead_links(page, text, root, {*made})
    if faults:
        raise SiteError("\n".join(faults))
    shutil.rmtree(to, ignore_errors=True)
    everything = {**made, **written}
    for page, text in written.items():
        _write(to / page, adapted(page, text, root, everything))
    for page, text in made.items():
        _write(to / page, text)
    for section in sections:
        _write(to / f"{section.file}.md", section_page(section, everything))
    _write(to / "index.md", index_page(sections))
    for picture in (path for ending in PICTURES for path in (root / "docs").rglob(f"*{ending}")):
        _copy(picture, to / picture.relative_to(root))


def _listed(sections: Iterable[Section]) -> list[str]:
    return [page for section in sections for page in section.pages]


def dead_links(page: str, text: str, root: Path, made: Iterable[str]) -> list[str]:
    """Links of a page to what is not in the repository, one line each. Anchors are checked by Sphinx."""
    faults = []
    known = set(made)
    for match in LINK.finditer(_without_code(text)):
        target = _target(page, match[3])
        if target is not None and target not in known and not (root / target).exists():
            line = text[: text.find(match[0])].count("\n") + 1
            faults.append(f"{page}:{line}: there is no {target} ({match[3]})")
    return faults


def adapted(page: str, text: str, root: Path, pages: Iterable[str]) -> str:
    """A page for the site: links to files that are not part of it become their names in the repository."""
    known = set(pages)

    def link(match: re.Match[str]) -> str:
        target = _target(page, match[3])
        if target is None or target in known or target.endswith(PICTURES):
            return match[0]
        return f"{match[2]} (`{target}`)" if target not in match[2] else match[2]

    return LINK.sub(link, text)


def _target(page: str, link: str) -> str | None:
    """The path in the repository that a link means; None for an address or an anchor of the same page."""
    path = link.partition("#")[0]
    if not path or re.match(r"[a-z]+:", path):
        return None
    parts: list[str] = []
    for part in (PurePosixPath(page).parent / path).parts:
        if part == ".." and parts:
            parts.pop()
        elif part != ".":
            parts.append(part)
    return "/".join(parts)


def _without_code(text: str) -> str:
    return re.sub(r"`[^`\n]+`", "", FENCED.sub("", text))


def section_page(section: Section, pages: Mapping[str, str]) -> str:
    """The page of a section: a line for each of its pages, below the titles of its groups."""
    lines = [f"# {section.title}", "", section.about, ""]
    for group in section.groups:
        if group.title:
            lines += ["", f"## {group.title}", "", group.about, ""]
        lines += [_line(page, pages[page]) for page in group.pages]
    return "\n".join([*lines, "", *_toctree(section.pages)])


def _line(page: str, text: str) -> str:
    """Title and first sentence of a page."""
    if page.endswith(".rst"):
        title, says = text.splitlines()[0], text.splitlines()[3]
    else:
        title, says = title_of(text), first_sentence(text)
    return f"- [{title}]({page})" + (f": {says}" if says else "")


def index_page(sections: Iterable[Section]) -> str:
    """The first page."""
    lines = [INTRODUCTION, *(f"- **[{one.title}]({one.file}.md)**. {one.about}" for one in sections)]
    lines += ["", "The method is that of B. Höscheler and L. Számel (1997). canfb has the MIT licence.", ""]
    return "\n".join([*lines, *_toctree(f"{one.file}.md" for one in sections)])


def _toctree(pages: Iterable[str]) -> list[str]:
    return [
        "```{toctree}",
        ":hidden:",
        "",
        *(str(PurePosixPath(page).with_suffix("")) for page in pages),
        "```",
        "",
    ]


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def _copy(source: Path, to: Path) -> None:
    to.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, to)


__all__ = ["NAV", "adapted", "dead_links", "index_page", "section_page", "write_source"]
