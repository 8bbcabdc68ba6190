"""What the tests on a real bus share: a configuration, a SYNC, python canopen as master."""

from __future__ import annotations

import struct
import time
from pathlib import Path

import can
import canopen

from canfb.eds_files import eds_path

NODE_ID, INTERFACE_ID = 0x20, 0x10
POSITION_COB_ID, ADC_COB_ID = 0x180 + NODE_ID, 0x180 + INTERFACE_ID
SYNC = can.Message(arbitration_id=0x80, is_extended_id=False)


def write_config(folder: Path, text: str = "", simulation: str = "") -> str:
    """A configuration for vcan0 in ``folder``; ``text`` are more keys of the module."""
    path = folder / "feedback.yaml"
    path.write_text(
        "bus: {interface: socketcan, channel: vcan0}\n"
        f"modules:\n  - node_id: {NODE_ID}\n    encoder_interface: {INTERFACE_ID}\n{text}{simulation}"
    )
    return str(path)


def start_command(*nodes: int) -> list[can.Message]:
    """NMT start of each node."""
    return [can.Message(arbitration_id=0, data=[1, node], is_extended_id=False) for node in nodes]


def next_frame(bus: can.BusABC, can_id: int, within_s: float = 5.0) -> bytes | None:
    """Data of the next frame with this CAN-ID, None if there is none in time."""
    deadline = time.monotonic() + within_s
    while (left := deadline - time.monotonic()) > 0:
        message = bus.recv(left)
        if message is not None and message.arbitration_id == can_id:
            return bytes(message.data)
    return None


def position_fields(data: bytes) -> tuple[int, int, int]:
    """6004h, status word and residual of a position PDO."""
    position, status, residual = struct.unpack("<IHH", data)
    return position, status, residual


class Master:
    """python canopen's master with a RemoteNode for each of the two nodes."""

    def __init__(self, channel: str) -> None:
        self.network = canopen.Network()
        self.network.connect(interface="socketcan", channel=channel)
        self.module = self.network.add_node(NODE_ID, str(eds_path("canfb-module")))
        self.interface = self.network.add_node(INTERFACE_ID, str(eds_path("encoder-interface")))
        for node in (self.module, self.interface):
            node.sdo.RESPONSE_TIMEOUT = 5.0

    def close(self) -> None:
        """Disconnect from the bus."""
        self.network.disconnect()
