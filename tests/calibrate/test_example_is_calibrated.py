"""`canfb calibrate feedback.yaml` on the example configuration at 100 Hz, as the README has it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from canfb.cia301.frame import Frame
from canfb.cli.calibrate import over_bus
from canfb.cli.config_file import EXAMPLE
from canfb.cli.main import build_parser
from canfb.cli.progress import Progress
from canfb.cli.simulate import chosen
from canfb.configuration import parse_config
from canfb.errors import CalibrationError
from canfb.files import prepare_folder
from canfb.interface.encoder_interface import EncoderInterface
from canfb.master.all_or_nothing import Guard
from canfb.module.feedback_module import FeedbackModule
from canfb.signal.supervision import TABLE_ACTIVE, VALID
from canfb.simulation.embedded_bus import EmbeddedBus
from canfb.simulation.set_up import source_of
from canfb.simulation.sync_producer import SyncProducer
from commissioning_kit import EmbeddedMaster

RATE_HZ = 100.0


def calibrated(text: str, folder: Path) -> tuple[FeedbackModule, EmbeddedBus, float]:
    """Ten seconds of the first session, then the command; module, bus, and the time that it took."""
    config = parse_config(text)
    simulate = build_parser().parse_args(["simulate", "feedback.yaml", "--rate", str(RATE_HZ)])
    bus, module = EmbeddedBus(), FeedbackModule(config.modules[0])
    interface = EncoderInterface(
        config.modules[0].encoder_interface,
        source_of(*chosen(simulate, config)),
        times=config.modules[0].times,
        samples_per_sync=config.modules[0].samples_per_sync,
    )
    master = EmbeddedMaster(bus)
    for device in (module, interface, SyncProducer(1.0 / RATE_HZ)):
        bus.attach(device)
    bus.send(Frame(0x000, b"\x01\x00"))
    bus.run_until(10.0)
    options = build_parser().parse_args(
        ["calibrate", "feedback.yaml", "--out", str(folder / "measured"), "--json"]
    )
    prepare_folder(options.out)
    try:
        assert over_bus(master, options, config, Progress(quiet=True), Guard(), "2026-03-01") == 0
    finally:
        took_s = bus.now - 10.0
    return module, bus, took_s


def test_it_is_measured_proven_and_active_and_still_right_ten_seconds_later(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    module, bus, took_s = calibrated(EXAMPLE, tmp_path)
    figures = json.loads(capsys.readouterr().out)
    assert figures["accepted"]
    assert figures["active"]
    assert figures["before_rms_cycles"] > 0.005
    assert figures["fresh_rms_cycles"] < 1.5e-4
    assert took_s < 110.0, "8000 samples at 100 Hz, and 1500 to prove it"
    bus.run_until(bus.now + 10.0)
    status = module.dictionary.entry(0x2011, 1).value
    assert status & VALID
    assert status & TABLE_ACTIVE
    assert module.dictionary.entry(0x2012, 2).value == 0, "no residual was over its limit"
    assert (tmp_path / "measured" / "report.html").is_file()


def test_a_steady_speed_of_a_whole_number_of_cycles_per_sample_is_said_after_a_second(tmp_path: Path) -> None:
    text = EXAMPLE.replace("ramp_s: 30, rpm: 61, ripple_rpm: 0.3", "ramp_s: 3, rpm: 60, ripple_rpm: 0")
    text = text.replace("max_acceleration_rad_s2: 0.25", "max_acceleration_rad_s2: 0")
    assert "ramp_s: 3, rpm: 60, ripple_rpm: 0," in text
    assert "rad_s2: 0\n" in text
    with pytest.raises(
        CalibrationError, match=r"a whole number of cycles per sample.* for example at 60\.917 rpm"
    ):
        calibrated(text, tmp_path)
