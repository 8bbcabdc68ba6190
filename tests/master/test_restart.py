"""`canfb node reset`: a module starts again at standstill, and only there."""

from __future__ import annotations

import json
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
    figures = json.loads(canfb(bench, "node", "reset", NODE, "--json")[0])
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


def test_a_whole_cycle_for_each_sample_is_seen_while_it_is_counted(canfb: Commands) -> None:
    """Its phase stands still. Once it is lost, nothing but uneven intervals could tell it."""
    bench = running(Motion((Ramp(1.0, 60.0 * RATE_HZ / CYCLES),)))
    bench.bus.run_until(3.0)
    _, err = canfb(bench, "node", "reset", NODE, code=1)
    assert "the machine moves, it has moved by +" in err


def test_force_looks_at_nothing(canfb: Commands) -> None:
    bench = running(Motion((), (), 0.6))
    _, err = canfb(bench, "node", "reset", NODE, "--force", code=1)
    assert "reset and started, but its position is lost" in err, "it turned, and may still turn"
    out, _ = canfb(running(STILL), "node", "reset", NODE, "--force")
    assert "machine not looked at" in out


def test_a_module_without_samples_is_not_reset(canfb: Commands) -> None:
    bench = running(STILL, sync=False)
    _, err = canfb(bench, "node", "reset", NODE, code=1)
    assert "so it cannot be seen whether the machine stands still" in err
    silent = running(STILL)
    silent.source.change = lambda counts: None
    assert "cannot be seen" in canfb(silent, "node", "reset", NODE, code=1)[1], "a missed sample is no sample"


def test_a_machine_that_begins_to_move_meanwhile_is_told(canfb: Commands) -> None:
    bench = running(Motion((Ramp(1.2, 0.0), Ramp(0.3, 20.0))))
    _, err = canfb(bench, "node", "reset", NODE, code=1)
    assert "began to move while it was reset" in err


def test_a_drive_that_holds_its_position_is_at_rest(canfb: Commands) -> None:
    """A millicycle to and fro, around a place where the phase wraps."""
    bench = running(Motion((), (Ripple(60.0 * 0.001 * 6.28 * 5.0 / CYCLES, 5.0),)))
    assert "position valid" in canfb(bench, "node", "reset", NODE)[0]


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
