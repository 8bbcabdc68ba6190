"""docs/service.md, events: its table has every kind."""

from __future__ import annotations

import re
from pathlib import Path

from canfb.module.events import DETAILS, EventKind

PAGE = (
    (Path(__file__).parents[2] / "docs" / "service.md")
    .read_text(encoding="utf-8")
    .partition("\n## Events")[2]
    .partition("\n## Real time")[0]
)


def test_every_kind_has_its_row() -> None:
    rows = re.findall(r"^\| `(\w+)` \| (.*) \|$", PAGE, re.M)
    assert rows.pop(0)[0] == "event"
    assert [kind for kind, _ in rows] == [str(kind) for kind in EventKind]
    assert {kind for kind, text in rows if "only with `-v`" in text} == {str(kind) for kind in DETAILS}
