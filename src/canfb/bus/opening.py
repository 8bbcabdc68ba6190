"""Opening a bus with python-can, with one clear line when it does not work."""

from __future__ import annotations

from typing import Any

import can
from can.interfaces.udp_multicast import UdpMulticastBus

from canfb.errors import BusError


def open_bus(options: dict[str, Any]) -> can.BusABC:
    """A python-can bus from its own words (interface, channel, bitrate, ...).

    What is not given comes from python-can's environment variables and configuration
    files. BusError when there is no such bus.
    """
    try:
        return can.Bus(**options)
    except Exception as error:  # what the drivers raise has no common root
        raise BusError(f"cannot open the bus {describe(options)}: {reason(error)}") from error


def brings_own_frames_back(bus: can.BusABC) -> bool:
    """True for udp_multicast, whose sender hears itself; a CAN controller does not."""
    return isinstance(bus, UdpMulticastBus)


def describe(options: dict[str, Any]) -> str:
    """The bus in a few words, for messages."""
    words = [str(options[key]) for key in ("interface", "channel") if options.get(key) is not None]
    return " ".join(words) or "of python-can's configuration"


def reason(error: Exception) -> str:
    """One line on what an error of python-can or of the system says."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    text = str(error).strip().splitlines()
    return text[0] if text else type(error).__name__
