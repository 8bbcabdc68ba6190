"""Opening a bus: python-can's own words in, a bus or one clear line out."""

import contextlib
import errno
import os
import re
import struct
import sys
from collections.abc import Callable, Iterator
from typing import Any
from unittest.mock import Mock

import can
import pytest
from can.interfaces.udp_multicast import UdpMulticastBus
from can.interfaces.virtual import VirtualBus

from canfb.bus.opening import describe, group_port, open_bus, open_device_bus
from canfb.bus.raw_can_bus import RawCanBus
from canfb.errors import BusError, ConfigError
from documentation import page
from folding import each


@pytest.fixture(autouse=True)
def no_configuration_of_the_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    for word in ("CAN_INTERFACE", "CAN_CHANNEL", "CAN_BITRATE", "CAN_CONFIG"):
        monkeypatch.delenv(word, raising=False)
    monkeypatch.setattr(can.util, "load_file_config", lambda *arguments, **words: {})


NOWHERE = {"interface": "socketcan", "channel": "nothing77"}
WRONG: list[dict[str, Any]] = [
    {},
    {"interface": "there is none such", "channel": "x"},
    {"interface": ["a", "list"]},
    {"interface": 7},
    NOWHERE,
    {"interface": "udp_multicast", "channel": "not an address"},
    {"interface": "udp_multicast", "channel": "127.0.0.1"},
    {"interface": "udp_multicast", "channel": {"a": 1}},
    {"interface": "slcan", "channel": "/nowhere/tty"},
]


@each("opening, options", [*((open_bus, options) for options in WRONG), (open_device_bus, NOWHERE)])
def test_a_missing_bus_gets_one_line(opening: Callable[..., object], options: dict[str, Any]) -> None:
    with pytest.raises(BusError) as caught:
        opening(options)
    assert re.fullmatch(re.escape(f"cannot open the bus {describe(options)}: ") + ".+", str(caught.value))
    assert caught.value.__cause__ is not None
    assert options is not NOWHERE or "docs/vcan.md" in str(caught.value)


def because(error: Exception, cause: Exception) -> Exception:
    error.__cause__ = cause
    return error


@pytest.mark.parametrize(("words", "error", "advice"), [
    ({"interface": "socketcan", "channel": "vcan0"}, OSError(97, "Address family not supported by protocol"),
     "this system has no SocketCAN (Address family not supported by protocol); see docs/vcan.md"),
    ({"interface": "socketcan", "channel": "vcan7"}, OSError(19, "No such device"),
     "No such device; `ip link` lists the interfaces, docs/vcan.md explains how to create one"),
    ({"interface": "kvaser", "channel": 0}, NameError("name 'canGetNumberOfChannels' is not defined"),
     "the driver of kvaser is missing; install it, see python-can's page on kvaser"),
    ({"interface": "pcan"}, OSError("pcanbasic library not found."),
     "the driver of pcan is missing (pcanbasic library not found.); install it, see python-can's page "
     "on pcan"),
    ({"interface": "slcan"}, can.CanInterfaceNotImplementedError("The serial module is not installed"),
     "the driver of slcan is missing (The serial module is not installed); install it, see python-can's "
     "page on slcan"),
    ({"interface": "socketcand", "channel": "can0"},
     TypeError("SocketCanDaemonBus.__init__() missing 2 required positional arguments: 'host' and 'port'"),
     "the bus also needs 'host' and 'port'; see python-can's page on socketcand"),
    ({"interface": "slcan"}, OSError(13, "Permission denied"), "Permission denied"),
    ({"channel": "x"}, struct.error("not a number"), "not a number"),
    ({"channel": "x"}, AttributeError("what?"), "what?"),
    ({"channel": "x"}, ValueError("one\ntwo"), "one"),
    ({"channel": "x"}, RuntimeError(), "RuntimeError"),
    ({"interface": "udp_multicast", "channel": "239.74.163.3"},
     because(can.CanInitializationError("could not create socket"), OSError(errno.ENODEV, "No such device")),
     "this computer has no route for multicast (`ip route add 224.0.0.0/4 dev lo`); see docs/vcan.md"),
])  # fmt: skip
def test_what_python_can_says_becomes_advice(
    monkeypatch: pytest.MonkeyPatch, words: dict[str, Any], error: Exception, advice: str
) -> None:
    def failing(**options: object) -> None:
        raise error

    monkeypatch.setattr(can, "Bus", failing)
    with pytest.raises(BusError) as caught:
        open_bus(words)
    assert str(caught.value) == f"cannot open the bus {describe(words)}: {advice}"


# Other programs compute it from the documentation: 61440 + CRC-32 of the packed address modulo 4096.
PORTS = {"239.74.163.3": 63732, "239.255.0.1": 64009, "ff15::1": 62416, "FF15:0::0:1": 62416}


def test_a_multicast_group_has_a_port_of_its_own() -> None:
    """Not those of python-can, and what is no group."""
    assert {group: group_port(group) for group in PORTS} == PORTS
    defaults = UdpMulticastBus.DEFAULT_GROUP_IPv4, UdpMulticastBus.DEFAULT_GROUP_IPv6
    assert {group_port(group) for group in (*defaults, "127.0.0.1", "can0", None, 7)} == {None}
    assert len({group_port(f"239.74.163.{last}") for last in range(3, 256)}) == 253
    assert all(61440 <= (group_port(f"239.1.{last}.9") or 0) < 65536 for last in range(256))


def test_the_page_has_the_port_of_its_example() -> None:
    text = page("vcan")
    group, port = "239.74.163.3", PORTS["239.74.163.3"]
    assert f"| {group} | {port} |" in text
    assert f'channel="{group}", port={port})' in text
    assert "61440 + CRC-32 of its address (the 4 or 16 bytes) modulo 4096" in text


GROUP = "239.74.163.3"
MULTICAST = {"interface": "udp_multicast"}


# Words, those in a file of python-can, and the port that is set.
@pytest.mark.parametrize(("words", "file", "port"), [
    ({**MULTICAST, "channel": GROUP}, {}, PORTS[GROUP]),
    ({**MULTICAST, "channel": GROUP, "port": 5000}, {}, 5000),
    ({"channel": GROUP}, MULTICAST, PORTS[GROUP]),
    ({**MULTICAST, "channel": GROUP}, {"port": "6000"}, None),  # python-can reads it from there
    ({**MULTICAST, "channel": "239.74.163.2"}, {}, None),
    (MULTICAST, {}, None),
    ({"interface": "virtual", "channel": GROUP}, {}, None),
], ids=str)  # fmt: skip
def test_the_port_that_a_bus_is_opened_with(
    monkeypatch: pytest.MonkeyPatch,
    opened: list[Any],
    words: dict[str, Any],
    file: dict[str, Any],
    port: int | None,
) -> None:
    monkeypatch.setattr(can.util, "load_file_config", lambda *arguments, **words: dict(file))
    assert open_bus(words).channel_info == "Virtual bus channel opened", "its own"
    assert opened[0].get("port") == port


@each("words, text", [
    ({"interface": "socketcan", "channel": "can0", "bitrate": 1}, "socketcan can0"),
    ({"channel": "can0"}, "can0"),
    ({}, "of python-can's configuration"),
    ({"interface": None}, "of python-can's configuration"),
    ({"interface": "udp_multicast", "channel": GROUP}, f"udp_multicast {GROUP} port {PORTS[GROUP]}"),
    ({"interface": "udp_multicast", "channel": GROUP, "port": 5000}, f"udp_multicast {GROUP}"),
    ({"interface": "udp_multicast", "channel": "239.74.163.2"}, "udp_multicast 239.74.163.2"),
])  # fmt: skip
def test_a_bus_in_a_few_words(words: dict[str, Any], text: str) -> None:
    assert describe(words) == text


def test_two_groups_are_two_buses_of_frames(
    multicast_bus: can.BusABC, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With python-can alone all three would hear the frame, on Linux, and a datagram that is none fails."""
    words = {"interface": "udp_multicast", "hop_limit": 0}
    # Groups of this process: tests beside this one have others.
    third, fourth = divmod(os.getpid() % 65000, 254)
    groups = [f"239.255.{third % 250}.{fourth + 1}", f"239.255.{third % 250 + 1}.{fourth + 1}"]
    with (
        open_bus(words | {"channel": groups[0]}) as one,
        open_bus(words | {"channel": groups[0]}) as same,
        open_bus(words | {"channel": groups[1]}) as other,
    ):
        for data in (b"", b"no frame", b"\x81\xa1x\x01", bytes(2000)):
            one._multicast.send(data)  # type: ignore[attr-defined]
        one.send(can.Message(arbitration_id=0x123, is_extended_id=False))
        heard = same.recv(5.0)
        assert heard is not None
        assert heard.arbitration_id == 0x123
        assert other.recv(0.0) is None
        failure = because(can.CanOperationError("Failed to wait"), OSError(errno.ENETDOWN, "down"))
        monkeypatch.setattr(same._multicast, "recv", Mock(side_effect=failure))  # type: ignore[attr-defined]
        with pytest.raises(can.CanOperationError, match="Failed to wait"):
            same.recv(0.0)


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Any]]:
    calls: list[Any] = []
    with contextlib.ExitStack() as buses:

        def python_can(**words: object) -> can.BusABC:
            calls.append(words)
            return buses.enter_context(VirtualBus("opened"))

        monkeypatch.setattr(RawCanBus, "open", calls.append)
        monkeypatch.setattr(can, "Bus", python_can)
        yield calls


CAN0 = {"interface": "socketcan", "channel": "can0"}
RAW: list[dict[str, Any]] = [
    CAN0,
    {**CAN0, "bitrate": 500_000},
    {**CAN0, "receive_own_messages": False, "python_can": False},
    {**CAN0, "fd": None},
]
NOT_RAW: list[dict[str, Any]] = [
    {**CAN0, "python_can": True},
    {**CAN0, "fd": True},
    {**CAN0, "local_loopback": False},
    {**CAN0, "ignore_rx_error_frames": True},
    {**CAN0, "channel": ""},
    {**CAN0, "channel": 0},
    {**CAN0, "interface": "kvaser"},
]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="SocketCAN is of Linux")
def test_socketcan_has_a_raw_socket_and_python_can_opens_what_is_more_than_that(
    opened: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    for words in (*RAW, *NOT_RAW):
        open_device_bus(words)
    others = [{key: value for key, value in words.items() if key != "python_can"} for words in NOT_RAW]
    assert opened == ["can0"] * len(RAW) + others
    for interface, found in (("socketcan", "can5"), ("pcan", {})):
        monkeypatch.setenv("CAN_INTERFACE", interface)
        monkeypatch.setenv("CAN_CHANNEL", "can5")
        open_device_bus({})
        assert opened[-1] == found


@each("more, match", [
    *(({"python_can": value}, "python_can in bus must be true or false, not") for value in ("yes", 1, 0)),
    ({"receive_own_messages": True}, "receive_own_messages: omit it"),
])  # fmt: skip
def test_words_that_no_device_can_have(more: dict[str, Any], match: str) -> None:
    with pytest.raises(ConfigError, match=match):
        open_device_bus(CAN0 | more)
