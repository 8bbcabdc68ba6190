"""A snapshot in words: one list of rows, for lines, terminal and browser."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import NamedTuple

from canfb.monitoring.snapshot import (
    BusSnapshot,
    EmergencySnapshot,
    ModuleSnapshot,
    NodeSnapshot,
    SyncSnapshot,
)
from canfb.objects import PositionState
from canfb.rows import age_words
from canfb.signal.limits import RPM

SPELLING = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([^\s\d.,;]{1,8})\s*", re.ASCII)


@dataclass(frozen=True)
class MachineUnits:
    """Units: one revolution is ``per_revolution`` ``name``; by default 1 rev, and min⁻¹."""

    per_revolution: float = 1.0
    name: str = "rev"

    @classmethod
    def parse(cls, text: str) -> MachineUnits:
        """Units from ``"5 mm"``, or ValueError."""
        match = SPELLING.fullmatch(text)
        number = float(match[1]) if match else math.nan
        if match is None or not math.isfinite(number) or number == 0.0:
            raise ValueError(f"{text!r} is not a distance per revolution")
        return cls(number, match[2])

    def position(self, revolutions: float | None) -> str:
        return "-" if revolutions is None else f"{revolutions * self.per_revolution:.5f} {self.name}"

    @property
    def speed_name(self) -> str:
        return "rpm" if self.name == "rev" else f"{self.name}/s"

    def speed(self, rad_s: float) -> float:
        """Speed in units per second, or in rpm."""
        return rad_s * RPM if self.name == "rev" else rad_s / (2.0 * math.pi) * self.per_revolution

    def velocity(self, rad_s: float | None) -> str:
        if rad_s is None:
            return "-"
        return f"{self.speed(rad_s):.{2 if self.name == 'rev' else 3}f} {self.speed_name}"


STALE_S = 1.0
NEAR = 0.8  # part of the residual limit from which a residual is shown as doubtful
ASSUMED = "assumed"
Tone = str  # Display of a text: good, doubtful, bad, faint, or "": normal.
TONES = {PositionState.VALID: "good", PositionState.COASTING: "doubtful"}
Parts = tuple[tuple[str, Tone], ...]


class Line(NamedTuple):
    """A line: texts with their tones."""

    label: str
    parts: Parts

    @property
    def text(self) -> str:
        return "".join(text for text, _ in self.parts)


def module_lines(node: NodeSnapshot, module: ModuleSnapshot, units: MachineUnits) -> list[Line]:
    stale = is_stale(module)
    tone = "faint" if stale else ""
    since, lost = module.since_fault_s, lost_words(node, module)
    words = ", ".join((position_words(module), *([] if stale else module.faults)))
    marks = " ".join(["referenced"] * module.referenced + ["table active"] * module.table_active)
    own = f"  {module.position_units} units" if module.position_units is not None else ""
    counts = (module.counters or module.seen).items()
    counted = ", ".join(f"{name} {count}" for name, count in counts if count)
    return [
        Line("status", ((words, tone_of(module)), (f"  {marks}" if marks else "", "faint"))),
        _scaled("position", units.position(module.position_revolutions), own, module, tone),
        _scaled("velocity", units.velocity(module.velocity_rad_s), "", module, tone),
        Line("residual", ((residual_words(module), residual_tone(module, module.residual_cycles) or tone),)),
        *([Line("why", ((lost, "bad"),))] if lost else []),
        Line("amplitude", ((amplitude_words(module), tone),)),
        Line(
            "2012h" if module.counters else "faults",
            (
                ("" if since is None else f"{age_words(since)} ago: ", "faint"),
                (counted or "none", ""),
                ("" if module.counters or counted else " seen", "faint"),
            ),
        ),
        Line("EMCY", _emergency(node)),
    ]


def _scaled(name: str, words: str, behind: str, module: ModuleSnapshot, tone: Tone) -> Line:
    field = "position_revolutions" if name == "position" else "velocity_rad_s"
    assumed = field in module.assumed and words != "-"
    return Line(name, ((words, tone), (behind, "faint"), (f" (scale {ASSUMED})" if assumed else "", "faint")))


def _emergency(node: NodeSnapshot) -> Parts:
    if not node.emergencies:
        return (("none", "faint"),)
    return (emergency_part(node.emergencies[0]), (f"  ({node.emergency_count})", "faint"))


def emergency_part(one: EmergencySnapshot) -> tuple[str, Tone]:
    return f"{one.code:04X}h {one.text}, {age_words(one.age_s)} ago", "bad" if one.code else ""


def tone_of(module: ModuleSnapshot) -> Tone:
    if is_stale(module):
        return "faint"
    return "bad" if module.position_state is None else TONES.get(PositionState(module.position_state), "bad")


def residual_tone(module: ModuleSnapshot, residual: float | None) -> Tone:
    limit = module.residual_limit_cycles
    if is_stale(module) or not limit or residual is None or residual <= NEAR * limit:
        return ""
    return "bad" if residual > limit else "doubtful"


def bus_lines(snapshot: BusSnapshot) -> list[Line]:
    sync = sync_words(snapshot.sync), "" if snapshot.sync.rate_hz else "bad"
    errors = f", {snapshot.error_frames} error frames" if snapshot.error_frames else ""
    return [Line("SYNC", (sync,)), Line("bus", ((load_words(snapshot), ""), (errors, "bad")))]


def other_nodes(snapshot: BusSnapshot) -> str:
    return ", ".join(f"{node.node_id} {node.state or '-'}" for node in snapshot.nodes if node.module is None)


def sync_words(sync: SyncSnapshot) -> str:
    if sync.rate_hz is None or sync.jitter_rms_s is None or sync.jitter_peak_s is None:
        return "none" if sync.silent_s is None else f"no rate, the last {age_words(sync.silent_s)} ago"
    rms, peak = sync.jitter_rms_s * 1e6, sync.jitter_peak_s * 1e6
    return f"{sync.rate_hz:.6g} Hz, jitter {rms:.1f} µs rms, {peak:.1f} µs peak"


def load_words(snapshot: BusSnapshot) -> str:
    load = snapshot.load
    frames = f"{load.frames_per_s:.0f} frames/s"
    if load.load is None or load.bit_rate is None:
        return f"{frames}, {load.bits_per_s / 1e3:.1f} kbit/s"
    return f"{frames}, load {load.load * 100.0:.1f} % of {load.bit_rate / 1e3:g} kbit/s"


def name_of(node: NodeSnapshot) -> str:
    return f"node {node.node_id} ({node.node_id:02X}h)"


def state_words(node: NodeSnapshot) -> str:
    if node.heard_s is None:
        return "not heard"
    source = "" if node.state_source in (None, "heartbeat") else f" (by {node.state_source})"
    return f"{node.state or 'state not known'}{source}"


def position_words(module: ModuleSnapshot) -> str:
    if is_stale(module):
        return "no module PDO" if module.age_s is None else f"no data for {age_words(module.age_s)}"
    return module.position_state or "no status"


def lost_words(node: NodeSnapshot, module: ModuleSnapshot) -> str:
    if is_stale(module) or module.position_state != PositionState.LOST:
        return ""
    return f"canfb why {node.node_id:#04x}: {module.lost_by or 'its cause is not known'}"


def is_stale(module: ModuleSnapshot) -> bool:
    """Whether nothing was received for a second."""
    return module.age_s is None or module.age_s > STALE_S


def residual_words(module: ModuleSnapshot) -> str:
    if module.residual_cycles is None or module.residual_limit_cycles is None:
        return "-"
    noise = module.residual_noise_cycles
    said = "" if noise is None else f", noise {noise:.4f}"
    limit = f"{_mark(module, 'residual_limit_cycles')}{module.residual_limit_cycles:.3f}"
    return f"{module.residual_cycles:.3f} of {limit} cycle{said}"


def amplitude_words(module: ModuleSnapshot) -> str:
    if module.amplitude_counts is None:
        return "-"
    low, high = module.amplitude_limits_counts
    limits = f", limits {_mark(module, 'amplitude_limits_counts')}{low} to {high}" if high else ""
    return f"{module.amplitude_counts:.0f} counts{' (raw)' if module.amplitude_is_raw else ''}{limits}"


def _mark(module: ModuleSnapshot, name: str) -> str:
    return f"{ASSUMED} " if name in module.assumed else ""


def mapping_words(module: ModuleSnapshot) -> str:
    return module.layout if module.layout in ("module", ASSUMED) else f"{module.layout}, {ASSUMED}"


def plain_lines(snapshot: BusSnapshot, units: MachineUnits) -> list[str]:
    bus = ", ".join(f"{line.label} {line.text}" for line in bus_lines(snapshot))
    head = f"{snapshot.time_s:.3f}"
    modules = []
    for node, module in snapshot.modules:
        rows = module_lines(node, module, units)
        said = ", ".join(f"{row.label} {row.text}" for row in (rows[:1] if is_stale(module) else rows))
        modules.append(f"{head} {name_of(node)}: {state_words(node)}, {said}; {bus}")
    return modules or [f"{head} no module found; {bus}"]
