"""reference/api.rst: the public names of canfb for autodoc, and its docstrings as reStructuredText."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Iterator

import canfb
from tools.site.markdown import FIELD

INTRODUCTION = """\
Python API
==========

The names of ``canfb``, with shapes, units, ranges and errors. Others are not stable.

.. py:module:: canfb

"""
PARTS = (
    (
        "Configuration and device",
        (
            "load_config",
            "Config",
            "ModuleConfig",
            "SecondPositionConfig",
            "FeedbackModule",
            "StateFiles",
            "Frame",
        ),
    ),
    ("Signals", ("phase_in_cycle", "track", "process", "process_stream", "max_acceleration", "max_speed")),
    (
        "Calibration",
        ("calibrate_from_motion", "calibrate_from_zero_crossings", "Calibration", "drift", "Drift"),
    ),
)
OTHERS = "Further names"
# What reStructuredText reads as markup: left alone inside of ``literals`` and :roles:`of names`.
KEPT = re.compile(r"(``.+?``|:\w+:`[^`]+`|`[^`]+`)")


def api_page() -> str:
    """The page, reStructuredText."""
    placed = {name for _, names in PARTS for name in names}
    rest = tuple(name for name in canfb.__all__ if name not in placed)
    lines = [INTRODUCTION]
    for title, names in (*PARTS, (OTHERS, rest)):
        lines += [title, "-" * len(title), "", *(_directive(name) for name in names)]
    return "\n".join(lines) + "\n"


def _directive(name: str) -> str:
    thing = getattr(canfb, name)
    if inspect.isclass(thing) and issubclass(thing, Exception):
        return f".. autoexception:: {name}\n"
    if inspect.isclass(thing):
        return f".. autoclass:: {name}\n   :members:\n"
    return f".. autofunction:: {name}\n"


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
