"""The drive network with the encoder of the drive as a second opinion: the coupling slips."""

from __future__ import annotations

import pytest
from story_bench import DriveNetwork

from canfb.module.events import Event, EventKind
from canfb.objects import StatusBit

CYCLES = 1024


def events_of(network: DriveNetwork) -> list[Event]:
    events: list[Event] = []
    network.module.events.on_event = events.append
    return events


def test_the_coupling_slips_in_a_move(capsys: pytest.CaptureFixture[str]) -> None:
    """As the page says. The position stays valid, and that of the encoder; the motor is somewhere else."""
    network = DriveNetwork(slip_revolutions=0.05, slip_at_s=1.0)
    events = events_of(network)
    assert network.run() == 0
    said = capsys.readouterr().out
    assert "  EMCY of module (20h): FF1Ch, the motor's encoder disagrees" in said
    (event,) = (event for event in events if event.kind is EventKind.SECOND_POSITION)
    assert event.text.endswith("revolutions, tolerance 0.01")
    assert 0.01 < float(str(event.values["difference_revolutions"])) < 0.02
    second, feedback = network.module.chain.second, network.module.feedback
    assert second is not None
    assert feedback is not None
    assert second.difference_cycles == pytest.approx(0.05 * CYCLES, abs=0.05)
    assert feedback.status & StatusBit.SECOND_POSITION
    assert feedback.valid
    assert network.plant.motor.revolutions == pytest.approx(1.05, abs=1e-3)
    assert network.drive.dictionary.entry(0x6063).value == pytest.approx(1.05 * 65536, abs=80)
