"""docs/architecture.md: its rooms, its arrows and its files are those of the code."""

import re
from pathlib import Path

from test_layering import ALLOWED, PACKAGE, WORDS
from tools.suite import house

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGE = (DOCS / "architecture.md").read_text(encoding="utf-8")
WORD_LIMIT = 1300  # a row for each room, and what goes through them
# Names of files that stand for many.
PATTERN = re.compile(r"[*]|NAME|ROOM")
PLACES = (PACKAGE, ROOT, DOCS)


def test_the_table_is_read_as_it_is_meant_and_goes_from_the_ground_up() -> None:
    assert ALLOWED["device"] == WORDS - {"objects", "rows"}
    assert ALLOWED["replay"] == {"signal", "calibration", "device", "module", "view"} | WORDS
    assert set(ALLOWED) - ALLOWED["cli"] == {"interface", "timing", "cli", "__init__", "__main__"}
    seen: set[str] = set()
    for room, imported in ALLOWED.items():
        assert imported <= seen, f"{room} stands above what it may import"
        seen.add(room)


def test_every_room_is_drawn_above_those_that_it_imports() -> None:
    assert set(house.places()) | {*house.UNDRAWN} == set(ALLOWED)
    assert WORDS | {"eds_files", "marked_yaml"} == set(house.GROUND)
    places, arrows = house.places(), house.arrows()
    assert all(places[upper][1] < places[lower][1] and lower in ALLOWED[upper] for upper, lower in arrows)
    assert {("calibrate", "sdo"), ("module", "view"), ("view", "signal")} <= set(arrows)
    assert not {("cli", "sdo"), ("module", "signal")} & set(arrows)  # which follow from others


def test_the_picture_is_the_one_that_the_tool_draws() -> None:
    drawn = (DOCS / "architecture.svg").read_text(encoding="utf-8")
    assert drawn == house.drawing(), "python -m tools.suite.house > docs/architecture.svg"


def test_every_file_on_the_page_is_there() -> None:
    names = set(re.findall(r"[\w/*.-]+\.(?:py|eds|md|svg)\b", PAGE))
    files = {name for name in names if not PATTERN.search(name)}
    assert len(files) > 25
    missing = [name for name in files if not any((base / name).is_file() for base in PLACES)]
    assert missing == []
    folders = {name.split("/")[0] for name in names - files}
    assert [name for name in folders if not any((base / name).is_dir() for base in PLACES)] == []


def test_names_in_code_are_there() -> None:
    """What the page says of a file's content: `Timed` in device/core.py."""
    code = "\n".join(file.read_text(encoding="utf-8") for file in PACKAGE.rglob("*.py"))
    names = set(re.findall(r"`(?:[A-Z]\w+\.)?([A-Za-z]\w+_\w+|[A-Z]\w+)(?:\(\w*\))?`", PAGE)) - set(ALLOWED)
    assert {"ModuleConfig", "on_written", "SourceConfig"} <= names
    assert [name for name in names if not re.search(rf"\b{name}\b", code)] == []


def test_the_page_says_its_words_is_short_and_linked() -> None:
    assert f"*words* stands for {', '.join(sorted(WORDS))}." in PAGE
    assert len(PAGE.split()) <= WORD_LIMIT
    for page in ("README.md", "CONTRIBUTING.md"):
        assert "(docs/architecture.md)" in (ROOT / page).read_text(encoding="utf-8")
