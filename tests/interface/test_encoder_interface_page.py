"""Encoder interface, simulation, local ADC: tables of their pages by formula and program; ``interfaces:``."""

import dataclasses
import re
from pathlib import Path

import pytest
import yaml

from canfb import ConfigError, ModuleConfig, eds_path
from canfb.configuration import INTERFACES, parse_config
from canfb.device.od.dictionary import Dictionary
from canfb.interface.encoder_interface import InterfaceConfig
from canfb.module.parameters import configured_defaults
from canfb.planning import plan_rows
from canfb.signal.limits import MOST_PHASE_ERROR_CYCLES
from canfb.simulation.scenario import SimulationConfig
from canfb.sources.iio_source import IioSourceConfig
from commands import Command
from documentation import page
from folding import each

INTERFACE, PAGE = page("encoder-interface"), page("local-adc")
LIMIT, CYCLES = 1.0 / 3.0, 2500
UNITS = {"ns": 1e-9, "µs": 1e-6}


def seconds(text: str) -> float:
    value, unit = text.split()
    return float(value) * UNITS[unit]


def test_how_well_the_interface_must_know_when() -> None:
    rows = re.findall(r"\| (\d+) rpm \| (\d+)[^|]*\| ([^|]+) \| ([^|]+) \|", INTERFACE)
    assert len(rows) == 4
    for rpm, speed, clock, skew in rows:
        cycles_per_s = float(rpm) / 60 * CYCLES
        assert float(speed) == pytest.approx(cycles_per_s, abs=1)
        assert seconds(clock) == pytest.approx(LIMIT / 2 / 4 / cycles_per_s, rel=0.05), "4 v e = L / 2"
        assert seconds(skew) == pytest.approx(2 * 0.001 / cycles_per_s, rel=0.05), "v d / 2 = 0.1 %"
    worst, rms = 4 * 83333 * 50e-9, 6**0.5 * 83333 * 100e-9 / 12**0.5
    assert worst == pytest.approx(0.017, abs=5e-4)
    assert rms == pytest.approx(0.006, abs=2e-4)
    rpm = LIMIT / 2 / 4 / 100e-6 / CYCLES * 60
    assert rpm == pytest.approx(10, rel=0.05), "what +-100 us allow"


def test_the_pdos_are_those_of_the_eds() -> None:
    entry = Dictionary.load(eds_path("encoder-interface"), 16).entry
    (line,) = [line for line in INTERFACE.splitlines() if line.startswith("| TPDO2")]
    sent, taken = line.split("RPDO2")
    mapped = [entry(0x1A01, n).value for n in range(1, entry(0x1A01, 0).value + 1)]
    assert re.findall(r"(\w{4})h:(\w{2})", sent) == [
        (f"{one >> 16:04X}", f"{one >> 8 & 0xFF:02X}") for one in mapped
    ]
    assert sum(one & 0xFF for one in mapped) == 56
    assert entry(0x1801, 1).value >> 31 == 1, "off"
    assert re.findall(r"2000h:0(\d)", taken) == ["3", "4", "6", "7"]
    timed = configured_defaults(ModuleConfig(node_id=32, times=True))
    assert (timed[0x1600, 0], timed[0x1600, 3]) == (3, 0x20000520)


def test_the_keys_are_read_and_go_where_they_belong() -> None:
    keys = (
        "{sync_jitter_us: 100, sync_jitter_rms_us: 5, sync_drift_ppm: -50, bus_load: 0.3, seed: 9, "
        "bus_bit_rate: 500000, clock_drift_ppm: 100, aperture_jitter_ns: 20, pace: sync, sync_period_us: 500}"
    )
    simulation = parse_config(f"modules: [{{node_id: 32}}]\nsimulation: {keys}\n").simulation
    assert simulation == SimulationConfig(**yaml.safe_load(keys))
    clock = simulation.sample_clock()
    assert (clock.ticks(1.0) - clock.ticks(0.0)) % (1 << 32) == pytest.approx(10_001_000, abs=1)
    assert clock.ticks(0.0) != 0, "nobody knows where it starts"


PLAN = re.findall(r"^    canfb (plan .*)$", PAGE, re.M)[0]


def test_the_speeds_are_those_of_the_plan(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """0.0125 + v (e + d / 2) cycles: each speed holds, and one a tenth higher does not."""
    command(PLAN)
    # The faults that are simulated have no part in whether it holds, and take nearly all of the time.
    monkeypatch.setattr(plan_rows, "fault_coverage", lambda window: [])
    rows = re.findall(r"^\| (\d+) µs \| (\d+) µs \| (\d+) \| (\d+) \|", PAGE, re.M)
    assert len(rows) == 6
    for jitter_us, delay_us, *speeds in rows:
        for rpm, cycles in zip(speeds, (2500, 512), strict=True):
            for times, allowed in ((1.0, True), (1.1, False)):
                speed = times * float(rpm)
                error = 0.0125 + speed / 60 * cycles * (float(jitter_us) + float(delay_us) / 2) * 1e-6
                assert (error <= MOST_PHASE_ERROR_CYCLES) is allowed, "more cannot be declared (2010:0C)"
                words = f"--rpm={speed} --cycles={cycles} --phase-error={error} --json"
                assert not allowed or command(f"{PLAN.partition('--rpm')[0]} {words}").json["holds"]


def test_the_noise_of_the_residual_tells_the_jitter() -> None:
    """Second differences weigh independent errors by sqrt(1 + 4 + 1)."""
    (factor,) = re.findall(r"65536 \* ([\d.]+) \* v", PAGE)
    assert float(factor) == pytest.approx(6**0.5, abs=0.005)


ADC = "source: {kind: iio, device: ads7950}"
BOTH = f"""\
modules:
  - {{node_id: 0x20, encoder_interface: 0x10}}
interfaces:
  - {{node_id: 0x10, {ADC}, times: true}}
"""


def test_every_key_is_read() -> None:
    text = (
        "interfaces:\n- {node_id: 0x10, source: {kind: iio, device: x, scans_per_sync: 4}, serial_number: 7,"
        " times: true, samples_per_sync: 2, adc_bits: 14, cycles_per_revolution: 1024, state_dir: /tmp/x,"
        " autostart: true}\n"
    )
    (config,) = parse_config(text, needs=INTERFACES).interfaces
    (keys,) = yaml.safe_load(text)["interfaces"]
    converter = IioSourceConfig(device="x", scans_per_sync=4, adc_bits=14, samples_per_sync=2)
    assert config == InterfaceConfig(**keys | {"source": converter})
    assert set(keys) == {field.name for field in dataclasses.fields(InterfaceConfig)}


ONE = "interfaces:\n- node_id: 16\n"
# Text: the line, and words of the message.
WRONG = {
    "modules: [{node_id: 3}]": "1: 'interfaces' is missing: a list with at least one encoder interface",
    ONE: "2: 'source' is missing in interfaces[0]",
    f"{ONE}  source: null\n": "3: 'source' must be a mapping with a kind, such as",
    f"{ONE}  {ADC}\n  residual_limit: 0.3\n": "4: unknown key 'residual_limit' in interfaces[0]",
    f"{ONE}  {ADC}\n  samples_per_sync: 9\n": "4: samples_per_sync must be a whole number 1..8, not 9",
    f"interfaces: [{{node_id: 1, {ADC}, samples_per_sync: 2}}]":
        "1: interfaces[0]: samples_per_sync: 2 need scans_per_sync in source, a multiple of it, not None",
    f"interfaces: [{{node_id: 128, {ADC}}}]": "1: node_id must be a whole number 1..127",
    f"interfaces: [{{node_id: 1, {ADC}, state_dir: 4}}]": "1: state_dir must be text, not 4",
    f"interfaces: [{{node_id: 1, {ADC}, times: 1}}]": "1: times must be true or false, not 1",
    BOTH.replace("0x10}", "0x10, samples_per_sync: 2}"): "2: times and samples_per_sync of modules[0] are",
    BOTH.replace("0x10}", "0x10, samples_per_sync: 2}")
    .replace(ADC, "source: {kind: motion}, samples_per_sync: 3"): "2: times and samples_per_sync of modules",
    BOTH.replace("id: 0x10, s", "id: 0x20, s"): "4: node_id 32 of interfaces[0] is also that of modules[0]",
    f"interfaces:\n- {{node_id: 16, {ADC}}}\n- {{node_id: 16, {ADC}}}\n":
        "3: node_id 16 of interfaces[1] is also that of interfaces[0]",
    f"modules: [{{node_id: 3, state_dir: x}}]\ninterfaces:\n- {{node_id: 16, {ADC}, state_dir: ./x}}\n":
        "3: state_dir of interfaces[0] is also that of modules[0]",
    f"interfaces:\n- {{node_id: 255, {ADC}}}\n- {{node_id: 255, {ADC}}}\n":
        "3: serial_number 0 of interfaces[1] is also that of interfaces[0]: LSS needs unique ones",
    f"interfaces: [{{node_id: 48, {ADC}}}]\nsimulation: {{drive: {{node_id: 48}}}}\n":
        "2: drive: node_id 48 is the node_id of interfaces[0]",
}  # fmt: skip


@each("text", WRONG)
def test_what_is_wrong_is_told_with_its_line(text: str) -> None:
    line, _, words = WRONG[text].partition(": ")
    with pytest.raises(ConfigError) as caught:
        parse_config(text, "f.yaml", INTERFACES)
    assert str(caught.value).startswith(f"f.yaml:{line}: ")
    assert words in str(caught.value)


def test_the_commands_take_one_or_both_lists(tmp_path: Path, command: Command) -> None:
    path = tmp_path / "interface.yaml"
    one = f"interfaces: [{{node_id: 16, {ADC}}}]"
    for text, nodes in ((one, "interfaces: 10h"), (BOTH, "modules: 20h; interfaces: 10h")):
        path.write_text(text)
        assert command("config check", path).out == f"{path}: valid; {nodes}\n"
    path.write_text("bus: {interface: virtual, channel: none}\n")
    assert "'modules' or 'interfaces' is missing" in command("run", path, code=2).err
