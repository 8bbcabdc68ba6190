"""Eight modules of one process on a real SocketCAN."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from pathlib import Path

import can
import pytest
from network import SYNC, Timer, frame, next_frame, tolerate_late_syncs, wait_for, wait_for_boot_up
from pace import Pace

from canfb.objects import StatusBit
from processes import Process

NODES = tuple(range(33, 40))
NEWCOMER, SERIAL = 40, 7
INTERFACES = {node: node + 40 for node in (*NODES, NEWCOMER)}
BAD_TABLE = 35
CYCLES = 10


def lss(text: str) -> can.Message:
    return frame(0x7E5, bytes.fromhex(text).ljust(8, b"\0"))


@pytest.fixture
def eight(process: Callable[..., Process], tmp_path: Path, can_bus: can.BusABC, pace: Pace) -> Process:
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
    a_twin_is_noticed(eight, can_bus, pace)
    error_frames_report_bus_off(eight, can_bus, pace)
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


def a_twin_is_noticed(eight: Process, bus: can.BusABC, pace: Pace) -> None:
    bus.send(frame(0x700 + NODES[0], b"\x05"))
    assert next_frame(bus, pace, 0x080 + NODES[0]) == bytes.fromhex("5081112107000000")
    eight.wait_for(r"^canfb: node 33 \(21h\): another node on the bus uses this node-ID \(721h\)$")


def error_frames_report_bus_off(eight: Process, bus: can.BusABC, pace: Pace) -> None:
    for error_class, line in ((0x040, "the CAN controller is bus-off"), (0x100, "is on the bus again")):
        bus.send(
            can.Message(arbitration_id=error_class, data=bytes(8), is_extended_id=False, is_error_frame=True)
        )
        eight.wait_for(line)
    for data in wait_for(bus, pace, *(0x080 + node for node in NODES)).values():
        assert data[:2] == b"\x40\x81"
    bus.send(can.Message(arbitration_id=0x700 + NODES[0], is_extended_id=False, is_remote_frame=True))
    assert next_frame(bus, pace, 0x700 + NODES[0]) == b"\x7f", "guarding: Pre-operational"
