"""2050h of the encoder interface, by python canopen's block upload: the paper's reference measurement."""

from typing import Any

import canopen
import numpy as np
import pytest
from canopen.sdo import SdoAbortedError

import canfb
from canfb.demo.story import EmbeddedNetwork
from canfb.eds_files import eds_path
from canfb.interface.encoder_interface import EncoderInterface
from canfb.simulation.embedded_bus import EmbeddedBus, SyncProducer
from canfb.simulation.encoder import AnalogPath, Encoder, Motion, MotionSource, ShaftEncoder
from canfb.sources.protocol import Source
from folding import each
from played import Still

NODE = 16
START, STOP = 1, 2


class PatientNetwork(EmbeddedNetwork):
    """Lets ``patience_s`` pass after each request: a device paces the segments of a block."""

    patience_s = 0.0

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        super().send_message(can_id, data, remote)
        self._embedded.run_until(self._embedded.now + self.patience_s)


class Bench:
    """An encoder interface on an embedded bus, and python canopen as the master."""

    def __init__(self, source: Source) -> None:
        self.bus = EmbeddedBus()
        self.network = PatientNetwork(self.bus)
        self.remote = canopen.RemoteNode(NODE, str(eds_path("encoder-interface")))
        self.network.add_node(self.remote)
        self.interface = EncoderInterface(NODE, source)
        self.bus.attach(self.interface)
        self.sdo = self.remote.sdo

    def record(self, seconds: float) -> None:
        self.sdo[0x2050][1].raw = START
        self.bus.run_until(self.bus.now + seconds)
        self.sdo[0x2050][1].raw = STOP

    def upload(self) -> np.ndarray:
        self.network.patience_s = 0.1
        with self.sdo.open(0x2050, 3, "rb", block_transfer=True) as stream:
            data = stream.read()
        self.network.patience_s = 0.0
        return np.frombuffer(data, dtype="<i2").reshape(-1, 2)


def turning(rpm: float = 15.0, **encoder: Any) -> MotionSource:
    shaft = ShaftEncoder(Encoder(amplitude_counts=1400.0, **encoder), 2500)
    return MotionSource(shaft, Motion((), start_rpm=rpm), 1e-3)


@pytest.mark.parametrize(
    ("errors", "limit"),
    [({}, 0.0002), ({"sine_offset": 0.4, "cosine_amplitude": 0.8}, 0.0005)],
    ids=["ideal", "40 % offset, 20 % amplitude"],
)
@pytest.mark.parametrize("rpm", [9.0, 20.0])
def test_the_reference_measurement_of_the_paper(rpm: float, errors: dict[str, Any], limit: float) -> None:
    """The error of the calibrated phase, over a whole cycle without noise and ADC."""
    bench = Bench(turning(rpm, **errors))
    bench.record(2.0)
    assert bench.sdo[0x2050][2].raw == 100_001
    sine, cosine = bench.upload().astype(float).T
    table = canfb.calibrate_from_zero_crossings(sine, cosine).table
    phase = np.arange(4096) / 4096
    raw = canfb.phase_in_cycle(*Encoder(amplitude_counts=1400.0, **errors).tracks(phase))
    error = (table(raw) - phase + 0.5) % 1.0 - 0.5
    assert 1e-6 < np.abs(error - error.mean()).max() <= limit


def test_the_analog_path_delays_it_too() -> None:
    times_s = 0.1 + np.arange(500) / 50e3
    late = turning(path=AnalogPath(cosine_delay_s=2e-5)).fast_samples(times_s, (0, 0))[:, 1]
    np.testing.assert_allclose(late, turning().fast_samples(times_s + 2e-5, (0, 0))[:, 1], atol=1)


def test_it_tells_what_it_does_and_what_it_has() -> None:
    bench = Bench(turning())
    assert [bench.sdo[0x2050][n].raw for n in (1, 2, 4, 5)] == [0, 0, 50_000, 1_000_000]
    bench.sdo[0x2050][1].raw = START
    bench.bus.run_until(0.01)
    assert [bench.sdo[0x2050][n].raw for n in (1, 2)] == [1, 501]
    early = bench.upload()
    bench.sdo[0x2050][1].raw = STOP
    count = bench.sdo[0x2050][2].raw
    assert count > 501
    bench.bus.run_until(bench.bus.now + 0.5)
    assert [bench.sdo[0x2050][n].raw for n in (1, 2)] == [0, count]
    assert np.array_equal(bench.upload()[:501], early)
    bench.remote.nmt.state = "RESET"
    assert bench.sdo[0x2050][2].raw == 0


def test_the_memory_is_bounded() -> None:
    bench = Bench(turning())
    bench.interface.dictionary.entry(0x2050, 5).value = 70_000
    bench.sdo[0x2050][1].raw = START
    bench.bus.run_until(3600.0)
    assert [bench.sdo[0x2050][n].raw for n in (1, 2)] == [0, 70_000]
    assert len(bench.upload()) == 70_000


def test_the_rate_can_be_set_but_not_while_it_records() -> None:
    bench = Bench(turning())
    bench.sdo[0x2050][4].raw = 1000
    bench.sdo[0x2050][1].raw = START
    bench.bus.run_until(0.1)
    for value in (2000, 1000):
        with pytest.raises(SdoAbortedError, match="0x08000022"):
            bench.sdo[0x2050][4].raw = value
    bench.sdo[0x2050][1].raw = STOP
    assert bench.sdo[0x2050][2].raw == 101
    for value, code in ((999, "0x06090032"), (200_001, "0x06090031")):
        with pytest.raises(SdoAbortedError, match=code):
            bench.sdo[0x2050][4].raw = value


@each(
    "source, value, code",
    [*((turning(), value, "0x06090030") for value in (0, 3, 255)), (Still(), START, "0x08000022")],
)
def test_other_commands_and_recording_what_is_played_from_a_file_are_refused(
    source: Source, value: int, code: str
) -> None:
    with pytest.raises(SdoAbortedError, match=code):
        Bench(source).sdo[0x2050][1].raw = value


def test_fast_samples_and_those_of_the_syncs_are_of_one_motion() -> None:
    bench = Bench(turning(60.0))
    heard: list[bytes] = []
    bench.bus.observers.append(lambda frame, now: heard.append(frame.data) if frame.can_id == 0x190 else None)
    bench.bus.attach(SyncProducer(1e-3))
    bench.remote.nmt.state = "OPERATIONAL"
    bench.bus.run_until(0.0105)
    del heard[:]
    bench.record(0.02)
    of_syncs = np.frombuffer(b"".join(heard), dtype="<i2").reshape(-1, 2)
    assert len(of_syncs) == 20
    assert np.abs(bench.upload()[25::50] - of_syncs).max() <= 1
