"""Display of a snapshot in a terminal, with rich."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from rich import box
from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from canfb.monitoring import lines
from canfb.monitoring.snapshot import BusSnapshot, ModuleSnapshot, NodeSnapshot

HEIGHTS, PLAIN_HEIGHTS = "▁▂▃▄▅▆▇█", "_.-:=+*#"
NO_VALUE = " "
BRAILLE = 0x2800
DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))  # of a braille character, by row and column


def bar(part: float, width: int, *, plain: bool = False) -> str:
    part = min(max(part, 0.0), 1.0) if math.isfinite(part) else 1.0
    full = min(width, math.ceil(part * width - 1e-9))
    return ("#" if plain else "█") * full + ("." if plain else "░") * (width - full)


def history(values: Sequence[float | None], top: float, width: int, *, plain: bool = False) -> str:
    """Bar chart of ``width`` characters; full height: ``top``."""
    heights = PLAIN_HEIGHTS if plain else HEIGHTS
    shown = []
    for value in values[-width:]:
        part = 0.0 if value is None or top <= 0.0 else min(max(value / top, 0.0), 1.0)
        shown.append(NO_VALUE if value is None else heights[min(int(part * len(heights)), len(heights) - 1)])
    return "".join(shown).rjust(width)


def dots(
    points: Iterable[tuple[float, float]], limit: float, width: int, height: int, *, plain: bool = False
) -> list[str]:
    """Lines of braille patterns (``plain``: asterisks); x, y are -limit..limit."""
    cells = [[0] * width for _ in range(height)]
    for x, y in points:
        column = int((x / limit + 1.0) / 2.0 * width * 2) if limit > 0.0 else width
        row = int((1.0 - y / limit) / 2.0 * height * 4) if limit > 0.0 else height * 2
        column, row = min(max(column, 0), width * 2 - 1), min(max(row, 0), height * 4 - 1)
        cells[row // 4][column // 2] |= DOTS[row % 4][column % 2]
    if plain:
        return ["".join("*" if cell else " " for cell in line) for line in cells]
    return ["".join(chr(BRAILLE + cell) for cell in line) for line in cells]


HEAD_LINES = 3
PANEL_LINES, HIGHEST_PANEL = 11, 18  # usual and largest height of a module, with its frame, lines
LEAST_FIGURES, LEAST_TRACKS = 56, 12  # least width of figures and of the picture, characters
LABEL = 10
LEAST_TABLE = 4  # lines required for the table before notes get any
NOT_READ = "scales and limits are assumed where they were not read: --sdo reads them"
NO_MODULE = "frames are received, but none of a module: name it (canfb monitor NODE)"
BAR = 60  # width of the residual history, characters: 30 s
STYLES = {"good": "green", "doubtful": "yellow", "bad": "bold red", "faint": "dim", "": ""}
Modules = Sequence[tuple[NodeSnapshot, ModuleSnapshot]]


class Page:
    """The display, fitted to the console; ``plain``: ASCII only."""

    def __init__(
        self, snapshot: BusSnapshot, units: lines.MachineUnits, title: str, *, plain: bool = False
    ) -> None:
        self._snapshot, self._units, self._title, self._plain = snapshot, units, title, plain

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        yield self.layout(options.max_width, options.height or console.height)

    def layout(self, width: int, height: int) -> RenderableType:
        snapshot, modules, others = self._snapshot, self._snapshot.modules, lines.other_nodes(self._snapshot)
        room = height - HEAD_LINES - bool(others)
        if not modules:
            body: list[RenderableType] = [
                self._text(f"\n{NO_MODULE if snapshot.load.frames_per_s else 'no frame'}", "doubtful")
            ]
        elif len(modules) * PANEL_LINES <= room:
            rows = min(HIGHEST_PANEL, room // len(modules))
            body = [self._panel(node, module, width, rows) for node, module in modules]
        else:
            body = self._overview(modules, width, room)
        head = [self._row(line, 6) for line in lines.bus_lines(snapshot)]
        foot = [self._row(lines.Line("other nodes  ", ((others, ""),)), 0)] if others else []
        title = Text(f"{self._title}  {snapshot.time_s:.1f} s", "bold", no_wrap=True, overflow="crop")
        return Group(title, *head, *body, *foot)

    def _text(self, text: str, tone: lines.Tone = "") -> Text:
        return self._row(lines.Line("", ((text, tone),)), 0)

    def _row(self, line: lines.Line, width: int) -> Text:
        parts = [(text, STYLES[tone]) for text, tone in ((f"{line.label:<{width}}", "faint"), *line.parts)]
        return Text.assemble(*parts, no_wrap=True, overflow="crop" if self._plain else "ellipsis")

    def _panel(self, node: NodeSnapshot, module: ModuleSnapshot, width: int, rows: int) -> Panel:
        inner, high = width - 4, rows - 2
        wide = min(2 * high, inner - LEAST_FIGURES - 1)  # characters are about twice as high as wide
        with_tracks = bool(module.tracks_counts) and wide >= LEAST_TRACKS
        figures = inner - wide - 1 if with_tracks else inner
        texts = self._figures(node, module, max(10, min(figures - LABEL - 12, BAR)))
        older = node.emergencies[1 : 1 + max(0, high - len(texts))]
        texts += [self._row(lines.Line("", (lines.emergency_part(one),)), LABEL) for one in older]
        table = Table.grid(padding=(0, 1, 0, 0))
        table.add_column(width=figures, no_wrap=True)
        table.add_column(width=wide if with_tracks else 0, no_wrap=True)
        table.add_row(Group(*texts), self._lissajous(module, wide, wide // 2) if with_tracks else "")
        return Panel(
            table,
            title=f"{lines.name_of(node)}  {lines.state_words(node)}",
            title_align="left",
            subtitle=f"PDO mapping: {lines.mapping_words(module)}",
            subtitle_align="right",
            border_style=STYLES[lines.tone_of(module)],
            box=box.ASCII if self._plain else box.ROUNDED,
            height=min(rows, max(len(texts), wide // 2 if with_tracks else 0) + 2),
        )

    def _figures(self, node: NodeSnapshot, module: ModuleSnapshot, room: int) -> list[Text]:
        rows = lines.module_lines(node, module, self._units)
        labels = [row.label for row in rows]
        drawn = [self._residual_history(module, room)]
        if "why" not in labels:
            drawn.insert(0, self._peak(module, room, " " * LABEL, " peak {:.3f}"))
        texts = [self._row(row, LABEL) for row in rows]
        at = labels.index("amplitude")
        return [*texts[:at], *drawn, *texts[at:]]

    def _peak(self, module: ModuleSnapshot, width: int, head: str = "", behind: str = "") -> Text:
        limit, peak = module.residual_limit_cycles, module.residual_peak_cycles
        if not limit or peak is None:
            return Text("" if behind else "-")
        full = bar(peak / limit, width, plain=self._plain)
        tone = lines.residual_tone(module, peak) or "good"
        return Text.assemble(head.format(peak), (full, STYLES[tone]), (behind.format(peak), "dim"))

    def _residual_history(self, module: ModuleSnapshot, room: int) -> Text:
        limit, values = module.residual_limit_cycles or 0.5, module.residual_history_cycles
        drawn = history(values, limit, room, plain=self._plain)
        tones = [lines.residual_tone(module, value) for value in values[-room:]]
        tones = [""] * (room - len(tones)) + tones
        said = f" last {min(room, len(values)) * module.history_bin_s:.0f} s" if values else ""
        parts = tuple(zip(drawn, tones, strict=True))
        return self._row(lines.Line("history", (*parts, (said, "faint"))), LABEL)

    def _lissajous(self, module: ModuleSnapshot, width: int, height: int) -> Group:
        """Cosine to the right, sine upwards; the edge is full scale."""
        points = [(float(cosine), float(sine)) for sine, cosine in module.tracks_counts]
        limit = float(module.full_scale_counts or max(max(map(abs, point)) for point in points))
        drawn = dots(points, limit, width, height, plain=self._plain)
        return Group(*(Text(line, style="cyan") for line in drawn))

    def _overview(self, modules: Modules, width: int, room: int) -> list[RenderableType]:
        body: list[RenderableType] = []
        if any(module.assumed for _, module in modules) and room > LEAST_TABLE:
            body.append(self._text(NOT_READ, "faint"))
        shown = modules[: max(1, room - len(body) - 2)]
        body.append(self._table(shown, width))
        if len(shown) < len(modules):
            more = f"... and {len(modules) - len(shown)} more: make the window higher"
            body.append(self._text(more, "faint"))
        found = sorted(
            ((node.node_id, one) for node, _ in modules for one in node.emergencies),
            key=lambda entry: entry[1].age_s,
        )
        left = room - len(body) - len(shown) - 1
        if left > 1 and found:
            body.append(self._text("EMCY", "faint"))
            for node_id, one in found[: left - 1]:
                text, tone = lines.emergency_part(one)
                body.append(self._text(f"  node {node_id:<3}  {text}", tone))
        return body

    def _table(self, modules: Modules, width: int) -> Table:
        table = Table(box=None, padding=(0, 1, 0, 0), width=width, header_style="dim", pad_edge=False)
        table.add_column("node", no_wrap=True, width=4, justify="right")
        for name, ratio in (("NMT", 3), ("status", 4), ("position", 4), ("velocity", 3)):
            table.add_column(name, no_wrap=True, ratio=ratio, justify="left", overflow="ellipsis")
        table.add_column("peak residual", no_wrap=True, width=15)
        table.add_column("counts", no_wrap=True, width=6, justify="right")
        for node, module in modules:
            status = lines.module_lines(node, module, self._units)[0].parts[0]
            amplitude = "-" if module.amplitude_counts is None else f"{module.amplitude_counts:.0f}"
            table.add_row(
                str(node.node_id),
                node.state or ("not heard" if node.heard_s is None else "-"),
                self._text(*status),
                self._units.position(module.position_revolutions),
                self._units.velocity(module.velocity_rad_s),
                self._peak(module, 9, "{:.3f} "),
                amplitude,
            )
        return table
