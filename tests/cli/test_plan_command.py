"""``canfb plan``: from options and from a configuration, for people and for programs; what cannot be."""

from __future__ import annotations

from pathlib import Path

import pytest

from commands import Command

MODULES = "modules: [{node_id: 32, times: true}]\n"


def written(folder: Path, text: str) -> str:
    path = folder / "plan.yaml"
    path.write_text(text)
    return str(path)


def test_the_exit_code_says_whether_it_holds(command: Command) -> None:
    said = command("plan --acceleration 120").out
    assert "  acceleration: 120 of 712.1 rad/s^2, margin 5.9\n" in said
    assert "eq. 12 alone allows 837.7, eq. 10 1257" in said
    assert "the plan holds; tightest: bus load, margin 2.3" in said
    said = command("plan --acceleration 1200", code=1).out
    assert "margin 0.59   <- exceeded" in said
    assert "the plan does NOT hold; tightest: acceleration" in said
    assert "first, for acceleration: raise the SYNC rate to 1300 Hz" in said


def test_json_agrees_with_the_exit_code(command: Command) -> None:
    found = command("plan --rpm 3000 --jitter 10us --json", code=1).json
    assert found["holds"] is False
    assert found["tightest"]["limit"] == "speed"
    assert found["changes"][0]["change"] == "send sample times with the ADC PDO (times: true)"
    (module,) = found["modules"]
    assert module["speed"]["equation_rpm"] == pytest.approx(200.0, rel=1e-3)
    assert module["acceleration"]["stated_rad_s2"] is None
    free = command("plan --rpm 3000 --json").json
    assert free["modules"][0]["speed"]["largest_rpm"] is None
    assert free["changes"] == []


def test_a_configuration_and_options_before_it(tmp_path: Path, command: Command) -> None:
    text = (
        "bus: {bitrate: 500000}\nmodules: [{node_id: 32, max_acceleration_rad_s2: 40}]\n"
        "simulation: {sync_period_us: 2000, sync_jitter_us: 5, sync_jitter_rms_us: 2, bus_load: 0.1,"
        " motion: {rpm: 30, ramp_s: 1.0}}\n"
    )
    found = command("plan --json", written(tmp_path, text), code=1).json  # 135 µs for the frames of others
    bus = found["bus"]
    assert (bus["bit_rate"], bus["sync_hz"], bus["extra_load"]) == (500_000, 500.0, 0.1)
    (module,) = found["modules"]
    assert module["sync_jitter_s"] == pytest.approx(13e-6 + 135e-6)
    assert module["speed"]["stated_rpm"] == pytest.approx(30.0)
    assert module["acceleration"]["stated_rad_s2"] == 40.0, "the machine may do it"
    assert module["residual_limit_cycles"] == pytest.approx(
        4 * 819 / 65536 + 40 * 2500 / 6.2832 / 500**2, abs=1e-5
    )
    line = "plan --rate 1000 -b 1000000 --acceleration 3 --rpm 5 --extra 0 --jitter 0 --cycles 1000 --json"
    other = command(line, written(tmp_path, text)).json
    assert other["bus"]["sync_hz"] == 1000.0
    assert other["modules"][0]["cycles_per_revolution"] == 1000
    assert other["modules"][0]["acceleration"]["stated_rad_s2"] == 3.0


def test_a_drive_its_frames_and_its_torque(tmp_path: Path, command: Command) -> None:
    path = written(tmp_path, MODULES + "simulation: {drive: {node_id: 0x30}}\n")
    found = command("plan --json", path).json
    assert {0x1B0, 0x2B0, 0xB0} <= {message["cob_id"] for message in found["bus"]["messages"]}
    assert found["modules"][0]["acceleration"]["stated_rad_s2"] == pytest.approx(510.0)


def test_saved_parameters_go_before_the_configuration(tmp_path: Path, command: Command) -> None:
    from canfb.hosting.state_files import StateFiles
    from canfb.module.feedback_module import FeedbackModule
    from canfb.module.module_config import ModuleConfig

    with StateFiles(tmp_path / "state") as store:
        module = FeedbackModule(ModuleConfig(node_id=32), store)
        module.start(0.0)
        module.dictionary.lookup(0x2010, 1).download((6554).to_bytes(2, "little"))
        module.dictionary.lookup(0x1010, 1).download(b"save")
    path = written(tmp_path, f"modules: [{{node_id: 32, state_dir: {tmp_path / 'state'}}}]\n")
    (found,) = command("plan --json", path).json["modules"]
    assert found["residual_limit_cycles"] == pytest.approx(0.1, abs=1e-4)


def test_modules_without_a_node_id_and_those_that_sample_themselves(tmp_path: Path, command: Command) -> None:
    text = "modules: [{node_id: 255, source: {kind: motion}}, {node_id: 32, serial_number: 1}]\n"
    found = command("plan --rpm 3000 --jitter 50us --json", written(tmp_path, text), code=1).json
    assert [module["node_id"] for module in found["modules"]] == [127, 32]
    assert found["modules"][0]["speed"]["largest_rpm"] is None, "the module samples at the exact instant"


def test_no_amplitude_is_no_encoder(tmp_path: Path, command: Command) -> None:
    path = written(tmp_path, MODULES + "simulation: {encoder: {amplitude: 0}}\n")
    (found,) = command("plan --json", path, code=1).json["modules"]
    assert found["residual"]["needed_cycles"] is None
    command("plan", path, code=1)
