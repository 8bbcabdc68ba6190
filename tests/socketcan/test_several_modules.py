"""Eight modules of one process on a real SocketCAN; an interface that goes down and comes back."""

from __future__ import annotations

import os
import re
import struct
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import pytest
from network import SYNC

from canfb.signal.supervision import StatusBit

NODES = tuple(range(33, 40))
NEWCOMER, SERIAL = 40, 7
INTERFACES = {node: node + 40 for node in (*NODES, NEWCOMER)}
BAD_TABLE = 35
CYCLES = 10
LIMIT_S = 30.0


def message(can_id: int, data: bytes = b"", *, rtr: bool = False) -> can.Message:
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False, is_remote_frame=rtr)


def lss(text: str) -> can.Message:
    return message(0x7E5, bytes.fromhex(text).ljust(8, b"\0"))


def frames(bus: can.BusABC) -> Iterator[can.Message]:
    """What comes until the time is up."""
    deadline = time.monotonic() + LIMIT_S
    while (left := deadline - time.monotonic()) > 0:
        heard = bus.recv(left)
        if heard is not None:
            yield heard
    pytest.fail(f"not what was waited for within {LIMIT_S:g} s")


def wait_for(bus: can.BusABC, *can_ids: int) -> dict[int, bytes]:
    """The next frame with each of these CAN-IDs."""
    found: dict[int, bytes] = {}
    for heard in frames(bus):
        if heard.arbitration_id in can_ids:
            found.setdefault(heard.arbitration_id, bytes(heard.data))
        if len(found) == len(can_ids):
            return found
    raise AssertionError


@pytest.fixture
def eight(process: Callable[..., Any], tmp_path: Path, can_bus: can.BusABC) -> Any:
    """The process; it has started when it says so. Each module has stored nothing, one has a bad table."""
    (tmp_path / str(BAD_TABLE)).mkdir()
    (tmp_path / str(BAD_TABLE) / "manufacturer.bin").write_bytes(b"no table at all")
    modules = [
        f"- {{node_id: {node}, encoder_interface: {INTERFACES[node]}, autostart: true, "
        f"state_dir: {tmp_path}/{node}}}\n"
        for node in NODES
    ]
    modules.append(
        f"- {{node_id: 255, serial_number: {SERIAL}, encoder_interface: {INTERFACES[NEWCOMER]}, "
        "autostart: true}\n"
    )
    config = tmp_path / "eight.yaml"
    config.write_text("bus: {interface: socketcan, channel: vcan0}\nmodules:\n" + "".join(modules))
    started = process("run", str(config))
    wait_for(can_bus, *(0x700 + node for node in NODES), 0x080 + BAD_TABLE)
    return started


def test_each_gives_its_own_positions_and_a_twin_is_noticed(eight: Any, can_bus: can.BusABC) -> None:
    for text in ("40", "4101", "4201", f"43{SERIAL:02X}", f"11{NEWCOMER:02X}", "0400"):
        can_bus.send(lss(text))
    wait_for(can_bus, 0x700 + NEWCOMER)
    positions: dict[int, list[int]] = {node: [] for node in INTERFACES}
    for _ in range(CYCLES):
        can_bus.send(SYNC)
        for node, interface in INTERFACES.items():
            can_bus.send(message(0x180 + interface, struct.pack("<hh", 50 * (node - 30), 1200)))
        for can_id, data in wait_for(can_bus, *(0x180 + node for node in INTERFACES)).items():
            position, status = struct.unpack("<IH", data[:6])
            assert status & StatusBit.VALID
            positions[can_id - 0x180].append(position)
    assert all(len(set(seen)) == 1 for seen in positions.values()), "they stand still"
    assert len({seen[0] for seen in positions.values()}) == len(INTERFACES), "each where it is"
    can_bus.send(message(0x700 + NODES[0], b"\x05"))
    assert wait_for(can_bus, 0x080 + NODES[0]) == {0x080 + NODES[0]: bytes.fromhex("5081112107000000")}
    eight.wait_for(r"^canfb: node 33 \(21h\): another node sends with this node-ID \(721h\)$")
    assert eight.stop() == 0
    refused = [line for line in eight.lines if "refused" in line]
    assert len(refused) == 1
    assert refused[0].startswith(f"canfb: node {BAD_TABLE}: stored manufacturer parameters")
    summaries = [line for line in eight.lines if re.match(r"node \d+: 10 samples; ", line)]
    assert [line.split(":")[0] for line in summaries] == [f"node {node}" for node in INTERFACES]


def test_error_frames_tell_of_bus_off(eight: Any, can_bus: can.BusABC) -> None:
    for error_class, line in ((0x040, "the CAN controller is bus-off"), (0x100, "is on the bus again")):
        can_bus.send(
            can.Message(arbitration_id=error_class, data=bytes(8), is_extended_id=False, is_error_frame=True)
        )
        eight.wait_for(line)
    for data in wait_for(can_bus, *(0x080 + node for node in NODES)).values():
        assert data[:2] == b"\x40\x81"
    can_bus.send(message(0x700 + NODES[0], rtr=True))
    assert wait_for(can_bus, 0x700 + NODES[0])[0x700 + NODES[0]] == b"\x7f", "guarding: Pre-operational"
    assert eight.stop() == 0


def test_the_interface_goes_down_and_comes_back(
    eight: Any, can_bus: can.BusABC, open_bus: Callable[..., can.BusABC], can_channel: str
) -> None:
    if os.geteuid() != 0:
        pytest.skip("taking an interface down needs root")
    ip = ["ip", "link", "set", can_channel]
    subprocess.run([*ip, "down"], check=True)
    try:
        eight.wait_for("the bus fails: .*Network is down")
    finally:
        subprocess.run([*ip, "up"], check=True)
    bus = open_bus()
    told: dict[int, bytes] = {}
    deadline = time.monotonic() + LIMIT_S
    while len(told) < len(NODES) and time.monotonic() < deadline:
        bus.send(SYNC)  # a sign of life
        heard = bus.recv(0.2)
        if heard is not None and 0x080 < heard.arbitration_id < 0x100 and heard.data[:2] == b"\x40\x81":
            told[heard.arbitration_id - 0x080] = bytes(heard.data)
    assert sorted(told) == list(NODES)
    bus.send(message(0x600 + NODES[0], bytes.fromhex("4003100100000000")))
    assert wait_for(bus, 0x580 + NODES[0])[0x580 + NODES[0]][4:6] == b"\x40\x81"
    assert eight.stop() == 0
