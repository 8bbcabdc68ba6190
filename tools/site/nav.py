"""docs/nav.yaml: the sections of the site and their pages, and what is wrong with it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

NAV = "docs/nav.yaml"


class SiteError(Exception):
    """The site cannot be built; one line for each fault."""


@dataclass(frozen=True)
class Group:
    """Pages of a section that belong together, below a title; without one if the section has no groups."""

    title: str
    about: str
    pages: tuple[str, ...]


@dataclass(frozen=True)
class Section:
    """A part of the site: its title, its own page without ending, a sentence, its pages in order."""

    title: str
    file: str
    about: str
    groups: tuple[Group, ...]

    @classmethod
    def plain(cls, title: str, file: str, about: str, pages: Iterable[str]) -> Section:
        """Without groups."""
        return cls(title, file, about, (Group("", "", tuple(pages)),))

    @property
    def pages(self) -> tuple[str, ...]:
        """Of all groups."""
        return tuple(page for group in self.groups for page in group.pages)


def read_nav(root: Path) -> list[Section]:
    """The sections of docs/nav.yaml. SiteError for a file that has no such form."""
    try:
        parts = yaml.safe_load((root / NAV).read_text(encoding="utf-8"))
        return [
            Section(str(one["section"]), str(one["file"]), str(one["about"]), tuple(_groups(one)))
            for one in parts
        ]
    except (OSError, yaml.YAMLError, KeyError, TypeError) as error:
        raise SiteError(
            f"{NAV}: a list of section, file, about, pages or groups is required: {error}"
        ) from None


def _groups(section: dict[str, Any]) -> Iterator[Group]:
    if "groups" not in section:
        yield Group("", "", tuple(map(str, section["pages"])))
        return
    for one in section["groups"]:
        yield Group(str(one["group"]), str(one["about"]), tuple(map(str, one["pages"])))


def pages_of(root: Path) -> Iterator[str]:
    """The pages that the folder docs/ has."""
    for path in sorted((root / "docs").rglob("*.md")):
        yield path.relative_to(root).as_posix()


def faults_of(
    sections: Iterable[Section], written: Iterable[str], made: Iterable[str], root: Path
) -> list[str]:
    """What is wrong with the order, one line each: ``written``: those in docs/, ``made``: generated."""
    listed = [page for section in sections for page in section.pages]
    made = set(made)
    twice = sorted({page for page in listed if listed.count(page) > 1})
    faults = [f"{NAV}: {page} is there twice" for page in twice]
    absent = (page for page in listed if page not in made and not (root / page).is_file())
    faults += [f"{NAV}: {page}: there is no such page" for page in absent]
    missing = sorted({*written, *made} - set(listed))
    faults += [f"{page} is not in {NAV}: add it to the pages of a section" for page in missing]
    return faults
