"""The drive network with the drive's own encoder as a second opinion: moves, a slip, a reversed sensor."""

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


def test_a_move_in_which_both_agree(capsys: pytest.CaptureFixture[str]) -> None:
    network = DriveNetwork()
    events = events_of(network)
    assert network.run("--revolutions", "-1.5") == 0
    second = network.module.chain.second
    assert second is not None
    assert second.difference_cycles == pytest.approx(0.0, abs=0.05)
    assert not second.disagrees
    assert EventKind.SECOND_POSITION not in {event.kind for event in events}
    assert "EMCY" not in capsys.readouterr().out


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


def test_a_motor_encoder_wired_the_other_way_round(capsys: pytest.CaptureFixture[str]) -> None:
    network = DriveNetwork()
    network.module.dictionary.entry(0x2014, 3).default = 1
    network.module.dictionary.entry(0x2014, 3).reset()
    events = events_of(network)
    assert network.run() == 0
    assert "FF1Ch" in capsys.readouterr().out
    moved = [event.values["difference_revolutions"] for event in events if "disagrees:" in event.text]
    assert moved == [pytest.approx(-0.0145, abs=0.0045)]
