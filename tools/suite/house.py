"""Draw docs/architecture.svg: the rooms of src/canfb, and which import which.

    python -m tools.suite.house > docs/architecture.svg

An arrow runs from a room to one that it imports. Left out are arrows that follow from others, and those to
the ground. tests/test_architecture.py holds the arrows against the rules of tests/test_layering.py.
"""

from __future__ import annotations

import sys
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
    "cli": Room(320, 260, 0, "a command: parse, call, print"),
    "logs": Room(40, 240, 1, "a bus log, or a folder of them"),
    "bus": Room(20, 240, 2, "the clock, threads, sockets: here alone", "world"),
    "planning": Room(280, 190, 2, "limits, before a bus"),
    "demo": Room(490, 200, 2, "the whole story, in one process"),
    "commissioning": Room(710, 220, 2, "sets up a module over the bus"),
    "configuration": Room(20, 200, 3, "the YAML, validated"),
    "scope": Room(240, 200, 3, "a page for commissioning"),
    "replay": Room(460, 230, 3, "recorded frames through a module"),
    "report": Room(720, 220, 3, "pictures and pages"),
    "simulation": Room(20, 220, 4, "a machine, its encoder, a drive"),
    "module": Room(300, 210, 4, "samples in, position PDO out", "join"),
    "monitoring": Room(530, 160, 4, "what the bus says"),
    "interface": Room(20, 240, 5, "the encoder interface as a node"),
    "sources": Room(320, 200, 6, "samples from elsewhere"),
    "view": Room(540, 160, 5, "what a module is"),
    "calibration": Room(720, 220, 5, "a recording in, a table out", "mathematics"),
    "device": Room(20, 300, 7, "the CiA 301 slave: frames and times in", "canopen"),
    "timing": Room(345, 150, 7, "what times prove", "mathematics"),
    "signal": Room(520, 420, 7, "mathematics of a sample: counts in, position out", "mathematics"),
}
GROUND = ("cia301", "objects", "checks", "errors", "eds_files")
ARROWS = [
    ("cli", "logs"),
    ("cli", "planning"),
    ("cli", "demo"),
    ("cli", "commissioning"),
    ("logs", "bus"),
    ("logs", "replay"),
    ("logs", "report"),
    ("replay", "module"),
    ("bus", "configuration"),
    ("bus", "scope"),
    ("planning", "configuration"),
    ("scope", "monitoring"),
    ("scope", "calibration"),
    ("demo", "configuration"),
    ("demo", "report"),
    ("commissioning", "report"),
    ("commissioning", "sources"),
    ("commissioning", "view"),
    ("configuration", "simulation"),
    ("configuration", "module"),
    ("simulation", "interface"),
    ("interface", "sources"),
    ("interface", "device"),
    ("module", "sources"),
    ("module", "calibration"),
    ("module", "device"),
    ("module", "view"),
    ("module", "timing"),
    ("report", "calibration"),
    ("monitoring", "view"),
    ("view", "signal"),
    ("sources", "signal"),
    ("calibration", "signal"),
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
    ground = TOP + 8 * FLOOR_HEIGHT
    height = ground + ROOM_HEIGHT + TOP
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}">',
        f"<title>The rooms of canfb</title><style>{STYLE}</style>",
        '<defs><marker id="head" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" '
        'orient="auto"><path class="head" d="M0 0 L10 5 L0 10 z"/></marker></defs>',
        f'<rect class="paper" width="{WIDTH}" height="{height}"/>',
        *[arrow(upper, lower) for upper, lower in ARROWS],
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


def arrow(upper: str, lower: str) -> str:
    """From the bottom of a room to the top of another, each at a place of its own."""
    x0, y0 = place(upper, [arrow for arrow in ARROWS if arrow[0] == upper], lower, 1), ROOMS[upper].top
    x1, y1 = place(lower, [arrow for arrow in ARROWS if arrow[1] == lower], upper, 0), ROOMS[lower].top - 2
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
