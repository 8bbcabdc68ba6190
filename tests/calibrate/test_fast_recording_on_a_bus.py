"""`canfb calibrate` by the paper's method: the encoder interface records, the module goes on measuring."""

from __future__ import annotations

import json

import numpy as np
import pytest

import commissioning_kit
from canfb.cli.calibrate import over_bus
from canfb.cli.main import build_parser
from canfb.cli.progress import Progress
from canfb.configuration import Config
from canfb.master.all_or_nothing import Guard
from canfb.simulation.encoder import Encoder, ShaftEncoder
from canfb.simulation.motion import Motion, MotionSource, Ramp
from commissioning_kit import CYCLES, RATE_HZ, Bench, random_encoder


def position_errors(bench: Bench, motion: MotionSource, samples: int) -> list[float]:
    """Error of the module's position within a cycle, sample by sample."""
    errors = []
    for _ in range(samples):
        bench.bus.run_until(bench.bus.now + 1.0 / RATE_HZ)
        assert bench.module.feedback is not None
        errors.append((bench.module.feedback.phase - motion.position_cycles + 0.5) % 1.0 - 0.5)
    return errors


def test_the_interface_records_and_the_position_becomes_right(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def source(encoder: Encoder, motion: Motion) -> MotionSource:
        return MotionSource(ShaftEncoder(encoder, CYCLES, seed=7), motion, 1.0 / RATE_HZ)

    monkeypatch.setattr(commissioning_kit, "ChangingSource", source)
    bench = Bench(random_encoder(3), motion=Motion((Ramp(0.2, 0.0), Ramp(1.0, 13.3))))
    motion = bench.interface.source
    assert isinstance(motion, MotionSource)
    bench.bus.run_until(1.5)
    assert bench.value(0x2011, 1) & 0x7F == 0x01
    before = np.ptp(position_errors(bench, motion, 400))
    words = ["calibrate", "--method", "zero-crossings", "--source", "recording", "--seconds", "2", "--json"]
    options = build_parser().parse_args(words)
    assert over_bus(bench.master, options, Config(), Progress(quiet=True), Guard(), "2026-03-01") == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["crc32"] == f"{bench.value(0x2020, 4):08X}"
    after = np.ptp(position_errors(bench, motion, 400))
    assert before > 0.01
    assert 1e-5 < after < 0.002
    assert bench.value(0x2011, 1) & 0x7F == 0x01, "valid, and nothing else to say"
    assert bench.value(0x2012, 1) == 0, "no sample missed"
