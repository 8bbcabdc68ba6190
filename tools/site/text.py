"""Text of the code as Markdown, or as reStructuredText for autodoc: cells, tables, lines, docstrings."""

import re
from collections.abc import Iterable, Iterator, Sequence

FIELD = re.compile(r"^(\w+(?:, \w+)*) {2,}(\S.*)$")
"""A line of a docstring on a field: its name, or several, and what it means."""

# ``literals`` and :roles:`of names`, inside which nothing is escaped for reStructuredText.
KEPT = re.compile(r"(``.+?``|:\w+:`[^`]+`|`[^`]+`)")


def cell(text: object) -> str:
    """A cell of a table: one line, with escaped bars."""
    return " ".join(str(text).split()).replace("|", "\\|")


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> Iterator[str]:
    """The lines of a table."""
    yield f"| {' | '.join(head)} |"
    yield "|" + " --- |" * len(head)
    for row in rows:
        yield f"| {' | '.join(cell(one) for one in row)} |"


def plain(text: str) -> str:
    """Text of the code in one line, escaped for Markdown; ``x`` becomes `x`."""
    one_line = " ".join(text.split())
    parts = re.split(r"(``.+?``)", re.sub(r":\w+:`~?\.?([^`]+)`", r"``\1``", one_line))
    return "".join(
        f"`{p[2:-2]}`" if p.startswith("``") else re.sub(r"([*_<\[\]])", r"\\\1", p) for p in parts
    )


def as_rst(lines: Iterable[str]) -> Iterator[str]:
    """A docstring as reStructuredText: lines "name  meaning" become a field list, other text is escaped."""
    in_fields = in_code = False
    for line in lines:
        stripped = line.strip()
        if in_code and (not stripped or line.startswith(" ")):
            yield line
            continue
        in_code = False
        if start := FIELD.match(line):
            if not in_fields:
                yield ""
            in_fields = True
            yield f":{start[1]}: {escaped(start[2])}"
        elif in_fields and stripped and line.startswith(" "):
            yield f"    {escaped(stripped)}"
        else:
            if in_fields and stripped:
                yield ""
            in_fields = False
            in_code = line.endswith("::")
            yield escaped(line)


def escaped(text: str) -> str:
    """Text with escaped asterisks, bars and underscores."""
    parts = KEPT.split(text)
    return "".join(p if KEPT.fullmatch(p) else re.sub(r"([*|]|_(?=\W|$))", r"\\\1", p) for p in parts)
