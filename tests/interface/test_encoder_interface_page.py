"""The pages of encoder interface, simulation and local ADC: their tables are those of formula and program."""

from __future__ import annotations

import re

import pytest

from canfb.configuration import parse_config
from canfb.device.od.dictionary import Dictionary
from canfb.eds_files import eds_path
from canfb.module.module_config import ModuleConfig
from canfb.module.parameters import configured_defaults
from canfb.planning import plan_rows
from canfb.simulation.scenario import SimulationConfig
from commands import Command
from documentation import page

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
    text = (
        "modules: [{node_id: 32}]\n"
        "simulation: {sync_jitter_us: 100, sync_jitter_rms_us: 5, sync_drift_ppm: -50, bus_load: 0.3,"
        " bus_bit_rate: 500000, clock_drift_ppm: 100, aperture_jitter_ns: 20, pace: sync,"
        " sync_period_us: 500, seed: 9}\n"
    )
    simulation = parse_config(text).simulation
    assert simulation == SimulationConfig(
        sync_jitter_us=100,
        sync_jitter_rms_us=5,
        sync_drift_ppm=-50,
        bus_load=0.3,
        bus_bit_rate=500000,
        clock_drift_ppm=100,
        aperture_jitter_ns=20,
        pace="sync",
        sync_period_us=500,
        seed=9,
    )
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
                words = f"--rpm={speed} --cycles={cycles} --phase-error={error} --json"
                found = command(f"{PLAN.partition('--rpm')[0]} {words}", code=0 if allowed else 1).json
                assert found["holds"] is allowed
                assert allowed or found["tightest"]["limit"] in ("residual", "acceleration", "speed")


def test_the_noise_of_the_residual_tells_the_jitter() -> None:
    """Second differences weigh independent errors by sqrt(1 + 4 + 1)."""
    (factor,) = re.findall(r"65536 \* ([\d.]+) \* v", PAGE)
    assert float(factor) == pytest.approx(6**0.5, abs=0.005)
