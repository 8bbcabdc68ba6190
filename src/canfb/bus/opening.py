"""Opening a bus with python-can, with one clear line when it does not work."""

from __future__ import annotations

import contextlib
import errno
import re
from typing import Any

import can
from can.interfaces.udp_multicast import UdpMulticastBus

from canfb.errors import BusError, ConfigError, reason

# Buses of python-can that hand out what was sent through them, and say so (`is_rx` is false). SocketCAN and
# Kvaser say it of frames of other processes on the same computer, which are to be heard.
_ECHOING = frozenset({"GsUsbBus", "CantactBus", "VirtualBus"})

_MISSING = re.compile(r"missing \d+ required [a-z -]+ arguments?: (.*)")


def open_bus(options: dict[str, Any]) -> can.BusABC:
    """A python-can bus from its own words (interface, channel, bitrate, ...).

    What is not given comes from python-can's environment variables and configuration
    files. BusError when there is no such bus.
    """
    try:
        return can.Bus(**options)
    except Exception as error:  # what the drivers raise has no common root
        raise BusError(f"cannot open the bus {describe(options)}: {_advice(options, error)}") from error


def open_sync_bus(options: dict[str, Any], *, hears_itself: bool) -> can.BusABC:
    """:func:`open_bus`, for a program that counts by the SYNC.

    ``hears_itself``: for a program that produces the SYNC, the bus receives its own frames, if it can.
    """
    if hears_itself:
        with contextlib.suppress(BusError):  # udp_multicast always does, and has no such option
            return open_bus(options | {"receive_own_messages": True})
    return open_bus(options)


def check_device_bus(options: dict[str, Any]) -> None:
    """Refuse a bus on which a device would hear itself, and take that for a second node.

    ConfigError for ``receive_own_messages``.
    """
    if options.get("receive_own_messages"):
        raise ConfigError("receive_own_messages: omit it; a device must not receive its own frames")


def marks_own_frames(bus: can.BusABC) -> bool:
    """True where a message with ``is_rx`` false was sent through this very bus: gs_usb and the like."""
    return type(bus).__name__ in _ECHOING


def brings_own_frames_back(bus: can.BusABC) -> bool:
    """True for udp_multicast, whose sender hears itself; a CAN controller does not."""
    return isinstance(bus, UdpMulticastBus)


def describe(options: dict[str, Any]) -> str:
    """The bus in a few words, for messages."""
    words = [str(options[key]) for key in ("interface", "channel") if options.get(key) is not None]
    return " ".join(words) or "of python-can's configuration"


def _advice(options: dict[str, Any], error: Exception) -> str:
    """The reason, and what to do about it where the text of python-can does not say so."""
    interface, text = options.get("interface"), reason(error)
    number = error.errno if isinstance(error, OSError) and interface == "socketcan" else None
    if number == errno.EAFNOSUPPORT:
        return f"this system has no SocketCAN ({text}); see docs/vcan.md"
    if number in (errno.ENODEV, errno.ENXIO):
        return f"{text}; `ip link` lists the interfaces, docs/vcan.md explains how to create one"
    if isinstance(error, TypeError) and (missing := _MISSING.search(text)):
        return f"the bus also needs {missing[1]}; see python-can's page on {interface}"
    if not isinstance(interface, str) or interface not in can.VALID_INTERFACES:
        return text
    drivers = (NameError, ImportError, can.CanInterfaceNotImplementedError)
    if isinstance(error, drivers) or (isinstance(error, OSError) and "library" in text):
        why = "" if isinstance(error, NameError) else f" ({text})"
        return f"the driver of {interface} is missing{why}; install it, see python-can's page on {interface}"
    return text
