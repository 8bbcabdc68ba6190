"""A snapshot in words: the pieces that each output is made of, and one plain line for each module."""

from __future__ import annotations

from canfb.monitoring.snapshot import BusSnapshot, ModuleSnapshot, NodeSnapshot, SyncSnapshot
from canfb.monitoring.units import MachineUnits
from canfb.objects import PositionState

STALE_S = 1.0


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
    """What the status word says, in one or a few words; "no data" where it is old."""
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
    return f"{module.residual_cycles:.3f} of {module.residual_limit_cycles:.3f} cycle{said}"


def amplitude_words(module: ModuleSnapshot) -> str:
    """Amplitude, its limits."""
    if module.amplitude_counts is None:
        return "-"
    low, high = module.amplitude_limits_counts
    limits = f", limits {low} to {high}" if high else ""
    return f"{module.amplitude_counts:.0f} counts{' (raw)' if module.amplitude_is_raw else ''}{limits}"


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
        pieces += [*module.faults, *[lost] * bool(lost), units.position(module.position_revolutions)]
        pieces += [units.velocity(module.velocity_rad_s), f"residual {residual_words(module)}"]
        pieces.append(f"amplitude {amplitude_words(module)}")
    if node.emergencies:
        last = node.emergencies[0]
        pieces.append(f"EMCY {last.code:04X}h {last.text}, {age(last.age_s)} ago")
    return ", ".join(pieces)
