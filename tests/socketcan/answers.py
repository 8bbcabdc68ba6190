"""Wait until all these nodes answer an SDO request: then they are on the bus. The answer is 1000h."""

from __future__ import annotations

import sys

import can

REQUEST = bytes.fromhex("4000100000000000")
AGAIN_S = 0.5


def main(channel: str, *nodes: str) -> None:
    """Ask each until it answers."""
    with can.Bus(interface="socketcan", channel=channel) as bus:
        for node in map(int, nodes):
            heard = False
            while not heard:
                bus.send(can.Message(arbitration_id=0x600 + node, data=REQUEST, is_extended_id=False))
                while not heard and (message := bus.recv(AGAIN_S)) is not None:
                    heard = message.arbitration_id == 0x580 + node


if __name__ == "__main__":
    main(*sys.argv[1:])
