"""The set-ups of the soak: how the module is configured, and what stands between it and the bus."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from canfb.simulation.sync_producer import REGULAR, SyncTiming
from tools.soak.machine import MAX_ACCELERATION_CYCLES_S2

CYCLES = 2500
RADIANS = 2.0 * math.pi / CYCLES
SPARE = 1.05  # declared beyond what the machine does
ACCELERATION = {"max_acceleration_rad_s2": SPARE * MAX_ACCELERATION_CYCLES_S2 * RADIANS}
JITTER = SyncTiming(sync_jitter_us=20.0, sync_drift_ppm=-50.0)


@dataclass(frozen=True)
class Setup:
    """A network.

    config    of the module
    stamps    frames have receive times
    coarse    samples have a coarse track, in the same PDO
    hosted    the module is in the runner of `canfb run`
    bit_rate  of the bus, bit/s: frames take time and wait for each other; None: they do not
    timing    of the SYNC
    """

    name: str
    config: dict[str, Any] = field(default_factory=dict)
    stamps: bool = False
    coarse: bool = False
    hosted: bool = False
    bit_rate: int | None = None
    timing: SyncTiming = REGULAR


SETUPS = (
    Setup("plain", ACCELERATION),
    Setup("times", ACCELERATION | {"times": True}),
    Setup("two samples", ACCELERATION | {"times": True, "samples_per_sync": 2}),
    Setup("coarse track", ACCELERATION, coarse=True),
    Setup("predicted", ACCELERATION | {"times": True, "predict": True}),
    Setup("receive times", ACCELERATION | {"times": True}, stamps=True),
    Setup("wire", ACCELERATION | {"times": True}, bit_rate=1_000_000, timing=JITTER),
    Setup("hosted", ACCELERATION, hosted=True),
    Setup("hosted, times", ACCELERATION | {"times": True}, hosted=True),
)
