"""The time of the machine: true time, or one interval with each SYNC."""

from __future__ import annotations

import itertools
import math
import struct

import pytest

from canfb.cia301.frame import Frame
from canfb.configuration import parse_config
from canfb.errors import ConfigError
from canfb.hosting.simulating import fed_module
from canfb.interface.encoder_interface import EncoderInterface
from canfb.interface.sample_instants import TRUE_TIME, SampleClock
from canfb.simulation.embedded_bus import EmbeddedBus
from canfb.simulation.encoder import Encoder, ShaftEncoder
from canfb.simulation.motion import Motion, MotionSource, Ramp
from canfb.simulation.set_up import SlowMotion, simulated_axis, sync_rate

NODE, TPDO1 = 16, 0x190
SYNC = Frame(0x80, b"")
LATE_S = (0.01, 0.0101, 0.5, 0.5001, 3.0, 60.0, 60.01)  # when the SYNCs come


def turning() -> MotionSource:
    return MotionSource(ShaftEncoder(Encoder(noise_lsb=0.0), 100), Motion((Ramp(0.0, 60.0),)), 1e-3)


def slow(interval_s: float = 1e-3) -> tuple[EmbeddedBus, EncoderInterface, SlowMotion, list[Frame]]:
    """An interface in slow motion, in OPERATIONAL, and the PDOs that it sends."""
    interface = EncoderInterface(NODE, turning(), autostart=True, times=True, clock=SampleClock())
    hearing = SlowMotion(interface.dictionary, interval_s)
    interface.time_base = hearing
    bus, sent = EmbeddedBus(), []
    bus.observers.append(lambda frame, now: sent.append(frame) if frame.can_id == TPDO1 else None)
    bus.attach(hearing)
    bus.attach(interface)
    return bus, interface, hearing, sent


def steps(sent: list[Frame]) -> tuple[list[float], list[int]]:
    """From sample to sample: cycles, and units of 100 ns."""
    samples = [struct.unpack("<hhI", frame.data) for frame in sent]
    phases = [math.atan2(sine, cosine) / math.tau for sine, cosine, _ in samples]
    pairs = list(itertools.pairwise(phases))
    times = [time for *_, time in samples]
    return [(b - a) % 1.0 for a, b in pairs], [b - a for a, b in itertools.pairwise(times)]


def test_in_slow_motion_each_sync_is_one_interval_however_late() -> None:
    bus, _, hearing, sent = slow()
    for at in LATE_S:
        bus.run_until(at)
        bus.send(SYNC)
    cycles, ticks = steps(sent)
    assert cycles == pytest.approx([0.1] * 6, abs=2e-3)
    assert ticks == pytest.approx([10_000] * 6, abs=1)
    assert hearing.time_s == pytest.approx(7e-3)


def test_in_true_time_a_late_sync_finds_the_machine_further_on() -> None:
    bus, interface, _, sent = slow()
    interface.time_base = TRUE_TIME
    for at in LATE_S:
        bus.run_until(at)
        bus.send(SYNC)
    later = [b - a for a, b in itertools.pairwise(LATE_S)]
    assert steps(sent)[1] == pytest.approx([1e7 * seconds for seconds in later], abs=1)


def test_1006h_and_1005h_of_the_interface_count() -> None:
    bus, interface, hearing, _ = slow()
    interface.dictionary.entry(0x1006).value = 2500
    bus.send(SYNC)
    assert hearing.time_s == pytest.approx(2.5e-3)
    bus.send(Frame(0x80, b"", rtr=True))
    bus.send(Frame(0x85, b""))
    assert hearing.time_s == pytest.approx(2.5e-3)
    interface.dictionary.entry(0x1005).value = 0x85
    bus.send(Frame(0x85, b""))
    assert hearing.time_s == pytest.approx(5e-3)


def test_the_fast_recording_goes_on_with_the_syncs() -> None:
    bus, interface, _, _ = slow()
    interface.dictionary.entry(0x2050, 4).value = 50_000
    bus.send(SYNC)
    bus.send(Frame(0x600 + NODE, bytes.fromhex("2F50200101000000")))
    bus.run_until(10.0)
    assert interface.recorder.count == 1
    for _ in range(10):
        bus.send(SYNC)
    bus.send(Frame(0x600 + NODE, bytes.fromhex("4050200200000000")))
    assert interface.recorder.count == 501


def test_the_plant_turns_one_interval_with_each_sync() -> None:
    config = parse_config("modules: [{node_id: 32}]\nsimulation: {drive: {load_torque_nm: -0.1}}\n")
    axis = simulated_axis(config.simulation, fed_module(config.modules[0]), autostart=True)
    assert axis is not None
    interface = EncoderInterface(NODE, axis.source, autostart=True)
    hearing = SlowMotion(interface.dictionary, 0.01)
    interface.time_base = axis.plant.time_base = axis.drive.time_base = hearing
    bus = EmbeddedBus()
    for device in (hearing, axis.plant, interface, axis.drive):
        bus.attach(device)
    for at in LATE_S:
        bus.run_until(at)
        bus.send(SYNC)
    assert axis.plant.motor.time_s == pytest.approx(0.06), "the first SYNC begins"
    assert axis.plant.motor.speed_rad_s > 1.0
    assert axis.drive.interval_s == pytest.approx(0.01)


@pytest.mark.parametrize("interval_s", [0.0, -1.0, 10.1, math.nan, True])
def test_an_interval_that_cannot_be(interval_s: float) -> None:
    with pytest.raises(ValueError, match="interval_s"):
        slow(interval_s)


@pytest.mark.parametrize("text", ["pace: fast", "pace: 1", "sync_period_us: 1", "sync_period_us: fast"])
def test_a_configuration_that_cannot_be(text: str) -> None:
    with pytest.raises(ConfigError, match=text.partition(":")[0]):
        parse_config(f"modules: [{{node_id: 32}}]\nsimulation: {{{text}}}\n")


def test_the_interval_is_that_of_the_rate_or_of_the_configuration() -> None:
    config = parse_config("modules: [{node_id: 32}]\nsimulation: {pace: sync, sync_period_us: 2e4}\n")
    assert config.simulation.pace == "sync"
    assert sync_rate(config.simulation, None) == pytest.approx(50.0)
    assert sync_rate(config.simulation, 200.0) == 200.0
