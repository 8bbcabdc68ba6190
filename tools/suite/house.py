"""Draw docs/architecture.svg: the rooms of src/canfb, and which import which.

    python -m tools.suite.house > docs/architecture.svg

An arrow runs from a room to one that it may import, by the table of docs/architecture.md. Left out are arrows
that follow from others, and those to the ground.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import escape

WIDTH, ROOM_HEIGHT, FLOOR_HEIGHT, TOP = 960, 56, 100, 20


class Room(NamedTuple):
    """A room: its left edge and width in pixels, its floor (0 is the highest), what it is, and its kind."""

    left: int
    width: int
    floor: int
    says: str
    kind: str = "plain"

    @property
    def top(self) -> int:
        return TOP + self.floor * FLOOR_HEIGHT


ROOMS = {
    "cli": Room(375, 205, 0, "a command: parse, call, print"),
    "commission": Room(130, 230, 1, "limits from a machine in its duty"),
    "diagnosis": Room(680, 155, 1, "nodes, frames, losses"),
    "logs": Room(20, 210, 2, "a log replayed, or a folder"),
    "planning": Room(290, 150, 2, "limits, before a bus"),
    "demo": Room(490, 220, 2, "the whole story, in one process"),
    "scope": Room(765, 175, 2, "a page with pictures"),
    "hosting": Room(35, 175, 3, "a configuration on a bus", "world"),
    "replay": Room(265, 225, 3, "recorded frames through a module"),
    "monitoring": Room(550, 130, 3, "what the bus says"),
    "calibrate": Room(740, 185, 3, "a measurement over the bus"),
    "configuration": Room(120, 140, 4, "the YAML, validated"),
    "report": Room(325, 135, 4, "pictures and pages"),
    "sdo": Room(560, 215, 4, "objects by name, tables, backups"),
    "logfile": Room(800, 140, 4, "bus logs as files"),
    "simulation": Room(100, 220, 5, "a machine, its encoder, a drive"),
    "module": Room(375, 200, 5, "samples in, position PDO out", "join"),
    "master": Room(635, 225, 5, "objects by SDO, samples, undoing"),
    "interface": Room(150, 220, 6, "the encoder interface as a node"),
    "view": Room(430, 130, 6, "what a module is"),
    "calibration": Room(620, 195, 6, "a recording in, a table out", "mathematics"),
    "bus": Room(265, 205, 7, "frames, the clock, the runner", "world"),
    "sources": Room(530, 160, 7, "samples from elsewhere"),
    "device": Room(60, 265, 8, "the CiA 301 slave: frames and times in", "canopen"),
    "signal": Room(575, 325, 8, "mathematics of a sample: counts in, position out", "mathematics"),
    "timing": Room(385, 130, 9, "what times prove", "mathematics"),
}
GROUND = ("cia301", "objects", "checks", "errors", "eds_files", "files", "marked_yaml", "rows")
PAGE = Path(__file__).parents[2] / "docs" / "architecture.md"
ALL_BUT = "all above but "


def imports() -> dict[str, set[str]]:
    """What each room may import: the table of docs/architecture.md."""
    page = PAGE.read_text(encoding="utf-8")
    words = re.findall(r"\*words\* stands for (.+?)\.", page)[0].split(", ")
    named: dict[str, set[str]] = {}
    for room, cell in re.findall(r"^\| `(\w+)` \| .+ \| ?(.*) \|$", page, re.M):
        names = cell.removeprefix(ALL_BUT).split(", ")
        listed = {word for name in names if name for word in (words if name == "words" else [name])}
        named[room] = set(named) - listed if cell.startswith(ALL_BUT) else listed
    return named


def arrows() -> list[tuple[str, str]]:
    """The imports that do not follow from others, without those of the ground, from the top down."""
    allowed = imports()
    below = {room: [lower for lower in ROOMS if lower in allowed[room]] for room in ROOMS}

    def reached(room: str) -> set[str]:
        return set(below[room]).union(*(reached(lower) for lower in below[room]))

    return [
        (room, lower)
        for room in ROOMS
        for lower in below[room]
        if not any(lower in reached(other) for other in below[room] if other != lower)
    ]


STYLE = """
  svg { --paper: #ffffff; --ink: #1d2b33; --faint: #5c6b74; --line: #7b8a93; --room: #f6f8f9;
        --mathematics: #e2f1e4; --canopen: #dcecf2; --join: #fdf3d8; --world: #f9e1dd; }
  @media (prefers-color-scheme: dark) {
    svg { --paper: #0d1117; --ink: #e6edf3; --faint: #9aa7b1; --line: #7b8a93; --room: #1b222a;
          --mathematics: #16331d; --canopen: #12303f; --join: #3d3212; --world: #45201a; } }
  text { fill: var(--ink); text-anchor: middle; font: 12px Helvetica, Arial, sans-serif; }
  .name { font-weight: bold; font-size: 15px; } .says { fill: var(--faint); }
  rect { stroke: var(--line); stroke-width: 1.2; fill: var(--room); }
  .paper { fill: var(--paper); stroke: none; }
  .mathematics { fill: var(--mathematics); } .canopen { fill: var(--canopen); }
  .join { fill: var(--join); } .world { fill: var(--world); }
  path { fill: none; stroke: var(--line); stroke-width: 1.4; } .head { fill: var(--line); stroke: none; }
"""


def drawing() -> str:
    ground = TOP + 10 * FLOOR_HEIGHT
    height = ground + ROOM_HEIGHT + TOP
    lines = arrows()
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}">',
        f"<title>The rooms of canfb</title><style>{STYLE}</style>",
        '<defs><marker id="head" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" '
        'orient="auto"><path class="head" d="M0 0 L10 5 L0 10 z"/></marker></defs>',
        f'<rect class="paper" width="{WIDTH}" height="{height}"/>',
        *[arrow(upper, lower, lines) for upper, lower in lines],
        *[room(name, one) for name, one in ROOMS.items()],
        f'<rect x="20" y="{ground}" width="{WIDTH - 40}" height="{ROOM_HEIGHT}" rx="6"/>',
        text(WIDTH // 2, ground + 24, "name", " · ".join(GROUND)),
        text(WIDTH // 2, ground + 43, "says", "names, checks and errors: no arrows drawn"),
        "</svg>\n",
    ]
    return "\n".join(parts)


def room(name: str, one: Room) -> str:
    middle = one.left + one.width // 2
    return (
        f'<rect class="{one.kind}" x="{one.left}" y="{one.top}" width="{one.width}" height="{ROOM_HEIGHT}" '
        f'rx="6"/>{text(middle, one.top + 24, "name", name)}{text(middle, one.top + 43, "says", one.says)}'
    )


def text(x: int, y: int, kind: str, content: str) -> str:
    return f'<text class="{kind}" x="{x}" y="{y}">{escape(content)}</text>'


def arrow(upper: str, lower: str, arrows: list[tuple[str, str]]) -> str:
    """From the bottom of a room to the top of another, each at a place of its own."""
    x0, y0 = place(upper, [arrow for arrow in arrows if arrow[0] == upper], lower, 1), ROOMS[upper].top
    x1, y1 = place(lower, [arrow for arrow in arrows if arrow[1] == lower], upper, 0), ROOMS[lower].top - 2
    y0 += ROOM_HEIGHT
    bend = min(60, (y1 - y0) // 2)
    return f'<path marker-end="url(#head)" d="M{x0} {y0} C{x0} {y0 + bend} {x1} {y1 - bend} {x1} {y1}"/>'


def place(name: str, arrows: list[tuple[str, str]], other: str, end: int) -> int:
    """Where at this room the arrow to or from the other one is: in the order of the others."""
    others = sorted((arrow[end] for arrow in arrows), key=lambda one: ROOMS[one].left + ROOMS[one].width / 2)
    return ROOMS[name].left + ROOMS[name].width * (others.index(other) + 1) // (len(others) + 1)


def main() -> int:
    sys.stdout.write(drawing())
    return 0


if __name__ == "__main__":
    sys.exit(main())
