"""`canfb run` and `canfb simulate` as processes of their own, with masters that are not ours."""

from __future__ import annotations

import queue
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import canopen
import numpy as np
import pytest
from network import (
    ADC_COB_ID,
    INTERFACE_ID,
    NODE_ID,
    POSITION_COB_ID,
    SYNC,
    Master,
    next_frame,
    position_fields,
    start_command,
    write_config,
)

from canfb.signal.correction import CorrectionTable
from canfb.signal.supervision import StatusBit

# The SYNCs of these tests come when they come: only a machine at rest is where it was. The other one turns,
# and says when it was sampled.
STANDING = "simulation: {motion: {rpm: 0}}\n"
TIMED = "    times: true\n"
MOVING = "simulation: {motion: {standstill_s: 0.1, ramp_s: 0.5, rpm: 0.6}}\n"
READY = "end with Ctrl-C"


@pytest.fixture
def master(can_channel: str) -> Iterator[Master]:
    made = Master(can_channel)
    yield made
    made.close()


@pytest.fixture
def both(process: Callable[..., Any], tmp_path: Path) -> tuple[Any, Any]:
    """The module and the encoder interface, running, in PRE-OPERATIONAL."""
    config = write_config(tmp_path, simulation=STANDING)
    started = process("run", config), process("simulate", config)
    for one in started:
        one.wait_for(READY)
    return started


def test_python_canopen_starts_reads_uploads_and_hears(both: tuple[Any, Any], master: Master) -> None:
    module = master.module
    assert module.sdo[0x1000].raw == 0x00040196
    assert master.interface.sdo[0x1000].raw == 0x00040191
    adc_cob_id = master.interface.sdo[0x1800][1].raw & 0x7FF
    module.sdo[0x1400][1].raw = 0x80000000 | adc_cob_id
    module.sdo[0x1400][1].raw = adc_cob_id
    heard: queue.Queue[tuple[int, int]] = queue.Queue()
    module.tpdo.read()
    module.tpdo[1].add_callback(lambda pdo: heard.put((pdo[0].raw, pdo[1].raw)))
    for node in (module, master.interface):
        node.nmt.state = "OPERATIONAL"
    positions = []
    for _ in range(50):
        master.network.sync.transmit()
        position, status = heard.get(timeout=10)
        assert status & StatusBit.VALID
        positions.append(position)
    assert module.sdo[0x6004].raw == positions[-1]

    x = np.arange(256) / 256
    table = CorrectionTable(x + 0.01 * np.sin(2 * np.pi * x))
    module.sdo.download(0x2020, 1, table.to_bytes())
    assert module.sdo[0x2020][2].raw == table.crc32
    module.sdo[0x2020][3].raw = table.crc32
    assert module.sdo[0x2020][4].raw == table.crc32
    assert module.sdo.upload(0x2020, 1) == table.to_bytes()
    master.network.sync.transmit()
    assert heard.get(timeout=10)[1] == StatusBit.VALID | StatusBit.TABLE_ACTIVE


def test_cansend_starts_and_candump_sees_the_position(
    both: tuple[Any, Any], command: Callable[..., Any], can_utils: None, can_channel: str
) -> None:
    dump = command("candump", "-L", can_channel)
    dump_id = f"{POSITION_COB_ID:03X}#"
    for line in ("000#0100", "080#"):  # candump may still be starting: until it has seen one
        command("cansend", can_channel, line).wait()
    while dump.find(dump_id, 1.0) is None:
        command("cansend", can_channel, "080#").wait()
    command("cansend", can_channel, "620#4004600000000000").wait()
    assert "5A0#43046000" in dump.wait_for("5A0#")


def test_bad_frames_are_answered_or_dropped_and_change_nothing(
    both: tuple[Any, Any], master: Master, can_bus: can.BusABC
) -> None:
    sdo = master.module.sdo
    for message in start_command(NODE_ID):
        can_bus.send(message)
    can_bus.send(can.Message(arbitration_id=ADC_COB_ID, data=[1, 2, 3, 4], is_extended_id=False))
    assert next_frame(can_bus, POSITION_COB_ID) is not None
    can_bus.send(can.Message(arbitration_id=ADC_COB_ID, data=[9], is_extended_id=False))
    emergency = next_frame(can_bus, 0x80 + NODE_ID)
    assert emergency is not None
    can_bus.send(can.Message(arbitration_id=0x7FF, data=bytes(8), is_extended_id=False))
    can_bus.send(can.Message(arbitration_id=0x600 + NODE_ID, data=bytes(3), is_extended_id=False))
    can_bus.send(can.Message(arbitration_id=0x12345678, data=bytes(8), is_extended_id=True))
    for index, subindex, code in ((0x1234, 0, 0x06020000), (0x2011, 99, 0x06090011), (0x2020, 3, 0x06010001)):
        with pytest.raises(canopen.SdoAbortedError) as error:
            sdo.upload(index, subindex)
        assert error.value.code == code
    with pytest.raises(canopen.SdoAbortedError) as error:
        sdo.download(0x2020, 1, np.full(64, np.nan, "<f4").tobytes())
    assert error.value.code == 0x06090030
    assert (sdo[0x2000][1].raw, sdo[0x2000][2].raw) == (0x0201, 0x0403)
    assert sdo[0x2020][2].raw == 0
    assert sdo[0x2012][8].raw == 1


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_clean_end_on_a_signal(both: tuple[Any, Any], can_bus: can.BusABC, number: signal.Signals) -> None:
    for message in start_command(NODE_ID, INTERFACE_ID):
        can_bus.send(message)
    can_bus.send(SYNC)
    assert next_frame(can_bus, POSITION_COB_ID) is not None
    for one, last_words in zip(both, ("node 32: 1 samples", "1 samples sent"), strict=True):
        one.send(number)
        assert one.wait() == 0
        assert last_words in one.lines[-1]
        assert not any("Traceback" in line for line in one.lines)


def test_the_simulator_can_produce_the_sync(
    process: Callable[..., Any], tmp_path: Path, can_bus: can.BusABC
) -> None:
    config = write_config(tmp_path, "    autostart: true\n" + TIMED, MOVING)
    process("run", config).wait_for(READY)
    process("simulate", config, "--rate", "50").wait_for(READY)
    for _ in range(20):
        data = next_frame(can_bus, POSITION_COB_ID)
        assert data is not None
        assert position_fields(data)[1] & StatusBit.VALID


def test_two_modules_of_one_process(process: Callable[..., Any], tmp_path: Path, can_bus: can.BusABC) -> None:
    config = write_config(
        tmp_path, "    autostart: true\n  - {node_id: 33, encoder_interface: 16, autostart: true}\n", STANDING
    )
    process("run", config).wait_for(READY)
    process("simulate", config).wait_for(READY)
    can_bus.send(SYNC)
    wanted = {POSITION_COB_ID, POSITION_COB_ID + 1}
    while wanted:
        message = can_bus.recv(5.0)
        assert message is not None, f"no frame {wanted}"
        wanted.discard(message.arbitration_id)


def test_a_bus_that_does_not_exist_is_one_line(process: Callable[..., Any], tmp_path: Path) -> None:
    config = write_config(tmp_path)
    failed = process("run", config, "-c", "vcan77")
    assert failed.wait() == 1
    (line,) = failed.lines
    assert line.startswith("canfb: cannot open the bus socketcan vcan77: No such device; ")
    assert "docs/vcan.md" in line
