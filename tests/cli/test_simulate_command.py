"""`canfb simulate`: a motion, a recording, a drive, several samples for each SYNC."""

import json
import re
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from canfb import ConfigError, FeedbackModule, Frame, Sample
from canfb.cli.commands import build_parser
from canfb.cli.simulate import chosen
from canfb.configuration import Config, load_config, parse_config
from canfb.hosting.simulating import Simulating
from canfb.simulation.cia402.plant import DriveConfig
from canfb.simulation.embedded_bus import EmbeddedBus
from canfb.simulation.encoder import MotionSource
from canfb.simulation.set_up import Play, SimulatedNetwork, set_up, simulated_axis, source_of
from canfb.sources.recording_source import RecordingSource
from commands import Command, yaml_file
from documentation import blocks, page
from folding import each

CHANNEL = "canfb-simulate"
CONFIG = f"""\
bus: {{interface: virtual, channel: {CHANNEL}}}
modules: [{{node_id: 32}}, {{node_id: 33, encoder_interface: 17, cycles_per_revolution: 100}}]
simulation: {{motion: {{standstill_s: 0, ramp_s: 0, rpm: 6}}, encoder: {{noise_lsb: 0, amplitude: 0.5}}}}
"""


@pytest.fixture
def config(tmp_path: Path) -> str:
    return str(yaml_file(tmp_path, CONFIG))


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


@each("options, cycles", [
    ([], 0.25),  # 6 rpm, 2500 cycles, 1 kHz
    (["--rpm", "60"], 2.5),
    (["--rate", "100"], 2.5),
    (["0x21"], 0.01),
])  # fmt: skip
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
    config: str, samples: str, command: Command
) -> None:
    options = "--columns a,b --mid-scale 2048 --rate 500 --autostart 33 --samples"
    with can.Bus(interface="virtual", channel=CHANNEL) as bus:
        said = command(f"simulate {config} {options}", samples)
        heard = [(one.arbitration_id, bytes(one.data).hex()) for one in iter(lambda: bus.recv(0.0), None)]
    assert said.err == ""
    assert said.lines == [
        f"encoder interface: node 17 (11h) on virtual {CHANNEL}; end with Ctrl-C",
        f"recording {samples}, with the errors of its tracks: up to 0 cycles per sample, acceleration up to "
        "0 rad/s^2, the module follows 5.24e+03 at 500 Hz (eq. 10)",
        "4 samples sent; end of the recording",
    ]
    assert heard[:2] == [(0x611, "4000100000000000"), (0x711, "00")], "is the node-ID free?"
    sync, sent = (0x80, ""), ("64009cff", "c80038ff", "2c01d4fe", "900170fe")
    want = [frame for data in sent for frame in (sync, (0x191, data))]
    assert heard[2:] == [*want, sync], "the SYNC after the last sample ends it"


@pytest.mark.parametrize("how", ["option", "key"])
def test_in_slow_motion_the_samples_are_equidistant_however_late_the_sync_is(
    how: str, config: str, tmp_path: Path, command: Command
) -> None:
    """61.2 rpm of 2500 cycles at 1 kHz: 2.55 cycles per sample; 0.1 ms more would be a quarter of a cycle."""
    path, pace = tmp_path / "tracks.npz", "--pace sync" if how == "option" else ""
    if how == "key":
        Path(config).write_text(CONFIG.replace("simulation: {", "simulation: {pace: sync, "))
    command(f"simulate {config} --rpm 61.2 {pace} --rate 1000 --autostart --seconds 0.1 --record", path)
    tracks = np.load(path)
    phases = np.arctan2(tracks["sine"], tracks["cosine"]) / (2.0 * np.pi)
    assert len(phases) >= 100
    assert np.abs(np.diff(phases) % 1.0 - 0.55).max() < 2e-3


def test_the_jitter_of_the_page_on_time_can_be() -> None:
    (line,) = re.findall(r"`canfb (simulate \S+ --rate .*)`", page("time"))
    simulation, _, _ = chosen(build_parser().parse_args(line.split()), parse_config(CONFIG))
    assert simulation.sync_jitter_us == pytest.approx(1000.0)


def test_a_sync_that_jitters_on_purpose(config: str) -> None:
    options = build_parser().parse_args(["simulate", config, "--rate", "200", "--jitter", "10%"])
    simulation, _, _ = chosen(options, load_config(config))
    assert simulation.sync_jitter_us == pytest.approx(500.0)


MODULES = "modules: [{node_id: 0x20, encoder_interface: 0x10}]\n"


def parsed(drive: str, modules: str = MODULES) -> Config:
    return parse_config(f"{modules}simulation:\n  drive: {drive}\n", "drive.yaml")


def axis_of(config: Config) -> object:
    return simulated_axis(config.simulation, config.modules[0], autostart=True)


def test_the_yaml_of_the_page_is_a_drive() -> None:
    configurations = blocks(page("simulation"), "yaml")
    (drive,) = [config for config in map(parse_config, configurations) if config.simulation.drive is not None]
    demand = network_of(drive).demand
    assert demand is not None
    assert demand.warning() is None


def test_the_drive_of_a_configuration() -> None:
    assert parse_config(MODULES).simulation.drive is None
    assert axis_of(parse_config(MODULES)) is None
    assert parsed("{}").simulation.drive == DriveConfig()
    keys: dict[str, Any] = {
        "node_id": 0x31,
        "inertia_kg_m2": 2e-3,
        "load_at_s": 3.0,
        "synchronous_feedback": True,
    }
    assert parsed(json.dumps(keys)).simulation.drive == DriveConfig(**keys)
    own = "modules: [{node_id: 32, encoder_interface: 48, source: {kind: motion}}]\n"
    assert parsed("{}", own).simulation.drive is not None, "48 is free: it has no encoder interface"
    with pytest.raises(ConfigError, match="no node_id"):
        axis_of(parsed("{}", "modules: [{node_id: 255, encoder_interface: 0x10}]\n"))


RATE_HZ = 1000.0
# 2400 rad/s^2: three times what one sample for each SYNC follows.
MOVE = """
modules: [{{node_id: 32, times: true, samples_per_sync: {per_sync}, autostart: true}}]
simulation: {{sync_jitter_us: 50, motion: {{standstill_s: 0.1, ramp_s: 0.13, rpm: 3000}}}}
"""


def test_another_node_with_the_node_id_of_one_of_them_is_named(caplog: pytest.LogCaptureFixture) -> None:
    config = parsed("{}")
    simulating = Simulating(config.simulation, config.modules[0], Play(), {}, config.realtime)
    for device in simulating.network.devices:
        device.start(0.0)
        for can_id in (0x710, 0x720, 0x730):
            device.receive(Frame(can_id, b"\5"), 0.0)
    assert caplog.messages == [
        f"{name}: another node on the bus uses this node-ID ({can_id}h)"
        for name, can_id in (("encoder interface 16 (10h)", 710), ("drive 48 (30h)", 730))
    ]


def network_of(config: Config) -> SimulatedNetwork:
    return set_up(config.simulation, config.modules[0], Play(rate_hz=RATE_HZ, autostart=True), report=print)


@pytest.mark.parametrize(
    ("per_sync", "followed", "held"),
    [(1, "838 at 1000 Hz (eq. 10)", False), (2, "3.35e+03 at 1000 Hz with 2 samples for each SYNC", True)],
)
def test_a_move_is_followed_or_warned_of(per_sync: int, followed: str, held: bool) -> None:
    config = parse_config(MOVE.format(per_sync=per_sync))
    network, module, bus = network_of(config), FeedbackModule(config.modules[0]), EmbeddedBus(1_000_000)
    demand = network.demand
    assert demand is not None
    assert f"the module follows {followed}" in demand.describe()
    assert (demand.warning() is None) is held
    assert demand.rate_hz / demand.per_sync == RATE_HZ
    for device in (*network.devices, module):
        bus.attach(device)
    source = network.interface.source
    assert isinstance(source, MotionSource)
    away: list[float] = []
    valid: list[bool] = []

    def listen(feedback: object, now: float) -> None:
        found = module.feedback
        assert found is not None
        valid.append(found.valid)
        away.append(found.cycles + found.phase - source.position_cycles)

    module.on_feedback = listen
    bus.run_until(0.4)
    assert len(valid) > 390
    exact = all(valid) and max(abs(one - away[0]) for one in away) < 0.3
    assert exact is held, away[-1] - away[0]
