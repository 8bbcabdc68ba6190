"""docs/architecture.md: its rooms, its arrows and its files are those of the code."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

from test_layering import ALLOWED, PACKAGE, WORDS
from tools.suite import house

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGE = (DOCS / "architecture.md").read_text(encoding="utf-8")
WORD_LIMIT = 1300  # a row for each room, and what goes through them
# Names of files that stand for many.
PATTERN = re.compile(r"[*]|NAME|ROOM")
PLACES = (PACKAGE, ROOT, DOCS)
# Drawn as the ground, without arrows, or not at all.
UNDRAWN = {*house.GROUND, "__init__", "__main__"}


def test_the_table_is_the_rule() -> None:
    assert house.imports() == ALLOWED


def test_the_table_is_in_order_from_the_ground() -> None:
    seen: set[str] = set()
    for room, imported in house.imports().items():
        assert imported <= seen, f"{room} stands above what it may import"
        seen.add(room)


def test_words_are_said_on_the_page() -> None:
    assert f"*words* stands for {', '.join(sorted(WORDS))}." in PAGE


def test_every_room_is_drawn() -> None:
    assert set(house.ROOMS) | UNDRAWN == set(ALLOWED)
    assert WORDS | {"eds_files", "marked_yaml"} == set(house.GROUND)


def test_arrows_do_not_follow_from_others() -> None:
    arrows = house.arrows()
    assert {("calibrate", "sdo"), ("module", "view"), ("view", "signal")} <= set(arrows)
    assert not {("cli", "sdo"), ("module", "signal")} & set(arrows)
    assert [(upper, lower) for upper, lower in arrows if lower not in ALLOWED[upper]] == []


def test_arrows_point_down() -> None:
    assert [
        (upper, lower)
        for upper, lower in house.arrows()
        if house.ROOMS[upper].floor >= house.ROOMS[lower].floor
    ] == []


def test_rooms_stand_apart_and_inside_the_picture() -> None:
    for name, one in house.ROOMS.items():
        assert one.left > 0, name
        assert one.left + one.width < house.WIDTH, name
        for other, two in house.ROOMS.items():
            apart = one.left + one.width < two.left or two.left + two.width < one.left
            assert name == other or one.floor != two.floor or apart, f"{name} and {other}"


def test_the_picture_is_the_one_that_the_tool_draws() -> None:
    drawn = (DOCS / "architecture.svg").read_text(encoding="utf-8")
    assert drawn == house.drawing(), "python -m tools.suite.house > docs/architecture.svg"
    texts = {text.text for text in ElementTree.fromstring(drawn).iter("{http://www.w3.org/2000/svg}text")}
    assert set(house.ROOMS) <= texts


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


def test_the_page_is_short() -> None:
    assert len(PAGE.split()) <= WORD_LIMIT


def test_it_is_linked() -> None:
    for page in ("README.md", "CONTRIBUTING.md"):
        assert "(docs/architecture.md)" in (ROOT / page).read_text(encoding="utf-8")
