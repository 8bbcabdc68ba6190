"""Motions and what they ask of the module; a machine that stops and starts, and what was sampled of it."""

import itertools
import math
import re
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from canfb import ChainConfig, Frame, ModuleConfig, Sample, eds_path, max_acceleration
from canfb.cli.commands import build_parser
from canfb.cli.simulate import check_record, chosen, write_record
from canfb.configuration import parse_config
from canfb.device.od.dictionary import Dictionary
from canfb.errors import CanfbError, ConfigError
from canfb.interface.encoder_interface import EncoderInterface
from canfb.objects import MachineCommand
from canfb.simulation.cia402.plant import DriveConfig
from canfb.simulation.embedded_bus import EmbeddedBus
from canfb.simulation.encoder import Encoder, Motion, Ramp, Ripple, StoppableMotion
from canfb.simulation.scenario import MotionConfig
from canfb.simulation.set_up import Play, SampleRecorder, of_drive, of_motion, of_recording, set_up, source_of
from canfb.sources.recording_source import RecordingLayout, open_recording
from folding import each
from played import Listed, Still, until_end

speeds = st.floats(-3000, 3000)
durations = st.one_of(st.just(0.0), st.floats(1e-6, 5))  # numpy's interpolation fails on subnormal ones
ramps = st.lists(st.builds(Ramp, durations, speeds), max_size=4).map(tuple)
ripples = st.lists(st.builds(Ripple, st.floats(-100, 100), st.floats(0.1, 5)), max_size=2).map(tuple)


def speed_rpm(motion: Motion, time_s: np.ndarray) -> np.ndarray:
    """The speed as the class describes it: straight lines through the ends of the ramps, and the ripple."""
    times, values = [0.0], [motion.start_rpm]
    for ramp in motion.ramps:
        times.append(times[-1] + ramp.duration_s)
        values.append(ramp.end_rpm)
    speed = np.interp(time_s, times, values)
    for ripple in motion.ripples:
        speed = speed + ripple.size_rpm * np.sin(2 * np.pi * ripple.frequency_hz * time_s)
    return speed


def integrated(motion: Motion, until_s: float) -> float:
    """Revolutions by the trapezoidal rule, with nodes at the ends of the ramps."""
    ends = np.cumsum([0.0, *(ramp.duration_s for ramp in motion.ramps)])
    corners = np.unique([0.0, until_s, *(end for end in ends if end < until_s)])
    total = 0.0
    for start, stop in itertools.pairwise(corners):
        # Inside of the interval only: at a corner itself a ramp of no duration jumps.
        middle = (np.arange(4000) + 0.5) / 4000 * (stop - start) + start
        total += float(np.mean(speed_rpm(motion, middle))) * (stop - start) / 60
    return total


@given(ramps, ripples, speeds, st.floats(0, 20))
def test_the_position_is_the_integral_of_the_speed(
    ramps: tuple[Ramp, ...], ripples: tuple[Ripple, ...], start_rpm: float, time_s: float
) -> None:
    motion = Motion(ramps, ripples, start_rpm)
    assert motion.revolutions(0.0) == 0.0
    assert motion.revolutions(time_s) == pytest.approx(integrated(motion, time_s), rel=1e-6, abs=1e-3)
    times = np.linspace(0.0, time_s, 7)
    assert motion.revolutions_at(times) == pytest.approx([motion.revolutions(t) for t in times], abs=1e-9)


MODULE = ChainConfig()
N = MODULE.cycles_per_revolution


@given(
    rpm=st.floats(-3000, 3000).filter(lambda rpm: abs(rpm) > 1.0),
    ramp_s=st.sampled_from([0.0, 0.003, 0.4, 1.0, 2.0]),
    ripple=st.sampled_from([(0.0, 1.0), (0.5, 0.3), (-3.0, 2.0)]),
    rate_hz=st.sampled_from([50.0, 100.0, 500.0, 1000.0]),
)
def test_speed_and_acceleration_are_those_of_the_sampled_motion(
    rpm: float, ramp_s: float, ripple: tuple[float, float], rate_hz: float
) -> None:
    motion = MotionConfig(rpm=rpm, standstill_s=0.5, ramp_s=ramp_s, ripple_rpm=ripple[0], ripple_hz=ripple[1])
    demand = of_motion(motion, MODULE, rate_hz)
    # Sampled a little later each time: a short ramp may begin anywhere in an interval.
    times = (np.arange(int(7.0 * rate_hz)) + np.linspace(0.0, 1.0, 8, endpoint=False)[:, None]) / rate_hz
    position = motion.motion().revolutions_at(times)
    speed = float(np.abs(np.diff(position)).max()) * N
    acceleration = float(np.abs(np.diff(position, 2)).max()) * rate_hz**2 * 2.0 * math.pi
    assert demand.speed_cycles is not None
    assert speed <= demand.speed_cycles * (1 + 1e-9) + 1e-9
    assert speed >= 0.98 * demand.speed_cycles - 1e-9
    assert acceleration <= demand.acceleration_rad_s2 * (1 + 1e-6) + 1e-6
    # A step of twice the ripple, against it: a third of the sum is seen.
    assert acceleration >= 0.3 * demand.acceleration_rad_s2, "a bound, and not a wild one"


LOST = "the module will lose the position"


@each(
    "rpm, standstill_s, ramp_s, rate_hz, rad_s2, warning",
    [
        (60, 0.5, 1.0, 100.0, 2 * math.pi, None),
        (60, 0.5, 0.9, 100.0, 2 * math.pi / 0.9, None),
        (60, 0.5, 0.87, 100.0, 2 * math.pi / 0.87, LOST),  # an uncorrected phase needs its part
        (
            600, 0.5, 2.0, 100.0, 10 * math.pi,
            f"motion: 600 rpm: {LOST}: acceleration 31.4 rad/s^2, it follows 8.38 at 100 Hz: set --rate to "
            "220 or more, or a longer ramp_s",
        ),
        (600, 0.5, 2.0, 205.0, 10 * math.pi, LOST),
        (600, 0.5, 2.0, 220.0, 10 * math.pi, None),
        (60, 0.5, 0.0, 100.0, 200 * math.pi, LOST),  # a step of the speed
        (60, 0.0, 0.0, 100.0, 0.0, "turns by 25 cycles per sample from the first sample on"),
        (1, 0.0, 0.0, 100.0, 0.0, None),
    ],
)  # fmt: skip
def test_a_motion_that_eq_10_does_not_allow_is_warned_of_with_a_rate_that_is_enough(
    rpm: float, standstill_s: float, ramp_s: float, rate_hz: float, rad_s2: float, warning: str | None
) -> None:
    motion = MotionConfig(rpm=rpm, standstill_s=standstill_s, ramp_s=ramp_s)
    demand = of_motion(motion, MODULE, rate_hz)
    assert demand.allowed_rad_s2 == max_acceleration(N, rate_hz, MODULE.residual_limit)
    assert demand.acceleration_rad_s2 == pytest.approx(rad_s2)
    said = demand.warning()
    assert (said is None) == (warning is None)
    assert (warning or "") in (said or "")
    for enough in re.findall(r"--rate to (\d+)", said or ""):
        assert of_motion(motion, MODULE, float(enough)).warning() is None


@each("ripple_hz, warned", [(3.0, False), (30.0, True), (45.0, True), (310.0, False), (2010.0, False)])
def test_a_ripple_asks_for_what_its_samples_show(ripple_hz: float, warned: bool) -> None:
    motion = MotionConfig(rpm=0.0, ripple_rpm=1.0, ripple_hz=ripple_hz)
    demand = of_motion(motion, MODULE, 100.0, sampled=True)
    places = motion.motion().revolutions_at(np.arange(300) / 100.0)
    assert 2e4 * math.pi * np.abs(np.diff(places, 2)).max() <= 1.001 * demand.acceleration_rad_s2
    said = demand.warning()
    assert (said is not None) is warned
    for enough in re.findall(r"--rate to (\d+)", said or ""):
        assert of_motion(motion, MODULE, float(enough), sampled=True).warning() is None


def test_a_motion_is_described() -> None:
    assert of_motion(MotionConfig(rpm=60, ramp_s=1.0), MODULE, 100.0).describe() == (
        "motion: 60 rpm: up to 25 cycles per sample, acceleration up to 6.28 rad/s^2, the module follows "
        "8.38 at 100 Hz (eq. 10)"
    )
    for most, is_enough in ((6.0, False), (6.3, True), (0.0, True)):
        declared = ModuleConfig(node_id=1, max_acceleration_rad_s2=most)
        demand = of_motion(MotionConfig(rpm=60, ramp_s=1.0), declared, 100.0)
        assert ("2010:02" not in (demand.warning() or "")) is is_enough


def test_a_drive_has_its_torque_and_its_friction() -> None:
    objects = Dictionary.load(eds_path("drive"), 0x30)
    demand = of_drive(DriveConfig(rated_torque_nm=0.5, coulomb_friction_nm=0.01), objects, MODULE, 500.0)
    assert demand.acceleration_rad_s2 == pytest.approx(510.0)
    assert demand.speed_cycles == pytest.approx(250.0), "6080h: 3000 rpm"
    assert "write 336 or less to 6072h" in (demand.warning() or "")
    assert of_drive(DriveConfig(), objects, MODULE, 1000.0).warning() is None
    loaded = of_drive(DriveConfig(load_torque_nm=-1.5, load_at_s=1.0), objects, MODULE, 1000.0)
    assert "less friction and torque" in (loaded.warning() or "")


@pytest.mark.parametrize("rate_hz", [100.0, 400.0])
@pytest.mark.parametrize("ramp_s", [2.0, 0.5])
def test_a_recording_asks_for_what_the_motion_did_that_it_is_of(rate_hz: float, ramp_s: float) -> None:
    motion = MotionConfig(rpm=60, standstill_s=0.3, ramp_s=ramp_s)
    times = np.arange(int(3.0 * rate_hz)) / rate_hz
    position = motion.motion().revolutions_at(times) * N
    sine, cosine = (track.astype(float) for track in Encoder().sample(position))
    sine[50] = np.nan
    cosine[60] = np.nan
    demand = of_recording(sine, cosine, MODULE, rate_hz, "tracks.npz")
    wanted = of_motion(motion, MODULE, rate_hz)
    # The errors of Table 1 are 1.1 % of a cycle, and eq. 9 takes them four times at worst: 0.14 of 1/3.
    assert demand.acceleration_rad_s2 < wanted.acceleration_rad_s2 + 0.15 * demand.allowed_rad_s2
    bend = wanted.acceleration_rad_s2 / demand.allowed_rad_s2 / 3.0
    assert demand.acceleration_rad_s2 > (0.9 if bend < 0.5 else 0.0) * wanted.acceleration_rad_s2
    assert (demand.warning() is not None) is (bend > 1 / 3)
    assert demand.describe().startswith("recording tracks.npz, with the errors of its tracks: up to ")


def test_a_recording_of_nothing() -> None:
    for length in (0, 1, 2):
        demand = of_recording(np.full(length, 100.0), np.full(length, np.nan), MODULE, 100.0, "x.csv")
        assert (demand.speed_cycles, demand.acceleration_rad_s2, demand.warning()) == (0.0, 0.0, None)


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


def place(interface: EncoderInterface, now: float) -> float:
    """The true position at a SYNC, revolutions."""
    interface.receive(Frame(0x080, b""), now)
    return interface.source.position_cycles / 2500  # type: ignore[attr-defined]


def test_it_stops_with_its_ramp_and_goes_on_from_there() -> None:
    config = parse_config(CONFIG)
    network = set_up(config.simulation, config.modules[0], Play(autostart=True), print)
    interface = network.interface
    interface.start(0.0)
    place(interface, 0.0)
    before = place(interface, 10.0)
    assert read(interface, 10.0) == MachineCommand.START
    (answer,) = interface.receive(write(MachineCommand.STOP), 10.0)
    assert answer.data[0] == 0x60
    assert read(interface, 10.0) == MachineCommand.STOP
    stopped = place(interface, 10.0 + RAMP_S)
    assert stopped == pytest.approx(before + 0.5 * RAMP_S), "1 revolution per second, braked for two seconds"
    interface.receive(Frame(0x000, b"\x81\x10"), 30.0)
    assert read(interface, 30.1) == MachineCommand.STOP, "a reset of the interface moves nothing"
    assert place(interface, 60.0) == pytest.approx(stopped, abs=1e-9)
    interface.receive(write(MachineCommand.START), 60.0)
    assert place(interface, 60.0 + RAMP_S) == pytest.approx(stopped + 0.5 * RAMP_S)
    assert place(interface, 70.0) == pytest.approx(stopped + 0.5 * RAMP_S + 8.0)


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


def played(path: Path, *options: str) -> list[Sample | None]:
    arguments = ["simulate", "x.yaml", "--samples", str(path), *options]
    config = parse_config("modules: [{node_id: 32}]")
    return until_end(source_of(*chosen(build_parser().parse_args(arguments), config)))


def test_what_is_written_as_npz_is_played_as_it_was(tmp_path: Path) -> None:
    path, recorder = tmp_path / "tracks.npz", recorded(COUNTS)
    write_record(path, recorder, RATE_HZ)
    assert played(path) == COUNTS, "not the SYNCs before the start, nor after the end"
    assert len(recorder) == len(COUNTS)
    assert float(np.load(path)["rate_hz"]) == RATE_HZ
    source = open_recording(path, RecordingLayout(time_stamps=True, interval_s=1e-3))
    assert [one and one.time_100ns for one in (source.next(), source.next())] == [0, 10_000]


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
