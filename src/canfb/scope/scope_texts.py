"""Texts of the page, as HTML; text from the bus or from a file is escaped."""

from __future__ import annotations

from html import escape
from itertools import groupby

from canfb.monitoring import lines
from canfb.monitoring.lines import MachineUnits
from canfb.monitoring.snapshot import BusSnapshot, ModuleSnapshot, NodeSnapshot
from canfb.scope.desk import DeskState, Stage
from canfb.scope.traces import DeviationCurve

NOT_HEARD = "<p class='state bad'>no module heard yet</p>"
KINDS = {"valid": "good", "coasting": "doubtful"}


def bus_line(snapshot: BusSnapshot | None) -> str:
    """SYNC and load."""
    if snapshot is None:
        return "<p class='bus'>nothing heard yet</p>"
    sync, load = escape(lines.sync_words(snapshot.sync)), escape(lines.load_words(snapshot))
    return f"<p class='bus'>SYNC {sync}<br>{load}</p>"


def state_line(node: NodeSnapshot, module: ModuleSnapshot) -> str:
    """Position valid, lost and so on, with the faults of the status word."""
    stale = lines.is_stale(module)
    kind = "bad" if stale else KINDS.get(module.position_state or "", "bad")
    faults = "" if stale or not module.faults else f": {', '.join(module.faults)}"
    lost = lines.lost_words(node, module)
    return (
        f"<p class='state {kind}'>{escape(lines.position_words(module) + faults)}</p>"
        f"{f'<p>{escape(lost)}</p>' if lost else ''}"
        f"<p class='node'>{escape(lines.name_of(node))}, {escape(lines.state_words(node))}</p>"
    )


def figures_table(module: ModuleSnapshot, units: MachineUnits) -> str:
    """The present values."""
    position = units.position(module.position_revolutions) + lines.scale_note(module, "position_revolutions")
    velocity = units.velocity(module.velocity_rad_s) + lines.scale_note(module, "velocity_rad_s")
    return _table(
        [
            ("position", position),
            ("position value, 6004h", "-" if module.position_units is None else str(module.position_units)),
            ("velocity", velocity),
            ("residual", lines.residual_words(module)),
            ("amplitude", lines.amplitude_words(module)),
            ("its limits", lines.amplitude_limits_words(module) or "-"),
            ("table", "active" if module.table_active else "none active"),
            ("zero pulse", "referenced" if module.referenced else "not referenced"),
            ("PDO mapping", lines.mapping_words(module)),
        ]
    )


def counters_table(module: ModuleSnapshot) -> str:
    """Counters 2012h where they are known, and what was counted here."""
    rows = []
    for name in dict.fromkeys((*module.counters, *module.seen)):
        there, here = module.counters.get(name), module.seen.get(name)
        rows.append((name, ("-" if there is None else str(there), "-" if here is None else str(here))))
    since = "none seen" if module.since_fault_s is None else f"{lines.age(module.since_fault_s)} ago"
    body = "".join(f"<tr><th>{escape(name)}</th><td>{a}</td><td>{b}</td></tr>" for name, (a, b) in rows)
    head = "<tr><th></th><td class='faint'>2012h</td><td class='faint'>seen here</td></tr>"
    return f"<table>{head}{body}</table><p class='faint'>last position that was not valid: {since}</p>"


def emergencies(node: NodeSnapshot) -> str:
    """The last EMCYs."""
    if not node.emergencies:
        return "<p class='faint'>none heard</p>"
    rows = "".join(
        f"<tr><th>{one.code:04X}h</th><td class='words'>{escape(one.text)}</td>"
        f"<td>{lines.age(one.age_s)} ago</td></tr>"
        for one in node.emergencies[:6]
    )
    return f"<table>{rows}</table><p class='faint'>{node.emergency_count} in all</p>"


def deviation_note(curve: DeviationCurve, *, known: bool) -> str:
    """What the picture of the deviation shows."""
    if curve.note:
        return f"<p class='faint'>nothing to see: {escape(curve.note)}</p>"
    before = f"<span class='before'>without a table</span> {curve.before_rms:.3f} % rms"
    if curve.with_table:
        return f"<p>{before}, <span class='after'>with the active one</span> {curve.rms:.3f} % rms</p>"
    why = "no table is active" if known else "the active table is not known: read it (--sdo)"
    return f"<p>{before}; <span class='faint'>{why}</span></p>"


def desk_text(state: DeskState) -> str:
    """The task that runs or has ended."""
    if state.stage is Stage.IDLE:
        return "<p class='faint'>no task yet</p>"
    if state.stage is Stage.RUNNING:
        done = round(100.0 * state.part)
        return (
            f"<p class='state doubtful'>{escape(state.title)}</p><p>{escape(state.step)}</p>"
            f"<progress max='100' value='{done}'></progress> {done} %"
        )
    kind, said = ("good", "done") if state.stage is Stage.DONE else ("bad", "failed")
    text = f"<p class='state {kind}'>{escape(state.title)}: {said}</p>"
    if state.measured is not None:
        text += "<p>mean deviation over the phase: <span class='before'>before</span>, "
        text += "<span class='after'>after</span></p>"
    return text


def outcome_text(state: DeskState) -> str:
    """What has come out of a task: columns as they are, sentences as paragraphs."""
    parts: list[str] = []
    for in_columns, group in groupby(state.lines, lambda line: not line or "  " in line):
        text = [escape(line) for line in group]
        parts += ["<pre>" + "\n".join(text) + "</pre>"] if in_columns else [f"<p>{one}</p>" for one in text]
    return "".join(parts)


def _table(rows: list[tuple[str, str]]) -> str:
    body = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in rows)
    return f"<table>{body}</table>"
