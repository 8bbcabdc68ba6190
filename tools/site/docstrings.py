"""Docstrings of ours as reStructuredText, for autodoc."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

from tools.site.markdown import FIELD

# What reStructuredText reads as markup: left alone inside of ``literals`` and :roles:`of names`.
KEPT = re.compile(r"(``.+?``|:\w+:`[^`]+`|`[^`]+`)")


def as_rst(lines: Iterable[str]) -> Iterator[str]:
    """A docstring of ours: lines of "name  meaning" become a field list, what looks like markup does not."""
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
    """Text in which stars, bars and low lines stand for themselves."""
    parts = KEPT.split(text)
    return "".join(p if KEPT.fullmatch(p) else re.sub(r"([*|]|_(?=\W|$))", r"\\\1", p) for p in parts)
