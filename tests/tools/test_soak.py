"""The soak in its short form, and that it would see what it is to see."""

from __future__ import annotations

import json
from itertools import pairwise
from typing import Any

import pytest

from canfb.device.storage.writing import BackgroundStore
from canfb.signal.feedback import Feedback
from tools.soak.__main__ import Resources, as_figures, main
from tools.soak.machine import (
    MAX_ACCELERATION_CYCLES_S2,
    MAX_JERK_CYCLES_S3,
    MOVE_S,
    REST_S,
    position_cycles,
    rests,
)
from tools.soak.parts import SlowStore
from tools.soak.world import DISTURBANCES, SETUPS, Findings, World

CYCLES = 4000
BY_NAME = {one.name: one for one in SETUPS}


@pytest.mark.parametrize("name", BY_NAME)
def test_the_short_form(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--cycles", str(CYCLES), "--setup", name, "--json"]) == 0
    (one,) = json.loads(capsys.readouterr().out)
    assert one["good"]
    assert one["cycles"] >= CYCLES
    assert one["valid"] > 0.3 * one["cycles"]
    assert (one["wrong"], one["uncounted"], one["not_recovered"]) == (0, 0, 0)


@pytest.mark.parametrize("name", DISTURBANCES)
def test_after_each_disturbance_the_position_is_right_again(name: str) -> None:
    world = World(BY_NAME["receive times"], 3)
    world.run(100)
    DISTURBANCES[name](world)
    world._recover()
    before = world.found.valid
    world.run(world.found.cycles + 1)
    assert world.found.bad == 0, world.found.first_wrong
    assert world.found.valid > before


def test_the_machine_keeps_what_is_declared() -> None:
    step = 1e-3
    places = [position_cycles(n * step) for n in range(8000)]
    speeds = [(b - a) / step for a, b in pairwise(places)]
    changes = [(b - a) / step for a, b in pairwise(speeds)]
    jerks = [(b - a) / step for a, b in pairwise(changes)]
    assert max(map(abs, changes)) <= MAX_ACCELERATION_CYCLES_S2
    assert max(map(abs, jerks)) <= MAX_JERK_CYCLES_S3 * 1.001
    assert not rests(0.5 * MOVE_S)
    assert rests(MOVE_S + 0.1, REST_S - 0.2)
    assert position_cycles(MOVE_S + 0.1) == position_cycles(MOVE_S + REST_S - 0.1)


def test_a_wrong_position_is_seen() -> None:
    world = World(BY_NAME["plain"], 1)
    world.run(200)
    last = world.module.feedback
    assert isinstance(last, Feedback)
    world._judge(last._replace(cycles=last.cycles + 1, status=1), 1.0)
    assert world.found.wrong == 1
    assert "off by" in world.found.first_wrong


def figures(first: Resources, last: Resources, **found: Any) -> dict[str, Any]:
    return as_figures(BY_NAME["plain"], Findings(cycles=1000, **found), first, last)


def test_what_grows_is_seen() -> None:
    first = Resources(50_000_000, 10_000, 6)
    assert figures(first, first)["good"]
    for last, name in (
        (first._replace(memory_bytes=60_000_000), "memory_bytes"),
        (first._replace(objects=20_000), "objects"),
        (first._replace(descriptors=7), "descriptors"),
    ):
        assert figures(first, last)["grown"] == [name]
        assert not figures(first, last)["good"]
    for bad in ("wrong", "uncounted", "not_recovered"):
        assert not figures(first, first, **{bad: 1})["good"]
    assert not figures(first, first, log_lines=1000)["good"]


def test_the_store_is_one_that_writes_in_the_background() -> None:
    assert isinstance(SlowStore(), BackgroundStore)
