"""`canfb run` and `canfb simulate` on a real bus, and several modules in one process."""

import queue
import re
import signal
import struct
from pathlib import Path

import can
import pytest
from network import (
    ADC_COB_ID,
    INTERFACE_ID,
    NODE_ID,
    PERIODS,
    POSITION_COB_ID,
    SYNC,
    TIMES,
    Master,
    OpenBus,
    Timer,
    frame,
    next_frame,
    position_fields,
    reset,
    slow_motion,
    start_command,
    tolerate_late_syncs,
    wait_for,
    wait_for_boot_up,
    write_config,
)
from pace import Pace

from canfb.objects import StatusBit
from ideal_tracks import wavy_table
from processes import Process, Started

MOTION = "{standstill_s: 0.01, ramp_s: 0.5, rpm: 60}"


@pytest.fixture
def both(process: Started, tmp_path: Path, can_bus: can.BusABC, pace: Pace) -> tuple[Process, Process]:
    """The module and the encoder interface, on the bus, in PRE-OPERATIONAL."""
    config = write_config(tmp_path, TIMES, slow_motion(pace, MOTION))
    started = process("run", config), process("simulate", config)
    wait_for_boot_up(can_bus, pace, NODE_ID, INTERFACE_ID)
    return started


def test_python_canopen_as_master_bad_frames_and_a_clean_end(
    both: tuple[Process, Process], open_bus: OpenBus, can_channel: str, pace: Pace
) -> None:
    with Master(can_channel, pace) as master:
        starts_reads_uploads_and_hears(master, pace)
        bad_frames_are_told_or_dropped_and_change_nothing(master, open_bus(), pace)
    signals = signal.SIGINT, signal.SIGTERM
    words = r"node 32: \d+ samples", r"\d+ samples sent"
    for one, number, last_words in zip(both, signals, words, strict=True):
        one.send(number)
        assert one.wait() == 0
        assert re.search(last_words, one.lines[-1])
        assert not any("Traceback" in line for line in one.lines)


def starts_reads_uploads_and_hears(master: Master, pace: Pace) -> None:
    module = master.module
    assert module.sdo[0x1000].raw == 0x00040196
    assert master.interface.sdo[0x1000].raw == 0x00040191
    adc_cob_id = master.interface.sdo[0x1800][1].raw & 0x7FF
    module.sdo[0x1400][1].raw = 0x80000000 | adc_cob_id
    module.sdo[0x1400][1].raw = adc_cob_id
    heard: queue.Queue[tuple[int, int]] = queue.Queue()
    module.tpdo.read()
    module.tpdo[1].add_callback(lambda pdo: heard.put((pdo[0].raw, pdo[1].raw)))
    module.sdo[0x2010][6].raw = PERIODS
    for node in (module, master.interface):
        node.nmt.state = "OPERATIONAL"
    positions = []
    timer = Timer(pace)
    for _ in range(50):
        timer.wait()
        master.network.sync.transmit()
        position, status = heard.get(timeout=pace.patience_s)
        assert status & StatusBit.VALID
        positions.append(position)
    assert module.sdo[0x6004].raw == positions[-1]

    table = wavy_table(256)
    module.sdo.download(0x2020, 1, table.to_bytes())
    assert module.sdo[0x2020][2].raw == table.crc32
    module.sdo[0x2020][3].raw = table.crc32
    assert module.sdo[0x2020][4].raw == table.crc32
    assert module.sdo.upload(0x2020, 1) == table.to_bytes()
    timer.wait()
    master.network.sync.transmit()
    assert heard.get(timeout=pace.patience_s)[1] == StatusBit.VALID | StatusBit.TABLE_ACTIVE


def bad_frames_are_told_or_dropped_and_change_nothing(
    master: Master, can_bus: can.BusABC, pace: Pace
) -> None:
    reset(can_bus, pace)
    sdo = master.module.sdo
    for message in start_command(NODE_ID):
        can_bus.send(message)
    can_bus.send(can.Message(arbitration_id=ADC_COB_ID, data=[1, 2, 3, 4, 0, 0, 0, 0], is_extended_id=False))
    next_frame(can_bus, pace, POSITION_COB_ID)
    can_bus.send(can.Message(arbitration_id=ADC_COB_ID, data=[9], is_extended_id=False))
    next_frame(can_bus, pace, 0x80 + NODE_ID)
    can_bus.send(can.Message(arbitration_id=0x7FF, data=bytes(8), is_extended_id=False))
    can_bus.send(can.Message(arbitration_id=0x600 + NODE_ID, data=bytes(3), is_extended_id=False))
    can_bus.send(can.Message(arbitration_id=0x12345678, data=bytes(8), is_extended_id=True))
    assert (sdo[0x2000][1].raw, sdo[0x2000][2].raw) == (0x0201, 0x0403)
    assert sdo[0x2012][8].raw == 1


def test_the_simulator_can_produce_the_sync_and_the_other_signals(
    process: Started, tmp_path: Path, can_bus: can.BusABC, pace: Pace
) -> None:
    config = write_config(tmp_path, f"{TIMES}    autostart: true\n", slow_motion(pace, MOTION))
    run = process("run", config)
    wait_for_boot_up(can_bus, pace, NODE_ID)
    tolerate_late_syncs(can_bus, pace)
    simulate = process("simulate", config, "--rate", f"{1.0 / pace.period_s:.3g}")
    valid = 0
    while valid < 20:  # a process that gets no processor may miss some
        valid += position_fields(next_frame(can_bus, pace, POSITION_COB_ID))[1] & StatusBit.VALID
    for one, number in ((run, signal.SIGTERM), (simulate, signal.SIGINT)):
        one.send(number)
        assert one.wait() == 0


def test_a_bus_that_does_not_exist_is_one_line(process: Started, tmp_path: Path) -> None:
    run = process("run", write_config(tmp_path), "-c", "vcan77")
    assert run.wait() == 1
    assert run.lines == [
        "canfb: cannot open the bus socketcan vcan77: No such device; `ip link` lists the interfaces, "
        "docs/vcan.md explains how to create one"
    ]


NODES = tuple(range(33, 40))
NEWCOMER, SERIAL = 40, 7
INTERFACES = {node: node + 40 for node in (*NODES, NEWCOMER)}
BAD_TABLE = 35
CYCLES = 10


def lss(text: str) -> can.Message:
    return frame(0x7E5, bytes.fromhex(text).ljust(8, b"\0"))


@pytest.fixture
def eight(process: Started, tmp_path: Path, can_bus: can.BusABC, pace: Pace) -> Process:
    """The process, on the bus. Each module has stored nothing, one has a bad table."""
    (tmp_path / str(BAD_TABLE)).mkdir()
    (tmp_path / str(BAD_TABLE) / "manufacturer.bin").write_bytes(b"no table at all")
    modules = [
        f"- {{node_id: {node}, encoder_interface: {INTERFACES[node]}, autostart: true, "
        f"times: true, state_dir: {tmp_path}/{node}}}\n"
        for node in NODES
    ]
    modules.append(
        f"- {{node_id: 255, serial_number: {SERIAL}, encoder_interface: {INTERFACES[NEWCOMER]}, "
        "autostart: true, times: true}\n"
    )
    config = tmp_path / "eight.yaml"
    config.write_text("bus: {interface: socketcan, channel: vcan0}\nmodules:\n" + "".join(modules))
    started = process("run", str(config))
    wait_for(can_bus, pace, *(0x700 + node for node in NODES), 0x080 + BAD_TABLE)
    return started


def test_positions_a_twin_and_a_bus_off(eight: Process, can_bus: can.BusABC, pace: Pace) -> None:
    each_gives_its_own_positions(can_bus, pace)
    can_bus.send(frame(0x700 + NODES[0], b"\x05"))  # a twin
    assert next_frame(can_bus, pace, 0x080 + NODES[0]) == bytes.fromhex("5081112107000000")
    eight.wait_for(r"^canfb: node 33 \(21h\): another node on the bus uses this node-ID \(721h\)$")
    for error_class, line in ((0x040, "the CAN controller is bus-off"), (0x100, "is on the bus again")):
        can_bus.send(
            can.Message(arbitration_id=error_class, data=bytes(8), is_extended_id=False, is_error_frame=True)
        )
        eight.wait_for(line)
    for data in wait_for(can_bus, pace, *(0x080 + node for node in NODES)).values():
        assert data[:2] == b"\x40\x81"
    can_bus.send(can.Message(arbitration_id=0x700 + NODES[0], is_extended_id=False, is_remote_frame=True))
    assert next_frame(can_bus, pace, 0x700 + NODES[0]) == b"\x7f", "guarding: Pre-operational"
    assert eight.stop() == 0
    refused = [line for line in eight.lines if "refused" in line]
    assert refused
    assert all(
        line.startswith(f"canfb: node {BAD_TABLE}: stored manufacturer parameters") for line in refused
    )
    summaries = re.findall(r"^node (\d+): (\d+) samples; ", "\n".join(eight.lines), re.M)
    assert [one for one in summaries if one[0] != str(NEWCOMER)] == [
        (str(node), str(CYCLES)) for node in NODES
    ]


def each_gives_its_own_positions(bus: can.BusABC, pace: Pace) -> None:
    for text in ("40", "4101", "4201", f"43{SERIAL:02X}", f"11{NEWCOMER:02X}", "0400"):
        bus.send(lss(text))
    wait_for_boot_up(bus, pace, NEWCOMER)
    tolerate_late_syncs(bus, pace, *INTERFACES)
    positions: dict[int, list[int]] = {node: [] for node in INTERFACES}
    timer = Timer(pace)
    for number in range(CYCLES):
        timer.wait()
        bus.send(SYNC)
        ticks = round(number * timer.period_s * 1e7)
        for node, interface in INTERFACES.items():
            bus.send(frame(0x180 + interface, struct.pack("<hhI", 50 * (node - 30), 1200, ticks)))
        for can_id, data in wait_for(bus, pace, *(0x180 + node for node in INTERFACES)).items():
            position, status = struct.unpack("<IH", data[:6])
            assert status & StatusBit.VALID
            positions[can_id - 0x180].append(position)
    assert all(len(set(seen)) == 1 for seen in positions.values()), "they stand still"
    assert len({seen[0] for seen in positions.values()}) == len(INTERFACES), "each where it is"
