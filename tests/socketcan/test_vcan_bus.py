"""The interface itself: python-can and can-utils see each other's frames."""

from __future__ import annotations

import subprocess
from collections.abc import Callable

import can
import pytest
from network import frame, frames
from pace import Pace

from processes import Process


@pytest.mark.usefixtures("can_utils")
def test_python_can_sees_what_cansend_sends(can_bus: can.BusABC, can_channel: str, pace: Pace) -> None:
    subprocess.run(["cansend", can_channel, "1A0#0102030405060708"], check=True)
    subprocess.run(["cansend", can_channel, "720#R1"], check=True)
    (data, remote) = (next(frames(can_bus, pace, "a frame of cansend")) for _ in range(2))
    assert (data.arbitration_id, data.is_extended_id, data.is_remote_frame) == (0x1A0, False, False)
    assert data.data == bytes([1, 2, 3, 4, 5, 6, 7, 8])
    assert (remote.arbitration_id, remote.is_remote_frame, remote.dlc) == (0x720, True, 1)


@pytest.mark.usefixtures("can_utils")
def test_candump_sees_what_python_can_sends(
    can_bus: can.BusABC, can_channel: str, command: Callable[..., Process]
) -> None:
    candump = command("candump", "-L", can_channel)
    line = None
    while line is None:  # candump does not say when it has begun to listen
        assert not candump.has_ended(), str(candump)
        can_bus.send(frame(0x123, b"\xca\xfe"))
        line = candump.find("123#CAFE", 0.1)
    assert can_channel in line


def test_buses_do_not_hear_themselves(open_bus: Callable[..., can.BusABC], pace: Pace) -> None:
    one, other = open_bus(), open_bus()
    one.send(frame(0x80))
    assert next(frames(other, pace, "080h")).arbitration_id == 0x80
    assert one.recv(timeout=0.0) is None
