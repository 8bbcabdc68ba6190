"""The changes known to change nothing: each still is one, and has its reason; the page counts them."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

from tools.suite import mutate

ROOT = Path(__file__).parents[2]
LIST = ROOT / "tests" / "signal" / "known_survivors.txt"


def test_each_known_survivor_is_a_change_and_has_a_reason() -> None:
    lines = [line.split("  # ") for line in LIST.read_text(encoding="utf-8").splitlines()]
    modules = {name.split(" ")[0] for name, _ in lines}
    paths = [path for path in (ROOT / "src" / "canfb" / "signal").rglob("*.py") if path.stem in modules]
    changes = {name for path in paths for name in mutate.names(path)}
    assert [name for name, _ in lines if name not in changes] == []
    assert all(reason for _, reason in lines)
    assert len({name for name, _ in lines}) == len(lines)


def test_the_page_counts_the_changes_and_those_that_change_nothing() -> None:
    page = (ROOT / "docs" / "testing.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\w+)\.py: [^|]* \| (\d+) \| (\d+) \|$", page, re.M)
    known = Counter(line.split(" ")[0] for line in LIST.read_text(encoding="utf-8").splitlines())
    files = {path.stem: path for path in (ROOT / "src" / "canfb" / "signal").rglob("*.py")}
    assert rows == [(name, str(len(mutate.names(files[name]))), str(known[name])) for name, _, _ in rows]
    (every,) = re.findall(r"^\| \*\*all\*\* \| \*\*(\d+)\*\* \| \*\*(\d+)\*\* \|$", page, re.M)
    assert every == tuple(str(sum(int(row[n]) for row in rows)) for n in (1, 2))
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8").replace("\\\n", " ")
    (listed,) = re.findall(r"^MUTATED.*signal/,(.*)\)$", makefile, re.M)
    assert [Path(one).stem for one in listed.split()] == [name for name, _, _ in rows]
