"""`canfb node reset`: a module starts again at standstill, and only there."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from canfb.simulation.motion import Motion, Ramp, Ripple
from commissioning_kit import CYCLES, MODULE_ID, RATE_HZ, Bench, heard
from node_commands import Commands

NODE = hex(MODULE_ID)
STILL = Motion((), ())


def running(motion: Motion, **fields: Any) -> Bench:
    bench = Bench(motion=motion, **fields)
    bench.bus.run_until(0.5)
    return bench


def lose(bench: Bench) -> Bench:
    bench.source.change = lambda counts: None
    bench.bus.run_until(bench.bus.now + 0.05)
    bench.source.change = lambda counts: counts
    bench.bus.run_until(bench.bus.now + 0.2)
    assert bench.value(0x2011, 1) & 4
    return bench


def test_a_lost_position_comes_back_at_standstill(canfb: Commands) -> None:
    bench = lose(running(STILL))
    out, _ = canfb(bench, "node", "reset", NODE)
    assert out.startswith("node 32 (20h): reset and started; position valid, machine still, within 0.00")
    assert bench.value(0x2011, 1) & 1
    figures = canfb(bench, "node", "reset", NODE, "--json").json
    assert figures["position"] == "valid"
    assert figures["forced"] is False
    assert 0.0 < figures["spread_cycles"] < 0.01


@pytest.mark.parametrize("rpm", [0.6, 61.0, -610.0])
def test_a_machine_that_turns_is_refused_whether_it_is_lost_or_not(canfb: Commands, rpm: float) -> None:
    bench = running(Motion((), (), rpm))
    frames = heard(bench)
    for _ in range(2):
        _, err = canfb(bench, "node", "reset", NODE, code=1)
        assert "the machine moves" in err
        lose(bench)
    assert 0x720 not in [frame.can_id for frame in frames], "nothing was reset"


def silent() -> Bench:
    """A missed sample is no sample."""
    bench = running(STILL)
    bench.source.change = lambda counts: None
    return bench


def at_a_whole_cycle() -> Bench:
    """For each sample: its phase stands still, and the count does not."""
    bench = running(Motion((Ramp(1.0, 60.0 * RATE_HZ / CYCLES),)))
    bench.bus.run_until(3.0)
    return bench


# A millicycle to and fro, around a place where the phase wraps.
HELD = Motion((), (Ripple(60.0 * 0.001 * 6.28 * 5.0 / CYCLES, 5.0),))
CASES: list[tuple[Callable[[], Bench], tuple[str, ...], str]] = [
    (lambda: running(HELD), (), "position valid"),
    (lambda: running(STILL), ("--force",), "machine not looked at"),
    (lambda: running(Motion((), (), 0.6)), ("--force",), "reset and started, but its position is lost"),
    (lambda: running(Motion((Ramp(1.2, 0.0), Ramp(0.3, 20.0)))), (), "began to move while it was reset"),
    (lambda: running(STILL, sync=False), (), "so it cannot be seen whether the machine stands still"),
    (silent, (), "so it cannot be seen whether the machine stands still"),
    (at_a_whole_cycle, (), "the machine moves, it has moved by +"),
]


@pytest.mark.parametrize(("made", "options", "words"), CASES)
def test_what_is_said_of_a_reset(
    canfb: Commands, made: Callable[[], Bench], options: tuple[str, ...], words: str
) -> None:
    succeeds = words in ("position valid", "machine not looked at")
    assert words in "".join(canfb(made(), "node", "reset", NODE, *options, code=0 if succeeds else 1))


def test_a_position_that_is_lost_again_at_once_is_told(canfb: Commands) -> None:
    bench = running(STILL)
    bench.module.dictionary.entry(0x2001, 3).value = 410
    reset_from = bench.bus.now

    def weak(counts: tuple[float, float]) -> tuple[float, float]:
        late = bench.bus.now > reset_from + 0.3
        return (counts[0] // 9, counts[1] // 9) if late else counts

    bench.source.change = weak
    _, err = canfb(bench, "node", "reset", NODE, code=1)
    assert "reset and started, but its position is" in err
    assert "canfb why 0x20" in err
