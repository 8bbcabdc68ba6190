"""docs/service.md, events: its lines are those of the program, and its table has every kind."""

from __future__ import annotations

import json
import re
from pathlib import Path

from canfb import objects as od
from canfb.module import event_watch, node_events
from canfb.module.event import DETAILS, EventKind

PAGE = (
    (Path(__file__).parents[2] / "docs" / "service.md")
    .read_text(encoding="utf-8")
    .partition("\n## Events")[2]
)
WATCH = " ".join(
    (
        *(Path(str(one.__file__)).read_text(encoding="utf-8") for one in (event_watch, node_events)),
        *od.FAULT_WORDS.values(),
    )
)


def test_every_kind_has_its_row() -> None:
    rows = re.findall(r"^\| `(\w+)` \| (.*) \|$", PAGE, re.M)
    assert rows.pop(0)[0] == "event"
    assert [kind for kind, _ in rows] == [str(kind) for kind in EventKind]
    assert {kind for kind, text in rows if "only with `-v`" in text} == {str(kind) for kind in DETAILS}


def test_the_lines_have_the_words_of_the_program() -> None:
    (lines, _) = re.findall(r"```text\n(.*?)```", PAGE, re.S)
    for line in lines.splitlines():
        text = re.fullmatch(r"[-0-9]{10} [0-9:.]{12} node 32 \(20h\): (.*)", line)
        assert text, line
        first = re.split(r"[:,]? ?[0-9]|:", text[1])[0].removesuffix(" amplitude").split(",")[0]
        pieces = [word for word in first.split() if word not in ("coasting", "lost", "valid", "OPERATIONAL")]
        assert all(piece in WATCH for piece in pieces), first


def test_the_objects_are_json() -> None:
    (block,) = re.findall(r"```json\n(.*?)```", PAGE, re.S)
    event, message = (json.loads(line) for line in block.splitlines())
    assert set(event) >= {"time", "event", "node", "text", "monotonic_s"}
    assert set(message) == {"event", "level", "text"}
