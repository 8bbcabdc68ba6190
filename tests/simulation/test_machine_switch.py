"""The simulated encoder interface in use: its machine stops and starts, and what it sampled is kept."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np
import pytest

from canfb.cia301.frame import Frame
from canfb.cli.main import build_parser
from canfb.cli.simulate import check_record, chosen, write_record
from canfb.configuration import load_config, parse_config
from canfb.errors import CanfbError, ConfigError
from canfb.hosting.simulating import fed_module
from canfb.interface.encoder_interface import EncoderInterface
from canfb.objects import MachineCommand
from canfb.signal.sample import Sample
from canfb.simulation.embedded_bus import EmbeddedBus
from canfb.simulation.motion import Motion, Ramp, StoppableMotion
from canfb.simulation.set_up import Play, SampleRecorder, set_up, source_of
from canfb.sources.protocol import SourceEnded
from played import Listed, Still

NODE, RAMP_S = 0x10, 2.0
CONFIG = """
bus: {interface: virtual, channel: x}
modules: [{node_id: 32}]
simulation: {motion: {rpm: 60, standstill_s: 0.0, ramp_s: 2.0}}
"""


def write(value: int) -> Frame:
    return Frame(0x600 + NODE, struct.pack("<BHBB3x", 0x2F, 0x2060, 0, value))


def read(interface: EncoderInterface, now: float) -> int:
    (answer,) = interface.receive(Frame(0x600 + NODE, struct.pack("<BHB4x", 0x40, 0x2060, 0)), now)
    return answer.data[4]


@pytest.fixture
def interface(tmp_path: Path) -> EncoderInterface:
    path = tmp_path / "feedback.yaml"
    path.write_text(CONFIG, encoding="utf-8")
    config = load_config(path)
    network = set_up(config.simulation, fed_module(config.modules[0]), Play(autostart=True), print)
    network.interface.start(0.0)
    return network.interface


def place(interface: EncoderInterface, now: float) -> float:
    """The true position at a SYNC, revolutions."""
    interface.receive(Frame(0x080, b""), now)
    return interface.source.position_cycles / 2500  # type: ignore[attr-defined]


def test_it_stops_with_its_ramp_and_goes_on_from_there(interface: EncoderInterface) -> None:
    place(interface, 0.0)
    before = place(interface, 10.0)
    assert read(interface, 10.0) == MachineCommand.START
    (answer,) = interface.receive(write(MachineCommand.STOP), 10.0)
    assert answer.data[0] == 0x60
    assert read(interface, 10.0) == MachineCommand.STOP
    stopped = place(interface, 10.0 + RAMP_S)
    assert stopped == pytest.approx(before + 0.5 * RAMP_S), "1 revolution per second, braked for two seconds"
    assert place(interface, 60.0) == pytest.approx(stopped, abs=1e-9)
    interface.receive(write(MachineCommand.START), 60.0)
    assert place(interface, 60.0 + RAMP_S) == pytest.approx(stopped + 0.5 * RAMP_S)
    assert place(interface, 70.0) == pytest.approx(stopped + 0.5 * RAMP_S + 8.0)


def test_a_reset_of_the_interface_moves_nothing(interface: EncoderInterface) -> None:
    place(interface, 0.0)
    place(interface, 10.0)
    interface.receive(write(MachineCommand.STOP), 10.0)
    still = place(interface, 15.0)
    interface.receive(Frame(0x000, b"\x81\x10"), 15.0)
    assert read(interface, 15.1) == MachineCommand.STOP
    assert place(interface, 20.0) == pytest.approx(still, abs=1e-9)


def test_it_brakes_no_harder_than_its_own_ramp() -> None:
    """In the middle of the ramp, too, and when it is told twice."""
    motion = StoppableMotion(Motion((Ramp(2.0, 60.0),)), RAMP_S)
    for running, at in ((False, 5.0), (True, 5.7), (False, 6.0), (True, 12.0), (True, 12.5)):
        motion.run(running, at)
    times = np.arange(0.0, 20.0, 1e-3)
    places = motion.revolutions_at(times)
    assert places.tolist() == [motion.revolutions(float(time)) for time in times]
    speeds = np.diff(places) / 1e-3
    assert np.abs(np.diff(speeds) / 1e-3).max() == pytest.approx(0.5, rel=0.01), "rev/s², as 60 rpm in 2 s"
    assert speeds.min() == pytest.approx(0.0, abs=1e-9)
    assert speeds[-1] == pytest.approx(1.0)


def test_a_recording_cannot_be_stopped() -> None:
    interface = EncoderInterface(NODE, Still(), autostart=True)
    interface.start(0.0)
    assert read(interface, 0.0) == MachineCommand.START
    (answer,) = interface.receive(write(MachineCommand.STOP), 0.0)
    assert (answer.data[0], struct.unpack_from("<I", answer.data, 4)[0]) == (0x80, 0x08000022)


SYNC, START = Frame(0x080, b""), Frame(0x000, b"\x01\x00")
COUNTS: list[Sample | None] = [Sample(1, -2), Sample(300, 400), None, Sample(-2048, 2047), None, Sample(7, 8)]
RATE_HZ = 500.0


def recorded(counts: list[Sample | None]) -> SampleRecorder:
    bus, interface = EmbeddedBus(), EncoderInterface(16, Listed(counts))
    recorder = SampleRecorder(interface)
    bus.attach(interface)
    bus.attach(recorder)
    for frame in (SYNC, SYNC, START, *[SYNC] * (len(counts) + 3)):
        bus.send(frame)
    return recorder


def test_each_sync_from_the_first_sample_on_is_an_interval() -> None:
    recorder = recorded(COUNTS)
    assert len(recorder) == len(COUNTS), "not those before the start, nor after the end"
    sine, cosine = recorder.tracks()
    np.testing.assert_array_equal(sine, [1, 300, math.nan, -2048, math.nan, 7])
    np.testing.assert_array_equal(cosine, [-2, 400, math.nan, 2047, math.nan, 8])


def played(path: Path, *options: str) -> list[Sample | None]:
    arguments = ["simulate", "x.yaml", "--samples", str(path), *options]
    source = source_of(
        *chosen(build_parser().parse_args(arguments), parse_config("modules: [{node_id: 32}]"))
    )
    samples = []
    while True:
        try:
            samples.append(source.next())
        except SourceEnded:
            return samples


def test_what_is_written_as_npz_is_played_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "tracks.npz"
    write_record(path, recorded(COUNTS), RATE_HZ)
    assert played(path) == COUNTS
    assert float(np.load(path)["rate_hz"]) == RATE_HZ


def test_what_is_written_as_csv_has_the_time_of_each_sample(tmp_path: Path) -> None:
    path = tmp_path / "tracks.csv"
    write_record(path, recorded(COUNTS), RATE_HZ)
    assert path.read_text().splitlines() == [
        "t_s,sine,cosine", "0,1,-2", "0.002,300,400", "0.006,-2048,2047", "0.01,7,8"
    ]  # fmt: skip
    assert played(path) == [sample for sample in COUNTS if sample is not None]
    # A gap costs the sample before it, as everywhere in such files.
    gaps = ["--time-column", "t_s", "--gap", "0.003", "--gap-samples", "2"]
    assert played(path, *gaps) == [COUNTS[0], None, None, None, None, COUNTS[5]]


def test_a_folder_is_no_file_and_a_file_that_fails_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "x.csv").mkdir()
    with pytest.raises(ConfigError, match="cannot be written"):
        check_record(str(tmp_path / "x.csv"))
    with pytest.raises(CanfbError, match=r"--record .*x\.csv: cannot be written: Is a directory"):
        write_record(tmp_path / "x.csv", recorded(COUNTS), RATE_HZ)
