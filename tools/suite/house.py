"""Draw docs/architecture.svg: the rooms of src/canfb, and which import which.

    python -m tools.suite.house > docs/architecture.svg

An arrow leads from a room to one that it may import, by the table of docs/architecture.md. Arrows that follow
from others, and those to the ground, are omitted. A room is one floor above the highest that it imports;
rooms of a floor are ordered by the mean position of the rooms that import them.
"""

import re
import sys
from functools import cache
from pathlib import Path

WIDTH, ROOM, HEIGHT, FLOOR, TOP = 960, 130, 34, 74, 14
MARGIN = 80  # from the edge to the centre of the outermost room
GROUND = ("cia301", "objects", "checks", "errors", "files", "eds_files", "marked_yaml", "rows")
UNDRAWN = (*GROUND, "__init__", "__main__")
PAGE = Path(__file__).parents[2] / "docs" / "architecture.md"
ALL_BUT = "all above but "
KINDS = {
    "mathematics": ("signal", "timing", "calibration"),
    "canopen": ("device",),
    "join": ("module",),
    "world": ("bus", "hosting"),
}
STYLE = """
  svg { --paper: #ffffff; --ink: #1d2b33; --line: #7b8a93; --room: #f6f8f9;
        --mathematics: #e2f1e4; --canopen: #dcecf2; --join: #fdf3d8; --world: #f9e1dd; }
  @media (prefers-color-scheme: dark) {
    svg { --paper: #0d1117; --ink: #e6edf3; --line: #7b8a93; --room: #1b222a;
          --mathematics: #16331d; --canopen: #12303f; --join: #3d3212; --world: #45201a; } }
  text { fill: var(--ink); text-anchor: middle; font: bold 15px Helvetica, Arial, sans-serif; }
  rect { stroke: var(--line); stroke-width: 1.2; fill: var(--room); }
  .paper { fill: var(--paper); stroke: none; }
  .mathematics { fill: var(--mathematics); } .canopen { fill: var(--canopen); }
  .join { fill: var(--join); } .world { fill: var(--world); }
  path { fill: none; stroke: var(--line); stroke-width: 1.4; } .head { fill: var(--line); stroke: none; }
"""


@cache
def imports() -> dict[str, set[str]]:
    """The imports permitted to each room, by the table of docs/architecture.md."""
    page = PAGE.read_text(encoding="utf-8")
    words = re.findall(r"\*words\* stands for (.+?)\.", page)[0].split(", ")
    named: dict[str, set[str]] = {}
    for room, cell in re.findall(r"^\| `(\w+)` \| .+ \| ?(.*) \|$", page, re.M):
        names = cell.removeprefix(ALL_BUT).split(", ")
        listed = {word for name in names if name for word in (words if name == "words" else [name])}
        named[room] = set(named) - listed if cell.startswith(ALL_BUT) else listed
    return named


def below(room: str) -> list[str]:
    return [lower for lower in imports() if lower in imports()[room] and lower not in UNDRAWN]


@cache
def reached(room: str) -> set[str]:
    return set(below(room)).union(*(reached(lower) for lower in below(room)))


@cache
def floor(room: str) -> int:
    return 1 + max((floor(lower) for lower in below(room)), default=-1)


def arrows() -> list[tuple[str, str]]:
    """The imports that do not follow from others, without imports of the ground."""
    return [
        (room, lower)
        for room in imports()
        if room not in UNDRAWN
        for lower in below(room)
        if not any(lower in reached(other) for other in below(room) if other != lower)
    ]


def places() -> dict[str, tuple[int, int]]:
    """Centre (x) and top (y) of each room; rooms of a floor in the order of the mean x of importers."""
    rooms = [room for room in imports() if room not in UNDRAWN]
    highest = max(map(floor, rooms))
    found: dict[str, tuple[int, int]] = {}
    for number in range(highest, -1, -1):
        above = {
            room: [found[one][0] for one, lower in arrows() if lower == room]
            for room in rooms
            if floor(room) == number
        }
        ordered = sorted(above, key=lambda room: sum(above[room]) / max(1, len(above[room])))
        apart = (WIDTH - 2 * MARGIN) / len(ordered)
        for place, room in enumerate(ordered):
            found[room] = round(MARGIN + apart * (place + 0.5)), TOP + (highest - number) * FLOOR
    return found


def drawing() -> str:
    at = places()
    ground = max(top for _, top in at.values()) + FLOOR
    boxes = [(name, x, top, ROOM) for name, (x, top) in at.items()]
    boxes.append((" · ".join(GROUND), WIDTH // 2, ground, WIDTH - 2 * TOP))
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {ground + HEIGHT + TOP}">',
        f"<title>The rooms of canfb</title><style>{STYLE}</style>",
        '<defs><marker id="head" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" '
        'orient="auto"><path class="head" d="M0 0 L10 5 L0 10 z"/></marker></defs>',
        '<rect class="paper" width="100%" height="100%"/>',
    ]
    for upper, lower in arrows():
        (x0, y0), (x1, y1) = at[upper], at[lower]
        y0 += HEIGHT
        bend = (y1 - y0) // 2
        lines.append(
            f'<path marker-end="url(#head)" d="M{x0} {y0} C{x0} {y0 + bend} {x1} {y1 - bend} {x1} {y1 - 2}"/>'
        )
    for name, x, top, width in boxes:
        kind = next((kind for kind, names in KINDS.items() if name in names), "plain")
        lines.append(
            f'<rect class="{kind}" x="{x - width // 2}" y="{top}" width="{width}" height="{HEIGHT}" rx="6"/>'
        )
        lines.append(f'<text x="{x}" y="{top + 22}">{name}</text>')
    return "\n".join([*lines, "</svg>\n"])


if __name__ == "__main__":
    sys.stdout.write(drawing())
