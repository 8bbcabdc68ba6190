"""`canfb simulate`: options that cannot be, recordings that cannot be played, and one that can."""

from __future__ import annotations

from pathlib import Path

import can
import numpy as np
import pytest

from canfb.cli.main import build_parser, main
from canfb.cli.simulate import chosen
from canfb.configuration import load_config
from canfb.signal.sample import Sample
from canfb.simulation.motion import MotionSource
from canfb.simulation.set_up import source_of
from canfb.sources.recording_source import RecordingSource

CHANNEL = "canfb-simulate"
CONFIG = f"""\
bus: {{interface: virtual, channel: {CHANNEL}}}
modules: [{{node_id: 32}}, {{node_id: 33, encoder_interface: 17, cycles_per_revolution: 100}}]
simulation: {{motion: {{standstill_s: 0, ramp_s: 0, rpm: 6}}, encoder: {{noise_lsb: 0, amplitude: 0.5}}}}
"""


@pytest.fixture
def config(tmp_path: Path) -> str:
    path = tmp_path / "feedback.yaml"
    path.write_text(CONFIG)
    return str(path)


@pytest.fixture
def samples(tmp_path: Path) -> str:
    path = tmp_path / "tracks.csv"
    path.write_text("t,a,b\n0,2148,1948\n0.001,2248,1848\n0.9,2348,1748\n0.901,2448,1648\n")
    return str(path)


def opened(arguments: list[str]) -> MotionSource | RecordingSource:
    options = build_parser().parse_args(["simulate", *arguments])
    source = source_of(*chosen(options, load_config(options.config)))
    assert isinstance(source, (MotionSource, RecordingSource))
    return source


@pytest.mark.parametrize(
    ("options", "cycles"),
    [
        ([], 0.25),  # 6 rpm, 2500 cycles, 1 kHz
        (["--rpm", "60"], 2.5),
        (["--rate", "100"], 2.5),
        (["0x21"], 0.01),
    ],
)
def test_speed_rate_and_module_move_the_machine(options: list[str], cycles: float, config: str) -> None:
    source = opened([config, *options])
    assert isinstance(source, MotionSource)
    assert source.next() == Sample(0, 1024)
    source.next()
    assert source.position_cycles == pytest.approx(cycles)


def test_gaps_and_mid_scale_of_a_recording(config: str, samples: str) -> None:
    options = ["--columns", "a,b", "--mid-scale", "2048", "--time-column", "t", "--gap-samples", "2"]
    source = opened([config, "--samples", samples, *options])
    played = [source.next() for _ in range(5)]
    assert played == [Sample(100, -100), None, None, Sample(300, -300), Sample(400, -400)]
    far = opened([config, "--samples", samples, *options, "--gap", "1"])
    assert far.next() == Sample(100, -100)
    assert far.next() == Sample(200, -200)


def test_a_recording_is_played_onto_the_bus_and_ends_by_itself(
    config: str, samples: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with can.Bus(interface="virtual", channel=CHANNEL) as bus:
        options = ["--samples", samples, "--columns", "a,b", "--mid-scale", "2048", "--rate", "500"]
        assert main(["simulate", config, *options, "--autostart", "33"]) == 0
        heard = []
        while (message := bus.recv(0.0)) is not None:
            heard.append((message.arbitration_id, bytes(message.data).hex()))
    said = capsys.readouterr()
    assert said.err == ""
    assert said.out.splitlines() == [
        f"encoder interface: node 17 (11h) on virtual {CHANNEL}; end with Ctrl-C",
        f"recording {samples}, with the errors of its tracks: up to 0 cycles per sample, acceleration up to "
        "0 rad/s^2, the module follows 5.24e+03 at 500 Hz (eq. 10)",
        "4 samples sent; end of the recording",
    ]
    assert heard[:2] == [(0x611, "4000100000000000"), (0x711, "00")], "is the node-ID free?"
    sync = (0x80, "")
    want = [
        sync,
        (0x191, "64009cff"),
        sync,
        (0x191, "c80038ff"),
        sync,
        (0x191, "2c01d4fe"),
        sync,
        (0x191, "900170fe"),
    ]
    assert heard[2:] == [*want, sync], "the SYNC after the last sample ends it"


@pytest.mark.parametrize("how", ["option", "key"])
def test_in_slow_motion_the_samples_are_equidistant_however_late_the_sync_is(
    how: str, config: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """61.2 rpm of 2500 cycles at 1 kHz: 2.55 cycles per sample; 0.1 ms more would be a quarter of a cycle."""
    path, options = tmp_path / "tracks.npz", ["--rpm", "61.2"]
    if how == "option":
        options += ["--pace", "sync"]
    else:
        Path(config).write_text(CONFIG.replace("simulation: {", "simulation: {pace: sync, "))
    said = ["--rate", "1000", "--autostart", "--seconds", "0.1", "--record", str(path)]
    assert main(["simulate", config, *options, *said]) == 0
    capsys.readouterr()
    tracks = np.load(path)
    phases = np.arctan2(tracks["sine"], tracks["cosine"]) / (2.0 * np.pi)
    assert len(phases) >= 100
    assert np.abs(np.diff(phases) % 1.0 - 0.55).max() < 2e-3


def test_a_sync_that_jitters_on_purpose(config: str) -> None:
    options = build_parser().parse_args(["simulate", config, "--rate", "200", "--jitter", "10%"])
    simulation, _, _ = chosen(options, load_config(config))
    assert simulation.sync_jitter_us == pytest.approx(500.0)
