"""The residual limit that the monitor shows is that of the module."""

from __future__ import annotations

import itertools
import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb import objects as od
from canfb.cia301.frame import Frame
from canfb.configuration import Config
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.monitoring.bus_model import BusModel
from canfb.monitoring.layout import known_layouts
from canfb.monitoring.lines import residual_words
from canfb.monitoring.snapshot import ModuleSnapshot
from folding import each

NODE = 0x20


def shown(module: FeedbackModule, syncs: int = 50, noise: int | None = None) -> ModuleSnapshot:
    """With a SYNC of 1 kHz on the bus; ``noise`` is read by SDO, 1/65536 cycle."""
    model = BusModel(known_layouts(Config(modules=[module.config])))
    for k in range(syncs):
        model.receive(Frame(0x80, b""), k * 1e-3)
        model.receive(Frame(0x180 + NODE, struct.pack("<IHH", 0, 1, 0)), k * 1e-3 + 5e-4)
    if noise is not None:
        model.put(NODE, od.FEEDBACK_NOISE, noise, 0.05)
    ((_, found),) = model.snapshot().modules
    return found


def started(**fields: Any) -> FeedbackModule:
    module = FeedbackModule(ModuleConfig(node_id=NODE, **fields))
    module.dictionary.entry(*od.CYCLE_PERIOD).value = 1000
    module.start(0.0)
    return module


@given(
    per_sync=st.integers(1, 4),
    acceleration=st.sampled_from([0.0, 40.0, 3000.0]),
    limit=st.sampled_from([0.05, 1.0 / 3.0]),
    times=st.booleans(),
)
def test_by_the_configuration_and_the_sync_on_the_bus(
    per_sync: int, acceleration: float, limit: float, times: bool
) -> None:
    module = started(
        samples_per_sync=per_sync,
        max_acceleration_rad_s2=acceleration,
        residual_limit=limit,
        times=times,
    )
    assert shown(module).residual_limit_cycles == pytest.approx(module.limits.residual_limit, abs=1e-6)


def test_without_a_sync_it_is_2010_01() -> None:
    module = started(max_acceleration_rad_s2=40.0)
    assert shown(module, syncs=1).residual_limit_cycles == pytest.approx(1 / 3, abs=1e-4)


@each("noise, limit", [(None, 0.066), (0, 0.066), (16, 0.0159 + 6 * 16 / 65536), (6000, 0.066)])
def test_the_noise_that_was_read(noise: int | None, limit: float) -> None:
    module = started(max_acceleration_rad_s2=40.0, noise_margin=6)
    found = shown(module, noise=noise)
    assert found.residual_limit_cycles == pytest.approx(limit, abs=5e-4)
    known = found.residual_noise_cycles
    assert known == (noise / 65536 if noise else None)
    assert residual_words(found).endswith(f", noise {noise / 65536:.4f}" if noise else "cycle")


def test_sample_times_widen_it_at_speed() -> None:
    module = started(max_acceleration_rad_s2=40.0, times=True)
    supervision = known_layouts(Config(modules=[module.config]))[0].supervision
    slow, fast = (supervision.limit_cycles(2500, 1000.0, None, velocity) for velocity in (0.0, 314.159))
    assert fast - slow == pytest.approx(4 * 125_000 * 50e-9, rel=1e-4)
    assert supervision.limit_cycles(2500, 1000.0, None, 1e9) == supervision.widest_cycles


def test_pairs_are_counted_to_the_first_that_is_not_mapped() -> None:
    pairs = [[one.mapped(16) for one in pair] for pair in od.SAMPLE_EARLIER]
    for there in itertools.product([False, True], repeat=7):
        mapped = [pair for pair, is_there in zip(pairs, there, strict=True) if is_there]
        first_gap = there.index(False) if False in there else 7
        assert od.samples_per_sync(mapped) == 1 + first_gap
    split = [[pairs[0][0]], [pairs[0][1]]]
    assert od.samples_per_sync(split) == 1, "both tracks in one RPDO"
