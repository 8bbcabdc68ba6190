"""What `canfb plan` says of the analog path."""

from __future__ import annotations

import math
from typing import Any

import pytest

from canfb import ModuleConfig
from canfb.module.parameters import configured_defaults
from canfb.planning.plan_rows import analog_row
from canfb.planning.planned_module import PlannedModule
from canfb.signal.conditioning import Conditioning

SPEED = 3000.0 / 60.0 * 2.0 * math.pi


def lines(**fields: Any) -> list[str]:
    values = configured_defaults(ModuleConfig(node_id=32, **fields))
    return list(analog_row(PlannedModule(node_id=32, values=values), SPEED).words)


def test_the_path_of_the_issue() -> None:
    used = Conditioning(cosine_delay_s=1e-6, delay_s=1.0 / (2.0 * math.pi * 125e3))
    (line,) = lines(conditioning=used, corner_hz=125e3)
    assert line.strip() == (
        "analog path at 125 kHz: +0.125 cycle between the tracks, removed; 71 % of the amplitude left; "
        "+0.125 cycle of delay, added to the position"
    )


def test_a_module_that_knows_none_has_no_line() -> None:
    assert lines() == []
    values = configured_defaults(ModuleConfig(node_id=32, corner_hz=1e5))
    assert analog_row(PlannedModule(node_id=32, values=values), None).words == ()


@pytest.mark.parametrize(("delay_us", "exceeded"), [(1.8, False), (2.0, True), (-2.0, True)])
def test_tracks_that_become_one_are_exceeded(delay_us: float, exceeded: bool) -> None:
    (line,) = lines(conditioning=Conditioning(cosine_delay_s=delay_us * 1e-6))
    assert line.endswith("<- exceeded") == exceeded
