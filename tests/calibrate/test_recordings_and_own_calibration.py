"""Objects 2050h and 2030h as sources of samples and tables, with the module itself on the bus."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from test_calibrate_on_a_bus import calibrate

from canfb.cia301.frame import Frame
from canfb.errors import CalibrationError
from canfb.master.access import CommissioningError
from canfb.master.all_or_nothing import read_active
from canfb.master.listening import record
from canfb.signal.correction import NO_CORRECTION
from canfb.simulation.motion import Motion
from commissioning_kit import RATE_HZ, Bench


def with_calculator(bench: Bench) -> Bench:
    """What `canfb run` does in another process is done here while somebody waits."""

    def work(now: float) -> None:
        job = bench.module.pending_job()
        if job is not None:
            bench.module.finish_job(job, job(), now)

    bench.master.on_wait = work
    bench.access.write(0x2030, 0x0A, "I", 1500)
    return bench


def test_a_recording_of_the_module() -> None:
    bench = Bench()
    parts: list[float] = []
    samples = record(bench.access, 1.0, None, parts.append)
    assert len(samples) == pytest.approx(1000, abs=300)
    assert samples.rate_hz == pytest.approx(RATE_HZ, rel=0.01)
    assert samples.missed == 0
    assert np.abs(samples.sine).max() > 900
    assert parts == sorted(parts)
    assert bench.access.integer(0x2050, 1, "B") == 0, "it records no more"


def test_a_recording_ends_when_the_memory_is_full() -> None:
    bench = Bench()
    bench.module._recorder._recording.capacity = 300
    samples = record(bench.access, 60.0, None, lambda part: None)
    assert len(samples) == 300
    assert bench.bus.now < 5.0


def test_a_recording_is_stopped_when_it_is_interrupted() -> None:
    bench = Bench()

    def interrupt(now: float) -> None:
        if now > 0.5:
            bench.master.on_wait = lambda now: None
            raise KeyboardInterrupt

    bench.master.on_wait = interrupt
    with pytest.raises(KeyboardInterrupt):
        record(bench.access, 60.0, None, lambda part: None)
    assert bench.access.integer(0x2050, 1, "B") == 0


def test_what_cannot_record_says_so() -> None:
    bench = Bench(operational=False)
    with pytest.raises(CommissioningError, match=r"module 32 \(20h\) has recorded nothing \(2050:02\)"):
        record(bench.access, 0.5, None, lambda part: None)


def test_the_rate_of_a_recording_that_does_not_say_it(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench()
    monkeypatch.delitem(bench.module.dictionary._entries, (0x2050, 4))
    assert record(bench.access, 0.5, 990.0, lambda part: None).rate_hz == 990.0


def test_the_recording_of_the_module_makes_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    bench = Bench()
    assert calibrate(bench, "--source", "recording", "--recorder", "module", "--json") == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["active"]
    assert figures["crc32"] == f"{bench.value(0x2020, 4):08X}"


def test_the_module_measures_by_itself(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    bench = with_calculator(Bench())
    assert calibrate(bench, "--source", "module", "--json", "--out", str(tmp_path)) == 0
    figures = json.loads(capsys.readouterr().out)
    active = read_active(bench.access)
    assert figures["crc32"] == f"{active.crc32:08X}" != "00000000"
    assert figures["active"]
    assert bench.access.integer(0x2030, 2, "B") == 5, "accepted"
    assert (tmp_path / "table.bin").read_bytes() == active.table.to_bytes()  # type: ignore[union-attr]
    assert "Accepted." in (tmp_path / "report.html").read_text()
    rms = bench.access.read(0x2030, 5, "f")
    assert figures["residual_rms_cycles"] == pytest.approx(rms, rel=0.1)


def test_a_dry_run_of_it_drops_what_the_module_measured(capsys: pytest.CaptureFixture[str]) -> None:
    bench = with_calculator(Bench())
    assert calibrate(bench, "--source", "module", "--dry-run") == 0
    assert "dry run" in capsys.readouterr().out
    assert read_active(bench.access) == NO_CORRECTION
    assert bench.access.integer(0x2030, 2, "B") == 0


@pytest.mark.parametrize("arguments", [
    ["--source", "module"], ["--source", "module", "--check"],
    ["--source", "recording", "--recorder", "module"],
])  # fmt: skip
def test_a_module_that_is_not_operational_is_told_within_three_seconds(arguments: list[str]) -> None:
    bench = Bench()
    bench.bus.run_until(0.5)
    bench.bus.send(Frame(0, bytes([0x80, 0x20])))  # the interface stays OPERATIONAL
    began = bench.bus.now
    with pytest.raises(CommissioningError, match=r"module 32 \(20h\) has .* OPERATIONAL"):
        calibrate(bench, "--seconds", "20", *arguments)
    assert bench.bus.now - began < 3.0
    assert bench.access.integer(0x2030, 2, "B") == 0
    assert bench.access.integer(0x2050, 1, "B") == 0


@pytest.mark.parametrize("arguments", [
    [], ["--check"], ["--source", "module"], ["--source", "module", "--check"],
    ["--source", "recording"], ["--source", "recording", "--recorder", "module"],
])  # fmt: skip
def test_an_encoder_interface_that_is_not_there_is_refused(arguments: list[str]) -> None:
    bench = Bench()
    bench.bus.run_until(0.5)
    with pytest.raises(CommissioningError, match=r"encoder interface 17 \(11h\) does not answer"):
        calibrate(bench, "--encoder-interface", "0x11", *arguments)
    assert read_active(bench.access) == NO_CORRECTION


def test_what_the_module_refuses_is_refused() -> None:
    bench = with_calculator(Bench(motion=Motion(())))
    with pytest.raises(CalibrationError, match=r"module 32 \(20h\) refuses its measurement: ") as error:
        calibrate(bench, "--source", "module")
    assert error.value.reason == "coverage"
    assert bench.access.integer(0x2030, 2, "B") == 0


def test_a_table_of_the_module_that_does_not_keep_its_promise_is_taken_back() -> None:
    bench = with_calculator(Bench())
    work = bench.master.on_wait

    def knock(now: float) -> None:
        work(now)
        if bench.value(0x2020, 4):
            bench.source.change = lambda counts: (counts[0] + 60, counts[1])

    bench.master.on_wait = knock
    with pytest.raises(CommissioningError, match=r"on fresh samples .*; the previous table and conditioning"):
        calibrate(bench, "--source", "module")
    assert read_active(bench.access) == NO_CORRECTION


def test_the_module_tells_its_drift(capsys: pytest.CaptureFixture[str]) -> None:
    bench = with_calculator(Bench())
    calibrate(bench, "--source", "module")
    active = read_active(bench.access)
    bench.source.change = lambda counts: (counts[0] + 12, counts[1])
    capsys.readouterr()
    assert calibrate(bench, "--source", "module", "--check", "--json") == 0
    figures = json.loads(capsys.readouterr().out)
    want = 12 / bench.encoder.amplitude_counts / (2 * np.pi * np.sqrt(2))
    assert figures["drift_rms_cycles"] == pytest.approx(want, rel=0.2)
    assert read_active(bench.access) == active
    assert bench.access.integer(0x2030, 2, "B") == 0
