"""`canfb run` with an emulated ADC: positions against the truth, PDOs, faults, what it says of a source."""

from __future__ import annotations

import contextlib
import errno
import re
import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest
from emulated_iiod import EmulatedAdc, EmulatedIiod
from iio_kit import LIMIT_S, Machine, fired_by_sync, reading, until

from canfb.cia301.frame import Frame
from canfb.configuration import INTERFACES, parse_config
from canfb.hosting.hosting import make_interface
from canfb.interface.encoder_interface import EncoderInterface
from canfb.signal.supervision import VALID
from canfb.simulation.motion import Ramp

Iiod = Callable[..., EmulatedIiod]
UNITS_PER_CYCLE = 8192
NO_ADC = "{kind: iio, uri: 'ip:127.0.0.1:9', device: x}"
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


def turning(server: EmulatedIiod) -> Machine:
    """The ADC samples it when it is fired: a quarter of a cycle further at most, by regular time stamps."""
    machine = Machine(PERIOD_S, Ramp(20 * PERIOD_S, 0.0), Ramp(50 * PERIOD_S, 6.0 * 1e-3 / PERIOD_S))
    server.adc.on_fire = lambda: server.deliver(machine.scan())
    return machine


def module_with(source: str) -> str:
    return f"modules:\n- {{node_id: 32, autostart: true, source: {source}}}"


def test_positions_of_a_fired_adc_are_right_until_it_is_lost_and_found_again(
    command: Any, iiod: Iiod
) -> None:
    server = iiod(EmulatedAdc())
    machine = turning(server)
    running = command(module_with(fired_by_sync(server)))
    running.heard(0x720)
    valid, producer = 0, Producer(running.bus)
    for _ in range(120):
        before = len(machine.truth_cycles)
        producer.send()
        # Where the computer is busy: a late SYNC has a PDO of its own, and one too early none.
        while (data := running.hear(0x1A0, 0.5)) is not None:
            units, status, _ = struct.unpack("<IHH", data)
            if status & VALID:
                valid += 1
                errors = [units / UNITS_PER_CYCLE - truth for truth in machine.truth_cycles[-2:]]
                assert min(abs((error + 261250) % 522500 - 261250) for error in errors) < 0.02
            if len(machine.truth_cycles) > before:
                break
    assert valid
    server.close()
    status = VALID
    while status & VALID:  # it coasts for three samples
        producer.send()
        status = struct.unpack_from("<H", running.heard(0x1A0), 4)[0]
    again = iiod(EmulatedAdc(), server.port)
    turning(again)
    assert again.opened.wait(LIMIT_S)
    returncode, output, errors = running.ended()
    assert returncode == 0
    assert re.search(r"node 32: \d+ samples; missed \d+,", output)
    assert len(re.findall(r"^canfb: node 32: the source fails: ", errors, re.MULTILINE)) == 1


@pytest.mark.parametrize(
    ("nodes", "words"),
    [
        (module_with(NO_ADC), "canfb: IIO context 'ip:127.0.0.1:9': "),
        (f"interfaces: [{{node_id: 16, source: {NO_ADC}}}]", "canfb: IIO context 'ip:127.0.0.1:9': "),
        (module_with("{kind: recording, file: /nowhere.csv}"), "canfb: /nowhere.csv: cannot be read: "),
    ],
)
def test_a_source_that_is_not_there_ends_the_command(nodes: str, words: str, command: Any) -> None:
    process = command(nodes).process
    _, errors = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 1
    assert [line for line in errors.splitlines() if line.startswith(words)]
    assert "Traceback" not in errors


NODE, ADC_PDO = 16, 0x190


def test_a_converter_that_fails_is_told_by_the_interface(
    iiod: Iiod, caplog: pytest.LogCaptureFixture
) -> None:
    server = iiod(EmulatedAdc(fire_error=errno.EIO))
    server.adc.on_fire = lambda: server.deliver(reading(2048, 2048, 0))
    text = f"interfaces: [{{node_id: {NODE}, autostart: true, source: {fired_by_sync(server)}}}]"
    (config,) = parse_config(text, needs=INTERFACES).interfaces
    with contextlib.ExitStack() as resources:
        interface = make_interface(config, resources, {})
        interface.start(0.0)
        for now, fire_error in ((0.0, errno.EIO), (0.5, 0), (1.5, 0)):
            server.adc.fire_error = fire_error
            interface.receive(Frame(0x80, b""), now)
    assert [record.getMessage() for record in caplog.records] == [
        "node 16: the source fails: the trigger cannot be fired: Input/output error",
        "node 16: the source works again",
    ]


def test_what_is_saved_is_there_again(tmp_path: Path) -> None:
    text = f"interfaces: [{{node_id: {NODE}, state_dir: {tmp_path / 'state'}, source: {{kind: motion}}}}]"
    (config,) = parse_config(text, needs=INTERFACES).interfaces
    for heartbeat_ms in (0, 250):
        with contextlib.ExitStack() as resources:
            interface = make_interface(config, resources, {})
            interface.start(0.0)
            assert interface.dictionary.entry(0x1017).value == heartbeat_ms
            for data in (b"\x2b\x17\x10\x00\xfa\x00\x00\x00", b"\x23\x10\x10\x01save"):
                assert written(interface, data)[0] == 0x60


def written(interface: EncoderInterface, data: bytes) -> bytes:
    """The answer to an SDO request; that to `save` comes when it is on the disk."""
    frames = interface.receive(Frame(0x600 + NODE, data), interface.node.now)

    def answered() -> bool:
        frames.extend(interface.tick(interface.node.now + 1e-3))
        return any(frame.can_id == 0x580 + NODE for frame in frames)

    until(answered, "answered")
    return next(frame.data for frame in frames if frame.can_id == 0x580 + NODE)


def test_the_command_serves_an_adc_from_boot_up_to_the_end(command: Any, iiod: Iiod, tmp_path: Path) -> None:
    server = iiod()
    count = iter(range(1, 1000))

    def scan() -> None:
        number = next(count)
        server.deliver(reading(2048 + number, 2048 - number, number * 1_000_000))

    server.adc.on_fire = scan
    ready = tmp_path / "interface.ready"
    nodes = f"interfaces:\n- {{node_id: {NODE}, times: true, source: {fired_by_sync(server)}}}"
    running = command(nodes, "--ready-file", str(ready))
    assert running.heard(0x710) == b"\0"
    until(ready.exists, "ready")
    running.send(0x000, bytes([1, NODE]))
    for number in range(1, 51):
        running.send(0x80)
        assert struct.unpack("<hhI", running.heard(ADC_PDO)) == (number, -number, number * 10_000)
    returncode, output, errors = running.ended()
    assert (returncode, [line for line in errors.splitlines() if line.startswith("canfb: ")]) == (0, [])
    assert not ready.exists()
    lines = output.splitlines()
    assert lines[0].startswith("encoder interface: node 16 (10h) on udp_multicast ")
    assert [re.sub(r"^\d\S+ \S+ ", "", line) for line in lines[1:]] == [
        "node 16 (10h): boot-up, PRE-OPERATIONAL",
        "node 16 (10h): OPERATIONAL",
        "node 16: 50 samples sent",
    ]
