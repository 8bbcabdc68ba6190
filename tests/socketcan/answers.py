"""Wait until all these nodes answer an SDO request: then they are on the bus. The answer is 1000h."""

from __future__ import annotations

import sys

import can

REQUEST = bytes.fromhex("4000100000000000")
AGAIN_S = 0.5


def main(channel: str, *nodes: str) -> None:
    """Ask each until it answers."""
    for node in map(int, nodes):
        request = can.Message(arbitration_id=0x600 + node, data=REQUEST, is_extended_id=False)
        answers = [{"can_id": 0x580 + node, "can_mask": 0x7FF}]
        with can.Bus(interface="socketcan", channel=channel, can_filters=answers) as bus:
            heard = None
            while heard is None:
                bus.send(request)
                heard = bus.recv(AGAIN_S)


if __name__ == "__main__":
    main(*sys.argv[1:])
