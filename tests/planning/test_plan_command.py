"""`canfb plan`, the commands of docs/plan.md; diagnostic coverage against docs/evidence.md."""

import math
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from planning_kit import planned

from canfb.cia301.frame import frame_bits
from canfb.planning.coverage import (
    KINDS,
    FaultCoverage,
    SampleWindow,
    area_coverage,
    fault_coverage,
    second_tolerance,
    window_of,
)
from canfb.planning.plan_rows import coverage_rows
from canfb.rows import as_figures
from canfb.signal.supervision import SampleLimits
from commands import Command, yaml_file
from documentation import blocks, page

DEFAULT = SampleWindow(
    sample=SampleLimits(2048, 410, 2560),
    nominal_counts=1500.0,
    limit_cycles=1.0 / 3.0,
    motion_cycles=0.01,
    tolerance_cycles=25.0,
)
COMMISSIONED = replace(DEFAULT, sample=SampleLimits(2048, 1200, 1800), limit_cycles=0.06)
WIDE = replace(DEFAULT, sample=SampleLimits(2048, 0, 4000))


@cache
def found(window: SampleWindow) -> dict[str, FaultCoverage]:
    return {one.name: one for one in fault_coverage(window)}


@pytest.mark.parametrize("window", [DEFAULT, COMMISSIONED, WIDE])
def test_the_area_is_that_of_any_voltages(window: SampleWindow) -> None:
    n = 1000
    sample = window.sample
    axis = (np.arange(n) + 0.5) / n * 2.0 * sample.full_scale_counts - sample.full_scale_counts
    length = np.hypot(axis[:, None], axis[None, :])
    allowed = ((length >= sample.amplitude_low_counts) & (length <= sample.amplitude_high_counts)).mean()
    shares = area_coverage(window)
    assert shares.amplitude == pytest.approx(1.0 - allowed, abs=1e-3)
    assert shares.residual == pytest.approx(1.0 - allowed * 2.0 * window.limit_cycles, abs=1e-3)
    assert shares.second_position == shares.residual, "a second position of 25 cycles sees nothing of a phase"


def test_the_window_of_a_plan() -> None:
    plan = planned(acceleration_rad_s2=25.0, residual_limit=0.06)
    (budget,) = plan.budgets
    window = window_of(budget)
    assert window.sample == SampleLimits(2048, 410, 2560)
    assert window.limit_cycles == pytest.approx(0.06, abs=2e-5)
    assert window.motion_cycles == pytest.approx(25.0 * 2500 / (2 * math.pi) * 1e-6)
    assert window.tolerance_cycles == 25.0
    assert second_tolerance(budget) is None
    figures = as_figures(coverage_rows(budget))["coverage"]
    assert figures["second_position_mapped"] is False
    assert list(figures["faults"]) == list(KINDS)


def test_a_second_position_that_is_mapped(tmp_path: Path, command: Command) -> None:
    config = yaml_file(
        tmp_path,
        "bus: {interface: virtual, channel: test}\n"
        "modules:\n  - node_id: 0x20\n    cycles_per_revolution: 1000\n"
        "    second_position: {cob_id: 0x381, increments: 4096, tolerance_revolutions: 0.05}\n",
    )
    (module,) = command("plan --json", config).json["modules"]
    assert module["coverage"]["second_position_mapped"] is True
    assert module["coverage"]["second_position_cycles"] == pytest.approx(50.0)


def test_the_table_is_printed_on_request(command: Command) -> None:
    lines = command("plan --coverage --acceleration 25").lines
    (area,) = (line for line in lines if "1 - allowed area / whole area" in line)
    assert "no certificate" in "".join(lines)
    begin = next(n for n, line in enumerate(lines) if line.split()[:2] == ["fault", "amplitude"])
    assert [line[4:30].strip() for line in lines[begin + 1 : begin + 1 + len(KINDS)]] == list(KINDS)
    table = lines[begin - 2 : begin + 1 + len(KINDS)]
    assert [line for line in lines if line not in table] == command("plan --acceleration 25").lines
    assert "by the amplitude" in area


def row(name: str) -> list[str]:
    """The computed cells of the table of the page, beside what was measured."""
    cells = []
    for window in (DEFAULT, COMMISSIONED):
        one = found(window)[name]
        second = one.shares.second_position
        shares = (one.shares.amplitude, one.shares.residual, second)
        cells.append(" / ".join(f"{math.floor(100.0 * share + 1e-9)}" for share in shares))
        cells.append("-" if one.within is None else f"{one.within}")
    return cells


def test_the_page_has_these_figures() -> None:
    rows = {}
    for line in re.findall(r"^\| (.*) \|$", page("evidence"), re.M):
        name, *cells = (cell.strip() for cell in line.split("|"))
        if name in KINDS and len(cells) == 6:
            rows[name] = [cells[0], cells[1], cells[3], cells[4]]
    assert rows == {name: row(name) for name in KINDS}, "\n".join(f"{n}: {row(n)}" for n in KINDS)


PLAN_PAGE = page("plan")
PLAN_PAGE = PLAN_PAGE.partition("\n## The SYNC rate")[0]
BLOCKS = [block.splitlines() for block in blocks(PLAN_PAGE, "sh")]


def test_the_commands_have_the_output_of_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Command
) -> None:
    """With and without sample times, with a configuration, and with several samples for each SYNC."""
    monkeypatch.chdir(tmp_path)
    (first,), (times,), (example, *plans), *several = BLOCKS
    shown, *parts = blocks(PLAN_PAGE, "text")
    assert command(first.removeprefix("canfb"), code=1).out == shown
    assert "the plan holds" in command(times.removeprefix("canfb")).out
    for (line,), part, code in zip(several, parts, (1, 0), strict=True):
        assert part in command(line.removeprefix("canfb"), code=code).out
    assert example == "canfb config example > feedback.yaml"
    Path("feedback.yaml").write_text(command("config example").out)
    for line in plans:
        command(line.removeprefix("canfb"))


def test_the_length_of_a_frame() -> None:
    (formula,) = re.findall(r"\| (47 \+ .*?) bits", PLAN_PAGE)
    for n in range(9):
        assert frame_bits(n) == 47 + 8 * n + (34 + 8 * n - 1) // 4
    assert formula == "47 + 8 n + floor((34 + 8 n - 1) / 4)"


MODULES = "modules: [{node_id: 32, times: true}]\n"


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
    found = command("plan --json", yaml_file(tmp_path, text), code=1).json  # 135 µs for the frames of others
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
    other = command(line, yaml_file(tmp_path, text)).json
    assert other["bus"]["sync_hz"] == 1000.0
    part = command("plan --jitter 10%", yaml_file(tmp_path, text), code=1).out
    assert "SYNC ±335 µs: producer 200, " in part, "10 % of sync_period_us"
    assert other["modules"][0]["cycles_per_revolution"] == 1000
    assert other["modules"][0]["acceleration"]["stated_rad_s2"] == 3.0
    said = command("plan --rate 1000 --acceleration 300 --rpm 0", yaml_file(tmp_path, text), code=1).out
    assert "first, for acceleration: set max_acceleration_rad_s2 (2010:02) to 300, which" in said
    poor = yaml_file(tmp_path, "modules: [{node_id: 32, phase_error_cycles: 0.05}]\n")
    assert "first, for detection: set max_acc" in command("plan --acceleration 80", poor).out
    for error, exceeds in ((0.05, False), (0.055, True)):
        assert ("wrong; set 2010:02, 2010:0C" in command(f"plan --phase-error {error}", poor).out) is exceeds


def test_a_drive_its_frames_and_its_torque(tmp_path: Path, command: Command) -> None:
    path = yaml_file(tmp_path, MODULES + "simulation: {drive: {node_id: 0x30}}\n")
    found = command("plan --json", path).json
    assert {0x1B0, 0x2B0, 0xB0} <= {message["cob_id"] for message in found["bus"]["messages"]}
    assert found["modules"][0]["acceleration"]["stated_rad_s2"] == pytest.approx(510.0)
    path = yaml_file(tmp_path, MODULES + "simulation: {motion: {rpm: 60, ramp_s: 0.001}}\n")
    found = command("plan --rate 100 --json", path, code=1).json  # a step at 100 Hz: no less than its ramp
    assert found["modules"][0]["acceleration"]["stated_rad_s2"] == pytest.approx(6283.2, rel=1e-4)


def test_saved_parameters_go_before_the_configuration(tmp_path: Path, command: Command) -> None:
    from canfb.hosting.state_files import StateFiles
    from canfb.module.feedback_module import FeedbackModule
    from canfb.module.module_config import ModuleConfig

    with StateFiles(tmp_path / "state") as store:
        module = FeedbackModule(ModuleConfig(node_id=32), store)
        module.start(0.0)
        module.dictionary.lookup(0x2010, 1).download((6554).to_bytes(2, "little"))
        module.dictionary.lookup(0x1010, 1).download(b"save")
    path = yaml_file(tmp_path, f"modules: [{{node_id: 32, state_dir: {tmp_path / 'state'}}}]\n")
    (found,) = command("plan --json", path).json["modules"]
    assert found["residual_limit_cycles"] == pytest.approx(0.1, abs=1e-4)


def test_modules_without_a_node_id_and_those_that_sample_themselves(tmp_path: Path, command: Command) -> None:
    text = "modules: [{node_id: 255, source: {kind: motion}}, {node_id: 32, serial_number: 1}, {node_id: 33, "
    text += "serial_number: 2, samples_per_sync: 4, source: {kind: iio, device: adc, scans_per_sync: 4}}]\n"
    found = command("plan --rpm 3000 --jitter 50us --json", yaml_file(tmp_path, text), code=1).json
    assert [one["node_id"] for one in found["modules"]] == [127, 32, 33]
    assert [one["samples_per_sync"] for one in found["modules"]] == [1, 1, 4]
    assert found["modules"][0]["speed"]["largest_rpm"] is None, "the module samples at the exact instant"


def test_no_amplitude_is_no_encoder(tmp_path: Path, command: Command) -> None:
    path = yaml_file(tmp_path, MODULES + "simulation: {encoder: {amplitude: 0}}\n")
    (found,) = command("plan --json", path, code=1).json["modules"]
    assert found["residual"]["needed_cycles"] is None
    command("plan", path, code=1)
