"""The help of the bus options: that of python-can takes half a page in each command."""

from __future__ import annotations

import argparse

BUS_METAVARS = {"interface": "NAME", "bitrate": "BIT/S", "data_bitrate": "BIT/S", "channel": "CHANNEL"}
BUS_HELP = {
    "channel": "its channel: can0, vcan0, PCAN_USBBUS1; default: CAN_CHANNEL or can.conf",
    "interface": "of python-can: socketcan, pcan, kvaser, udp_multicast; default: CAN_INTERFACE or can.conf",
    "bitrate": "bit rate; default: CAN_BITRATE or can.conf. SocketCAN has its own, set by ip link",
    "fd": "open the interface for CAN FD (CANopen frames are classic ones)",
    "data_bitrate": "bit rate of the data phase of CAN FD",
    "timing": "bit timing, such as f_clock=8_000_000 tseg1=5 tseg2=2 sjw=2 brp=2 nof_samples=1",
    "bus_kwargs": "further keys of the interface, such as serial=1234",
}
"""In place of the texts of python-can, which take half a page."""


def shorten_bus_help(parser: argparse.ArgumentParser) -> None:
    """Give the bus options of python-can, which ``parser`` has, our texts."""
    for action in parser._actions:
        if action.dest in BUS_HELP and action.help is not argparse.SUPPRESS:
            action.help = BUS_HELP[action.dest]
            action.metavar = BUS_METAVARS.get(action.dest, action.metavar)
