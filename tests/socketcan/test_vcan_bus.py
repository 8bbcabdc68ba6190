"""The interface itself, and the fixtures: python-can and can-utils see each other's frames."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

import can
import pytest

if TYPE_CHECKING:
    from conftest import Process


@pytest.mark.usefixtures("can_utils")
def test_python_can_sees_what_cansend_sends(can_bus: can.BusABC, can_channel: str) -> None:
    subprocess.run(["cansend", can_channel, "1A0#0102030405060708"], check=True)
    message = can_bus.recv(timeout=10.0)
    assert message is not None
    assert (message.arbitration_id, message.is_extended_id, message.is_remote_frame) == (0x1A0, False, False)
    assert message.data == bytes([1, 2, 3, 4, 5, 6, 7, 8])


@pytest.mark.usefixtures("can_utils")
def test_remote_frames_pass(can_bus: can.BusABC, can_channel: str) -> None:
    subprocess.run(["cansend", can_channel, "720#R1"], check=True)
    message = can_bus.recv(timeout=10.0)
    assert message is not None
    assert (message.arbitration_id, message.is_remote_frame, message.dlc) == (0x720, True, 1)


@pytest.mark.usefixtures("can_utils")
def test_candump_sees_what_python_can_sends(
    can_bus: can.BusABC, can_channel: str, command: Callable[..., Process]
) -> None:
    candump = command("candump", "-L", can_channel)
    frame = can.Message(arbitration_id=0x123, data=b"\xca\xfe", is_extended_id=False)
    for _ in range(100):  # candump does not say when it has begun to listen
        can_bus.send(frame)
        if line := candump.find("123#CAFE", within_s=0.1):
            break
    else:
        pytest.fail(str(candump))
    assert can_channel in line


def test_buses_do_not_hear_themselves(open_bus: Callable[..., can.BusABC]) -> None:
    one, other = open_bus(), open_bus()
    one.send(can.Message(arbitration_id=0x80, is_extended_id=False))
    heard = other.recv(timeout=10.0)
    assert heard is not None
    assert heard.arbitration_id == 0x80
    assert one.recv(timeout=0.0) is None


def test_a_command_that_ends_by_itself_gives_lines_and_status(command: Callable[..., Process]) -> None:
    script = "import sys; print('one'); print('two', file=sys.stderr); sys.stdout.write('three'); sys.exit(3)"
    started = command(sys.executable, "-c", script)
    assert started.wait_for("^t") == "two"
    assert started.wait() == 3
    assert started.lines == ["one", "two", "three"]


def test_a_command_that_runs_on_is_ended_with_sigterm(command: Callable[..., Process]) -> None:
    script = (
        "import signal, sys\n"
        "signal.signal(signal.SIGTERM, lambda *_: sys.exit('bye'))\n"
        "print('ready')\n"
        "signal.pause()\n"
    )
    started = command(sys.executable, "-c", script)
    started.wait_for("ready")
    assert started.stop() == 1
    assert started.lines == ["ready", "bye"]


def test_a_process_left_behind_is_found(command: Callable[..., Process]) -> None:
    started = command("sh", "-c", "sleep 1000 >/dev/null 2>&1 & echo ready")
    started.wait_for("ready")
    with pytest.raises(pytest.fail.Exception, match="has ended, a process that it started has not"):
        started.stop()


def test_a_line_that_does_not_come_fails_and_shows_what_was_said(command: Callable[..., Process]) -> None:
    started = command("sh", "-c", "echo something; exec sleep 1000")
    started.wait_for("something")
    with pytest.raises(pytest.fail.Exception, match="something"):
        started.wait_for("else", within_s=0.0)
    started.send(signal.SIGKILL)
    assert started.wait() == -signal.SIGKILL
