"""Small parts of Markdown pages: cells, tables, titles, first sentences, links."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence

FENCED = re.compile(r"^(```|~~~).*?^\1[^\n]*$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s]+)\)")
FIELD = re.compile(r"^(\w+(?:, \w+)*) {2,}(\S.*)$")
"""A line of a docstring on a field: its name, or several, and what it means."""
SENTENCE = re.compile(r"(.+?[.:])(?:\s|$)", re.DOTALL)


def cell(text: object) -> str:
    """One cell of a table: one line, no bar that would end it."""
    return " ".join(str(text).split()).replace("|", "\\|")


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> Iterator[str]:
    """The lines of a table."""
    yield f"| {' | '.join(head)} |"
    yield "|" + " --- |" * len(head)
    for row in rows:
        yield f"| {' | '.join(cell(one) for one in row)} |"


def plain(text: str) -> str:
    """Text of the code that Markdown must not take for markup, in one line; ``x`` becomes `x`."""
    one_line = " ".join(text.split())
    parts = re.split(r"(``.+?``)", re.sub(r":\w+:`~?\.?([^`]+)`", r"``\1``", one_line))
    return "".join(
        f"`{p[2:-2]}`" if p.startswith("``") else re.sub(r"([*_<\[\]])", r"\\\1", p) for p in parts
    )


def title_of(page: str) -> str:
    """The first heading of a page."""
    found = re.search(r"^# +(.+?)\s*$", page, re.MULTILINE)
    return found[1] if found else ""


def first_sentence(page: str) -> str:
    """What a page says of itself: the first sentence below its heading, without links."""
    _, _, below = page.partition(f"# {title_of(page)}")
    for part in FENCED.sub("", below).split("\n\n"):
        text = " ".join(part.split())
        if (text and text[0].isalpha()) or text.startswith("`"):
            sentence = SENTENCE.match(text)
            return LINK.sub(r"\2", sentence[1] if sentence else text).rstrip(":") if text else ""
    return ""


def words_of(page: str) -> int:
    """Number of words, as wc counts them."""
    return len(page.split())
