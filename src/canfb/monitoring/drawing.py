"""Bars, histories and dots of characters."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

HEIGHTS, PLAIN_HEIGHTS = "▁▂▃▄▅▆▇█", "_.-:=+*#"
NO_VALUE = " "
BRAILLE = 0x2800
DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))  # of a character, by row and column


def bar(part: float, width: int, *, plain: bool = False) -> str:
    """``width`` characters, the part 0..1 of them full; at least one for more than nothing."""
    part = min(max(part, 0.0), 1.0) if math.isfinite(part) else 1.0
    full = min(width, math.ceil(part * width - 1e-9))
    return ("#" if plain else "█") * full + ("." if plain else "░") * (width - full)


def history(values: Sequence[float | None], top: float, width: int, *, plain: bool = False) -> str:
    """The last ``width`` values as heights up to ``top``; a blank where there is none."""
    heights = PLAIN_HEIGHTS if plain else HEIGHTS
    shown = []
    for value in values[-width:]:
        part = 0.0 if value is None or top <= 0.0 else min(max(value / top, 0.0), 1.0)
        shown.append(NO_VALUE if value is None else heights[min(int(part * len(heights)), len(heights) - 1)])
    return "".join(shown).rjust(width)


def dots(
    points: Iterable[tuple[float, float]], limit: float, width: int, height: int, *, plain: bool = False
) -> list[str]:
    """``height`` lines of ``width`` characters with a dot at each point (x, y), -limit..limit both.

    Of braille patterns, two dots wide and four high; ``plain``: an asterisk for each character.
    """
    cells = [[0] * width for _ in range(height)]
    for x, y in points:
        column = int((x / limit + 1.0) / 2.0 * width * 2) if limit > 0.0 else width
        row = int((1.0 - y / limit) / 2.0 * height * 4) if limit > 0.0 else height * 2
        column, row = min(max(column, 0), width * 2 - 1), min(max(row, 0), height * 4 - 1)
        cells[row // 4][column // 2] |= DOTS[row % 4][column % 2]
    if plain:
        return ["".join("*" if cell else " " for cell in line) for line in cells]
    return ["".join(chr(BRAILLE + cell) for cell in line) for line in cells]
