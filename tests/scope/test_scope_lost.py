"""The page says why a position is lost, and which command says more; what came from the bus is escaped."""

from __future__ import annotations

import dataclasses

from canfb.scope.scope_texts import state_line
from monitored_network import MonitoredNetwork


def test_the_line_of_a_lost_position_has_its_cause() -> None:
    network = MonitoredNetwork()
    network.run(0.5)
    ((node, module),) = network.model.snapshot(network.bus.now).modules
    assert "canfb why" not in state_line(node, module)
    network.source.lost = True
    network.run(0.02)
    ((node, module),) = network.model.snapshot(network.bus.now).modules
    said = state_line(node, module)
    assert "<p>canfb why 0x20: more samples in a row were bad or missing than 2010:03 allows</p>" in said
    unheard = dataclasses.replace(module, lost_by=None)
    assert "canfb why 0x20: its cause was not heard" in state_line(node, unheard)
    assert "&lt;b&gt;" in state_line(node, dataclasses.replace(module, lost_by="<b>"))
