"""A snapshot as a page of a terminal, by rich."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from rich import box
from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from canfb.monitoring import lines
from canfb.monitoring.lines import MachineUnits
from canfb.monitoring.snapshot import BusSnapshot, ModuleSnapshot, NodeSnapshot

HEIGHTS, PLAIN_HEIGHTS = "▁▂▃▄▅▆▇█", "_.-:=+*#"
NO_VALUE = " "
BRAILLE = 0x2800
DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))  # of a character, by row and column


def bar(part: float, width: int, *, plain: bool = False) -> str:
    """``width`` characters, the part 0..1 of them full; one at least."""
    part = min(max(part, 0.0), 1.0) if math.isfinite(part) else 1.0
    full = min(width, math.ceil(part * width - 1e-9))
    return ("#" if plain else "█") * full + ("." if plain else "░") * (width - full)


def history(values: Sequence[float | None], top: float, width: int, *, plain: bool = False) -> str:
    """The last ``width`` values as heights up to ``top``."""
    heights = PLAIN_HEIGHTS if plain else HEIGHTS
    shown = []
    for value in values[-width:]:
        part = 0.0 if value is None or top <= 0.0 else min(max(value / top, 0.0), 1.0)
        shown.append(NO_VALUE if value is None else heights[min(int(part * len(heights)), len(heights) - 1)])
    return "".join(shown).rjust(width)


def dots(
    points: Iterable[tuple[float, float]], limit: float, width: int, height: int, *, plain: bool = False
) -> list[str]:
    """``height`` lines of ``width`` braille patterns (``plain``: asterisks); x, y are -limit..limit."""
    cells = [[0] * width for _ in range(height)]
    for x, y in points:
        column = int((x / limit + 1.0) / 2.0 * width * 2) if limit > 0.0 else width
        row = int((1.0 - y / limit) / 2.0 * height * 4) if limit > 0.0 else height * 2
        column, row = min(max(column, 0), width * 2 - 1), min(max(row, 0), height * 4 - 1)
        cells[row // 4][column // 2] |= DOTS[row % 4][column % 2]
    if plain:
        return ["".join("*" if cell else " " for cell in line) for line in cells]
    return ["".join(chr(BRAILLE + cell) for cell in line) for line in cells]


PANEL_LINES, HIGHEST_PANEL = 11, 18  # of a module, with its frame
LEAST_FIGURES, LEAST_TRACKS = 56, 12  # characters
LABEL = 10
LEAST_TABLE = 4  # lines: below, there is no room for notes
NOT_READ = "scales and limits are assumed where they were not read: --sdo reads them"
NO_MODULE = "frames come, but none of a module: name it (canfb monitor NODE)"
BAR = 60  # characters, of the residual: 30 s of it
STYLES = {"good": "green", "doubtful": "yellow", "bad": "bold red", "faint": "dim", "": ""}
GOOD, DOUBTFUL, BAD, FAINT = (STYLES[tone] for tone in ("good", "doubtful", "bad", "faint"))


class Page:
    """The whole picture, for the size of the console; ``plain``: in ASCII."""

    def __init__(
        self, snapshot: BusSnapshot, units: MachineUnits, title: str, *, plain: bool = False
    ) -> None:
        self._snapshot = snapshot
        self._units = units
        self._title = title
        self._plain = plain

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        yield self.layout(options.max_width, options.height or console.height)

    def layout(self, width: int, height: int) -> RenderableType:
        """All modules with their pictures where they fit, else a line for each."""
        snapshot = self._snapshot
        head = self._head(width)
        modules = snapshot.modules
        others = lines.other_nodes(snapshot)
        left = height - len(head) - bool(others)
        parts: list[RenderableType] = list(head)
        if not modules:
            parts.append(Text(f"\n{NO_MODULE if snapshot.load.frames_per_s > 0.0 else 'no frame'}", DOUBTFUL))
        elif len(modules) * PANEL_LINES <= left:
            rows = min(HIGHEST_PANEL, left // len(modules))
            parts += [self._panel(node, module, width, rows) for node, module in modules]
        else:
            if any(module.assumed for _, module in modules) and left > LEAST_TABLE:
                parts.append(Text(NOT_READ, FAINT))
                left -= 1
            shown = modules[: max(1, left - 2)]
            parts.append(self._table(shown, width))
            left -= 2 + len(shown)
            if len(shown) < len(modules):
                parts.append(Text(f"... and {len(modules) - len(shown)} more: make the window higher", FAINT))
                left -= 1
            parts += self._errors(modules, left, width)
        if others:
            parts.append(self._cut(Text.assemble(("other nodes  ", FAINT), others), width))
        return Group(*parts)

    def _cut(self, text: Text, width: int) -> Text:
        """One line of it."""
        text.no_wrap = True
        text.truncate(width, overflow="crop" if self._plain else "ellipsis")
        return text

    def _head(self, width: int) -> list[Text]:
        title = Text(f"{self._title}  {self._snapshot.time_s:.1f} s", style="bold")
        rows = [_row(line, 6) for line in lines.bus_lines(self._snapshot)]
        return [self._cut(one, width) for one in (title, *rows)]

    def _panel(self, node: NodeSnapshot, module: ModuleSnapshot, width: int, rows: int) -> Panel:
        """A frame of ``rows`` lines: figures, and tracks where there is room."""
        inner, high = width - 4, rows - 2
        wide = min(2 * high, inner - LEAST_FIGURES - 1)  # characters are about twice as high as wide
        with_tracks = bool(module.tracks_counts) and wide >= LEAST_TRACKS
        figures = inner - wide - 1 if with_tracks else inner
        texts = self._figures(node, module, figures)
        texts += self._more_errors(node, high - len(texts))
        table = Table.grid(padding=(0, 1, 0, 0))
        table.add_column(width=figures, no_wrap=True)
        cells: list[RenderableType] = [Group(*(self._cut(one, figures) for one in texts))]
        if with_tracks:
            table.add_column(width=wide, no_wrap=True)
            cells.append(self._lissajous(module, wide, wide // 2))
        table.add_row(*cells)
        rows = min(rows, max(len(texts), wide // 2 if with_tracks else 0) + 2)
        return Panel(
            table,
            title=f"{lines.name_of(node)}  {lines.state_words(node)}",
            title_align="left",
            subtitle=f"PDO mapping: {lines.mapping_words(module)}",
            subtitle_align="right",
            border_style=STYLES[lines.tone_of(module)],
            box=box.ASCII if self._plain else box.ROUNDED,
            height=rows,
        )

    def _figures(self, node: NodeSnapshot, module: ModuleSnapshot, width: int) -> list[Text]:
        """The rows, and the residual as pictures; without the peak where a loss needs the room."""
        rows = lines.module_lines(node, module, self._units)
        texts = {row.label: _row(row, LABEL) for row in rows}
        room = _bar_width(width)
        drawn = self._residual_history(module, room)
        if "why" in texts:
            return _behind(texts, "why", drawn)
        return _behind(texts, "residual", self._peak(module, room, " " * LABEL, " peak {:.3f}"), drawn)

    def _peak(self, module: ModuleSnapshot, width: int, head: str = "", behind: str = "") -> Text:
        """The peak residual of the last second: single samples change faster than anybody reads."""
        limit, peak = module.residual_limit_cycles, module.residual_peak_cycles
        if not limit or peak is None:
            return Text("" if behind else "-")
        full = bar(peak / limit, width, plain=self._plain)
        style = STYLES[lines.residual_tone(module, peak)] or GOOD
        return Text.assemble(head.format(peak), (full, style), (behind.format(peak), FAINT))

    def _residual_history(self, module: ModuleSnapshot, room: int) -> Text:
        limit, values = module.residual_limit_cycles or 0.5, module.residual_history_cycles
        seconds = min(room, len(values)) * module.history_bin_s
        drawn = history(values, limit, room, plain=self._plain)
        text = Text.assemble(
            (f"{'history':<{LABEL}}", FAINT), drawn, (f" last {seconds:.0f} s" if values else "", FAINT)
        )
        for place, value in enumerate(values[-room:], start=LABEL + room - len(values[-room:])):
            if value is not None and value > limit * lines.NEAR:
                text.stylize(BAD if value > limit else DOUBTFUL, place, place + 1)
        return text

    def _lissajous(self, module: ModuleSnapshot, width: int, height: int) -> Group:
        """Cosine to the right, sine upwards; the rim is the full scale."""
        points = [(float(cosine), float(sine)) for sine, cosine in module.tracks_counts]
        limit = float(module.full_scale_counts or max(max(map(abs, point)) for point in points))
        drawn = dots(points, limit, width, height, plain=self._plain)
        return Group(*(Text(line, style="cyan") for line in drawn))

    def _more_errors(self, node: NodeSnapshot, room: int) -> list[Text]:
        """The EMCYs before the last one."""
        rest = node.emergencies[1 : 1 + max(0, room)]
        return [_row(lines.Line("", (lines.emergency_part(one),)), LABEL) for one in rest]

    def _table(self, modules: Sequence[tuple[NodeSnapshot, ModuleSnapshot]], width: int) -> Table:
        """A line for each module."""
        table = Table(box=None, padding=(0, 1, 0, 0), width=width, header_style=FAINT, pad_edge=False)
        table.add_column("node", no_wrap=True, width=4, justify="right")
        for name, ratio in (("NMT", 3), ("status", 4), ("position", 4), ("velocity", 3)):
            table.add_column(name, no_wrap=True, ratio=ratio, justify="left", overflow="ellipsis")
        table.add_column("peak residual", no_wrap=True, width=15)
        table.add_column("counts", no_wrap=True, width=6, justify="right")
        for node, module in modules:
            stale = lines.is_stale(module)
            words = lines.position_words(module)
            if module.faults and not stale:
                words += f": {', '.join(module.faults)}"
            amplitude = "-" if module.amplitude_counts is None else f"{module.amplitude_counts:.0f}"
            table.add_row(
                str(node.node_id),
                node.state or ("not heard" if node.heard_s is None else "-"),
                Text(words, STYLES[lines.tone_of(module)]),
                self._units.position(module.position_revolutions),
                self._units.velocity(module.velocity_rad_s),
                self._peak(module, 9, "{:.3f} "),
                amplitude,
            )
        return table

    def _errors(
        self, modules: Sequence[tuple[NodeSnapshot, ModuleSnapshot]], room: int, width: int
    ) -> list[Text]:
        """The newest EMCYs of all modules."""
        found = [(one.age_s, node.node_id, one) for node, _ in modules for one in node.emergencies]
        found.sort(key=lambda entry: entry[0])
        if room < 2 or not found:
            return []
        texts = [Text("EMCY", FAINT)]
        for age_s, node_id, one in found[: room - 1]:
            text = f"{lines.age(age_s):>8} ago  node {node_id:<3}  {one.code:04X}h {one.text}"
            texts.append(self._cut(Text(text, "" if one.code == 0 else BAD), width))
        return texts


def _row(line: lines.Line, width: int) -> Text:
    return Text.assemble(
        (f"{line.label:<{width}}", FAINT), *((text, STYLES[tone]) for text, tone in line.parts)
    )


def _behind(texts: dict[str, Text], label: str, *more: Text) -> list[Text]:
    """The rows, with ``more`` behind the one of this label."""
    return [text for name, row in texts.items() for text in ((row, *more) if name == label else (row,))]


def _bar_width(width: int) -> int:
    """Of what is drawn behind a label, before a figure."""
    return max(10, min(width - LABEL - 12, BAR))
