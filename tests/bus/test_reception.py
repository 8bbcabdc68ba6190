"""Receiving that outlasts its interface: which failures are waited for, and what is said."""

import errno
import socket
from pathlib import Path
from typing import Any

import can
import pytest
from can.interfaces.socketcan import SocketcanBus

from canfb.bus.frame_bus import NamedInterface, PythonCanBus, Reception, enlarge_queue_of
from canfb.bus.shared_bus import SharedBus
from canfb.errors import BusError
from canfb.monitoring.watching import MessageReader, classic
from fake_bus import FakeBus, FakeClock, message

CHANNEL = "can7"
GONE = OSError(errno.ENODEV, "No such device")
FAILS, WORKS = "the bus fails: No such device", "the bus works again"


class KernelSocket:
    """A raw CAN socket, which the kernel unbinds when its interface is removed."""

    def __init__(self) -> None:
        self.bound = CHANNEL
        self.there = True

    family = getattr(socket, "AF_CAN", None)

    def getsockname(self) -> tuple[str]:
        return (self.bound,)

    def bind(self, address: tuple[str]) -> None:
        if not self.there:
            raise GONE
        self.bound = address[0]


class RemovableBus(SocketcanBus):
    """python-can's bus with a plan; it hears nothing while it is not bound, or has no filters."""

    def __init__(self, clock: FakeClock, plan: list[tuple[float, Any]]) -> None:
        self.socket: Any = KernelSocket()
        self.channel, self._planned = CHANNEL, FakeBus(clock, plan)
        self.filtered: list[Any] = []
        can.BusABC.__init__(self, CHANNEL)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        heard = self._planned.recv(timeout)
        if isinstance(heard, str):
            self.socket.there = heard == "made"
            self.socket.bound = ""
            self.filtered.clear()
            return None
        return heard if self.socket.bound and self.filtered else None

    def _apply_filters(self, filters: Any) -> None:
        self.filtered.append(filters)

    def shutdown(self) -> None:
        """Nothing is open."""
        self._is_shutdown = True


def received(bus: Any, clock: FakeClock, seconds: float, **options: Any) -> tuple[list[int], list[str]]:
    """What came within so many seconds, and what was said."""
    said: list[str] = []
    reception = Reception(bus, said.append, clock, clock.sleep, **options)
    came = []
    end = clock.now + seconds
    while clock.now < end:
        heard = reception.receive(0.1)
        if heard is not None:
            came.append(heard.arbitration_id)
    return came, said


@pytest.mark.parametrize("error", [[(0.5, GONE)], []])
def test_an_interface_that_is_made_again_is_bound_again(error: list[tuple[float, Any]]) -> None:
    """The kernel need not say that it was removed: another thread that sends may have had the error."""
    clock = FakeClock()
    plan = [(0.1, message(1)), *error, (0.6, "removed"), (5.0, "made"), (6.0, message(2)), (7.5, message(3))]
    bus = RemovableBus(clock, plan)
    came, said = received(bus, clock, 10.0)
    assert came == [1, 2, 3]
    assert said == [FAILS, WORKS]
    assert 10 < len(clock.slept) < 30, "it tries again, and does not spin"


def test_it_is_found_beneath_a_bus_that_is_shared() -> None:
    bus = RemovableBus(FakeClock(), [])
    bus.socket.bound = ""
    NamedInterface(SharedBus(bus)).bind()
    assert bus.socket.bound == CHANNEL


def test_so_does_a_bus_of_python_can_for_devices() -> None:
    clock = FakeClock()
    bus = PythonCanBus(RemovableBus(clock, [(0.0, "removed"), (0.1, "made"), (0.3, message(2))]))
    with pytest.raises(OSError, match="No such device"):
        bus.receive(0.1)
    assert bus.receive(0.1) is None
    assert bus.receive(0.2) == (2, b"", pytest.approx(0.0))


@pytest.mark.parametrize("error", [GONE, can.CanOperationError("the adapter does not answer")])
def test_what_cannot_come_back_is_an_error_unless_it_is_to_last(error: Exception) -> None:
    clock = FakeClock()
    with pytest.raises(BusError, match=r"^the bus fails: "):
        received(FakeBus(clock, [(0.5, error)]), clock, 1.0)
    bus = FakeBus(clock, [(0.5, error), (2.0, message(2))])
    came, said = received(bus, clock, 3.0, lasts=True)
    assert came == [2]
    assert len(said) == 2


def test_frames_go_on_after_a_link_was_down(caplog: pytest.LogCaptureFixture) -> None:
    clock = FakeClock()
    down = can.CanOperationError("Error receiving: Network is down", errno.ENETDOWN)
    plan = [(0.1, message(1, timestamp=1000.1)), (0.5, down), (2.0, message(2, timestamp=1002.0))]
    reader = MessageReader(3.0, clock, clock, clock.sleep)
    frames = [(at, one.can_id) for at, one in classic(reader.bus(FakeBus(clock, plan)))]  # type: ignore[arg-type]
    assert frames == [(0.0, 1), (pytest.approx(1.9), 2)]
    assert caplog.messages == [f"the bus fails: {down}", WORKS]


class BusOnSocket:
    """A bus of python-can with a descriptor; -1: one that says so wrongly."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def fileno(self) -> int:
        return self._descriptor


def test_more_frames_wait_in_a_socket_than_by_default_and_what_is_none_is_left_alone(tmp_path: Path) -> None:
    one, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with one, other, (tmp_path / "serial").open("wb") as file:
        before = one.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        for descriptor in (one.fileno(), file.fileno(), -1):
            bus: Any = BusOnSocket(descriptor)
            enlarge_queue_of(bus)
        assert one.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) >= before
        other.send(b"x")
        assert one.recv(1) == b"x", "it is still open"
        assert file.write(b"x") == 1
    with can.Bus(interface="virtual", channel="canfb no socket") as virtual:
        enlarge_queue_of(virtual)
