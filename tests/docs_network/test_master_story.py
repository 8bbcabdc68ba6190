"""docs/drive-network/master.py on an embedded bus: moves, alarm, a slip, and how it leaves the bus."""

import csv
import itertools
import re
from pathlib import Path
from typing import Any

import axis
import configuring
import nodes
import pytest
from hypothesis import given, strategies as st
from network_bench import write
from story_bench import FOLDER, DriveNetwork, assert_all_quiet

import master
from canfb import Frame, StatusBit
from canfb.cia301.codes import NmtState
from canfb.module.events import Event, EventKind
from canfb.simulation.cia402.drive import DriveError
from canfb.simulation.cia402.state_machine import State
from folding import each

EDS = str(FOLDER.parents[1] / "eds")
TEXT = (FOLDER / "network.yaml").read_text(encoding="utf-8").replace("../../eds", EDS)


def figure(said: str, what: str, move: int = 0) -> float:
    """A number of the report, after these words, of the n-th move."""
    return float(re.findall(rf"{what} (-?[0-9.]+)", said)[move])


def test_a_move(capsys: pytest.CaptureFixture[str]) -> None:
    """One of another length than that of the page."""
    network, revolutions = DriveNetwork(), -2.5
    assert network.run("--revolutions", str(revolutions)) == 0
    said = capsys.readouterr().out
    assert 1e-5 < figure(said, "rms") < 1e-3
    assert figure(said, "peak") < 3e-3
    assert 0.0 <= figure(said, "settled          ") < 0.2
    assert figure(said, "position          drive") == pytest.approx(revolutions, abs=2e-4)
    assert figure(said, "module") == pytest.approx(revolutions, abs=2e-4)
    assert figure(said, "at most") < 1e-4
    assert network.plant.motor.revolutions == pytest.approx(revolutions, abs=3e-4)
    assert "EMCY" not in said
    assert_all_quiet(network)


def test_the_trace_has_a_line_for_each_sync(tmp_path: Path) -> None:
    network, path = DriveNetwork(), tmp_path / "moves.csv"
    network.at[2.0] = lambda: network.bus.send(Frame(0, bytes([2, 0x10])))  # a trace of a fault, above all
    with pytest.raises(axis.FaultError):
        network.run("--trace", str(path))
    with path.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["sync"]) for row in rows] == list(range(len(rows)))
    assert 150 < len(rows) <= network.plant.syncs
    moving = [row for row in rows if row["state"] == "OPERATION ENABLED"]
    for row in moving:
        error = float(row["demand"]) - float(row["position"])
        assert error == pytest.approx(float(row["following_error"]), abs=0.02)
        assert float(row["position"]) == pytest.approx(float(row["module"]), abs=0.02)
    assert max(float(row["position"]) for row in moving) > 0.5
    assert {row["module_valid"] for row in rows[30:150]} == {"1"}


def test_check_finds_what_differs_and_nothing_after_a_run(capsys: pytest.CaptureFixture[str]) -> None:
    network = DriveNetwork()
    assert network.run("--check") == 1
    assert "drive (30h) 6085:00 is 03C00000h, not 00100000h" in capsys.readouterr().out
    assert network.run() == network.run("--check") == 0
    assert "all nodes agree with the file" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (bytes([2, 0x10]), "drive is in FAULT|interface .*: no longer OPERATIONAL, NMT state 4"),
        (bytes([2, 0x20]), "drive is in FAULT|module .*: no longer OPERATIONAL, NMT state 4"),
        (bytes([0x81, 0x20]), "drive is in FAULT|module .*: no longer OPERATIONAL, NMT state 0"),
        (bytes([2, 0x30]), "drive .*: no longer OPERATIONAL, NMT state 4|waited .* to answer the SYNC"),
    ],
)
def test_a_node_that_fails_in_a_move_ends_it(command: bytes, message: str) -> None:
    network = DriveNetwork()
    network.at[1.5] = lambda: network.bus.send(Frame(0, command))
    with pytest.raises(axis.FaultError, match=message):
        network.run()
    assert_all_quiet(network)


def test_a_node_that_is_silent_is_missed(monkeypatch: pytest.MonkeyPatch) -> None:
    network = DriveNetwork()

    def fail() -> None:
        monkeypatch.setattr(network.interface, "tick", lambda now: [])
        monkeypatch.setattr(network.interface, "receive", lambda frame, now: [])
        monkeypatch.setattr(network.interface, "deadline", lambda: None)

    network.at[0.5] = fail
    with pytest.raises(axis.FaultError, match=r"interface \(10h\): no heartbeat any more|drive is in FAULT"):
        network.run()
    assert network.module.state is NmtState.PRE_OPERATIONAL
    assert network.drive.state is NmtState.PRE_OPERATIONAL


def test_a_machine_that_still_turns_is_waited_for(capsys: pytest.CaptureFixture[str]) -> None:
    """The master before has ended in the middle of a move: the module begins while the machine brakes."""
    network = DriveNetwork()

    def fail() -> None:
        raise axis.FaultError("pulled out")

    network.at[1.5] = fail
    with pytest.raises(axis.FaultError, match="pulled out"):
        network.run()
    assert abs(network.plant.motor.speed_rad_s) > 0.5
    assert network.run() == 0
    said = capsys.readouterr().out
    assert figure(said, "position          drive") == pytest.approx(1.0, abs=2e-4)
    assert_all_quiet(network)


def test_a_master_that_dies_stops_the_drive() -> None:
    network = DriveNetwork()
    network.at[1.5] = network.network.die
    with pytest.raises(axis.FaultError):
        network.run()
    assert network.drive.power is State.FAULT
    assert network.drive.error == DriveError.SYNC_CONTROLLER
    assert network.plant.motor.braked
    assert network.drive.state is NmtState.PRE_OPERATIONAL  # the heartbeat is missed, too
    assert network.module.state is NmtState.OPERATIONAL  # it does not watch the master


def test_a_start_that_fails_undoes_the_configuration(monkeypatch: pytest.MonkeyPatch) -> None:
    network = DriveNetwork()
    receive = network.drive.receive
    lost = Frame(0, bytes([1, 0x30]))
    monkeypatch.setattr(
        network.drive, "receive", lambda frame, now: [] if frame[:2] == lost[:2] else receive(frame, now)
    )
    monkeypatch.setattr(nodes, "PATIENCE_S", 1.0)
    before = writable(network.module), writable(network.drive), writable(network.interface)
    with pytest.raises(axis.FaultError, match="waited 1 s for drive to become OPERATIONAL"):
        network.run()
    assert (writable(network.module), writable(network.drive), writable(network.interface)) == before
    assert_all_quiet(network)


def writable(device: Any) -> dict[tuple[int, int], Any]:
    return {(entry.index, entry.subindex): entry.value for entry in device.dictionary if entry.access == "rw"}


def test_another_device_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    network = DriveNetwork()
    before = writable(network.drive)
    path = write(tmp_path, TEXT.replace("product_code: 3", "product_code: 4"))
    with pytest.raises(configuring.NetworkError, match=r"drive \(30h\) 1018:02: another device"):
        network.run(file=path)
    assert writable(network.drive) == before


@each("old, new, message", [
    ("map: [607A, 6060, 6040]", "map: [6060, 6040]", "no link .* carries 6040h, 6060h, 607Ah together"),
    ("name: drive\n", "name: motor\n", "needs nodes with the names drive"),
])  # fmt: skip
def test_a_network_without_what_the_story_needs(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = TEXT.replace(old, new)
    if "motor" in new:
        text = text.replace("node: drive", "node: motor").replace("module, drive]", "module, motor]")
    network = DriveNetwork()
    with pytest.raises(axis.FaultError, match=message):
        network.run(file=write(tmp_path, text))
    assert_all_quiet(network)


def test_a_wrong_file_and_a_bus_that_is_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path, "nodes: 3\n")
    assert master.main([str(path)]) == 2
    assert capsys.readouterr().err.startswith(f"master: {path}:1: the network: 'bus' is missing")
    write(tmp_path, TEXT.replace("channel: vcan0", "channel: no0"))
    assert master.main([str(path)]) == 1
    said = capsys.readouterr().err
    assert said.startswith("master: ")
    assert said.count("\n") == 1


def test_the_errors_of_the_drive_have_words() -> None:
    assert {int(error) for error in DriveError} <= set(nodes.ERRORS)


@given(
    distance=st.floats(-100.0, 100.0, allow_subnormal=False),
    speed=st.floats(0.01, 100.0),
    acceleration=st.floats(0.01, 1000.0),
)
def test_a_trapezoid_keeps_its_limits(distance: float, speed: float, acceleration: float) -> None:
    at = axis.trapezoid(distance, speed, acceleration)
    total = (
        2.0 * abs(distance) / speed + 2.0 * speed / acceleration + 4.0 * (abs(distance) / acceleration) ** 0.5
    )
    step = total / 500
    places = [at(n * step) for n in range(502)]
    assert places[0] == 0.0
    assert places[-1] == pytest.approx(distance, abs=1e-9 + 1e-9 * abs(distance))
    rates = [(b - a) / step for a, b in itertools.pairwise(places)] if step else []
    assert all(abs(rate) <= speed * (1 + 1e-6) + 1e-9 for rate in rates)
    changes = [(b - a) / step for a, b in itertools.pairwise(rates)]
    assert all(abs(change) <= acceleration * (1 + 1e-4) + 1e-6 for change in changes)


def test_the_coupling_slips_in_a_move(capsys: pytest.CaptureFixture[str]) -> None:
    """As the page says. The position stays valid, and that of the encoder; the motor is somewhere else."""
    cycles = 1024
    network = DriveNetwork(slip_revolutions=0.05, slip_at_s=1.0)
    events = list[Event]()
    network.module.events.on_event = events.append
    assert network.run() == 0
    said = capsys.readouterr().out
    assert "  EMCY of module (20h): FF1Ch, the motor's encoder disagrees" in said
    (event,) = (event for event in events if event.kind is EventKind.SECOND_POSITION)
    assert event.text.endswith("revolutions, tolerance 0.01")
    assert 0.01 < float(str(event.values["difference_revolutions"])) < 0.02
    second, feedback = network.module.chain.second, network.module.feedback
    assert second is not None
    assert feedback is not None
    assert second.difference_cycles == pytest.approx(0.05 * cycles, abs=0.05)
    assert feedback.status & StatusBit.SECOND_POSITION
    assert feedback.valid
    assert network.plant.motor.revolutions == pytest.approx(1.05, abs=1e-3)
    assert network.drive.dictionary.entry(0x6063).value == pytest.approx(1.05 * 65536, abs=80)
