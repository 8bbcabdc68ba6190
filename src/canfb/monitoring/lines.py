"""A snapshot in words, with the units of the machine: what page, panels and lines are made of."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from canfb.monitoring.snapshot import BusSnapshot, ModuleSnapshot, NodeSnapshot, SyncSnapshot
from canfb.objects import PositionState

RPM = 60.0 / (2.0 * math.pi)
SPELLING = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([^\s\d.,;]{1,8})\s*", re.ASCII)


@dataclass(frozen=True)
class MachineUnits:
    """``per_revolution`` of ``name`` are one revolution of the encoder; by default 1 rev, and min⁻¹."""

    per_revolution: float = 1.0
    name: str = "rev"

    @classmethod
    def parse(cls, text: str) -> MachineUnits:
        """``"5 mm"``: 5 mm for each revolution. ValueError for anything else."""
        match = SPELLING.fullmatch(text)
        number = float(match[1]) if match else math.nan
        if match is None or not math.isfinite(number) or number == 0.0:
            raise ValueError(f"{text!r} is not a distance per revolution such as '5 mm' or '360 deg'")
        return cls(number, match[2])

    def position(self, revolutions: float | None) -> str:
        """In words, with the unit."""
        return "-" if revolutions is None else f"{revolutions * self.per_revolution:.5f} {self.name}"

    def velocity(self, rad_s: float | None) -> str:
        """In words, with the unit."""
        if rad_s is None:
            return "-"
        if self.name == "rev":
            return f"{rad_s * RPM:.2f} rpm"
        return f"{rad_s / (2.0 * math.pi) * self.per_revolution:.3f} {self.name}/s"


STALE_S = 1.0
ASSUMED = "assumed"


def sync_words(sync: SyncSnapshot) -> str:
    """Rate and jitter of the SYNC."""
    if sync.rate_hz is None or sync.jitter_rms_s is None or sync.jitter_peak_s is None:
        return "none" if sync.silent_s is None else f"none for {age(sync.silent_s)}"
    rms, peak = sync.jitter_rms_s * 1e6, sync.jitter_peak_s * 1e6
    return f"{sync.rate_hz:.6g} Hz, jitter {rms:.1f} µs rms, {peak:.1f} µs peak"


def load_words(snapshot: BusSnapshot) -> str:
    """Frames and bus load."""
    load = snapshot.load
    frames = f"{load.frames_per_s:.0f} frames/s"
    if load.load is None or load.bit_rate is None:
        return f"{frames}, {load.bits_per_s / 1e3:.1f} kbit/s"
    return f"{frames}, load {load.load * 100.0:.1f} % of {load.bit_rate / 1e3:g} kbit/s"


def name_of(node: NodeSnapshot) -> str:
    """The node-ID, decimal and hexadecimal."""
    return f"node {node.node_id} ({node.node_id:02X}h)"


def state_words(node: NodeSnapshot) -> str:
    """NMT state, and how it is known where that is not a heartbeat."""
    if node.heard_s is None:
        return "not heard"
    source = "" if node.state_source in (None, "heartbeat") else f" (by {node.state_source})"
    return f"{node.state or 'state not known'}{source}"


def position_words(module: ModuleSnapshot) -> str:
    """The status word in one or a few words; "no data" if it is old."""
    if is_stale(module):
        return "no data" if module.age_s is None else f"no data for {age(module.age_s)}"
    return module.position_state or "no status"


def lost_words(node: NodeSnapshot, module: ModuleSnapshot) -> str:
    """Why the position is lost, and who knows what to do; empty unless it is lost."""
    if is_stale(module) or module.position_state != PositionState.LOST:
        return ""
    return f"canfb why {node.node_id:#04x}: {module.lost_by or 'its cause was not heard'}"


def is_stale(module: ModuleSnapshot) -> bool:
    """No PDO with a position or a status for a second."""
    return module.age_s is None or module.age_s > STALE_S


def residual_words(module: ModuleSnapshot) -> str:
    """Residual of the last sample against its limit."""
    if module.residual_cycles is None or module.residual_limit_cycles is None:
        return "-"
    noise = module.residual_noise_cycles
    said = "" if noise is None else f", noise {noise:.4f}"
    limit = f"{mark(module, 'residual_limit_cycles')}{module.residual_limit_cycles:.3f}"
    return f"{module.residual_cycles:.3f} of {limit} cycle{said}"


def amplitude_words(module: ModuleSnapshot) -> str:
    """Amplitude."""
    if module.amplitude_counts is None:
        return "-"
    return f"{module.amplitude_counts:.0f} counts{' (raw)' if module.amplitude_is_raw else ''}"


def amplitude_limits_words(module: ModuleSnapshot) -> str:
    """Its limits; empty where there are none."""
    low, high = module.amplitude_limits_counts
    return f"{mark(module, 'amplitude_limits_counts')}{low} to {high}" if high else ""


def amplitude_line(module: ModuleSnapshot) -> str:
    """Amplitude and its limits."""
    limits = amplitude_limits_words(module) if module.amplitude_counts is not None else ""
    return f"{amplitude_words(module)}{', limits ' if limits else ''}{limits}"


def mark(module: ModuleSnapshot, name: str) -> str:
    """What stands before a value of the snapshot: "assumed " if a setting behind it was not read."""
    return f"{ASSUMED} " if name in module.assumed else ""


def scale_note(module: ModuleSnapshot, name: str) -> str:
    """What stands behind a position or velocity in units of the machine, a space before it."""
    value = module.position_revolutions if name == "position_revolutions" else module.velocity_rad_s
    return f" (scale {ASSUMED})" if name in module.assumed and value is not None else ""


def mapping_words(module: ModuleSnapshot) -> str:
    """How the PDO mapping is known."""
    known = module.layout in ("module", ASSUMED)
    return module.layout if known else f"{module.layout}, {ASSUMED}"


def counter_words(counters: dict[str, int]) -> str:
    """Those that are not 0."""
    return ", ".join(f"{name} {count}" for name, count in counters.items() if count) or "none"


def age(seconds: float) -> str:
    """How long ago, short."""
    if seconds < 100.0:
        return f"{seconds:.1f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"


def plain_lines(snapshot: BusSnapshot, units: MachineUnits) -> list[str]:
    """One line for each module, without any control characters; one for the bus where there is none."""
    bus = f"SYNC {sync_words(snapshot.sync)}; {load_words(snapshot)}"
    head = f"{snapshot.time_s:.3f}"
    modules = []
    for node, module in snapshot.modules:
        modules.append(f"{head} {name_of(node)}: {_line(node, module, units)}; {bus}")
    return modules or [f"{head} no module heard; {bus}"]


def _line(node: NodeSnapshot, module: ModuleSnapshot, units: MachineUnits) -> str:
    pieces = [state_words(node), position_words(module)]
    if not is_stale(module):
        lost = lost_words(node, module)
        scale = [scale_note(module, name) for name in ("position_revolutions", "velocity_rad_s")]
        pieces += [*module.faults, *[lost] * bool(lost)]
        pieces.append(f"{units.position(module.position_revolutions)}{scale[0]}")
        pieces += [f"{units.velocity(module.velocity_rad_s)}{scale[1]}", f"residual {residual_words(module)}"]
        pieces.append(f"amplitude {amplitude_line(module)}")
    if node.emergencies:
        last = node.emergencies[0]
        pieces.append(f"EMCY {last.code:04X}h {last.text}, {age(last.age_s)} ago")
    return ", ".join(pieces)
