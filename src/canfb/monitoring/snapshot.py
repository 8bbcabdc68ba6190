"""Snapshot of a bus as plain values."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True)
class SyncSnapshot:
    """SYNCs of the last seconds against the best regular grid; None: too few. ``silent_s`` since the last."""

    rate_hz: float | None = None
    jitter_rms_s: float | None = None
    jitter_peak_s: float | None = None
    silent_s: float | None = None
    count: int = 0


@dataclass(frozen=True)
class LoadSnapshot:
    """Traffic of the last second, with most stuff bits; ``load`` 0..1 requires a bit rate."""

    frames_per_s: float = 0.0
    bits_per_s: float = 0.0
    bit_rate: int | None = None
    load: float | None = None


@dataclass(frozen=True)
class EmergencySnapshot:
    """An EMCY; ``register`` is 1001h, ``detail`` hexadecimal."""

    age_s: float
    code: int
    text: str
    register: int
    detail: str


@dataclass(frozen=True)
class ModuleSnapshot:
    """The feedback of a module; None: not received.

    layout                 origin: EDS, configuration, module, assumed
    age_s                  time since its last PDO with a position or a status
    table_crc32            2020:04, by SDO; 0: the identity
    velocity_rad_s         2011:07, else from the positions
    residual_peak_cycles   of the last second; ``history``: of ``history_bin_s`` each, oldest first
    amplitude_counts       2011:05, else before conditioning (``amplitude_is_raw``)
    tracks_counts          the last pairs of the ADC PDO
    seen                   position PDOs with each fault, and losses, counted here
    counters               2012h, if read or mapped
    assumed                values above whose settings were not read
    """

    layout: str
    age_s: float | None = None
    position_state: str | None = None
    status: int | None = None
    faults: list[str] = field(default_factory=list)
    referenced: bool = False
    table_active: bool = False
    table_crc32: int | None = None
    position_units: int | None = None
    position_revolutions: float | None = None
    velocity_rad_s: float | None = None
    residual_cycles: float | None = None
    residual_limit_cycles: float | None = None
    residual_noise_cycles: float | None = None
    residual_peak_cycles: float | None = None
    residual_history_cycles: list[float | None] = field(default_factory=list)
    history_bin_s: float = 0.0
    amplitude_counts: float | None = None
    amplitude_is_raw: bool = False
    amplitude_limits_counts: tuple[int, int] = (0, 0)
    full_scale_counts: int = 0
    tracks_counts: list[tuple[int, int]] = field(default_factory=list)
    tracks_heard: int = 0
    seen: dict[str, int] = field(default_factory=dict)
    lost_by: str | None = None
    since_fault_s: float | None = None
    counters: dict[str, int] = field(default_factory=dict)
    assumed: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class NodeSnapshot:
    """A node of the bus.

    state_source    heartbeat, boot-up, PDO, command
    heard_s         time since its last frame; None: never
    emergencies     the last ones, newest first; ``emergency_count`` in all
    """

    node_id: int
    state: str | None = None
    state_source: str | None = None
    heard_s: float | None = None
    boot_ups: int = 0
    emergencies: list[EmergencySnapshot] = field(default_factory=list)
    emergency_count: int = 0
    module: ModuleSnapshot | None = None


@dataclass(frozen=True)
class BusSnapshot:
    """``time_s`` on the clock of the frames."""

    time_s: float
    sync: SyncSnapshot
    load: LoadSnapshot
    nodes: list[NodeSnapshot]
    error_frames: int = 0

    @property
    def modules(self) -> list[tuple[NodeSnapshot, ModuleSnapshot]]:
        return [(node, node.module) for node in self.nodes if node.module is not None]

    def to_json(self) -> dict[str, Any]:
        """Values for JSON; None replaces NaN and infinity."""
        return {name: _plain(value) for name, value in asdict(self).items()}


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
