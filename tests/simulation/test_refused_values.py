"""What no encoder, bus, fault or machine can have is refused by its name."""

import math
from typing import Any

import pytest

from canfb.simulation import faults
from canfb.simulation.cia402.plant import DriveConfig
from canfb.simulation.embedded_bus import BackgroundTraffic, SyncProducer, SyncTiming, Wire
from canfb.simulation.encoder import Encoder
from canfb.simulation.faults import Samples
from folding import each


# What is built, with which arguments besides, the argument that cannot be, its values, and what is said.
@each("build, others, name, values, message", [
    (Encoder, {}, "adc_bits", [3, 17, 12.0, True], r"adc_bits must be a whole number 4\.\.16"),
    (Encoder, {}, "noise_lsb", [-0.1, math.nan, math.inf], "noise_lsb must be a number"),
    (Samples.of, {"sine": [1, 2]}, "cosine", [[1]], "one length"),
    (Samples.of, {"sine": [1], "cosine": [1]}, "adc_bits", [3], "adc_bits"),
    (faults.track_drift, {}, "ramp_samples", [0], "ramp_samples"),
    (Wire, {}, "bit_rate", [9_999, 1_000_001, 0, -5], "bit_rate must be"),
    (BackgroundTraffic, {"bit_rate": 1_000_000}, "load", [-0.1, 0.96, math.nan], "load must be"),
    (SyncProducer, {}, "period_s", [0.0, -1.0, math.nan, math.inf], "period_s"),
    (SyncTiming, {}, "sync_jitter_us", [-1.0], "sync_jitter_us"),
    (SyncTiming, {}, "sync_jitter_rms_us", [math.nan], "sync_jitter_rms_us"),
    (SyncTiming, {}, "sync_drift_ppm", [10_001], "sync_drift_ppm"),
    (SyncTiming, {}, "bus_load", [1.1], "bus_load"),
    (SyncTiming, {}, "bus_bit_rate", [9_999], "bus_bit_rate"),
    (DriveConfig, {}, "node_id", [0, 128], "node_id"),
    (DriveConfig, {}, "motor_increments", [-1, 2**32], "motor_increments"),
    (DriveConfig, {}, "slip_revolutions", [1001.0, math.nan], "slip_revolutions"),
    (DriveConfig, {}, "slip_at_s", [-1.0], "slip_at_s"),
])  # fmt: skip
def test_what_cannot_be_is_refused(
    build: Any, others: dict[str, Any], name: str, values: list[Any], message: str
) -> None:
    for value in values:
        with pytest.raises(ValueError, match=message):
            build(**others, **{name: value})
