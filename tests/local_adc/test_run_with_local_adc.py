"""`canfb run` with a source of its own: positions against the truth, and what it says of a source."""

from __future__ import annotations

import contextlib
import re
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from emulated_iiod import EmulatedAdc, EmulatedIiod
from iio_kit import reading

from canfb.signal.supervision import VALID
from canfb.simulation.encoder import Encoder
from canfb.simulation.motion import Motion, Ramp

Iiod = Callable[..., EmulatedIiod]
LIMIT_S = 60.0  # for what takes a second
UNITS_PER_CYCLE = 8192
PERIOD_S = 0.02
# A computer that is busy may be late with a SYNC: 2010:06 = 255; 1019h = 240: none of them is missing.
COUNTED = 240
PATIENT = [bytes.fromhex("2F102006FF000000"), bytes.fromhex("2F191000F0000000")]


class Producer:
    """SYNCs with a counter, at a steady rate."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self._next_s = self._sent_s = time.monotonic()
        self._sent = 0
        for request in PATIENT:
            bus.send(can.Message(arbitration_id=0x620, data=request, is_extended_id=False))

    def send(self) -> None:
        # A late one puts off those after it: too near together they would pass for duplicates.
        self._next_s = max(self._next_s, self._sent_s) + PERIOD_S
        time.sleep(max(0.0, self._next_s - time.monotonic()))
        counter = [self._sent % COUNTED + 1]
        self._bus.send(can.Message(arbitration_id=0x80, data=counter, is_extended_id=False))
        self._sent += 1
        self._sent_s = time.monotonic()


class Machine:
    """An encoder on a machine; the ADC samples it when it is fired, a period after the last time."""

    def __init__(self, server: EmulatedIiod) -> None:
        self._server = server
        self._encoder = Encoder(noise_lsb=0.5)
        # A quarter of a cycle for each sample, at most: the time stamps are regular, the SYNC is not.
        self._motion = Motion((Ramp(20 * PERIOD_S, 0.0), Ramp(200 * PERIOD_S, 6.0 * 1e-3 / PERIOD_S)))
        self._rng = np.random.default_rng(5)
        self.truth_cycles: list[float] = []
        server.adc.on_fire = self._sample

    def _sample(self) -> None:
        time_s = len(self.truth_cycles) * PERIOD_S
        position = self._motion.revolutions(time_s) * 2500
        self.truth_cycles.append(position)
        sine, cosine = self._encoder.sample(position, self._rng)
        self._server.deliver(reading(int(sine) + 2048, int(cosine) + 2048, round(time_s * 1e9)))


@pytest.fixture
def port(multicast_words: dict[str, Any]) -> int:
    return int(multicast_words["port"])


@pytest.fixture
def bus(multicast_bus: can.BusABC) -> can.BusABC:
    return multicast_bus


@pytest.fixture
def run(port: int, tmp_path: Path) -> Iterator[Callable[[str], subprocess.Popen[str]]]:
    """Starts `canfb run` with a module that has this source."""
    with contextlib.ExitStack() as stack:

        def start(source: str) -> subprocess.Popen[str]:
            config = tmp_path / "feedback.yaml"
            config.write_text(
                f"bus: {{interface: udp_multicast, channel: 239.74.163.2, port: {port}, hop_limit: 0}}\n"
                f"modules:\n- {{node_id: 32, autostart: true, source: {source}}}\n"
            )
            process = subprocess.Popen(
                [sys.executable, "-W", "error", "-m", "canfb", "run", str(config)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
            stack.enter_context(process)
            stack.callback(process.kill)
            return process

        yield start


def fired_by_sync(server: EmulatedIiod) -> str:
    place = f"uri: 'ip:127.0.0.1:{server.port}', device: ads7950"
    return f"{{kind: iio, {place}, trigger: sysfstrig7, wait_us: 1000000}}"


def heard(bus: can.BusABC, can_id: int, process: subprocess.Popen[str]) -> bytes:
    """The next frame with this id."""
    end = time.monotonic() + LIMIT_S
    while time.monotonic() < end:
        message = bus.recv(0.2)
        if message is not None and message.arbitration_id == can_id:
            return bytes(message.data)
        if process.poll() is not None:
            pytest.fail(f"ended: {process.communicate()}")
    pytest.fail(f"no {can_id:03X}h within {LIMIT_S:g} s")


def ended(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    process.send_signal(signal.SIGTERM)
    output, errors = process.communicate(timeout=LIMIT_S)
    return process.returncode, output, errors


def test_positions_of_a_fired_adc_are_right(
    bus: can.BusABC, run: Callable[[str], subprocess.Popen[str]], iiod: Iiod
) -> None:
    server = iiod(EmulatedAdc())
    machine = Machine(server)
    process = run(fired_by_sync(server))
    heard(bus, 0x720, process)
    still = 0
    producer = Producer(bus)
    for n in range(400):
        producer.send()
        units, status, _ = struct.unpack("<IHH", heard(bus, 0x1A0, process))
        assert len(machine.truth_cycles) == n + 1, "one sample for each SYNC"
        assert status & VALID
        still += not units
        error = units / UNITS_PER_CYCLE - machine.truth_cycles[-1]
        assert abs((error + 261250) % 522500 - 261250) < 0.02
    assert machine.truth_cycles[-1] > 60
    assert still < 100
    returncode, output, errors = ended(process)
    assert returncode == 0
    assert re.search(r"node 32: 400 samples; missed 0,", output)
    assert "canfb: " not in errors


def test_an_adc_that_is_lost_is_told_and_found_again(
    bus: can.BusABC, run: Callable[[str], subprocess.Popen[str]], iiod: Iiod
) -> None:
    server = iiod(EmulatedAdc())
    Machine(server)
    process = run(fired_by_sync(server))
    heard(bus, 0x720, process)
    producer = Producer(bus)
    for _ in range(10):
        producer.send()
        assert struct.unpack_from("<H", heard(bus, 0x1A0, process), 4)[0] & VALID
    server.close()
    status = VALID
    while status & VALID:  # it coasts for three samples
        producer.send()
        status = struct.unpack_from("<H", heard(bus, 0x1A0, process), 4)[0]
    again = iiod(EmulatedAdc(), server.port)
    Machine(again)
    assert again.opened.wait(LIMIT_S)
    returncode, _, errors = ended(process)
    assert returncode == 0
    assert len(re.findall(r"^canfb: node 32: the source fails: ", errors, re.MULTILINE)) == 1


def test_the_end_of_a_recording_is_told_and_the_node_stays(
    bus: can.BusABC, run: Callable[[str], subprocess.Popen[str]], tmp_path: Path
) -> None:
    tracks = tmp_path / "tracks.csv"
    tracks.write_text("a,b\n" + "2048,3500\n" * 20)
    process = run(f"{{kind: recording, file: {tracks}, columns: [a, b], mid_scale: 2048}}")
    heard(bus, 0x720, process)
    producer, statuses = Producer(bus), []
    for _ in range(20):
        producer.send()
        statuses.append(struct.unpack_from("<H", heard(bus, 0x1A0, process), 4)[0])
    # Not all of them: a SYNC that a busy machine sends late takes the valid bit for a while.
    assert any(status & VALID for status in statuses)
    producer.send()
    assert not struct.unpack_from("<H", heard(bus, 0x1A0, process), 4)[0] & VALID
    for _ in range(5):  # lost after three of them, and then there is nothing to send
        producer.send()
    returncode, _, errors = ended(process)
    assert (returncode, errors) == (0, "canfb: node 32: the source has ended: no more samples\n")


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("{kind: iio, uri: 'ip:127.0.0.1:9', device: x}", "canfb: IIO context 'ip:127.0.0.1:9': "),
        ("{kind: recording, file: /nowhere.csv}", "canfb: /nowhere.csv: cannot be read: "),
    ],
)
def test_a_source_that_is_not_there_ends_the_command(
    source: str, words: str, run: Callable[[str], subprocess.Popen[str]]
) -> None:
    process = run(source)
    _, errors = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 1
    assert [line for line in errors.splitlines() if line.startswith(words)]
    assert "Traceback" not in errors
