"""The soak in its short form, and that it would see what it is to see."""

import contextlib
import json
from collections.abc import Iterator
from typing import Any

import pytest

from canfb.signal.sample import Feedback
from tools.soak.__main__ import Resources, as_figures, main
from tools.soak.disturbances import disturbances_of
from tools.soak.world import SETUPS, Findings, World

CYCLES = 1000
BY_NAME = {one.name: one for one in SETUPS}
HAPPENS = sorted({(name, setup.name) for setup in SETUPS for name in disturbances_of(setup)})
ONCE = dict(HAPPENS)  # each disturbance in one of the set-ups that have it; the others have the short form


@pytest.mark.parametrize("name", [name for name in BY_NAME if name not in ONCE.values()])
def test_the_short_form(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--cycles", str(CYCLES), "--setup", name, "--json"]) == 0
    (one,) = json.loads(capsys.readouterr().out)
    assert one["good"]
    assert one["cycles"] >= CYCLES
    assert one["valid"] > 0.2 * one["cycles"]
    assert (one["wrong"], one["uncounted"], one["not_recovered"]) == (0, 0, 0)


@pytest.mark.parametrize("wrong", [["--cycles", "0"], ["--seed", "-1"], ["--setup", "none"]])
def test_wrong_use_is_refused(wrong: list[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(wrong)


@contextlib.contextmanager
def soaked(name: str, seed: int) -> Iterator[World]:
    world = World(BY_NAME[name], seed)
    try:
        yield world
    finally:
        world.close()


@pytest.mark.parametrize("name", ONCE)
def test_after_each_disturbance_the_position_is_right_again(name: str) -> None:
    with soaked(ONCE[name], 3) as world:
        happens = disturbances_of(world.setup)
        world.pass_(0.1)
        world.suffer(name, happens[name])
        before = world.found.valid
        world.pass_(0.1)
        assert world.found.bad == 0, (world.found.first_wrong, world.found.first_uncounted)
        assert world.found.valid > before


def test_a_wrong_position_and_a_cycle_that_is_in_no_counter_are_seen() -> None:
    with soaked("plain", 1) as world:
        world.pass_(0.2)
        last = world.module.feedback
        assert isinstance(last, Feedback)
        world._judge(last._replace(cycles=last.cycles + 1, status=1), 1.0)
        assert (world.found.wrong, world.found.uncounted) == (1, 0)
        assert "off by" in world.found.first_wrong
        world._judge(last._replace(status=0), 1.0)
        assert (world.found.wrong, world.found.uncounted) == (1, 1)
        assert "status 0000h and no counter" in world.found.first_uncounted

        def swallows(world: World) -> None:
            world.feedbacks -= 1

        world.suffer("swallows", swallows)
    assert world.found.uncounted == 2


def figures(*looks: Resources, **found: Any) -> dict[str, Any]:
    return as_figures(BY_NAME["plain"], Findings(cycles=1000, **found), looks)


def test_what_grows_is_seen() -> None:
    first = Resources(50_000_000, 10_000, 6)
    assert figures(first, first)["good"]
    for half, last, name in (
        (first._replace(memory_bytes=53_000_000), first._replace(memory_bytes=56_000_000), "memory_bytes"),
        (first._replace(blocks=20_500), first._replace(blocks=31_000), "blocks"),
        (first, first._replace(descriptors=7), "descriptors"),
    ):
        assert figures(first, half, last)["grown"] == [name]
        assert not figures(first, half, last)["good"]
    loaded = first._replace(memory_bytes=60_000_000, blocks=30_000)
    assert figures(first, loaded, loaded)["good"]
    assert figures(first, first, loaded)["good"]
    for bad in ("wrong", "uncounted", "not_recovered"):
        assert not figures(first, first, **{bad: 1})["good"]
    assert not figures(first, first, log_lines=1000)["good"]
