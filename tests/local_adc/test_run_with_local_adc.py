"""`canfb run` with a source of its own: positions against the truth, and what it says of a source."""

from __future__ import annotations

import re
import struct
import time
from collections.abc import Callable
from typing import Any

import can
import pytest
from emulated_iiod import EmulatedAdc, EmulatedIiod
from iio_kit import LIMIT_S, Machine, fired_by_sync

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


def test_positions_of_a_fired_adc_are_right(command: Any, iiod: Iiod) -> None:
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
    returncode, output, said = running.ended()
    assert returncode == 0
    assert re.search(r"node 32: \d+ samples; missed \d+,", output)
    assert "canfb: " not in said


def test_an_adc_that_is_lost_is_told_and_found_again(command: Any, iiod: Iiod) -> None:
    server = iiod(EmulatedAdc())
    turning(server)
    running = command(module_with(fired_by_sync(server)))
    running.heard(0x720)
    producer = Producer(running.bus)
    for _ in range(10):
        producer.send()
        assert struct.unpack_from("<H", running.heard(0x1A0), 4)[0] & VALID
    server.close()
    status = VALID
    while status & VALID:  # it coasts for three samples
        producer.send()
        status = struct.unpack_from("<H", running.heard(0x1A0), 4)[0]
    again = iiod(EmulatedAdc(), server.port)
    turning(again)
    assert again.opened.wait(LIMIT_S)
    returncode, _, errors = running.ended()
    assert returncode == 0
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
