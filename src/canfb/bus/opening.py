"""Opens a bus from the options of python-can; a failure is one clear line."""

from __future__ import annotations

import ast
import contextlib
import errno
import ipaddress
import re
import sys
import zlib
from collections.abc import Callable, Iterator, Mapping
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import can
from can.interfaces import BACKENDS
from can.interfaces.udp_multicast import UdpMulticastBus

from canfb.bus.frame_bus import MULTICAST as MULTICAST, FrameBus, PythonCanBus, enlarge_queue_of
from canfb.errors import BusError, ConfigError, meant, reason

# The only key in ``bus:`` that is not an option of python-can: true: use python-can for SocketCAN, too.
FORCE_PYTHON_CAN = "python_can"

# Options that the raw socket supports, or that do not affect it: the interface determines the bit rate.
_RAW_WORDS = frozenset({"interface", "channel", "bitrate", "receive_own_messages", FORCE_PYTHON_CAN})

UNNAMED = '"None"'  # in python-can's message if no interface is named
# python-can uses one port for all groups, and on Linux a socket receives every group on its port that any
# program of the computer has joined: all groups would be one bus. So each group gets its own port, above the
# ephemeral ports of Linux.
_FIRST_GROUP_PORT, _GROUP_PORTS = 61440, 4096
_GROUPS_OF_PYTHON_CAN = frozenset(
    ipaddress.ip_address(group).packed
    for group in (UdpMulticastBus.DEFAULT_GROUP_IPv4, UdpMulticastBus.DEFAULT_GROUP_IPv6)
)

_Received = tuple[can.Message | None, bool]  # a message of python-can, and whether it is filtered already

_MISSING = re.compile(r"missing \d+ required [a-z -]+ arguments?: (.*)")


def open_bus(options: dict[str, Any]) -> can.BusABC:
    """A python-can bus by these options, environment and files of python-can; BusError if impossible."""
    words = {key: value for key, value in options.items() if key != FORCE_PYTHON_CAN}
    if words.get("interface") in (None, MULTICAST):
        full = _completed(options)
        if full.get("interface") == MULTICAST and full.get("port") is None:
            port = group_port(full.get("channel"))
            words |= {} if port is None else {"port": port}
    with _failing_in_one_line(options):
        bus = can.Bus(**words)
    if isinstance(bus, UdpMulticastBus):
        bus._recv_internal = partial(_frame_of, bus._recv_internal)  # type: ignore[method-assign]
    if bus.channel_info == can.BusABC.channel_info:  # some interfaces do not set it
        bus.channel_info = f"{type(bus).__name__} {getattr(bus, 'channel', '')}"
    enlarge_queue_of(bus)
    return bus


def _frame_of(receive: Callable[[float | None], _Received], timeout: float | None) -> _Received:
    """Receive; ignore a datagram that is not a frame."""
    try:
        return receive(timeout)
    except can.CanOperationError as error:
        if error.__cause__ is None or isinstance(error.__cause__, OSError):
            raise
        return None, False


def _completed(options: dict[str, Any]) -> dict[str, Any]:
    words = {key: value for key, value in options.items() if value is not None and key != FORCE_PYTHON_CAN}
    try:
        return dict(can.util.load_config(config=words))
    except Exception:  # python-can reports it better when it opens the bus
        return {}


def group_port(group: object) -> int | None:
    """The UDP port of a multicast group: 61440 + CRC-32 of its address modulo 4096.

    None for the two groups of python-can (43113), and if ``group`` is not an address.
    """
    try:
        address = ipaddress.ip_address(str(group).partition("%")[0])
    except ValueError:
        return None
    if not address.is_multicast or address.packed in _GROUPS_OF_PYTHON_CAN:
        return None
    return _FIRST_GROUP_PORT + zlib.crc32(address.packed) % _GROUP_PORTS


def open_device_bus(options: dict[str, Any]) -> FrameBus:
    """A bus for devices: a raw socket for SocketCAN, otherwise or with ``python_can: true`` python-can."""
    check_device_bus(options)
    channel = _raw_channel(options)
    if channel is None:
        return PythonCanBus(open_bus(options))
    from canfb.bus.raw_can_bus import RawCanBus  # imported here because it needs Linux

    with _failing_in_one_line({"interface": "socketcan", **options}):
        return RawCanBus.open(channel)


def _raw_channel(options: dict[str, Any]) -> str | None:
    words = {key: value for key, value in options.items() if value is not None}
    if not sys.platform.startswith("linux") or words.get(FORCE_PYTHON_CAN) or words.keys() - _RAW_WORDS:
        return None
    if "interface" not in words or "channel" not in words:
        words = _completed(options)
        if words.keys() - _RAW_WORDS - {"ignore_config"}:
            return None
    channel = words.get("channel")
    named = words.get("interface") == "socketcan" and isinstance(channel, str) and channel
    return str(channel) if named else None


@contextlib.contextmanager
def _failing_in_one_line(options: dict[str, Any]) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # the exceptions of drivers have no common base class
        raise BusError(f"cannot open the bus {describe(options)}: {_advice(options, error)}") from error


def open_sync_bus(options: dict[str, Any], *, receives_own: bool) -> can.BusABC:
    """A bus for a program that counts SYNCs; ``receives_own``: it produces them itself."""
    if receives_own:
        with contextlib.suppress(BusError):  # udp_multicast always receives its own, and lacks the option
            return open_bus(options | {"receive_own_messages": True})
    return open_bus(options)


def check_device_bus(options: dict[str, Any]) -> None:
    """ConfigError if a device would receive its own frames, or for a bad ``python_can``."""
    forced = options.get(FORCE_PYTHON_CAN)
    if forced is not None and not isinstance(forced, bool):
        raise ConfigError(f"{FORCE_PYTHON_CAN} in bus must be true or false, not {forced!r}")
    if options.get("receive_own_messages"):
        raise ConfigError("receive_own_messages: omit it; a device must not receive its own frames")


def describe(options: dict[str, Any]) -> str:
    """The bus in a few words, for messages."""
    words = [str(options[key]) for key in ("interface", "channel") if options.get(key) is not None]
    if options.get("interface") == MULTICAST and options.get("port") is None:
        port = group_port(options.get("channel"))
        words += [] if port is None else [f"port {port}"]
    return " ".join(words) or "of python-can's configuration"


def _advice(options: dict[str, Any], error: Exception) -> str:
    interface, text = options.get("interface"), reason(error)
    if interface is None and UNNAMED in text:
        return (
            "no interface is named: -i socketcan -c can0, a configuration (--config feedback.yaml), or "
            "CAN_INTERFACE and CAN_CHANNEL, or python-can's can.conf; see docs/wiring.md"
        )
    number = error.errno if isinstance(error, OSError) and interface == "socketcan" else None
    if number == errno.EAFNOSUPPORT:
        return f"this system has no SocketCAN ({text}); see docs/vcan.md"
    if number in (errno.ENODEV, errno.ENXIO):
        return f"{text}; `ip link` lists the interfaces, docs/vcan.md explains how to create one"
    cause = error.__cause__ or error.__context__
    if interface == MULTICAST and isinstance(cause, OSError) and cause.errno == errno.ENODEV:
        return (
            "this computer has no route for multicast (`ip route add 224.0.0.0/4 dev lo`); see docs/vcan.md"
        )
    if isinstance(error, TypeError) and (missing := _MISSING.search(text)):
        return f"the bus also needs {missing[1]}; see python-can's page on {interface}"
    if not isinstance(interface, str) or interface not in can.VALID_INTERFACES:
        return text
    drivers = (NameError, ImportError, can.CanInterfaceNotImplementedError)
    if isinstance(error, drivers) or (isinstance(error, OSError) and "library" in text):
        why = "" if isinstance(error, NameError) else f" ({text})"
        return f"the driver of {interface} is missing{why}; install it, see python-can's page on {interface}"
    return text


# Options that python-can evaluates for all interfaces.
_GENERAL = frozenset({
    FORCE_PYTHON_CAN, "interface", "channel", "bitrate", "fd", "data_bitrate", "timing",
    "receive_own_messages", "can_filters", "ignore_config", "config_context", "state", "port", "f_clock",
    "f_clock_mhz", "brp", "tseg1", "tseg2", "sjw", "nof_samples", "nom_brp", "nom_tseg1", "nom_tseg2",
    "nom_sjw", "data_brp", "data_tseg1", "data_tseg2", "data_sjw",
})  # fmt: skip


def check_words(words: Mapping[str, Any]) -> None:
    """ConfigError for an unknown interface or key, or a bad bit rate."""
    interface = words.get("interface")
    if interface is not None and (not isinstance(interface, str) or interface not in can.VALID_INTERFACES):
        known = sorted(can.VALID_INTERFACES)
        raise ConfigError(f"unknown interface {interface!r} in bus; {meant(str(interface), known)}")
    for key in ("bitrate", "data_bitrate"):
        value = words.get(key)
        if value is not None and (not isinstance(value, int) or isinstance(value, bool) or value < 10_000):
            raise ConfigError(f"{key} in bus must be bits per second, such as 1000000, not {value!r}")
    if interface is None:
        return
    named, mentioned = _words_of(str(interface))
    for key in words:
        if mentioned and key not in _GENERAL | named | mentioned:
            known = sorted({"interface", "channel", "bitrate", *named})
            raise ConfigError(f"unknown key {key!r} in bus for {interface}; {meant(key, known)}")


@cache
def _words_of(interface: str) -> tuple[frozenset[str], frozenset[str]]:
    """The parameters of the classes of an interface, and all words in its source; none for a plug-in."""
    named, mentioned = set[str](), set[str]()
    module = BACKENDS[interface][0]
    spec = find_spec(module) if module.startswith("can.interfaces.") else None
    if spec is None or spec.origin is None:
        return frozenset(), frozenset()
    path = Path(spec.origin)
    for file in path.parent.glob("*.py" if path.name == "__init__.py" else path.name):
        for node in ast.walk(ast.parse(file.read_bytes())):
            if isinstance(node, ast.FunctionDef) and node.name == "__init__":
                named.update(arg.arg for arg in (*node.args.args[1:], *node.args.kwonlyargs))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                mentioned.add(node.value)
    return frozenset(named), frozenset(mentioned)
