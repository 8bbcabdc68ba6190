"""Pictures as SVG files that stand alone: heading, legend and colours are in them."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from canfb.report import style
from canfb.report.plot import LEFT, Key, Plot

HEADING, ROW, MARGIN = 34.0, 18.0, 10.0  # heights
KEY_WIDTH = 22.0


def svg_file(panels: Sequence[tuple[str, Plot]]) -> str:
    """One SVG document with these plots, each below its heading and above its legend; at least one."""
    parts: list[str] = []
    height = 0.0
    for heading, plot in panels:
        parts.append(f'<text x="{LEFT:g}" y="{height + 22.0:g}" class="heading">{escape(heading)}</text>')
        height += HEADING
        parts.append(f'<g transform="translate(0 {height:g})">{plot.drawing()}</g>')
        height += plot.height
        for key in plot.legend:
            parts.append(_key(key, height + ROW / 2.0))
            height += ROW
        height += MARGIN
    width = max(plot.width for _, plot in panels)
    title = "; ".join(plot.title for _, plot in panels)
    body = "\n".join(parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}" height="{height:g}" '
        f'viewBox="0 0 {width:g} {height:g}" role="img">\n<title>{escape(title)}</title>\n'
        f"<style>{style.COLOURS}{style.DRAWING}</style>\n"
        f'<rect class="panel" width="100%" height="100%"/>\n{body}\n</svg>\n'
    )


def _key(key: Key, middle: float) -> str:
    left, centre = LEFT, LEFT + KEY_WIDTH / 2.0
    marks = {
        "line": f'<path class="line {key.style}" d="M{left:g} {middle:g}h{KEY_WIDTH:g}"/>',
        "dot": f'<path class="dots large {key.style}" d="M{centre:g} {middle:g}h0"/>',
        "bar": f'<path class="bar {key.style}" d="M{left + 5.0:g} {middle - 5.0:g}h12v10h-12z"/>',
        "ring": f'<circle class="ring {key.style}" cx="{centre:g}" cy="{middle:g}" r="5"/>',
    }
    words = f'<text x="{left + KEY_WIDTH + 8.0:g}" y="{middle + 4.0:g}">{escape(key.name)}</text>'
    return f"{marks[key.kind]}{words}"
