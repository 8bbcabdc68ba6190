"""The master's side on a python-can bus, alone or shared: what it hears and sends, and a bus that fails."""

from __future__ import annotations

import queue
import re
import threading
from collections.abc import Iterator
from datetime import datetime
from typing import Any
from uuid import uuid4

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.bus.bus_master import BusMaster
from canfb.bus.clocks import date_and_time
from canfb.bus.shared_bus import SharedBus, only_reads
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


AT_ONCE_S, PATIENCE_S = 0.0, 30.0
UPLOAD = b"\x40" + bytes(7)


@pytest.fixture
def channel() -> str:
    return f"shared {uuid4()}"


@pytest.fixture
def other(channel: str) -> Iterator[can.BusABC]:
    with can.Bus(interface="virtual", channel=channel) as bus:
        yield bus


@pytest.fixture
def shared(channel: str) -> Iterator[SharedBus]:
    with SharedBus(can.Bus(interface="virtual", channel=channel)) as bus:
        yield bus


def test_all_hear_and_all_send(shared: SharedBus, other: can.BusABC) -> None:
    branch = shared.branch()
    other.send(message(0x1A0))
    for bus in (shared, branch):
        heard = bus.recv(PATIENCE_S)
        assert heard is not None
        assert heard.arbitration_id == 0x1A0
        bus.send(message(0x601, UPLOAD))
        sent = other.recv(PATIENCE_S)
        assert sent is not None
        assert sent.arbitration_id == 0x601
    branch.shutdown()
    other.send(message(0x1A1))
    assert shared.recv(PATIENCE_S) is not None  # it still runs
    assert branch.recv(AT_ONCE_S) is None


def test_what_is_no_upload_is_not_sent(shared: SharedBus, other: can.BusABC) -> None:
    for bus in (shared, shared.branch()):
        with pytest.raises(can.CanOperationError, match="SDO uploads alone"):
            bus.send(message(0x601, b"\x23" + UPLOAD[1:]))
    assert other.recv(AT_ONCE_S) is None


FRAMES = st.builds(
    can.Message,
    arbitration_id=st.one_of(st.integers(0, 0x7FF), st.integers(0x600, 0x680)),
    data=st.binary(max_size=8),
    is_extended_id=st.booleans(),
    is_remote_frame=st.booleans(),
)


@given(FRAMES)
def test_only_uploads_may_be_sent(sent: can.Message) -> None:
    upload = (
        0x601 <= sent.arbitration_id <= 0x67F
        and len(sent.data) == 8
        and sent.data[0] >> 5 in (2, 3, 4, 5)
        and not sent.is_extended_id
        and not sent.is_remote_frame
    )
    assert only_reads(sent) is upload


def test_a_bus_that_fails_fails_for_all(channel: str, monkeypatch: pytest.MonkeyPatch) -> None:
    inner = can.Bus(interface="virtual", channel=channel)

    def gone(timeout: float | None) -> None:
        raise can.CanOperationError("the adapter is gone")

    monkeypatch.setattr(inner, "recv", gone)
    with SharedBus(inner) as shared, BusMaster(shared.branch()) as master:
        with pytest.raises(can.CanOperationError):
            shared.recv(AT_ONCE_S)
        with pytest.raises(BusError, match="the adapter is gone"):
            master.wait(PATIENCE_S)


def test_a_master_reads_while_another_thread_receives(shared: SharedBus, other: can.BusABC) -> None:
    """An SDO upload over a branch, answered by the other end; the frames arrive in the other thread."""
    done = threading.Event()

    def receive() -> None:
        while not done.is_set():
            shared.recv(0.05)

    def answer() -> None:
        while not done.is_set():
            asked = other.recv(0.05)
            if asked is not None:
                other.send(message(0x5A0, b"\x43" + bytes(asked.data[1:4]) + b"\x78\x56\x34\x12"))

    threads = [threading.Thread(target=one) for one in (receive, answer)]
    for one in threads:
        one.start()
    try:
        with BusMaster(shared.branch(), PATIENCE_S) as master:
            assert master.sdo(0x20) is master.sdo(0x20)
            assert master.sdo(0x20).upload(0x1000, 0) == b"\x78\x56\x34\x12"
    finally:
        done.set()
        for one in threads:
            one.join()
