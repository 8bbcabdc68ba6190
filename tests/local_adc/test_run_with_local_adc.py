"""An emulated ADC behind `canfb run`, modules and interfaces: positions against the truth, faults, clocks."""

import contextlib
import errno
import re
import struct
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from emulated_iiod import LIMIT_S, EmulatedAdc, EmulatedIiod, Machine, deliver, fired_by_sync, reading, until

from canfb import FeedbackModule, Frame, ModuleConfig
from canfb.configuration import INTERFACES, Config, parse_config
from canfb.hosting.captured_source import CapturedSource
from canfb.hosting.hosting import make_interface, open_source
from canfb.signal.supervision import MISSED, VALID
from canfb.simulation.encoder import Ramp

Iiod = Callable[..., EmulatedIiod]
Opened = Callable[..., tuple[EmulatedIiod, CapturedSource]]
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


def test_positions_of_a_fired_adc_are_right_until_it_is_lost_and_found(command: Any, iiod: Iiod) -> None:
    server = iiod(EmulatedAdc())
    machine = turning(server)
    running = command(module_with(fired_by_sync(server)))
    running.heard(0x720)
    valid, status, producer = 0, VALID, Producer(running.bus)
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
    # It coasts for three samples, a SYNC that is too early has no PDO, nor has a miss of a lost position.
    while status & VALID and not running.process.has_ended():
        producer.send()
        status = data[4] if (data := running.hear(0x1A0, 0.5)) else status
    again = iiod(EmulatedAdc(), server.port)
    turning(again)
    assert again.opened.wait(LIMIT_S)
    assert running.process.stop() == 0
    lines = running.process.lines
    assert re.search(r"node 32: \d+ samples; missed \d+,", "\n".join(lines))
    assert sum(line.startswith("canfb: node 32: the source fails: ") for line in lines) == 1


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
    assert process.wait() == 1
    assert [line for line in process.lines if line.startswith(words)]
    assert "Traceback" not in str(process)


NODE, ADC_PDO = 16, 0x190


def test_a_converter_that_fails_is_told_by_interface(iiod: Iiod, caplog: pytest.LogCaptureFixture) -> None:
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
                interface.receive(Frame(0x600 + NODE, data), 0.0)


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
    assert running.process.stop() == 0
    assert not ready.exists()
    lines = [line for line in running.process.lines if not line.startswith("ERROR: ")]  # of libiio
    assert lines[0].startswith("encoder interface: node 16 (10h) on udp_multicast ")
    assert [re.sub(r"^\d\S+ \S+ ", "", line) for line in lines[1:]] == [
        "node 16 (10h): boot-up, PRE-OPERATIONAL",
        "node 16 (10h): OPERATIONAL",
        "node 16: 50 samples sent",
    ]


SYNC = Frame(0x80, b"")
SYNC_S, SCANS = 1e-3, 4
SYNCS = 700
FAST_RPM = 600.0  # 25 cycles in each interval of SYNC
ADC_S = 2.6e-4  # no part of SYNC_S: a scan is up to a quarter of an interval old
SLOW_RPM = 60.0  # 2.5 cycles in each interval: 0.65 between two of these scans


@pytest.fixture
def resources() -> Iterator[contextlib.ExitStack]:
    with contextlib.ExitStack() as stack:
        yield stack


def keys_for(server: EmulatedIiod) -> str:
    source = f"{{kind: iio, device: ads7950, scans_per_sync: {SCANS}, uri: '{server.uri}'}}"
    return f"samples_per_sync: 2, autostart: true, source: {source}"


def scanned(scan_s: float = SYNC_S / SCANS * (1.0 + 20e-6), rpm: float = FAST_RPM) -> Machine:
    return Machine(scan_s, Ramp(0.1, 0.0), Ramp(0.5, rpm))


def follow(
    server: EmulatedIiod,
    source: CapturedSource,
    module: FeedbackModule,
    sync: Callable[[float], object],
    machine: Machine,
) -> None:
    """SYNC after SYNC, heard up to 0.2 ms late; the position is right at each of them that is valid."""
    rng, valid = np.random.default_rng(5), 0
    for number in range(1, SYNCS + 1):
        heard_s = number * SYNC_S + float(rng.uniform(0.0, 2e-4))
        deliver(server, source, *machine.scans_until(heard_s))
        sync(heard_s)
        feedback = module.feedback
        if feedback is None or not feedback.status & VALID:
            continue
        valid += 1
        scan = round(1e-7 * int(module.dictionary.entry(0x2000, 5).value) / machine.scan_s)
        truth = machine.truth_cycles[scan]
        assert abs(feedback.cycles + feedback.phase - truth) < 0.02, number
        assert number < 20 or not feedback.status & MISSED
    assert valid > 0.95 * SYNCS
    assert truth > 500


def test_a_module_with_an_adc_of_its_own_takes_two(iiod: Iiod, resources: contextlib.ExitStack) -> None:
    server = iiod()
    (config,) = parse_config(f"modules: [{{node_id: 32, {keys_for(server)}}}]").modules
    assert config.source is not None
    config, source = open_source(config, config.source, Config(), resources)
    assert isinstance(source, CapturedSource)
    assert server.opened.wait(LIMIT_S)
    module = FeedbackModule(config, source=source)
    module.start(0.0)
    follow(server, source, module, lambda now: module.receive(SYNC, now), scanned())
    assert module.dictionary.entry(0x2011, 8).current() > 1.9 * 0.95 * SYNCS, "all pairs are processed"
    newest, earlier = (
        (module.dictionary.entry(0x2000, sine).value, module.dictionary.entry(0x2000, sine + 1).value)
        for sine in (1, 8)
    )
    assert newest != earlier


def test_an_interface_sends_two_and_the_module_follows(iiod: Iiod, resources: contextlib.ExitStack) -> None:
    server = iiod()
    text = f"interfaces: [{{node_id: 16, times: true, {keys_for(server)}}}]"
    interface = make_interface(parse_config(text, needs=INTERFACES).interfaces[0], resources, {})
    assert server.opened.wait(LIMIT_S)
    assert isinstance(interface.source, CapturedSource)
    module = FeedbackModule(ModuleConfig(node_id=32, times=True, samples_per_sync=2, autostart=True))
    for device in (interface, module):
        device.start(0.0)

    def sync(now: float) -> None:
        module.receive(SYNC._replace(timestamp=now), now)
        sent = interface.receive(SYNC._replace(timestamp=now), now)
        assert [len(frame.data) for frame in sent] in ([8, 4], [])
        for frame in sent:
            module.receive(frame, now + 1e-4)

    follow(server, interface.source, module, sync, scanned())
    assert interface.missed < 5


def on_its_own(source: CapturedSource) -> FeedbackModule:
    """A module on a converter whose scans are no part of the interval of SYNC."""
    module = FeedbackModule(ModuleConfig(node_id=32, adc_bits=source.adc_bits, autostart=True), source=source)
    module.start(0.0)
    return module


def test_with_time_stamps_the_position_is_right(opened: Opened) -> None:
    server, source = opened()
    module = on_its_own(source)
    follow(server, source, module, lambda now: module.receive(SYNC, now), scanned(ADC_S, SLOW_RPM))


def test_without_them_it_is_lost_and_nobody_is_told_a_wrong_one(opened: Opened) -> None:
    server, source = opened(time_stamps=False)
    module, machine = on_its_own(source), scanned(ADC_S, SLOW_RPM)
    for number in range(1, SYNCS + 1):
        deliver(server, source, *machine.scans_until(number * SYNC_S))
        module.receive(SYNC, number * SYNC_S)
        feedback = module.feedback
        assert feedback is not None
        error = feedback.cycles + feedback.phase - machine.truth_cycles[-1]
        is_valid = bool(feedback.status & VALID)
        assert not is_valid or abs(error) <= 0.5
    assert not is_valid
