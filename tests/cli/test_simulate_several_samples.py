"""`canfb simulate` with several samples for each SYNC: a move that one sample loses, and what is said."""

from __future__ import annotations

import pytest

from canfb.configuration import Config, parse_config
from canfb.hosting.simulating import fed_module
from canfb.module.feedback_module import FeedbackModule
from canfb.simulation.embedded_bus import EmbeddedBus
from canfb.simulation.motion import MotionSource
from canfb.simulation.set_up import Play, SimulatedNetwork, set_up

RATE_HZ = 1000.0
# 2400 rad/s^2: three times what one sample for each SYNC follows.
MOVE = """
modules: [{{node_id: 32, times: true, samples_per_sync: {per_sync}, autostart: true}}]
simulation: {{sync_jitter_us: 50, motion: {{standstill_s: 0.1, ramp_s: 0.13, rpm: 3000}}}}
"""


def network_of(config: Config) -> SimulatedNetwork:
    return set_up(
        config.simulation, fed_module(config.modules[0]), Play(rate_hz=RATE_HZ, autostart=True), report=print
    )


@pytest.mark.parametrize(("per_sync", "held"), [(1, False), (2, True), (4, True)])
def test_a_move_on_the_bus(per_sync: int, held: bool) -> None:
    config = parse_config(MOVE.format(per_sync=per_sync))
    network, module, bus = network_of(config), FeedbackModule(config.modules[0]), EmbeddedBus(1_000_000)
    for device in (*network.devices, module):
        bus.attach(device)
    source = network.interface.source
    assert isinstance(source, MotionSource)
    away: list[float] = []
    valid: list[bool] = []

    def listen(feedback: object, now: float) -> None:
        found = module.feedback
        assert found is not None
        valid.append(found.valid)
        away.append(found.cycles + found.phase - source.position_cycles)

    module.on_feedback = listen
    bus.run_until(0.4)
    assert len(valid) > 390
    exact = all(valid) and max(abs(one - away[0]) for one in away) < 0.3
    assert exact is held, away[-1] - away[0]


@pytest.mark.parametrize(
    ("per_sync", "followed", "warned"),
    [(1, "838 at 1000 Hz (eq. 10)", True), (2, "3.35e+03 at 1000 Hz with 2 samples for each SYNC", False)],
)
def test_what_is_said_of_it(per_sync: int, followed: str, warned: bool) -> None:
    demand = network_of(parse_config(MOVE.format(per_sync=per_sync))).demand
    assert demand is not None
    assert f"the module follows {followed}" in demand.describe()
    assert (demand.warning() is not None) is warned
    assert demand.sync_hz == RATE_HZ


def test_the_rate_that_is_proposed_is_that_of_sync() -> None:
    """12000 rad/s^2: two samples need twice the rate."""
    text = MOVE.format(per_sync=2).replace("0.13", "0.026")
    demand = network_of(parse_config(text)).demand
    assert demand is not None
    assert "set --rate to 2100 or more" in (demand.warning() or "")
