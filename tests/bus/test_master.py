"""The master's side on a python-can bus: what it hears, what it sends, and a bus that fails."""

from __future__ import annotations

import queue
import re
from collections.abc import Iterator
from datetime import datetime
from typing import Any

import can
import pytest

from canfb.bus.bus_master import BusMaster
from canfb.bus.clocks import date_and_time
from canfb.errors import BusError
from fake_bus import message

CHANNEL = "canfb-master"


def open_virtual(**options: Any) -> can.BusABC:
    return can.Bus(interface="virtual", channel=CHANNEL, **options)


@pytest.fixture
def peer() -> Iterator[can.BusABC]:
    with open_virtual() as bus:
        yield bus


def test_it_hears_what_it_has_subscribed_to_and_nothing_else(peer: can.BusABC) -> None:
    heard: queue.Queue[tuple[int, bytes]] = queue.Queue()

    def hear(can_id: int, data: bytes, timestamp: float) -> None:
        assert timestamp > 0.0
        heard.put((can_id, bytes(data)))

    with BusMaster(open_virtual()) as master:
        master.subscribe(0x190, hear)
        for one in (
            message(0x191, b"no"),
            message(0x190, b"no", is_extended_id=True),
            message(0x190, is_remote_frame=True),
            message(0x190, b"yes"),
        ):
            peer.send(one)
        assert heard.get(timeout=5.0) == (0x190, b"yes")
        master.unsubscribe(0x190, hear)
        master.subscribe(0x191, hear)
        peer.send(message(0x190, b"no"))
        peer.send(message(0x191, b"yes"))
        assert heard.get(timeout=5.0) == (0x191, b"yes")
    assert heard.empty()


def test_what_it_sends(peer: can.BusABC) -> None:
    with BusMaster(open_virtual()) as master:
        master.request(0x720)
        master.send(0x000, b"\x01\x20")
    for want in ((0x720, b"", True, False), (0x000, b"\x01\x20", False, False)):
        got = peer.recv(5.0)
        assert got is not None
        assert (got.arbitration_id, bytes(got.data), got.is_remote_frame, got.is_extended_id) == want


def test_the_sync_is_produced_until_the_end_and_heard_by_itself(peer: can.BusABC) -> None:
    heard: queue.Queue[int] = queue.Queue()
    with BusMaster(open_virtual(receive_own_messages=True)) as master:
        master.subscribe(0x80, lambda can_id, data, timestamp: heard.put(can_id))
        master.produce_sync(200.0)
        for _ in range(5):
            assert heard.get(timeout=5.0) == 0x80
    while peer.recv(0.0) is not None:
        pass
    assert peer.recv(0.05) is None, "no more of it"


class FailingBus(can.BusABC):
    """Receives and sends only errors."""

    def __init__(self) -> None:
        super().__init__(channel="failing")
        self.sent = 0

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        raise OSError(100, "Network is down")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise can.CanOperationError("no buffer space")


def test_a_bus_that_fails_is_one_line_and_no_traceback(capfd: pytest.CaptureFixture[str]) -> None:
    with BusMaster(FailingBus()) as master:
        with pytest.raises(BusError, match=re.escape("the bus fails: Network is down")):
            master.wait(5.0)
        with pytest.raises(BusError, match="the bus fails"):
            master.check()
        with pytest.raises(
            BusError, match=r"the bus fails: Network is down|could not be sent: no buffer space"
        ):
            master.send(0x80, b"")
    assert capfd.readouterr().err == ""


def test_time_passes(peer: can.BusABC) -> None:
    with BusMaster(open_virtual()) as master:
        began = master.now()
        master.wait(0.02)
        assert master.now() - began >= 0.02
        master.wait(0.0)
    before = datetime.now().astimezone().replace(microsecond=0)
    assert before <= datetime.fromisoformat(date_and_time()) <= datetime.now().astimezone()
